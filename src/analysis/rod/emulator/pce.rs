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
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::rod::beam::Section;
    use crate::rod::emulator::OrExact;
    use crate::rod::prior::Prior;
    use std::sync::LazyLock;

    static TODI: LazyLock<(Training, Pce)> = LazyLock::new(|| {
        let prior = RodPrior::todi();
        let training = Training::solve(&prior, 5, 50, &|_, _| ()).unwrap();
        let pce = Pce::from_training(&prior, &training, Weighting::Equal);
        (training, pce)
    });

    #[test]
    fn the_papers_chaos_has_the_errors_that_independent_checks_found() {
        let (_, pce) = &*TODI;
        assert_eq!(pce.terms(), 462);
        let report = pce.report();
        let grid = report.grid.as_ref().unwrap();
        // Design 4.8: about 6e-6, 3e-5, 1e-4 Hz^2; least squares with a constant term has no mean error.
        for (errors, expected) in grid.iter().zip([6e-6, 3e-5, 1e-4]) {
            assert!((errors.variance_hz2 / expected - 1.0).abs() < 0.3, "{errors:?}");
            assert!(errors.mean_hz.abs() < 1e-10);
        }
        // Design 4.2: rms 5e-4, 4e-4, 5e-4, maximum 2e-2.
        for (errors, expected) in report.modes.iter().zip([5e-4, 4e-4, 5e-4]) {
            assert!((errors.relative.rms / expected - 1.0).abs() < 0.3, "{errors:?}");
            assert!(errors.relative.max < 2e-2);
        }
        // Five germs of six or so lie outside 3.32 standard deviations once in 1100 draws each.
        assert!(report.outside > 40 && report.outside < 200, "{}", report.outside);
    }

    #[test]
    fn weighting_by_the_quadrature_is_better_in_the_mean_and_worse_on_the_grid() {
        let (training, equal) = &*TODI;
        let weighted = Pce::from_training(&RodPrior::todi(), training, Weighting::Quadrature);
        for mode in 0..3 {
            let rms = |pce: &Pce| pce.report().modes[mode].value_hz.rms;
            let variance = |pce: &Pce| pce.report().grid.as_ref().unwrap()[mode].variance_hz2;
            assert!(rms(&weighted) < rms(equal));
            assert!(variance(&weighted) > variance(equal));
        }
    }

    #[test]
    fn slopes_are_the_derivatives_of_the_values() {
        let (_, pce) = &*TODI;
        let theta = [7.1e5, 2.2e11, 7800.0, 0.066, 3e5, 5e5, 14.0];
        let mut slopes = [0.0; 5];
        pce.log_slopes(&theta, &mut slopes).unwrap();
        let at = |factor: f64| {
            let mut moved = theta;
            moved[0] *= factor;
            let mut f = [0.0; 5];
            pce.frequencies(&moved, &mut f).unwrap();
            f
        };
        let h = 1e-5f64;
        let (up, down) = (at(h.exp()), at((-h).exp()));
        for i in 0..5 {
            assert!(((up[i] / down[i]).ln() / (2.0 * h) - slopes[i]).abs() < 1e-8);
        }
    }

    #[test]
    fn a_point_has_the_same_bits_alone_and_in_a_block_and_outside_the_exact_model_answers() {
        let prior = RodPrior::todi();
        let (_, pce) = &*TODI;
        let either = OrExact::new(pce.clone());
        let exact = Exact::new(*prior.parameterisation());
        let mut generator = random::stream(11, 0);
        let count = 20 * LANES + 3;
        let mut thetas = vec![0.0; 7 * count];
        thetas
            .chunks_exact_mut(7)
            .for_each(|theta| prior.sample(&mut generator, theta));
        // Far outside, another length, and no rod at all.
        thetas[0] = 3e6;
        thetas[7 + 6] = 13.0;
        thetas[14] = -1.0;
        let (mut alone, mut many, mut any) = ([0.0; 4], vec![0.0; 4 * count], vec![0.0; 4 * count]);
        pce.frequencies_of_many(&thetas, 4, &mut many);
        either.frequencies_of_many(&thetas, 4, &mut any);
        for (i, theta) in thetas.chunks_exact(7).enumerate() {
            let (row, any) = (&many[4 * i..4 * i + 4], &any[4 * i..4 * i + 4]);
            match pce.frequencies(theta, &mut alone) {
                Ok(()) => assert!(row == alone && any == alone && i > 2),
                Err(_) if i == 2 => assert!(any.iter().all(|f| f.is_nan())),
                Err(_) => {
                    assert!(row.iter().all(|f| f.is_nan()));
                    exact.frequencies(theta, &mut alone).unwrap();
                    assert_eq!(any, alone);
                }
            }
        }
        let error = pce.frequencies(&thetas[..7], &mut alone).unwrap_err();
        assert_eq!((error.what, error.value), ("axial_force_n", 3e6));
        let error = pce.frequencies(&thetas[7..14], &mut alone).unwrap_err();
        assert_eq!((error.what, error.low, error.high), ("length_m", 14.0, 14.0));
    }

    #[test]
    fn every_kind_of_prior_can_be_a_germ() {
        let priors = vec![
            Prior::LogNormal {
                median: 2e5,
                log_sd: 0.2,
            },
            Prior::Uniform {
                low: 1.9e11,
                high: 2.1e11,
            },
            Prior::Fixed { value: 7800.0 },
            Prior::TruncatedNormal {
                mean: 0.03,
                sd: 0.001,
            },
            Prior::Uniform { low: 0.0, high: 5e4 },
            Prior::Fixed { value: 0.0 },
            Prior::Fixed { value: 6.0 },
        ];
        let prior = RodPrior::new(Parameterisation::new(Section::Round), priors).unwrap();
        let pce = Pce::fit(&prior, 6, 20, &|_, _| ()).unwrap();
        for mode in &pce.report().modes[..3] {
            assert!(mode.relative.rms < 1e-3, "{mode:?}");
            assert!(mode.slope.unwrap().rms < 5e-3, "{mode:?}");
        }
    }

    #[test]
    fn what_cannot_be_expanded_is_refused() {
        let fixed = |value| Prior::Fixed { value };
        let all_fixed = [8e5, 4e5, 37.0, 4e5, 4e5, 14.0].map(fixed).to_vec();
        let direct = Parameterisation::new(Section::Direct);
        let prior = RodPrior::new(direct, all_fixed.clone()).unwrap();
        assert_eq!(
            Pce::fit(&prior, 3, 10, &|_, _| ()).unwrap_err(),
            FitError::NothingUncertain
        );
        let todi = RodPrior::todi();
        assert_eq!(
            Pce::fit(&todi, 0, 10, &|_, _| ()).unwrap_err(),
            FitError::Order { order: 0 }
        );
        let error = Pce::fit(&todi, 12, 10, &|_, _| ()).unwrap_err();
        assert_eq!(
            error,
            FitError::TooLarge {
                order: 12,
                germs: 6,
                points: 13usize.pow(6)
            }
        );
        // A known force leaves frequencies, but no slope.
        let mut known_force = all_fixed;
        known_force[3] = Prior::TruncatedNormal { mean: 4e5, sd: 4e4 };
        let prior = RodPrior::new(direct, known_force).unwrap();
        let pce = Pce::fit(&prior, 3, 10, &|_, _| ()).unwrap();
        assert!(pce.log_slopes(&prior.centre(), &mut [0.0]).is_err());
        assert!(pce.report().modes.iter().all(|mode| mode.slope.is_none()));
    }
}
