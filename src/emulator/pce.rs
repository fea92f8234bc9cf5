//! The paper's emulator (section 4.4): Hermite chaos of the natural frequencies in the germs of one rod.
//!
//! Its trained range is the box spanned by the design's points (for order 5, 3.32 standard deviations
//! either side of the mean): beyond it a polynomial of order 5 is anybody's guess, and a query is refused.

use super::basis::{Recurrence, total_degree};
use super::design::{Axis, Design};
use super::expansion::{Expansion, LANES, vectorised};
use super::fit::{Weighting, coefficients};
use super::validate::{self, ErrorReport, GridErrors};
use crate::bayes::RodPrior;
use crate::beam::{Exact, FiniteElements, Parameterisation};
use crate::forward::{ForwardModel, MAX_MODES, OutsideRange};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Raised whenever the same settings would give other coefficients.
pub const VERSION: u32 = 1;
/// The most design points that are solved.
pub const MAX_POINTS: usize = 4_000_000;
/// The highest total order.
pub const MAX_ORDER: usize = 12;
/// The name in refusals.
const MODEL: &str = "Hermite chaos";
/// Design points solved between two reports of progress.
const BLOCK: usize = 256;

/// Why no chaos can be fitted.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FitError {
    /// Every quantity is fixed.
    #[error(
        "the chaos expands uncertain quantities, but every one is fixed; use the exact or the reduced model"
    )]
    NothingUncertain,
    /// The order is not one that can be fitted.
    #[error("chaos order {order}; it must lie between 1 and {MAX_ORDER}")]
    Order {
        /// The order asked for.
        order: usize,
    },
    /// The tensor grid is too large.
    #[error(
        "order {order} with {germs} uncertain quantities needs {points} model solves, at most {MAX_POINTS} are made; lower the order or fix a quantity"
    )]
    TooLarge {
        /// The order asked for.
        order: usize,
        /// Uncertain quantities.
        germs: usize,
        /// Points of the grid.
        points: usize,
    },
    /// The forward model has no answer at a design point.
    #[error("a design point is no rod: {0}")]
    Model(#[from] OutsideRange),
}

/// The fitted coefficients with their error report: what the cache keeps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// One expansion per mode.
    pub expansions: Vec<Expansion>,
    /// Their error report.
    pub report: ErrorReport,
}

/// A fitted Hermite chaos.
#[derive(Debug, Clone)]
pub struct Pce {
    prior: RodPrior,
    order: usize,
    axes: Vec<Axis>,
    hermite: Recurrence,
    outer: Vec<Vec<usize>>,
    inner: Vec<Vec<usize>>,
    fitted: Fitted,
}

/// Frequencies on the design points, to be fitted.
#[derive(Debug, Clone)]
pub struct Training {
    design: Design,
    order: usize,
    /// Per mode, one frequency \[Hz\] per design point.
    values: Vec<Vec<f64>>,
}

impl Training {
    /// Solves the finite-element model on the whole design, in parallel; `solved` is told how many points
    /// more are done, and how many there are.
    pub fn solve(
        prior: &RodPrior,
        order: usize,
        elements: usize,
        solved: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self, FitError> {
        if order == 0 || order > MAX_ORDER {
            return Err(FitError::Order { order });
        }
        let design = Design::new(prior, order);
        let (germs, points) = (design.axes.len(), design.len());
        if germs == 0 {
            return Err(FitError::NothingUncertain);
        }
        if points > MAX_POINTS {
            return Err(FitError::TooLarge { order, germs, points });
        }
        let model = FiniteElements::new(*prior.parameterisation(), elements);
        let mut rows = vec![[0.0; MAX_MODES]; points];
        rows.par_chunks_mut(BLOCK)
            .enumerate()
            .try_for_each(|(block, rows)| {
                let mut theta = vec![0.0; prior.parameterisation().len()];
                for (i, row) in rows.iter_mut().enumerate() {
                    design.theta(block * BLOCK + i, &mut theta);
                    model.frequencies(&theta, row)?;
                }
                solved(rows.len(), points);
                Ok::<(), OutsideRange>(())
            })?;
        let values = (0..MAX_MODES)
            .map(|mode| rows.iter().map(|row| row[mode]).collect())
            .collect();
        Ok(Self {
            design,
            order,
            values,
        })
    }

    /// The expansions of the first `modes` modes, fitted by least squares.
    pub fn fit(&self, modes: usize, weighting: Weighting) -> Vec<Expansion> {
        let (outer, inner) = split(self.design.axes.len(), self.order);
        let count = self.order + 1;
        let place =
            |a: &[usize], b: &[usize]| a.iter().chain(b).fold(0, |place, &degree| place * count + degree);
        let one = |values: &Vec<f64>| {
            let tensor = coefficients(&self.design, self.order, values.clone(), weighting);
            let rows: Vec<Vec<f64>> = outer
                .iter()
                .map(|a| {
                    let left = self.order - a.iter().sum::<usize>();
                    let partners = inner.iter().take_while(|b| b.iter().sum::<usize>() <= left);
                    partners.map(|b| tensor[place(a, b)]).collect()
                })
                .collect();
            Expansion::new(rows.iter().map(Vec::as_slice))
        };
        self.values[..modes].iter().map(one).collect()
    }
}

/// The multi-indices of the first and of the second half of the germs.
fn split(germs: usize, order: usize) -> (Vec<Vec<usize>>, Vec<Vec<usize>>) {
    let inner = germs / 2;
    (total_degree(germs - inner, order), total_degree(inner, order))
}

impl Pce {
    /// Solves, fits and judges.
    pub fn fit(
        prior: &RodPrior,
        order: usize,
        elements: usize,
        solved: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self, FitError> {
        let training = Training::solve(prior, order, elements, solved)?;
        Ok(Self::from_training(prior, &training, Weighting::Equal))
    }

    /// Fits and judges.
    pub fn from_training(prior: &RodPrior, training: &Training, weighting: Weighting) -> Self {
        let report = ErrorReport {
            emulator: String::new(),
            reference: String::new(),
            sample: 0,
            seed: 0,
            outside: 0,
            modes: Vec::new(),
            extrapolated: None,
            grid: None,
        };
        let fitted = Fitted {
            expansions: training.fit(MAX_MODES, weighting),
            report,
        };
        let mut pce = Self::assemble(prior, training.order, training.design.clone(), fitted);
        let exact = Exact::new(*prior.parameterisation());
        let mut report = pce.validate(&exact, validate::SAMPLE, validate::SEED);
        report.grid = Some(pce.grid_errors(training));
        pce.fitted.report = report;
        pce
    }

    /// From coefficients fitted earlier with the same prior and order; `None` if they do not fit.
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
        let (prior, axes) = (prior.clone(), design.axes);
        Self {
            prior,
            order,
            axes,
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

    /// Its total order.
    pub fn order(&self) -> usize {
        self.order
    }

    /// Terms per mode.
    pub fn terms(&self) -> usize {
        self.fitted.expansions.first().map_or(0, Expansion::terms)
    }

    /// Judges it against `reference` on another sample from its prior.
    pub fn validate(&self, reference: &dyn ForwardModel, sample: usize, seed: u64) -> ErrorReport {
        let extrapolate = |theta: &[f64], values: &mut [f64], slopes: &mut [f64]| {
            self.evaluate(theta, values);
            self.slopes(theta, slopes).or_else(|_| {
                slopes.fill(f64::NAN);
                Ok(())
            })
        };
        validate::on_prior(self, Some(&extrapolate), reference, &self.prior, sample, seed)
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

    /// Refuses what lies outside the design's box, or differs in a quantity the prior holds fixed.
    fn check(&self, theta: &[f64]) -> Result<(), OutsideRange> {
        for axis in &self.axes {
            let z = axis.germ.germ(theta[axis.germ.index]);
            let (low, high) = (axis.nodes[0], axis.nodes[axis.nodes.len() - 1]);
            // Rounding on the way to the value and back must not exclude the design's own points.
            if !(z >= low - 1e-9 && z <= high + 1e-9) {
                let what = axis.germ.quantity.key();
                let (value, low, high) = (
                    theta[axis.germ.index],
                    axis.germ.value(low),
                    axis.germ.value(high),
                );
                return Err(OutsideRange {
                    model: MODEL,
                    what,
                    value,
                    low,
                    high,
                });
            }
        }
        let quantities = self.prior.parameterisation().quantities();
        for ((prior, &value), quantity) in self.prior.priors().iter().zip(theta).zip(quantities) {
            let fixed = prior.centre();
            if prior.is_fixed() && value != fixed {
                let what = quantity.key();
                return Err(OutsideRange {
                    model: MODEL,
                    what,
                    value,
                    low: fixed,
                    high: fixed,
                });
            }
        }
        Ok(())
    }

    /// Values of the expansions without a check of the range.
    fn evaluate(&self, theta: &[f64], out: &mut [f64]) {
        let germs: Vec<[f64; 1]> = self
            .axes
            .iter()
            .map(|axis| [axis.germ.germ(theta[axis.germ.index])])
            .collect();
        let mut rows = [[0.0]; MAX_MODES];
        let mut scratch = self.scratch();
        vectorised(|| self.block(&germs, &mut scratch, &mut rows[..out.len()]));
        out.iter_mut().zip(rows).for_each(|(out, [f])| *out = f);
    }

    /// The germ of the axial force, or a refusal if the force is fixed: the chaos knows no slope then.
    fn force(&self) -> Result<&Axis, OutsideRange> {
        let value = self.prior.priors()[0].centre();
        let refusal = OutsideRange {
            model: MODEL,
            what: "axial_force_n",
            value,
            low: value,
            high: value,
        };
        self.axes
            .first()
            .filter(|axis| axis.germ.index == 0)
            .ok_or(refusal)
    }

    /// Slopes of the expansions without a check of the range.
    fn slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        let axis = self.force()?;
        let germs: Vec<[f64; 1]> = self
            .axes
            .iter()
            .map(|axis| [axis.germ.germ(theta[axis.germ.index])])
            .collect();
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
        let factor = axis.germ.by_log_value(germs[0][0], theta[0]);
        for ((out, expansion), [value]) in out.iter_mut().zip(&self.fitted.expansions).zip(values) {
            *out = factor * expansion.evaluate(&scratch.outer, &scratch.inner)[0] / value;
        }
        Ok(())
    }

    fn scratch<const L: usize>(&self) -> Scratch<L> {
        Scratch {
            polynomials: vec![[0.0; L]; self.axes.len() * (self.order + 1)],
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
        self.check(theta)?;
        self.evaluate(theta, out);
        Ok(())
    }

    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        self.check(theta)?;
        self.slopes(theta, out)
    }

    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        let width = self.prior.parameterisation().len();
        let mut rows = [[0.0; LANES]; MAX_MODES];
        let rows = &mut rows[..modes];
        let mut germs = vec![[0.0; LANES]; self.axes.len()];
        let mut scratch = self.scratch();
        for (thetas, out) in thetas.chunks(LANES * width).zip(out.chunks_mut(LANES * modes)) {
            for (l, theta) in thetas.chunks_exact(width).enumerate() {
                for (axis, z) in self.axes.iter().zip(&mut germs) {
                    z[l] = axis.germ.germ(theta[axis.germ.index]);
                }
            }
            vectorised(|| self.block(&germs, &mut scratch, rows));
            for ((l, theta), out) in thetas
                .chunks_exact(width)
                .enumerate()
                .zip(out.chunks_exact_mut(modes))
            {
                let inside = self.check(theta).is_ok();
                for (out, row) in out.iter_mut().zip(rows.iter()) {
                    *out = if inside { row[l] } else { f64::NAN };
                }
            }
        }
    }
}
