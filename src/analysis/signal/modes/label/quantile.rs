//! Quantities as smooth, rising functions of a coordinate that is standard normal beforehand.

use crate::rod::prior::Prior;
use statrs::distribution::{ContinuousCDF, Normal};

/// Outermost coordinate of the table; beyond it the function continues as a straight line.
const REACH: f64 = 6.0;
/// Nodes between 0 and [`REACH`].
const NODES: usize = 32;
/// Distance of the nodes.
const STEP: f64 = REACH / NODES as f64;

/// Share of the doubt in the force's prior: without it, modes 3 and 4 of a rod of 383 kN whose prior was 1101
/// +- 220 kN were called 2 and 3.
const DOUBT: f64 = 0.25;
/// Least standard deviation of ln N under doubt; a prior wider than [`WIDE_LOG_SD`] claims little and is doubted less.
const DOUBT_LOG_SD: f64 = 0.8;
const WIDE_LOG_SD: f64 = 0.5;
/// Least standard deviation of ln N, for a force given as exact: in practice none is known better.
const LEAST_FORCE_LOG_SD: f64 = 0.02;

/// A rising function of a standard normal coordinate.
#[derive(Debug, Clone)]
pub(super) struct Quantile {
    values: Vec<f64>,
    /// Derivatives at the nodes, times [`STEP`].
    slopes: Vec<f64>,
}

impl Quantile {
    /// Interpolates the values of `function` at the nodes; cubic between them, without overshoot.
    fn of(function: impl Fn(f64) -> f64) -> Self {
        let values: Vec<f64> = (0..=2 * NODES)
            .map(|i| function(i as f64 * STEP - REACH))
            .collect();
        let last = values.len() - 1;
        let slopes = (0..=last)
            .map(|i| {
                let below = values[i] - values[i.saturating_sub(1)];
                let above = values[(i + 1).min(last)] - values[i];
                match i {
                    0 => above,
                    _ if i == last => below,
                    // The harmonic mean keeps a rising table rising (Fritsch and Butland 1984).
                    _ if below * above > 0.0 => 2.0 * below * above / (below + above),
                    _ => 0.0,
                }
            })
            .collect();
        Self { values, slopes }
    }

    /// The natural logarithm of an axial force \[N\] with its prior doubted; `None` if the prior holds no
    /// positive force.
    pub(super) fn of_force(prior: &Prior) -> Option<Self> {
        let prior = match *prior {
            Prior::Fixed { value } => Prior::LogNormal {
                median: value,
                log_sd: LEAST_FORCE_LOG_SD,
            },
            other => other,
        };
        let (_, own_sd) = log_moments(&prior);
        let centre = libm::log(quantile(&prior, 0.0));
        if !(centre.is_finite() && own_sd.is_finite()) {
            return None;
        }
        let sd = DOUBT_LOG_SD.max(own_sd);
        let doubt = DOUBT * (WIDE_LOG_SD / own_sd.max(WIDE_LOG_SD));
        let normal = Normal::standard();
        let reach = 1.5 * REACH * sd;
        // The share below where the coordinate is negative, above where it is not: no tail is lost to rounding.
        let solve = |q: f64| {
            let wanted = normal.cdf(-q.abs());
            let (mut low, mut high) = (centre - reach, centre + reach);
            for _ in 0..40 {
                let x = 0.5 * (low + high);
                let (below, above) = shares(&prior, libm::exp(x));
                let z = (x - centre) / sd;
                let is_above = if q < 0.0 {
                    (1.0 - doubt) * below + doubt * normal.cdf(z) > wanted
                } else {
                    (1.0 - doubt) * above + doubt * normal.cdf(-z) < wanted
                };
                if is_above {
                    high = x;
                } else {
                    low = x;
                }
            }
            0.5 * (low + high)
        };
        Some(Self::of(solve))
    }

    /// Range of `ln N` without doubt, less one draw in a thousand at either end.
    pub(super) fn log_range(prior: &Prior) -> (f64, f64) {
        const END: f64 = 3.1;
        let at = |q: f64| match *prior {
            Prior::Fixed { value } => libm::log(value) + q * LEAST_FORCE_LOG_SD,
            _ => libm::log(quantile(prior, q)),
        };
        (at(-END), at(END))
    }

    /// Quantile of the share `k / (k + unit)` of a stiffness `k`.
    pub(super) fn of_stiffness(prior: &Prior, unit: f64) -> Self {
        Self::of(|q| {
            let k = quantile(prior, q);
            if k.is_finite() { k / (k + unit) } else { 1.0 }
        })
    }

    /// Value and derivative at a coordinate.
    #[inline]
    pub(super) fn at(&self, q: f64) -> (f64, f64) {
        let place = ((q + REACH) / STEP).clamp(0.0, (2 * NODES) as f64);
        let i = (place as usize).min(2 * NODES - 1);
        let (x, beyond) = (place - i as f64, q - (place * STEP - REACH));
        let (y0, y1) = (self.values[i], self.values[i + 1]);
        let (m0, m1) = (self.slopes[i], self.slopes[i + 1]);
        let (c2, c3) = (3.0 * (y1 - y0) - 2.0 * m0 - m1, m0 + m1 - 2.0 * (y1 - y0));
        let value = y0 + x * (m0 + x * (c2 + x * c3));
        let slope = (m0 + x * (2.0 * c2 + 3.0 * x * c3)) / STEP;
        (value + beyond * slope, slope)
    }

    /// The coordinate of a value, by linear interpolation between the nodes.
    pub(super) fn inverse(&self, value: f64) -> f64 {
        let i = self
            .values
            .partition_point(|&node| node < value)
            .clamp(1, self.values.len() - 1);
        let (y0, y1) = (self.values[i - 1], self.values[i]);
        let x = if y1 > y0 { (value - y0) / (y1 - y0) } else { 0.5 };
        (i as f64 - 1.0 + x) * STEP - REACH
    }
}

/// Mean and standard deviation of the natural logarithm of a positive quantity.
pub(super) fn log_moments(prior: &Prior) -> (f64, f64) {
    match *prior {
        Prior::Fixed { value } => (libm::log(value), 0.0),
        Prior::LogNormal { median, log_sd } => (libm::log(median), log_sd),
        _ => {
            // Points of equal share: the outermost is at 0.12 %.
            const POINTS: usize = 400;
            let normal = Normal::standard();
            let logs: Vec<f64> = (0..POINTS)
                .map(|i| normal.inverse_cdf((i as f64 + 0.5) / POINTS as f64))
                .map(|q| libm::log(quantile(prior, q)))
                .collect();
            let mean = logs.iter().sum::<f64>() / POINTS as f64;
            let square = logs.iter().map(|log| (log - mean) * (log - mean)).sum::<f64>();
            (mean, (square / POINTS as f64).sqrt())
        }
    }
}

/// The value of a prior at a standard normal coordinate.
fn quantile(prior: &Prior, q: f64) -> f64 {
    let normal = Normal::standard();
    match *prior {
        Prior::Fixed { value } => value,
        Prior::LogNormal { median, log_sd } => median * libm::exp(log_sd * q),
        Prior::TruncatedNormal { mean, sd } => {
            // Of the share above zero, so much is above: the far tail keeps its digits.
            let above = normal.cdf(mean / sd) * normal.cdf(-q);
            let below = normal.cdf(-mean / sd) + normal.cdf(mean / sd) * normal.cdf(q);
            let z = if above < 0.5 {
                -normal.inverse_cdf(above)
            } else {
                normal.inverse_cdf(below)
            };
            (mean + sd * z).max(0.0)
        }
        bounded => bounded.at_share(normal.cdf(q)).unwrap_or(f64::NAN),
    }
}

/// Shares of a prior below and above a value.
fn shares(prior: &Prior, value: f64) -> (f64, f64) {
    let normal = Normal::standard();
    match *prior {
        Prior::Fixed { value: fixed } if value < fixed => (0.0, 1.0),
        Prior::Fixed { .. } => (1.0, 0.0),
        Prior::LogNormal { median, log_sd } => {
            let z = libm::log(value / median) / log_sd;
            (normal.cdf(z), normal.cdf(-z))
        }
        Prior::TruncatedNormal { mean, sd } => {
            let z = (value - mean) / sd;
            let above = (normal.cdf(-z) / normal.cdf(mean / sd)).min(1.0);
            let below = (normal.cdf(z) - normal.cdf(-mean / sd)) / normal.cdf(mean / sd);
            (below.max(0.0), above)
        }
        bounded => {
            let below = bounded
                .share(value)
                .map_or(f64::NAN, |share| share.clamp(0.0, 1.0));
            (below, 1.0 - below)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_have_the_priors_shares_below_every_quantile() {
        for prior in [
            Prior::TruncatedNormal { mean: 1.0, sd: 0.8 },
            Prior::LogNormal {
                median: 2.0,
                log_sd: 0.5,
            },
            Prior::Uniform { low: 0.0, high: 3.0 },
            Prior::LogUniform { low: 0.1, high: 3.0 },
        ] {
            let mut generator = crate::numerics::random::stream(4, 0);
            let draws: Vec<f64> = (0..20_000).map(|_| prior.sample(&mut generator)).collect();
            for q in [-1.5, -0.3, 0.8, 2.0] {
                let limit = quantile(&prior, q);
                let share = draws.iter().filter(|&&draw| draw < limit).count() as f64 / 2e4;
                let expected = Normal::standard().cdf(q);
                // Four binomial errors of at most 0.35 %.
                assert!((share - expected).abs() < 0.014, "{prior:?} {q}: {share}");
                assert!((shares(&prior, limit).0 - expected).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_force_is_mostly_its_prior_and_sometimes_far_from_it() {
        let force = Quantile::of_force(&Prior::TruncatedNormal {
            mean: 1100e3,
            sd: 220e3,
        })
        .unwrap();
        assert!((force.at(0.0).0.exp() / 1100e3 - 1.0).abs() < 0.01);
        // 383 kN: 3.3 sd below the prior's mean, no further than 2.2 once doubted.
        let coordinate = force.inverse(383e3f64.ln());
        assert!((-2.2..-1.2).contains(&coordinate), "{coordinate}");
        let (value, slope) = force.at(0.7);
        let difference = (force.at(0.7001).0 - force.at(0.6999).0) / 2e-4;
        assert!((slope - difference).abs() < 1e-6 * slope);
        // Cubic against linear interpolation over one node.
        assert!((force.inverse(value) - 0.7).abs() < 0.02);
        assert!(Quantile::of_force(&Prior::Fixed { value: 0.0 }).is_none());
    }
}
