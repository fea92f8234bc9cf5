//! The paper's emulator (section 4.4): Hermite chaos of the natural frequencies in the germs of one rod.
//!
//! Its trained range is the box spanned by the design's points (for order 5, 3.32 standard deviations
//! either side of the mean): beyond it a polynomial of order 5 cannot be trusted, and a query there is an
//! error.

use super::design::{Axis, Design};
use super::domain::Domain;
use super::expansion::{Expansion, LANES};
use super::fit::Weighting;
use super::sobol::{self, Indices};
use super::training::split;
use super::validate::{self, ErrorReport, GridErrors};
use crate::numerics::orthogonal::Recurrence;
use crate::numerics::simd::{Kernel, vectorised};
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::beam::{Exact, OutsideRange, Parameterisation, Quantity};
use crate::rod::prior::RodPrior;
use serde::{Deserialize, Serialize};

pub use super::training::{FitError, MAX_ORDER, MAX_POINTS, Training};

/// Version of the fit, raised whenever the same settings would give other coefficients.
pub const VERSION: u32 = 1;
/// Name of the model in errors.
const MODEL: &str = "Hermite chaos";
/// Fitted coefficients with their error report, as kept in the cache.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// One expansion per mode.
    pub expansions: Vec<Expansion>,
    /// Error report of the fit.
    pub report: ErrorReport,
}

/// A fitted Hermite chaos.
#[derive(Debug, Clone)]
pub struct Pce {
    prior: RodPrior,
    order: usize,
    domain: Domain,
    hermite: Recurrence,
    outer: Vec<Vec<usize>>,
    inner: Vec<Vec<usize>>,
    fitted: Fitted,
}

impl Pce {
    /// Solves the model on the design, fits the expansions and measures their errors.
    pub fn fit(
        prior: &RodPrior,
        order: usize,
        elements: usize,
        solved: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self, FitError> {
        let training = Training::solve(prior, order, elements, solved)?;
        Ok(Self::from_training(prior, &training, Weighting::Equal))
    }

    /// Fits the expansions and measures their errors.
    pub fn from_training(prior: &RodPrior, training: &Training, weighting: Weighting) -> Self {
        let fitted = Fitted {
            expansions: training.fit(MAX_MODES, weighting),
            report: ErrorReport::default(),
        };
        let mut pce = Self::assemble(prior, training.order, training.design.clone(), fitted);
        let exact = Exact::new(*prior.parameterisation());
        let mut report = pce.validate(&exact, (validate::SAMPLE, validate::SEED), &|_| ());
        report.grid = Some(pce.grid_errors(training));
        pce.fitted.report = report;
        pce
    }

    /// Restores coefficients fitted earlier with the same prior and order; `None` if they do not fit.
    pub fn restore(prior: &RodPrior, order: usize, fitted: Fitted) -> Option<Self> {
        if order == 0 || order > MAX_ORDER {
            return None;
        }
        let pce = Self::assemble(prior, order, Design::new(prior, order), fitted);
        let fits = |expansion: &Expansion| expansion.fits(pce.outer.len(), pce.inner.len());
        let complete = pce.fitted.expansions.len() == MAX_MODES;
        (complete && pce.fitted.expansions.iter().all(fits)).then_some(pce)
    }

    fn assemble(prior: &RodPrior, order: usize, design: Design, fitted: Fitted) -> Self {
        let (outer, inner) = split(design.axes.len(), order);
        let domain = Domain::new(MODEL, prior, &design);
        let prior = prior.clone();
        Self {
            prior,
            order,
            domain,
            hermite: Recurrence::hermite(order),
            outer,
            inner,
            fitted,
        }
    }

    /// The error report made when it was fitted, against the exact model.
    pub fn report(&self) -> &ErrorReport {
        &self.fitted.report
    }

    /// Coefficients and report.
    pub fn fitted(&self) -> &Fitted {
        &self.fitted
    }

    /// Total order of the chaos.
    pub fn order(&self) -> usize {
        self.order
    }

    /// Terms per mode.
    pub fn terms(&self) -> usize {
        self.fitted.expansions.first().map_or(0, Expansion::terms)
    }

    /// Sobol's indices of the quantities of [`Pce::uncertain`], mode by mode.
    pub fn sobol(&self) -> Vec<Indices> {
        let of = |expansion: &Expansion| {
            let terms: Vec<(Vec<usize>, f64)> = expansion
                .iter()
                .map(|(a, b, c)| ([self.outer[a].as_slice(), &self.inner[b]].concat(), c))
                .collect();
            let terms = terms.iter().map(|(index, c)| (index.as_slice(), *c));
            sobol::of_terms(self.domain.axes.len(), terms)
        };
        self.fitted.expansions.iter().map(of).collect()
    }

    /// The quantities it expands in.
    pub fn uncertain(&self) -> Vec<Quantity> {
        self.domain.axes.iter().map(|axis| axis.germ.quantity).collect()
    }

    /// Measures its errors against `reference` on another sample (draws and seed) from its prior, see
    /// [`validate::on_prior`].
    pub fn validate(
        &self,
        reference: &dyn ForwardModel,
        sample: (usize, u64),
        judged: &(dyn Fn(usize) + Sync),
    ) -> ErrorReport {
        let extrapolate = |theta: &[f64], values: &mut [f64], slopes: &mut [f64]| {
            self.evaluate(theta, values);
            self.slopes(theta, slopes).or_else(|_| {
                slopes.fill(f64::NAN);
                Ok(())
            })
        };
        validate::on_prior(self, Some(&extrapolate), reference, &self.prior, sample, judged)
    }

    fn grid_errors(&self, training: &Training) -> Vec<GridErrors> {
        let points = training.design.len();
        let width = self.prior.parameterisation().len();
        let mut theta = vec![0.0; width];
        let mut answer = [0.0; MAX_MODES];
        let (mut sum, mut squares) = ([0.0; MAX_MODES], [0.0; MAX_MODES]);
        for i in 0..points {
            training.design.theta(i, &mut theta);
            self.evaluate(&theta, &mut answer);
            for mode in 0..MAX_MODES {
                let error = answer[mode] - training.values[mode][i];
                sum[mode] += error;
                squares[mode] += error * error;
            }
        }
        (0..MAX_MODES)
            .map(|mode| {
                let mean = sum[mode] / points as f64;
                let variance_hz2 = squares[mode] / points as f64 - mean * mean;
                GridErrors {
                    order: mode + 1,
                    mean_hz: mean,
                    variance_hz2,
                }
            })
            .collect()
    }

    /// Values of the expansions without a check of the range.
    fn evaluate(&self, theta: &[f64], out: &mut [f64]) {
        let germs = self.domain.germs(theta);
        let mut rows = [[0.0]; MAX_MODES];
        let mut scratch = self.scratch();
        self.block(&germs, &mut scratch, &mut rows[..out.len()]);
        out.iter_mut().zip(rows).for_each(|(out, [f])| *out = f);
    }

    /// The germ of the axial force, or a refusal if the force is fixed: the chaos then has no slope.
    fn force(&self) -> Result<&Axis, OutsideRange> {
        let value = self.prior.priors()[0].centre();
        let refusal = OutsideRange {
            model: MODEL,
            what: "axial_force_n",
            value,
            low: value,
            high: value,
        };
        self.domain
            .axes
            .first()
            .filter(|axis| axis.germ.index == 0)
            .ok_or(refusal)
    }

    /// Slopes of the expansions without a check of the range.
    fn slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        let axis = self.force()?;
        let germs = self.domain.germs(theta);
        let mut scratch = self.scratch::<1>();
        let mut values = [[0.0]; MAX_MODES];
        self.block(&germs, &mut scratch, &mut values[..out.len()]);
        // Replace the first germ's polynomials by their derivatives.
        let mut polynomials = vec![[0.0]; self.order + 1];
        let mut derivatives = vec![[0.0]; self.order + 1];
        self.hermite
            .values_and_slopes(germs[0][0], &mut polynomials, &mut derivatives);
        scratch.polynomials[..=self.order].copy_from_slice(&derivatives);
        products(&self.outer, &scratch.polynomials, self.order, &mut scratch.outer);
        // The derivative of the constant is zero, which a product of the factors above degree 0 omits.
        for (outer, _) in scratch
            .outer
            .iter_mut()
            .zip(&self.outer)
            .filter(|(_, index)| index[0] == 0)
        {
            *outer = [0.0];
        }
        let factor = axis.germ.by_log_value(germs[0][0], theta[0]);
        for ((out, expansion), [value]) in out.iter_mut().zip(&self.fitted.expansions).zip(values) {
            *out = factor * expansion.evaluate(&scratch.outer, &scratch.inner)[0] / value;
        }
        Ok(())
    }

    fn scratch<const L: usize>(&self) -> Scratch<L> {
        Scratch {
            polynomials: vec![[0.0; L]; self.domain.axes.len() * (self.order + 1)],
            outer: vec![[0.0; L]; self.outer.len()],
            inner: vec![[0.0; L]; self.inner.len()],
        }
    }

    /// Frequencies \[Hz\] at `L` points given by their germs (germs x points), mode by mode.
    #[inline(always)]
    fn block<const L: usize>(&self, germs: &[[f64; L]], scratch: &mut Scratch<L>, out: &mut [[f64; L]]) {
        for (z, values) in germs
            .iter()
            .zip(scratch.polynomials.chunks_exact_mut(self.order + 1))
        {
            self.hermite.values(z, values);
        }
        let first_inner = (germs.len() - germs.len() / 2) * (self.order + 1);
        let (outer, inner) = scratch.polynomials.split_at(first_inner);
        products(&self.outer, outer, self.order, &mut scratch.outer);
        products(&self.inner, inner, self.order, &mut scratch.inner);
        for (out, expansion) in out.iter_mut().zip(&self.fitted.expansions) {
            *out = expansion.evaluate(&scratch.outer, &scratch.inner);
        }
    }
}

/// [`Pce::block`] as work to be vectorised.
struct Block<'a> {
    pce: &'a Pce,
    germs: &'a [[f64; LANES]],
    scratch: &'a mut Scratch<LANES>,
    out: &'a mut [[f64; LANES]],
}

impl Kernel for Block<'_> {
    #[inline(always)]
    fn run(self) {
        self.pce.block(self.germs, self.scratch, self.out);
    }
}

/// Working space of one block.
struct Scratch<const L: usize> {
    polynomials: Vec<[f64; L]>,
    outer: Vec<[f64; L]>,
    inner: Vec<[f64; L]>,
}

/// The products of the univariate polynomials that the multi-indices name.
#[inline(always)]
fn products<const L: usize>(
    indices: &[Vec<usize>],
    polynomials: &[[f64; L]],
    order: usize,
    out: &mut [[f64; L]],
) {
    for (out, index) in out.iter_mut().zip(indices) {
        *out = [1.0; L];
        for (&degree, values) in index.iter().zip(polynomials.chunks_exact(order + 1)) {
            if degree > 0 {
                for l in 0..L {
                    out[l] *= values[degree][l];
                }
            }
        }
    }
}

impl ForwardModel for Pce {
    fn name(&self) -> &'static str {
        "pce"
    }

    fn parameterisation(&self) -> &Parameterisation {
        self.prior.parameterisation()
    }

    fn modes(&self) -> usize {
        MAX_MODES
    }

    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        self.domain.check(theta)?;
        self.evaluate(theta, out);
        Ok(())
    }

    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        self.domain.check(theta)?;
        self.slopes(theta, out)
    }

    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        let mut scratch = self.scratch();
        self.domain.in_blocks(self, (thetas, modes, out), |germs, rows| {
            vectorised(Block {
                pce: self,
                germs,
                scratch: &mut scratch,
                out: rows,
            });
        });
    }
}

#[cfg(test)]
mod tests;
