//! Decides if two channels show each other's rods, by the odds of every explanation of their present records.
//!
//! Each of two channels had a rod's log-frequencies before, a and b, and has y_a and y_b now. Weather moves
//! all rods of a site together, `m ~ N(m_o, s_o^2)` in ln N as the other rods show it, and each by itself,
//! `N(0, w^2)`; a change of ln N by u moves mode n by `s_n u`. The explanations are Gaussian laws of (y_a,
//! y_b):
//!
//! ```text
//! as before         mean (a, b)
//! a force changed   mean (a, b), ln N of the one rod wider by 0.3; or of both
//! any change        mean (a, b), each mode of the one rod wider by 5 %
//! one rod on both   mean (b, b), or (a, a)
//! exchanged         mean (b, a)
//! ```
//!
//! An exchange is accepted only where both channels show it, each further from its earlier modes than the
//! weather explains: a force that falls to another rod's frequencies while that rod is unchanged is
//! `one rod on both` at most, which a change of force explains as well, however unlikely a fall by just that
//! amount.

use crate::track::observation::LogMode;

/// Prior odds of each explanation against `as before`; a change of both rods at once has its square.
const RARE: f64 = 1e-3;
/// Standard deviation of ln N under a changed force: a loss of 40 % is 0.5.
const CHANGE_SD: f64 = 0.3;
/// Standard deviation of ln f under any change.
const ANY_SD: f64 = 0.05;
/// Share of a move of ln N by which rods of a site differ under one weather, and the least difference.
const APART: f64 = 0.3;
const APART_LEAST: f64 = 2e-3;
/// Share of its move by which a mode may leave the shape `s_n` of a change of ln N.
const SHAPE: f64 = 0.1;
/// Factor on the stated errors of frequencies, and their least value.
const WIDER: f64 = 1.5;
const LEAST_SD: f64 = 1e-4;
/// Move of ln N within an hour, and the most within any time, where no other rod shows the effect of the
/// weather.
const HOUR_SD: f64 = 0.03;
const MOST_SD: f64 = 0.1;
/// Standard deviations of the weather beyond which a channel shows a change.
const BEYOND: f64 = 4.0;
/// Relative error of the weather's effect by the other rods.
const WITNESS: f64 = 0.1;
/// Further error of that effect, by one rod and by several.
const WITNESS_SD: [f64; 2] = [0.008, 0.004];

/// Frequencies of one channel before and now.
#[derive(Debug, Clone, Copy)]
pub struct Channel<'a> {
    /// Latest modes of the rod it belongs to.
    pub before: &'a [LogMode],
    /// Present modes; `None` if there are none since.
    pub now: Option<&'a [LogMode]>,
}

/// Probabilities of the explanations of the channels' records.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odds {
    /// Both rods are as before, but for the weather.
    pub as_before: f64,
    /// The rod of the first channel changed.
    pub changed: f64,
    /// The channels are exchanged, and both show it.
    pub exchanged: f64,
    /// The first channel shows the other rod, exchanged or not.
    pub other: f64,
}

/// Unlikeness of two channels at one time: misfit to showing one rod over its 99.9 % bound, below one if they
/// may. `hours` between them \[h\]. `None` with fewer than two modes in common.
pub fn unlikeness(first: &[LogMode], second: &[LogMode], hours: f64) -> Option<f64> {
    let orders = common(first, second);
    if orders.len() < 2 {
        return None;
    }
    let (one, other) = (Rod::of(first, &orders)?, Rod::of(second, &orders)?);
    let weather = HOUR_SD.powi(2) * hours.max(0.0).min((MOST_SD / HOUR_SD).powi(2));
    let mut misfit = 0.0;
    for n in 0..orders.len() {
        let variance = one.variance[n] + other.variance[n] + one.slope[n].powi(2) * weather;
        misfit += (one.log_frequency[n] - other.log_frequency[n]).powi(2) / variance;
    }
    // Wilson and Hilferty's cube for chi-square.
    let freedom = orders.len() as f64;
    let scale = 2.0 / (9.0 * freedom);
    Some(misfit / (freedom * (1.0 - scale + 3.09 * scale.sqrt()).powi(3)))
}

/// Orders that both have.
fn common(one: &[LogMode], other: &[LogMode]) -> Vec<usize> {
    let orders = one.iter().map(|mode| mode.order);
    orders
        .filter(|&order| other.iter().any(|mode| mode.order == order))
        .collect()
}

/// Two channels over one stretch of time.
pub struct Pair {
    /// Modes of the channels before, and the present ones of one or both.
    before: [Rod; 2],
    now: Vec<Rod>,
    weather: Weather,
}

impl Pair {
    /// A pair of channels, of which the first has present modes. `moves`: ln N of the other rods since then;
    /// `hours` since then \[h\]. `None` with fewer than two modes in common.
    pub fn new(first: Channel<'_>, second: Channel<'_>, moves: &[f64], hours: f64) -> Option<Self> {
        let now = first.now?;
        let mut orders = common(now, first.before);
        for modes in [Some(second.before), second.now].into_iter().flatten() {
            orders.retain(|order| modes.iter().any(|mode| mode.order == *order));
        }
        if orders.len() < 2 {
            return None;
        }
        let of = |modes: &[LogMode]| Rod::of(modes, &orders);
        let before = [of(first.before)?, of(second.before)?];
        let seen = [Some(now), second.now].into_iter().flatten();
        let now: Vec<Rod> = seen.map(of).collect::<Option<_>>()?;
        // The common part of both moves is the same with or without an exchange.
        let together = match &now[..] {
            [first, second] => 0.5 * (before[0].move_to(first) + before[1].move_to(second)),
            _ => 0.0,
        };
        Some(Self {
            before,
            now,
            weather: Weather::new(moves, hours, together),
        })
    }

    /// True if both channels have present modes, each further from its earlier ones than the weather
    /// explains.
    pub fn both_changed(&self) -> bool {
        let (mean, variance) = self.weather.shared;
        let is_beyond = |(rod, seen): (&Rod, &Rod)| {
            let sd = (variance + self.weather.apart + rod.variance_to(seen)).sqrt();
            (rod.move_to(seen) - mean).abs() > BEYOND * sd
        };
        self.now.len() == 2 && self.before.iter().zip(&self.now).all(is_beyond)
    }

    /// Weighs the explanations.
    pub fn weigh(&self) -> Odds {
        let [a, b] = &self.before;
        let is_whole = self.now.len() == 2;
        let model = |shown: [&Rod; 2], changed: [Change; 2], is_one_rod: bool| {
            log_density(
                &self.now,
                &shown[..self.now.len()],
                &changed,
                is_one_rod,
                &self.weather,
            )
        };
        let (rare, none) = (libm::log(RARE), Change::None);
        let as_before = [model([a, b], [none; 2], false)];
        let mut changed = vec![
            rare + model([a, b], [Change::Force, none], false),
            rare + model([a, b], [Change::Any, none], false),
        ];
        let mut other = vec![rare + model([b, b], [none; 2], is_whole)];
        let mut elsewhere = Vec::new();
        let exchanged = rare + model([b, a], [none; 2], false);
        if is_whole {
            changed.push(2.0 * rare + model([a, b], [Change::Force; 2], false));
            changed.push(2.0 * rare + model([a, b], [Change::Any; 2], false));
            elsewhere.push(rare + model([a, b], [none, Change::Force], false));
            elsewhere.push(rare + model([a, b], [none, Change::Any], false));
            elsewhere.push(rare + model([a, a], [none; 2], true));
            other.push(exchanged);
        }
        let all = [&as_before[..], &changed[..], &other[..], &elsewhere[..]].concat();
        let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weight = |logs: &[f64]| logs.iter().map(|log| libm::exp(log - most)).sum::<f64>();
        let total = weight(&all);
        Odds {
            as_before: weight(&as_before) / total,
            changed: weight(&changed) / total,
            exchanged: if self.both_changed() {
                weight(&[exchanged]) / total
            } else {
                0.0
            },
            other: weight(&other) / total,
        }
    }
}

/// The change of ln N by which a rod's modes moved; `None` with fewer than two modes in common.
pub fn moved(before: &[LogMode], now: &[LogMode]) -> Option<f64> {
    let orders = common(now, before);
    if orders.len() < 2 {
        return None;
    }
    Some(Rod::of(before, &orders)?.move_to(&Rod::of(now, &orders)?))
}

/// Change that a rod may have had.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Change {
    None,
    Force,
    Any,
}

/// Effect of the weather on ln N.
struct Weather {
    /// Mean and variance of the common move of all rods.
    mean: f64,
    variance: f64,
    /// Variance of the move of each rod alone.
    apart: f64,
    /// Mean and variance of the common move of the two rods: where no other rod shows it, half of the sum of
    /// their moves, in which an exchange cancels; half of a change of one rod remains, which widens `apart`.
    shared: (f64, f64),
}

impl Weather {
    fn new(moves: &[f64], hours: f64, together: f64) -> Self {
        let mut moves = moves.to_vec();
        moves.sort_by(f64::total_cmp);
        let (mean, sd) = match moves.len() {
            0 => (0.0, (HOUR_SD * hours.max(1.0).sqrt()).min(MOST_SD)),
            count => {
                let mean = 0.5 * (moves[(count - 1) / 2] + moves[count / 2]);
                (mean, WITNESS_SD[usize::from(count > 1)] + WITNESS * mean.abs())
            }
        };
        let shared = if moves.is_empty() {
            (together, WITNESS_SD[0])
        } else {
            (mean, sd)
        };
        let apart = APART_LEAST + APART * shared.0.abs();
        Self {
            mean,
            variance: sd * sd,
            apart: apart * apart,
            shared: (shared.0, shared.1 * shared.1),
        }
    }
}

/// A rod's modes, with their slopes by ln N.
struct Rod {
    log_frequency: Vec<f64>,
    variance: Vec<f64>,
    /// d ln f_n / d ln N of a tensioned beam, from its own frequencies: `f_n^2 / n^2 = alpha + beta n^2`,
    /// `s_n = alpha / (alpha + beta n^2) / 2`.
    slope: Vec<f64>,
}

impl Rod {
    fn of(modes: &[LogMode], orders: &[usize]) -> Option<Self> {
        let modes: Vec<&LogMode> = orders
            .iter()
            .map(|order| modes.iter().find(|mode| mode.order == *order))
            .collect::<Option<_>>()?;
        let (mut sum, mut squares, mut mean, mut product) = (0.0, 0.0, 0.0, 0.0);
        let points = modes.iter().map(|mode| {
            let square = (mode.order * mode.order) as f64;
            (square, libm::exp(2.0 * mode.log_frequency) / square)
        });
        let points: Vec<(f64, f64)> = points.collect();
        let count = points.len() as f64;
        for (square, value) in &points {
            sum += square / count;
            mean += value / count;
        }
        for (square, value) in &points {
            squares += (square - sum).powi(2);
            product += (square - sum) * (value - mean);
        }
        let stiffness = (product / squares).max(0.0);
        let tension = (mean - stiffness * sum).max(0.05 * mean);
        let slope = |square: &f64| 0.5 * tension / (tension + stiffness * square);
        Some(Self {
            log_frequency: modes.iter().map(|mode| mode.log_frequency).collect(),
            variance: modes
                .iter()
                .map(|mode| (WIDER * mode.log_sd).max(LEAST_SD).powi(2))
                .collect(),
            slope: points.iter().map(|(square, _)| slope(square)).collect(),
        })
    }

    /// Variance of the change of ln N to the modes seen.
    fn variance_to(&self, seen: &Rod) -> f64 {
        let information = |n: usize| self.slope[n].powi(2) / (self.variance[n] + seen.variance[n]);
        1.0 / (0..self.slope.len()).map(information).sum::<f64>()
    }

    /// Least-squares change of ln N to the modes seen.
    fn move_to(&self, seen: &Rod) -> f64 {
        let (mut top, mut bottom) = (0.0, 0.0);
        for n in 0..self.slope.len() {
            let weight = self.slope[n] / (self.variance[n] + seen.variance[n]);
            top += weight * (seen.log_frequency[n] - self.log_frequency[n]);
            bottom += weight * self.slope[n];
        }
        top / bottom
    }
}

/// Log density of the modes seen if the channels show these rods, changed like this.
#[allow(clippy::needless_range_loop, reason = "rows and columns have numbers")]
fn log_density(
    seen: &[Rod],
    shown: &[&Rod],
    changed: &[Change; 2],
    is_one_rod: bool,
    weather: &Weather,
) -> f64 {
    let mut residuals = Vec::new();
    let mut slopes = Vec::new();
    let mut diagonal = Vec::new();
    let mut block = Vec::new();
    for (index, (seen, rod)) in seen.iter().zip(shown).enumerate() {
        let change = changed[index];
        let u = rod.move_to(seen);
        for n in 0..rod.slope.len() {
            residuals.push(seen.log_frequency[n] - rod.log_frequency[n] - rod.slope[n] * weather.mean);
            slopes.push(rod.slope[n]);
            // The size of a move is limited to that of its explanation.
            let allowed = match change {
                Change::None => u.clamp(-0.1, 0.1),
                Change::Force | Change::Any => u.clamp(-1.0, 1.0),
            };
            let any = if change == Change::Any {
                ANY_SD * ANY_SD
            } else {
                0.0
            };
            let shape = (SHAPE * rod.slope[n] * allowed).powi(2);
            diagonal.push(seen.variance[n] + rod.variance[n] + shape + any);
            block.push(index);
        }
    }
    let size = residuals.len();
    let mut covariance = vec![0.0; size * size];
    for i in 0..size {
        for j in 0..size {
            let mut u = weather.variance;
            if block[i] == block[j] || is_one_rod {
                u += weather.apart;
            }
            if block[i] == block[j] && changed[block[i]] == Change::Force {
                u += CHANGE_SD * CHANGE_SD;
            }
            covariance[i * size + j] = u * slopes[i] * slopes[j];
        }
        covariance[i * size + i] += diagonal[i];
    }
    gaussian(&residuals, covariance)
}

/// Log density of a Gaussian at a residual, without the constant of its dimension. The covariance is positive definite.
#[allow(clippy::needless_range_loop, reason = "rows and columns have numbers")]
fn gaussian(residuals: &[f64], mut factor: Vec<f64>) -> f64 {
    let size = residuals.len();
    let mut solved = residuals.to_vec();
    let mut log_density = 0.0;
    for i in 0..size {
        for j in 0..=i {
            let mut value = factor[i * size + j];
            for k in 0..j {
                value -= factor[i * size + k] * factor[j * size + k];
            }
            factor[i * size + j] = if i == j {
                value.max(f64::MIN_POSITIVE).sqrt()
            } else {
                value / factor[j * size + j]
            };
        }
        for k in 0..i {
            solved[i] -= factor[i * size + k] * solved[k];
        }
        solved[i] /= factor[i * size + i];
        log_density -= 0.5 * solved[i] * solved[i] + libm::log(factor[i * size + i]);
    }
    log_density
}
