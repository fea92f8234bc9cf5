//! Blows at even intervals, in a motion that never comes to rest.
//!
//! A blow while the rod still rings from the one before hardly raises its level, so [`super::releases`] does not see it; and the
//! spectrum of blows at even intervals is a comb of lines at multiples of their rate, in which no mode is fitted that [`super::blows`]
//! could ask. An autoregressive model of low order (Yule and Walker's equations, Levinson's recursion) follows the modes and
//! not the comb: a blow is what it does not predict.

use super::Release;
use crate::numerics::extremes::extremes;
use crate::numerics::simd::{Kernel, vectorised};
use crate::signal::record::slope::Slope;

/// Order of the model: two for each mode and some for the noise.
const ORDER: usize = 48;
/// Lags summed at once: whole registers, more than the model asks for.
const LAGS: usize = 56;
/// Samples predicted at once.
const LANES: usize = 16;
/// White noise added, as a share of the variance, so that a motion without noise has a model.
const WHITE: f64 = 1e-9;
/// Least innovation of a blow, in robust standard deviations of all.
const HEIGHT: f64 = 8.0;
/// Ratio of its square to the largest one of the periods before.
const RISE: f64 = 16.0;
/// Periods before a blow that are compared.
const BEFORE: f64 = 2.0;
/// Fewest samples of these.
const LEAST_BEFORE: usize = 8;
/// Share of the largest square from which on a median puts it below the limit.
const USUAL: f64 = 1.01 * MEDIAN / (HEIGHT * HEIGHT);
/// Fewest blows of a train.
const LEAST: usize = 4;
/// Share of its blows that must be seen.
const SEEN: f64 = 0.6;
/// Largest scatter of the blows about even times (rms), as a share of the interval; less even ones make no comb.
const EVEN: f64 = 0.02;
/// Least ratio of the mean squared slope behind all blows to that before them: a disturbance of the sensor moves nothing.
const MOVES: f64 = 1.2;
/// Median of the square of a standard normal deviate.
const MEDIAN: f64 = 0.455;

/// The blows of a train, in time order; none if they are not even. `period` is that of the strongest peak, in samples.
pub fn train(samples: &[f64], period: f64) -> Vec<Release> {
    let reach = ((BEFORE * period).round() as usize).max(LEAST_BEFORE);
    let Some(powers) = innovations(samples) else {
        return Vec::new();
    };
    let seen = disturbances(&powers, reach);
    match places(&powers, &seen) {
        Some(blows) if moves(samples, &seen, reach) => blows
            .iter()
            .map(|&at| Release {
                before: at - 2,
                after: at + 1,
                is_of_train: true,
            })
            .collect(),
        _ => Vec::new(),
    }
}

/// Samples that the model does not predict though it did those of the `reach` samples before.
fn disturbances(powers: &[f64], reach: usize) -> Vec<usize> {
    let all = &powers[ORDER..];
    let ((_, largest), middle) = (extremes(all), all.len() / 2);
    // Then the median is so large that nothing exceeds the limit.
    if all.iter().filter(|&&power| power < USUAL * largest).count() <= middle {
        return Vec::new();
    }
    let mut sorted = all.to_vec();
    let median = *sorted.select_nth_unstable_by(middle, f64::total_cmp).1;
    let limit = HEIGHT * HEIGHT * median / MEDIAN;
    let mut found: Vec<usize> = Vec::new();
    // A blow between two samples reaches the one before the largest.
    for at in ORDER + reach + 2..powers.len() {
        let is_near = found.last().is_some_and(|&last| at < last + reach);
        if powers[at] <= limit || is_near {
            continue;
        }
        let before = powers[at - reach - 2..at - 2]
            .iter()
            .fold(0.0f64, |a, &b| a.max(b));
        if powers[at] > RISE * before {
            found.push(at);
        }
    }
    found
}

/// Square of what a linear prediction from the [`ORDER`] samples before leaves of each sample; `None` without motion.
fn innovations(samples: &[f64]) -> Option<Vec<f64>> {
    if samples.len() < 4 * ORDER {
        return None;
    }
    let mean = samples.iter().sum::<f64>() / samples.len() as f64;
    let moves: Vec<f64> = samples.iter().map(|x| x - mean).collect();
    let mut products = [0.0; LAGS];
    vectorised(Products {
        moves: &moves,
        sums: &mut products,
    });
    products.reverse();
    products[0] *= 1.0 + WHITE;
    let filter = levinson(&products[..=ORDER])?;
    let mut powers = vec![0.0; moves.len()];
    vectorised(Innovations {
        moves: &moves,
        filter: &filter,
        powers: &mut powers,
    });
    Some(powers)
}

/// Sums over all i of x_i x_(i - k), k from [`LAGS`] - 1 down to 0.
struct Products<'a> {
    moves: &'a [f64],
    sums: &'a mut [f64; LAGS],
}

impl Kernel for Products<'_> {
    const MANY_SUMS: bool = true;

    #[inline(always)]
    fn run(self) {
        let mut sums = [0.0; LAGS];
        for now in 1..LAGS {
            let past = &self.moves[..now];
            for (sum, x) in sums[LAGS - now..].iter_mut().zip(past) {
                *sum += past[now - 1] * x;
            }
        }
        for window in self.moves.windows(LAGS) {
            for (sum, x) in sums.iter_mut().zip(window) {
                *sum += window[LAGS - 1] * x;
            }
        }
        *self.sums = sums;
    }
}

/// Squares of what a filter leaves of each sample from the [`ORDER`]th on, several at once.
struct Innovations<'a> {
    moves: &'a [f64],
    filter: &'a [f64],
    powers: &'a mut [f64],
}

impl Kernel for Innovations<'_> {
    #[inline(always)]
    fn run(self) {
        let mut first = ORDER;
        for powers in self.powers[ORDER..].chunks_mut(LANES) {
            let mut left = [0.0; LANES];
            for (k, a) in self.filter.iter().enumerate() {
                let past = &self.moves[first - k..first - k + powers.len()];
                left.iter_mut().zip(past).for_each(|(left, x)| *left += a * x);
            }
            powers
                .iter_mut()
                .zip(left)
                .for_each(|(power, left)| *power = left * left);
            first += powers.len();
        }
    }
}

/// Prediction error filter of autocovariances, its first coefficient 1; `None` if they are none.
fn levinson(covariance: &[f64]) -> Option<Vec<f64>> {
    let mut filter = vec![0.0; covariance.len()];
    let mut error = *covariance.first()?;
    filter[0] = 1.0;
    for k in 1..covariance.len() {
        if error.is_nan() || error <= 0.0 {
            return None;
        }
        let sum: f64 = (0..k).map(|i| filter[i] * covariance[k - i]).sum();
        let reflection = -sum / error;
        let before = filter.clone();
        for i in 1..=k {
            filter[i] = before[i] + reflection * before[k - i];
        }
        error *= 1.0 - reflection * reflection;
    }
    Some(filter)
}

/// Places of all blows of a train of which most are `seen`: where one is missing, the largest innovation about its time. `None` if
/// they are not even.
fn places(powers: &[f64], seen: &[usize]) -> Option<Vec<usize>> {
    let (&first, &last) = (seen.first()?, seen.last()?);
    let mut gaps: Vec<usize> = seen.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if seen.len() < LEAST {
        return None;
    }
    let middle = gaps.len() / 2;
    let usual = *gaps.select_nth_unstable(middle).1 as f64;
    let count = ((last - first) as f64 / usual).round();
    if seen.len() as f64 <= SEEN * count {
        return None;
    }
    let interval = (last - first) as f64 / count;
    let number = |at: usize| ((at - first) as f64 / interval).round();
    let off = |at: usize| (at - first) as f64 - interval * number(at);
    let scatter = seen.iter().map(|&at| off(at).powi(2)).sum::<f64>() / seen.len() as f64;
    if scatter.sqrt() > EVEN * interval {
        return None;
    }
    let slack = (EVEN * interval).ceil() as usize;
    let place = |n: usize| {
        let known = seen.iter().find(|&&at| number(at) == n as f64);
        known.copied().or_else(|| {
            let due = first + (interval * n as f64).round() as usize;
            (due - slack..=due + slack).max_by(|&a, &b| powers[a].total_cmp(&powers[b]))
        })
    };
    (0..=count as usize).map(place).collect()
}

/// True if the rod moves more behind the blows than before them.
fn moves(samples: &[f64], blows: &[usize], reach: usize) -> bool {
    let slope = Slope::of(samples, 1);
    let (mut before, mut after) = (0.0, 0.0);
    for &at in blows.iter().filter(|&&at| at + 2 + reach <= samples.len()) {
        before += slope.mean_square(at - 2 - reach, at - 2);
        after += slope.mean_square(at + 2, at + 2 + reach);
    }
    after > MOVES * before
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A minute at 100 Hz of two modes driven by noise, and noise of the sensor.
    fn hum() -> Vec<f64> {
        let mut state = 0x9e37_79b9_7f4a_7c15_u64;
        let mut noise = move || {
            let uniform = |state: &mut u64| {
                *state ^= *state << 13;
                *state ^= *state >> 7;
                *state ^= *state << 17;
                (*state >> 11) as f64 / (1u64 << 53) as f64
            };
            (0..12).map(|_| uniform(&mut state)).sum::<f64>() - 6.0
        };
        let mut modes = [(4.5, 0.0, 0.0), (9.7, 0.0, 0.0)];
        (0..6000)
            .map(|_| {
                let mut sum = 0.02 * noise();
                for (f, now, last) in &mut modes {
                    let angle = std::f64::consts::TAU * *f / 100.0;
                    let next = 2.0 * 0.998 * angle.cos() * *now - 0.998 * 0.998 * *last + 0.02 * noise();
                    (*last, *now) = (*now, next);
                    sum += next;
                }
                sum
            })
            .collect()
    }

    fn with_blows(at: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut samples = hum();
        for blow_s in at {
            for (i, x) in samples.iter_mut().enumerate() {
                let t = i as f64 / 100.0 - blow_s;
                for f in [4.5, 9.7] {
                    let phase = std::f64::consts::TAU * f * t;
                    *x += if t > 0.0 {
                        10.0 * (-0.003 * phase).exp() * phase.sin()
                    } else {
                        0.0
                    };
                }
            }
        }
        samples
    }

    #[test]
    fn even_blows_are_found_to_the_sample() {
        for gap in [2.5, 4.3, 5.0] {
            let blows = || {
                (0..)
                    .map(move |n| 1.234 + gap * f64::from(n))
                    .take_while(|t| *t < 59.0)
            };
            let found = train(&with_blows(blows()), 22.0);
            assert_eq!(found.len(), blows().count(), "{gap}");
            for (release, blow) in found.iter().zip(blows()) {
                let at = blow * 100.0;
                assert!(
                    (release.before as f64) < at && at <= release.after as f64,
                    "{release:?} {at}"
                );
                assert!(release.after - release.before <= 3);
            }
        }
    }

    #[test]
    fn uneven_blows_ambient_motion_and_pulses_of_the_sensor_are_no_train() {
        let uneven = (0..12).map(|n: i32| 1.0 + 4.8 * f64::from(n) + 0.3 * f64::from((n * n) % 3));
        assert_eq!(train(&with_blows(uneven), 22.0), []);
        assert_eq!(train(&hum(), 22.0), []);
        let mut pulsed = hum();
        for x in pulsed.iter_mut().skip(250).step_by(500) {
            *x += 10.0;
        }
        assert_eq!(train(&pulsed, 22.0), []);
        assert_eq!(train(&vec![1.0; 6000], 22.0), []);
        assert_eq!(train(&[1.0, 2.0], 22.0), []);
    }
}
