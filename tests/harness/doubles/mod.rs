//! Forward models with answers known in closed form, to judge the inference against.
#![allow(dead_code, reason = "each test file uses its part")]

pub mod metropolis;

use std::f64::consts::PI;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::beam::{OutsideRange, Parameterisation, Section};
use tirante::analysis::rod::prior::{Prior, RodPrior};

/// Frequencies linear in axial force and flexural rigidity: with normal priors and normal errors the
/// posterior is normal, with mean and covariance in closed form.
pub struct Linear {
    parameterisation: Parameterisation,
}

impl Linear {
    /// Slopes (per unit of force, per unit of rigidity) of the modes.
    pub const SLOPES: [[f64; 2]; 5] = [[0.3, 0.0], [0.5, 0.1], [0.6, 0.4], [0.9, 0.7], [1.2, 1.4]];
    /// Frequencies at zero force and rigidity \[Hz\].
    pub const OFFSETS: [f64; 5] = [1.0, 4.0, 10.0, 20.0, 30.0];
    /// Prior means and standard deviations: ten standard deviations from zero, where truncation
    /// changes nothing.
    pub const PRIOR: [(f64, f64); 2] = [(10.0, 1.0), (20.0, 2.0)];

    pub fn new() -> Self {
        Self {
            parameterisation: Parameterisation::new(Section::Direct),
        }
    }

    pub fn prior() -> RodPrior {
        let normal = |(mean, sd)| Prior::TruncatedNormal { mean, sd };
        let fixed = |value| Prior::Fixed { value };
        RodPrior::new(
            Parameterisation::new(Section::Direct),
            vec![
                normal(Self::PRIOR[0]),
                normal(Self::PRIOR[1]),
                fixed(1.0),
                fixed(0.0),
                fixed(0.0),
                fixed(1.0),
            ],
        )
        .unwrap()
    }

    /// Posterior mean and covariance of (force, rigidity) given frequencies with errors of these
    /// variances, by the textbook update with one scalar observation after another.
    pub fn posterior(orders: &[usize], y: &[f64], variance: &[f64]) -> ([f64; 2], [[f64; 2]; 2]) {
        let mut mean = [Self::PRIOR[0].0, Self::PRIOR[1].0];
        let mut p = [[Self::PRIOR[0].1.powi(2), 0.0], [0.0, Self::PRIOR[1].1.powi(2)]];
        for ((&order, &y), &r) in orders.iter().zip(y).zip(variance) {
            let h = Self::SLOPES[order - 1];
            let ph = [p[0][0] * h[0] + p[0][1] * h[1], p[1][0] * h[0] + p[1][1] * h[1]];
            let s = h[0] * ph[0] + h[1] * ph[1] + r;
            let innovation = y - Self::OFFSETS[order - 1] - h[0] * mean[0] - h[1] * mean[1];
            for i in 0..2 {
                mean[i] += ph[i] / s * innovation;
                for j in 0..2 {
                    p[i][j] -= ph[i] * ph[j] / s;
                }
            }
        }
        (mean, p)
    }
}

impl ForwardModel for Linear {
    fn name(&self) -> &'static str {
        "linear"
    }
    fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }
    fn modes(&self) -> usize {
        5
    }
    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        for (mode, f) in out.iter_mut().enumerate() {
            let [a, b] = Self::SLOPES[mode];
            *f = Self::OFFSETS[mode] + a * theta[0] + b * theta[1];
        }
        Ok(())
    }
}

/// The hinged tensioned beam: f_n = n / (2 l) sqrt(N / m) sqrt(1 + n^2 pi^2 EI / (N l^2)).
/// Refuses forces below `lowest_force`, as an emulator refuses parameters outside its trained range.
pub struct Hinged {
    parameterisation: Parameterisation,
    pub lowest_force: f64,
}

impl Hinged {
    pub fn new() -> Self {
        Self {
            parameterisation: Parameterisation::new(Section::Square),
            lowest_force: 0.0,
        }
    }
}

impl ForwardModel for Hinged {
    fn name(&self) -> &'static str {
        "hinged"
    }
    fn parameterisation(&self) -> &Parameterisation {
        &self.parameterisation
    }
    fn modes(&self) -> usize {
        5
    }
    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        if theta[0] < self.lowest_force {
            return Err(OutsideRange {
                model: "hinged",
                what: "axial force",
                value: theta[0],
                low: self.lowest_force,
                high: f64::INFINITY,
            });
        }
        let beam = self.parameterisation.beam(theta);
        let (l, force) = (beam.length_m, beam.axial_force_n);
        let string = (force / beam.mass_per_length_kg_m).sqrt() / (2.0 * l);
        let bending = PI * PI * beam.flexural_rigidity_n_m2 / (force * l * l);
        for (mode, f) in out.iter_mut().enumerate() {
            let n = (mode + 1) as f64;
            *f = n * string * (1.0 + n * n * bending).sqrt();
        }
        Ok(())
    }
}
