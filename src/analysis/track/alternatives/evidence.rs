//! The evidence of one kind of change, and its size.

use super::response::{Alternatives, Curve, Modes};
use crate::numerics::tail::ln_upper;
use crate::rod::beam::forward::MAX_MODES;
use crate::track::relative::Interval;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, SQRT_2};

/// Parts with a density below exp(-FAR / 2) of the largest so far are ignored.
const FAR: f64 = 80.0;
/// Share of a posterior that is left out of its size.
const LEAST_SHARE: f64 = 1e-3;
/// Halvings of the range of sizes for a quantile: to 1e-6 of it.
const HALVINGS: usize = 20;
/// Standard deviations of independently moving modes.
const FREE_SDS: [f64; 9] = [0.001, 0.0018, 0.0032, 0.0056, 0.01, 0.018, 0.032, 0.056, 0.1];

/// The shift of some modes and its covariance.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    /// Mode orders, from 1.
    pub orders: Vec<usize>,
    pub shift: DVector<f64>,
    pub covariance: DMatrix<f64>,
}

/// A stretch of one particle's responses between two nodes: its weight, and a normal of the size cut to that
/// stretch.
#[derive(Debug, Clone, Copy)]
struct Part {
    log_weight: f64,
    mean: f64,
    sd: f64,
    low: f64,
    high: f64,
    node: usize,
    /// Index among the curves of the kind.
    owner: usize,
}

/// The posterior of one kind of change.
#[derive(Debug, Clone)]
pub(super) struct Posterior {
    /// ln p(z | kind).
    pub log_evidence: f64,
    parts: Vec<Part>,
    /// exp(log_weight) of the parts, the largest one.
    weights: Vec<f64>,
    sum: f64,
}

/// Evidence over curves of one kind, of equal prior probability, from every `stride`-th particle; `None` if
/// the covariance is not positive definite.
pub(super) fn of(
    alternatives: &Alternatives,
    curves: &[&Curve],
    seen: &Seen,
    stride: usize,
) -> Option<Posterior> {
    let mut parts = Vec::new();
    for (owner, curve) in curves.iter().enumerate() {
        parts_of(alternatives, (owner, curve), seen, stride, &mut parts)?;
    }
    let most = parts
        .iter()
        .fold(f64::NEG_INFINITY, |most, part| most.max(part.log_weight));
    if !most.is_finite() {
        return None;
    }
    let weights: Vec<f64> = parts
        .iter()
        .map(|part| libm::exp(part.log_weight - most))
        .collect();
    let sum: f64 = weights.iter().sum();
    Some(Posterior {
        log_evidence: most + libm::log(sum / curves.len() as f64),
        parts,
        weights,
        sum,
    })
}

impl Posterior {
    /// Mean predicted shift of every order; `curves` are those it was made from.
    pub fn expected(&self, curves: &[&Curve]) -> Modes {
        let mut expected = [0.0; MAX_MODES];
        for (part, weight) in self.parts.iter().zip(&self.weights) {
            let means = &curves[part.owner].means;
            let share = (centre(part) - part.low) / (part.high - part.low);
            for (n, expected) in expected.iter_mut().enumerate() {
                let (below, above) = (means[part.node][n], means[part.node + 1][n]);
                *expected += weight / self.sum * (below + share * (above - below));
            }
        }
        expected
    }

    /// Mean, spread and quantiles of the size.
    pub fn size(&self) -> Interval {
        let mut told: Vec<(f64, &Part)> = self
            .weights
            .iter()
            .map(|weight| weight / self.sum)
            .zip(&self.parts)
            .collect();
        told.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut known = 0.0;
        let enough = told.iter().position(|(share, _)| {
            known += share;
            known > 1.0 - LEAST_SHARE
        });
        told.truncate(enough.map_or(told.len(), |last| last + 1));
        let whole: f64 = told.iter().map(|(share, _)| share).sum();
        let (mut mean, mut square) = (0.0, 0.0);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut cuts = Vec::with_capacity(told.len());
        for (share, part) in &told {
            let centre = centre(part);
            // A part's own spread: no more than that of a uniform over its stretch.
            let own = part.sd.min((part.high - part.low) / 12f64.sqrt());
            mean += share / whole * centre;
            square += share / whole * (centre * centre + own * own);
            (low, high) = (low.min(part.low), high.max(part.high));
            cuts.push(Cut::new(share / whole, part));
        }
        let quantile = |p: f64| {
            let (mut low, mut high) = (low, high);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                if cuts.iter().map(|cut| cut.below(middle)).sum::<f64>() < p {
                    low = middle;
                } else {
                    high = middle;
                }
            }
            0.5 * (low + high)
        };
        Interval {
            mean,
            sd: (square - mean * mean).max(0.0).sqrt(),
            q025: quantile(0.025),
            q975: quantile(0.975),
        }
    }
}

/// A normal cut to a stretch, for its distribution function.
struct Cut<'a> {
    share: f64,
    part: &'a Part,
    /// The normal's tail beyond the end nearest to its mean, on the side of the far end, and what lies between the ends.
    tail: f64,
    whole: f64,
    /// Side of the mean on which the stretch lies: above.
    is_above: bool,
}

impl<'a> Cut<'a> {
    fn new(share: f64, part: &'a Part) -> Self {
        // Tails are taken on the far side of the mean, where they do not cancel.
        let is_above = part.mean < 0.5 * (part.low + part.high);
        let mut cut = Self {
            share,
            part,
            tail: 0.0,
            whole: 0.0,
            is_above,
        };
        cut.tail = cut.upper(part.low);
        cut.whole = cut.tail - cut.upper(part.high);
        cut
    }

    /// The normal's upper tail at x, or its lower tail with the sign turned.
    fn upper(&self, x: f64) -> f64 {
        let z = (x - self.part.mean) / (self.part.sd * SQRT_2);
        if self.is_above {
            0.5 * libm::erfc(z)
        } else {
            -0.5 * libm::erfc(-z)
        }
    }

    fn below(&self, x: f64) -> f64 {
        let part = self.part;
        if x >= part.high {
            self.share
        } else if x <= part.low {
            0.0
        } else if part.sd.is_infinite() {
            self.share * (x - part.low) / (part.high - part.low)
        } else if self.whole != 0.0 {
            self.share * (self.tail - self.upper(x)) / self.whole
        } else if self.is_above {
            // So far out that all of it lies at the near end.
            self.share
        } else {
            0.0
        }
    }
}

/// ln p(z) if every mode moves independently by N(0, s^2), s one of [`FREE_SDS`]; `None` if the covariance is
/// not positive definite.
pub(super) fn of_free_modes(seen: &Seen) -> Option<f64> {
    let logs = FREE_SDS
        .iter()
        .map(|sd| {
            let mut covariance = seen.covariance.clone();
            (0..seen.orders.len()).for_each(|n| covariance[(n, n)] += sd * sd);
            let factor = covariance.cholesky()?;
            let white = factor.l().solve_lower_triangular(&seen.shift)?;
            Some(-0.5 * white.norm_squared() - log_factor(&factor.l()))
        })
        .collect::<Option<Vec<f64>>>()?;
    let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    Some(most + libm::log(logs.iter().map(|log| libm::exp(log - most)).sum::<f64>() / logs.len() as f64))
}

/// ln of sqrt(det(2 pi C)) from the factor of C.
fn log_factor(lower: &DMatrix<f64>) -> f64 {
    (0..lower.nrows())
        .map(|n| libm::log(lower[(n, n)]) + 0.5 * libm::log(2.0 * PI))
        .sum()
}

/// Every stretch of every particle that counts. Along a stretch of length 1 the whitened distance is e - t d, so that
///
/// ```text
/// int_0^1 exp(-|e - t d|^2 / 2) dt = exp(-q / 2) sqrt(2 pi) / |d| (Phi((1 - m) |d|) - Phi(-m |d|)),  m = e.d / d.d,  q = |e|^2 - m e.d.
/// ```
fn parts_of(
    alternatives: &Alternatives,
    (owner, curve): (usize, &Curve),
    seen: &Seen,
    stride: usize,
    parts: &mut Vec<Part>,
) -> Option<()> {
    let modes = seen.orders.len();
    let mut most = f64::NEG_INFINITY;
    let pick = |answer: &Modes, white: &mut Modes| {
        for (slot, order) in seen.orders.iter().enumerate() {
            white[slot] = answer[order - 1];
        }
    };
    for (node, pair) in curve.nodes.windows(2).enumerate() {
        // Away from none: the larger of both ends.
        let mean = if pair[1] > 0.0 {
            &curve.means[node + 1]
        } else {
            &curve.means[node]
        };
        let square = seen.orders.iter().map(|n| mean[n - 1] * mean[n - 1]).sum::<f64>() / modes as f64;
        let mut covariance = seen.covariance.clone();
        for (slot, order) in seen.orders.iter().enumerate() {
            covariance[(slot, slot)] += alternatives.error[order - 1].powi(2) * square;
        }
        let lower = covariance.cholesky()?.unpack();
        let inverse = lower.clone().try_inverse()?;
        let mut whiten = [[0.0; MAX_MODES]; MAX_MODES];
        for row in 0..modes {
            for column in 0..=row {
                whiten[row][column] = inverse[(row, column)];
            }
        }
        let shift: Modes = std::array::from_fn(|n| if n < modes { seen.shift[n] } else { 0.0 });
        let constant = libm::log(curve.mass[node] / curve.count.div_ceil(stride) as f64) - log_factor(&lower);
        let below = &curve.answers[node * curve.count..][..curve.count];
        let above = &curve.answers[(node + 1) * curve.count..][..curve.count];
        for (below, above) in below.iter().zip(above).step_by(stride) {
            let (mut from, mut to) = ([0.0; MAX_MODES], [0.0; MAX_MODES]);
            pick(below, &mut from);
            pick(above, &mut to);
            let (mut ee, mut ed, mut dd) = (0.0, 0.0, 0.0);
            for row in whiten.iter().take(modes) {
                let (mut e, mut d) = (0.0, 0.0);
                for (w, (z, (from, to))) in row.iter().zip(shift.iter().zip(from.iter().zip(&to))).take(modes)
                {
                    e += w * (z - from);
                    d += w * (to - from);
                }
                ee += e * e;
                ed += e * d;
                dd += d * d;
            }
            let length = pair[1] - pair[0];
            let rate = dd.sqrt();
            // The density at the nearest point of the stretch bounds its part.
            let nearest = if dd > 0.0 { (ed / dd).clamp(0.0, 1.0) } else { 0.0 };
            let least = ee - 2.0 * nearest * ed + nearest * nearest * dd;
            if constant - 0.5 * least < most - 0.5 * FAR {
                continue;
            }
            let (log_weight, mean, sd) = if rate < 1e-3 {
                (constant - 0.5 * (ee - ed), pair[0], f64::INFINITY)
            } else {
                let m = ed / dd;
                let log_share = ln_between(-m * rate, (1.0 - m) * rate) + libm::log((2.0 * PI).sqrt() / rate);
                let q = ee - m * ed;
                (
                    constant - 0.5 * q + log_share,
                    pair[0] + m * length,
                    length / rate,
                )
            };
            if log_weight.is_finite() {
                most = most.max(log_weight);
                parts.push(Part {
                    log_weight,
                    mean,
                    sd,
                    low: pair[0],
                    high: pair[1],
                    node,
                    owner,
                });
            }
        }
    }
    Some(())
}

/// ln(Phi(b) - Phi(a)) for a <= b, without cancellation in the tails.
fn ln_between(a: f64, b: f64) -> f64 {
    if a > 0.0 {
        let (near, far) = (ln_upper(a), ln_upper(b));
        near + libm::log(-libm::expm1(far - near))
    } else if b < 0.0 {
        ln_between(-b, -a)
    } else {
        libm::log1p(-libm::exp(ln_upper(b)) - libm::exp(ln_upper(-a)))
    }
}

/// Mean of a part's size.
fn centre(part: &Part) -> f64 {
    if part.sd.is_infinite() {
        return 0.5 * (part.low + part.high);
    }
    let (a, b) = (
        (part.low - part.mean) / part.sd,
        (part.high - part.mean) / part.sd,
    );
    let density = |x: f64| libm::exp(-0.5 * x * x) / (2.0 * PI).sqrt();
    let mean = part.mean + part.sd * (density(a) - density(b)) / libm::exp(ln_between(a, b));
    // Far out in a tail the quotient is of the sort 0 / 0: the near end.
    if mean.is_finite() { mean } else { part.mean }.clamp(part.low, part.high)
}
