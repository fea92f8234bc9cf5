//! Evidence of an assignment: the most probable rod, and Laplace's integral around it.
//!
//! ```text
//! ln Z(a) = ln P(rod) + ln P(orders seen) + ln P(k foreign) + sum_foreign ln density + ln likeness
//!         - (|q|^2 + |r|^2) / 2 - ln det(H) / 2 - sum_seen ln(s_i sqrt(2 pi)),      H = I + J'J
//! ```
//!
//! with whitened coordinates `q`, residuals `r_i = (ln f_i - ln f_n(q)) / s_i` and the Jacobian `J` of the
//! residuals at the optimum. The model's discrepancy is itself uncertain: each assignment is scored under the
//! stated one and under one four times as wide.

use super::code::Code;
use super::likeness::Likeness;
use super::peak::Peak;
use super::rod::{COORDINATES, Guesses, NO_GUESSES, Place, Point, Rod};
use super::visibility::{self, Orders};
use crate::rod::beam::forward::MAX_ORDERS;
use nalgebra::{Cholesky, SMatrix, SVector};
use std::f64::consts::TAU;

/// Least relative model discrepancy: for a rod without earlier records. True 1 % with 0.3 % assumed gave 7 to
/// 9 wrong orders in 1000.
const LEAST_DISCREPANCY: f64 = 0.01;
/// The wide discrepancy in units of the stated one, and its share: the paper's own rod has f3/f1 = 2.950
/// where every rod on springs has 3 or more.
const WIDE: f64 = 4.0;
const WIDE_SHARE: f64 = 0.1;
/// Foreign peaks expected beside a rod, and where there is none: their number is geometric with this mean.
const FOREIGN_MEAN: f64 = 1.2;
const ALL_FOREIGN_MEAN: f64 = 2.0;
/// Prior probability that the rod is seen at all.
const ROD: f64 = 0.9;
/// Lower bound of the log odds that all foreign peaks beside a struck rod share: they are rare, but where
/// there is one there are often several.
const MOST_STRUCK: f64 = -5.0;
/// A peak may be an order if it lies within this many predictive standard deviations, plus this much in ln f.
const NEAR_SD: f64 = 4.0;
const NEAR: f64 = 0.002;
/// Most evaluations of a fit from afar, and from nearby.
const FROM_AFAR: usize = 14;
const FROM_NEARBY: usize = 5;

type Hessian = SMatrix<f64, COORDINATES, COORDINATES>;
type Vector = SVector<f64, COORDINATES>;

/// Input of the evidence of one record.
pub(super) struct Scene<'a> {
    pub(super) rod: &'a Rod,
    pub(super) peaks: &'a [Peak],
    /// Relative model discrepancy per order, as configured.
    pub(super) discrepancy: &'a [f64],
    /// Lowest and highest ln f searched for peaks.
    pub(super) band: (f64, f64),
    /// Masked ranges of ln f.
    pub(super) masks: &'a [(f64, f64)],
    /// Pairs that a person declared.
    pub(super) declared: Code,
    /// Orders with a window in which there is no peak: they are nowhere else.
    pub(super) absent: Orders,
    /// Log odds of there being no rod, in addition to those of any record, where something was struck or
    /// released.
    pub(super) log_struck: f64,
    /// True if the first mode is declared to be among the peaks.
    pub(super) is_first_seen: bool,
}

/// A fitted assignment.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) code: Code,
    /// Logarithm of prior probability times evidence.
    pub(super) log_evidence: f64,
    /// The most probable rod.
    pub(super) q: Point,
    /// Posterior covariance of the coordinates.
    pub(super) covariance: Hessian,
    /// Discrepancy it was fitted with, in units of the stated one.
    scale: f64,
    /// Phases of its frequencies, as first guesses of similar rods.
    pub(super) guesses: Guesses,
    /// Number of orders that the band holds, and those of them that cannot be seen.
    within: usize,
    hidden: Orders,
}

/// Minimum of the sum of squares.
struct Optimum {
    q: Point,
    /// `(|q|^2 + |r|^2) / 2`.
    half_square: f64,
    hessian: Cholesky<f64, nalgebra::Const<COORDINATES>>,
}

impl Optimum {
    /// `-ln det(H) / 2`.
    fn log_volume(&self) -> f64 {
        let l = self.hessian.l_dirty();
        -(0..COORDINATES).map(|i| libm::log(l[(i, i)])).sum::<f64>()
    }
}

/// Standard deviation of a sum of two independent parts.
fn both(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

impl Scene<'_> {
    /// Log odds of a foreign peak against a mode, without its density: its share of the rate.
    pub(super) fn log_foreign_rate() -> f64 {
        libm::log(FOREIGN_MEAN / (1.0 + FOREIGN_MEAN))
    }

    /// Discrepancy of an order.
    fn discrepancy(&self, order: usize) -> f64 {
        let stated = self.discrepancy.get(order - 1).or(self.discrepancy.last());
        stated.copied().unwrap_or(0.0).max(LEAST_DISCREPANCY)
    }

    /// Largest discrepancy of any order.
    pub(super) fn spread(&self) -> f64 {
        (1..=MAX_ORDERS)
            .map(|order| self.discrepancy(order))
            .fold(0.0, f64::max)
    }

    /// Logarithm of the probability that there is no rod and every peak is foreign.
    pub(super) fn log_no_rod(&self) -> f64 {
        let likenesses = self.peaks.iter().map(|peak| peak.likeness);
        let likeness = likenesses.fold(Likeness::default(), Likeness::with);
        libm::log(1.0 - ROD) + likeness.of_no_rod() + self.log_struck + self.log_foreign(Code::default())
    }

    /// Log probability of the number and places of the foreign peaks, and of how alike the modes' dampings
    /// are.
    fn log_foreign(&self, code: Code) -> f64 {
        let mut count = 0;
        let mut modes = 0u16;
        let mut likeness = Likeness::default();
        for (_, peak) in code.pairs() {
            modes |= 1 << peak;
            likeness = likeness.with(self.peaks[peak].likeness);
        }
        let mut sum = likeness.of_rod();
        let mut struck = 0.0f64;
        for (_, peak) in self.peaks.iter().enumerate().filter(|(i, _)| modes & 1 << i == 0) {
            count += 1;
            // k! beside the product of the densities: the peaks have no order of their own.
            sum += peak.log_foreign + libm::log(f64::from(count));
            if modes != 0 {
                sum += peak.log_beside;
                struck += peak.log_struck;
            }
        }
        sum += struck.max(MOST_STRUCK);
        let count = f64::from(count);
        let mean = if modes == 0 {
            ALL_FOREIGN_MEAN
        } else {
            FOREIGN_MEAN
        };
        sum + count * libm::log(mean) - (count + 1.0) * libm::log(1.0 + mean)
    }

    /// Fits an assignment from a first point; `None` if a declaration excludes it.
    pub(super) fn fit(&self, code: Code, start: &Point, is_near: bool) -> Option<Fit> {
        if !self.is_allowed(code) {
            return None;
        }
        let evaluations = if is_near { FROM_NEARBY } else { FROM_AFAR };
        let mut guesses = NO_GUESSES;
        let narrow = self.climb(code, start, 1.0, evaluations, None, &mut guesses)?;
        let wide = self.climb(code, &narrow.q, WIDE, FROM_NEARBY, None, &mut guesses)?;
        let log_narrow = libm::log(1.0 - WIDE_SHARE) + self.log_integral(code, &narrow, 1.0);
        let log_wide = libm::log(WIDE_SHARE) + self.log_integral(code, &wide, WIDE);
        let (best, scale) = if log_narrow >= log_wide {
            (narrow, 1.0)
        } else {
            (wide, WIDE)
        };
        let top = log_narrow.max(log_wide);
        let sum = top + libm::log(libm::exp(log_narrow - top) + libm::exp(log_wide - top));
        let (within, hidden) = self.in_sight(code, &best.q, &mut guesses);
        let visible = visibility::log_probability(code.orders(), within, hidden);
        Some(Fit {
            code,
            log_evidence: libm::log(ROD) + visible + self.log_foreign(code) + sum,
            q: best.q,
            covariance: best.hessian.inverse(),
            scale,
            guesses,
            within,
            hidden,
        })
    }

    fn is_allowed(&self, code: Code) -> bool {
        code.is_ascending()
            && code.contains(self.declared)
            && code.orders() & self.absent == 0
            && !(self.is_first_seen && code.peak_of(1).is_none())
    }

    fn log_integral(&self, code: Code, optimum: &Optimum, scale: f64) -> f64 {
        let widths: f64 = code
            .pairs()
            .map(|(order, peak)| libm::log(self.sd(order, peak, scale) * TAU.sqrt()))
            .sum();
        -optimum.half_square + optimum.log_volume() - widths
    }

    fn sd(&self, order: usize, peak: usize, scale: f64) -> f64 {
        both(self.peaks[peak].relative_sd, scale * self.discrepancy(order))
    }

    /// Levenberg's method in the whitened coordinates; `held` is a coordinate kept fixed.
    fn climb(
        &self,
        code: Code,
        start: &Point,
        scale: f64,
        evaluations: usize,
        held: Option<usize>,
        guesses: &mut Guesses,
    ) -> Option<Optimum> {
        let mut q = Vector::from_column_slice(start);
        let (mut half_square, mut gradient, mut hessian) = self.squares(code, &q, scale, held, guesses);
        let mut damping = 0.0;
        for _ in 1..evaluations {
            let damped = hessian + Hessian::identity() * damping;
            let step = -damped.cholesky()?.solve(&gradient);
            // Gain of a Gauss-Newton step if the rod were linear.
            if -step.dot(&gradient) < 1e-3 {
                break;
            }
            let longest = step.amax();
            let step = if longest > 2.0 {
                step * (2.0 / longest)
            } else {
                step
            };
            let next = q + step;
            let (square, next_gradient, next_hessian) = self.squares(code, &next, scale, held, guesses);
            if square < half_square {
                (q, half_square, gradient, hessian) = (next, square, next_gradient, next_hessian);
                damping *= 0.2;
            } else {
                damping = (4.0 * damping).max(1.0);
            }
        }
        Some(Optimum {
            q: q.into(),
            half_square,
            hessian: hessian.cholesky()?,
        })
    }

    fn squares(
        &self,
        code: Code,
        q: &Vector,
        scale: f64,
        held: Option<usize>,
        guesses: &mut Guesses,
    ) -> (f64, Vector, Hessian) {
        let point: Point = (*q).into();
        let place = self.rod.at(&point);
        let mut half_square = 0.5 * q.norm_squared();
        let mut gradient = *q;
        let mut hessian = Hessian::identity();
        for (order, peak) in code.pairs() {
            let weight = 1.0 / self.sd(order, peak, scale);
            let (log, slope) = place.log_frequency(order, guesses);
            let residual = (log - self.peaks[peak].log_hz) * weight;
            let row = Vector::from(slope) * weight;
            half_square += 0.5 * residual * residual;
            gradient += row * residual;
            hessian += row * row.transpose();
        }
        if let Some(held) = held {
            gradient[held] = 0.0;
            hessian.fill_row(held, 0.0);
            hessian.fill_column(held, 0.0);
            hessian[(held, held)] = 1.0;
        }
        (half_square, gradient, hessian)
    }

    /// Number of orders that the band holds, and the set of those that cannot be seen.
    fn in_sight(&self, code: Code, q: &Point, guesses: &mut Guesses) -> (usize, Orders) {
        let place = self.rod.at(q);
        let seen = code.orders();
        let highest = MAX_ORDERS - (seen.leading_zeros() as usize - (16 - MAX_ORDERS)).min(MAX_ORDERS);
        let mut within = highest;
        for order in highest + 1..=MAX_ORDERS {
            if place.log_frequency(order, guesses).0 > self.band.1 {
                break;
            }
            within = order;
        }
        let mut hidden: Orders = 0;
        for order in (1..=within).filter(|order| seen & 1 << (order - 1) == 0) {
            let log = place.log_frequency(order, guesses).0;
            let is_masked = self.masks.iter().any(|mask| (mask.0..=mask.1).contains(&log));
            if log < self.band.0 || is_masked {
                hidden |= 1 << (order - 1);
            }
        }
        (within, hidden)
    }

    /// Predicted ln f of an order under a fit, and its standard deviation without the model's discrepancy.
    fn predicted(&self, fit: &Fit, place: &Place, order: usize) -> (f64, f64) {
        let (log, slope) = place.log_frequency(order, &mut fit.guesses.clone());
        let slope = Vector::from(slope);
        let variance = (slope.transpose() * fit.covariance * slope)[(0, 0)].max(0.0);
        (log, variance.sqrt())
    }

    /// Assignments one step away from a fit that may count: an order dropped, added or given another peak.
    /// Each with its log evidence in the linear approximation, from the fit's own covariance.
    pub(super) fn neighbours(&self, fit: &Fit) -> Vec<(Code, f64)> {
        let mut found = Vec::new();
        let place = self.rod.at(&fit.q);
        for order in 1..=MAX_ORDERS {
            let (log, sd) = self.predicted(fit, &place, order);
            let own = fit.code.peak_of(order);
            if own.is_none() && log > self.band.1 + NEAR_SD * sd {
                break;
            }
            // Without its own peak the order is known less well.
            let (mut mean, mut variance) = (log, sd * sd);
            let without = fit.code.with(order, None);
            let mut log_without = 0.0;
            if let Some(peak) = own {
                let width = self.sd(order, peak, fit.scale);
                let share = (variance / (width * width)).min(1.0 - 1e-9);
                let residual = self.peaks[peak].log_hz - log;
                mean -= residual * share / (1.0 - share);
                variance /= 1.0 - share;
                let predicted = variance + width * width;
                let off = self.peaks[peak].log_hz - mean;
                log_without = 0.5 * off * off / predicted + 0.5 * libm::log(TAU * predicted);
                let changed = self.log_prior(fit, without) - self.log_prior(fit, fit.code);
                found.push((without, fit.log_evidence + log_without + changed));
            }
            for (i, peak) in self.peaks.iter().enumerate().filter(|&(i, _)| Some(i) != own) {
                let width = self.sd(order, i, fit.scale);
                let predicted = variance + width * width;
                let off = peak.log_hz - mean;
                if off.abs() > NEAR_SD * predicted.sqrt() + NEAR || fit.code.order_of(i).is_some() {
                    continue;
                }
                let code = fit.code.with(order, Some(i));
                let gain = -0.5 * off * off / predicted - 0.5 * libm::log(TAU * predicted);
                let changed = self.log_prior(fit, code) - self.log_prior(fit, fit.code);
                found.push((code, fit.log_evidence + log_without + gain + changed));
            }
        }
        found
    }

    /// Log prior probability of an assignment, with the rod of a fit.
    fn log_prior(&self, fit: &Fit, code: Code) -> f64 {
        visibility::log_probability(code.orders(), fit.within, fit.hidden) + self.log_foreign(code)
    }

    /// Log integral over all coordinates but one, which is fixed at `value`, up to a constant.
    pub(super) fn log_slice(
        &self,
        fit: &Fit,
        coordinate: usize,
        from: &Point,
        value: f64,
        guesses: &mut Guesses,
    ) -> Option<(f64, Point)> {
        let mut start = *from;
        start[coordinate] = value;
        let optimum = self.climb(
            fit.code,
            &start,
            fit.scale,
            FROM_NEARBY,
            Some(coordinate),
            guesses,
        )?;
        Some((-optimum.half_square + optimum.log_volume(), optimum.q))
    }
}
