//! Sensitivity of the frequencies: Sobol's indices, and figure 4's curves over the springs.

use super::StudyError;
use super::estimate::{Comparison, Estimate};
use crate::rod::beam::forward::ForwardModel;
use crate::rod::beam::{Exact, Quantity};
use crate::rod::emulator::Pce;
use crate::rod::emulator::sobol::{self, Indices, Problem};
use crate::rod::prior::RodPrior;
use serde::Serialize;

/// Number of modes.
const MODES: usize = 3;
/// Replications of the Monte Carlo estimate, and pairs of draws in each.
const REPLICATIONS: u64 = 16;
const PAIRS: usize = 4096;
/// Number of points of the curves, and their range \[N m/rad\].
const POINTS: usize = 81;
const STIFFNESS: (f64, f64) = (1e3, 1e9);

/// Sobol's indices of one quantity and mode, from the chaos and by Monte Carlo.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sensitivity {
    /// Mode order, from 1.
    pub order: usize,
    /// Quantity of the indices.
    pub quantity: Quantity,
    /// First-order index from the chaos.
    pub first: f64,
    /// Total index from the chaos.
    pub total: f64,
    /// First-order index by Monte Carlo on the exact model.
    pub first_monte_carlo: Estimate,
    /// Total index by Monte Carlo on the exact model.
    pub total_monte_carlo: Estimate,
}

impl Sensitivity {
    /// Figures of the indices.
    pub fn comparisons(&self) -> Vec<Comparison> {
        let column = format!("mode {}", self.order);
        [
            ("first order, chaos", Estimate::sure(self.first)),
            ("first order, Monte Carlo", self.first_monte_carlo),
            ("total, chaos", Estimate::sure(self.total)),
            ("total, Monte Carlo", self.total_monte_carlo),
        ]
        .map(|(name, ours)| Comparison::new("Sobol indices", &column, self.quantity.key(), name, None, ours))
        .to_vec()
    }
}

/// The indices of the first three modes under the chaos's prior.
pub fn indices(prior: &RodPrior, pce: &Pce, seed: u64) -> Vec<Sensitivity> {
    let exact = Exact::new(*prior.parameterisation());
    let problem = Problem {
        variables: prior.priors().len(),
        outputs: MODES,
        sample: &|generator, theta| prior.sample(generator, theta),
        evaluate: &|theta, out| {
            if exact.frequencies(theta, out).is_err() {
                out.fill(f64::NAN);
            }
        },
    };
    let replications: Vec<Vec<Indices>> = (0..REPLICATIONS)
        .map(|i| sobol::saltelli(&problem, PAIRS, seed.wrapping_add(i)))
        .collect();
    let chaos = pce.sobol();
    let mut all = Vec::new();
    for (mode, from_chaos) in chaos.iter().take(MODES).enumerate() {
        for (germ, quantity) in pce.uncertain().into_iter().enumerate() {
            let Some(variable) = prior.parameterisation().index(quantity) else {
                continue;
            };
            let over = |of: &dyn Fn(&Indices) -> f64| {
                Estimate::of(replications.iter().map(|outputs| of(&outputs[mode])))
            };
            all.push(Sensitivity {
                order: mode + 1,
                quantity,
                first: from_chaos.first[germ],
                total: from_chaos.total[germ],
                first_monte_carlo: over(&|indices| indices.first[variable]),
                total_monte_carlo: over(&|indices| indices.total[variable]),
            });
        }
    }
    all
}

/// Frequencies over the stiffness of both springs, everything else at its prior mean (figure 4).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Springs {
    /// Stiffness of either spring \[N m/rad\].
    pub stiffness_n_m: Vec<f64>,
    /// Frequencies of the first three modes \[Hz\].
    pub frequency_hz: Vec<[f64; MODES]>,
    /// Frequencies on hinges \[Hz\].
    pub hinged_hz: [f64; MODES],
    /// Frequencies on clamps \[Hz\].
    pub clamped_hz: [f64; MODES],
}

/// Computes figure 4.
///
/// # Errors
/// The prior means are no rod.
pub fn springs(prior: &RodPrior) -> Result<Springs, StudyError> {
    let exact = Exact::new(*prior.parameterisation());
    let at = |stiffness: f64| -> Result<[f64; MODES], StudyError> {
        let mut theta = prior.centre();
        for quantity in [Quantity::SpringLeft, Quantity::SpringRight] {
            if let Some(i) = prior.parameterisation().index(quantity) {
                theta[i] = stiffness;
            }
        }
        let mut y = [0.0; MODES];
        exact.frequencies(&theta, &mut y)?;
        Ok(y)
    };
    let (low, high) = (libm::log(STIFFNESS.0), libm::log(STIFFNESS.1));
    let stiffness_n_m: Vec<f64> = (0..POINTS)
        .map(|i| libm::exp(low + (high - low) * i as f64 / (POINTS - 1) as f64))
        .collect();
    Ok(Springs {
        frequency_hz: stiffness_n_m.iter().map(|&k| at(k)).collect::<Result<_, _>>()?,
        stiffness_n_m,
        hinged_hz: at(0.0)?,
        clamped_hz: at(f64::INFINITY)?,
    })
}
