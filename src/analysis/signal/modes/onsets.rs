//! Onsets of free decays and blows within a record.
//!
//! A strong release or blow is seen in the samples themselves ([`releases`]): the level of the smoothed
//! slope, which a slow pull before a release hardly moves, just after an instant over that before it. A
//! weaker one is seen in the innovations of the fitted modes ([`blows`]), where the motion that goes on
//! anyway is taken out. Blows at even intervals, which neither shows, are a train ([`train()`]).

mod train;

pub use train::train;

use super::subband::{Pole, Subband};
use crate::signal::record::slope::Slope;
use std::ops::Range;

/// Half width of the smoothed slope, in periods of the strongest peak.
const HALF: f64 = 0.12;
/// Stretches compared \[periods\]: after the instant, most before it, least before it.
const AFTER: f64 = 2.0;
const BEFORE: f64 = 10.0;
const BEFORE_LEAST: f64 = 0.5;
/// Periods before an instant from which on the ratio decides alone: within fewer, modes that cancel for a moment look like quiet, and the
/// ratio must be larger by the square of what is missing.
const SURE_BEFORE: f64 = 3.0;
/// Ratio of the mean squared slopes that makes an onset.
const RATIO: f64 = 25.0;
/// Share of that ratio above which motion must continue after the stretch; otherwise it was a spike.
const PERSISTS: f64 = 0.1;
/// Largest share of the mean squared slope that a steady one may have; above it, it was the beginning of a
/// pull.
const STEADY: f64 = 0.3;

/// A motion that begins within a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Release {
    /// A sample surely before the onset.
    pub before: usize,
    /// A sample surely after the onset.
    pub after: usize,
    /// True for one of a train of blows.
    pub is_of_train: bool,
}

/// The motions that begin within a record, in time order; `scale_hz` is the frequency of its strongest peak.
pub fn releases(samples: &[f64], fs_hz: f64, scale_hz: f64) -> Vec<Release> {
    let count = |periods: f64| (periods * fs_hz / scale_hz).round().max(1.0) as usize;
    let half = count(HALF);
    let (before, after) = (count(BEFORE), count(AFTER).max(4 * half));
    let least = count(BEFORE_LEAST).max(2 * half);
    let total = samples.len();
    if total < 2 * half + least + 2 * after {
        return Vec::new();
    }
    let slope = Slope::of(samples, half);
    let mean = |from: usize, to: usize| slope.mean_square(from, to);
    let floor = slope.floor();
    let period = fs_hz / scale_hz;
    let mut found = Vec::new();
    // The instant of the highest ratio in a run of instants above the limit.
    let mut best: Option<(f64, usize)> = None;
    let last = total - half - 2 * after;
    for at in (half + least..last).step_by(half.div_ceil(2)) {
        let quiet = mean(at.saturating_sub(before).max(half), at).max(floor);
        let level = mean(at, at + after);
        let ratio = level / quiet;
        let is_onset = || {
            let goes_on = mean(at + after, at + 2 * after);
            let swings = || {
                let later = &slope.values()[at + after..at + 2 * after];
                let drift = later.iter().sum::<f64>() / after as f64;
                drift * drift < STEADY * goes_on
            };
            let before = (at - half).min(before) as f64 / period;
            let limit = RATIO * (SURE_BEFORE / before).max(1.0).powi(2);
            ratio > limit && goes_on > PERSISTS * level && goes_on > 4.0 * quiet && swings()
        };
        // No limit is lower: most instants are done with here.
        if ratio > RATIO && is_onset() {
            if best.is_none_or(|(highest, _)| ratio > highest) {
                best = Some((ratio, at));
            }
        } else if let Some((_, at)) = best.take() {
            found.push(at);
        }
    }
    found.extend(best.map(|(_, at)| at));
    let period = count(1.0);
    let place = |at: usize| {
        let window = at..at + after;
        let first = slope
            .first_above(window.clone(), 0.25 * slope.peak(window))
            .unwrap_or(at);
        // The slope looks `half` samples to either side.
        let (before, after) = (first.saturating_sub(half + 1), first + half);
        Release {
            before: pull_began(samples, before, after, period),
            after,
            is_of_train: false,
        }
    };
    found.into_iter().map(place).collect()
}

/// Sample at which the rod begins to be pulled before a release, or `before` if it is not held.
///
/// The mean over a period is the static part. It is compared with the one about which the rod swings after the
/// release, and followed back until it is a two-hundredth of what is let go.
fn pull_began(samples: &[f64], before: usize, after: usize, period: usize) -> usize {
    let mean = |from: usize, to: usize| samples[from..to].iter().sum::<f64>() / (to - from).max(1) as f64;
    let later = |n: usize| (after + n * period).min(samples.len());
    if before < period || later(16) < later(6) + period {
        return before;
    }
    let rest = mean(later(6), later(16));
    let (mut ripple, mut windows) = (0.0, 0.0);
    for from in (later(6)..later(16) - period).step_by(period.div_ceil(4)) {
        ripple += (mean(from, from + period) - rest).powi(2);
        windows += 1.0;
    }
    let ripple = (ripple / f64::max(windows, 1.0)).sqrt();
    let held = |to: usize| (mean(to - period, to) - rest).abs();
    let least = (0.005 * held(before)).max(3.0 * ripple);
    let mut at = before;
    while at >= period && held(at) > least {
        at = at.saturating_sub(period.div_ceil(4));
    }
    at
}

/// Ratio of an innovation's power to its neighbours' that makes a blow: exponential deviates reach it once in
/// 1e8.
const BLOW: f64 = 40.0;
/// Distance of the nearest and the farthest neighbour compared; a blow off the grid leaks into the nearest.
const NEAREST: usize = 3;
const FARTHEST: usize = 8;
/// Innovations ignored at either end, where the record's ends meet.
const ENDS: usize = 3;
/// Median of an exponential deviate of mean 1.
const MEDIAN: f64 = 0.693;

/// A blow in the innovations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Blow {
    /// Time surely before the blow \[s\].
    pub before_s: f64,
    /// Time surely after the blow \[s\].
    pub after_s: f64,
    /// Ratio of its power to that of its neighbours \[-\].
    pub ratio: f64,
}

/// Blows in the innovations of all modes, at least `apart_s` seconds apart.
pub fn blows(series: &[(Subband, Pole)], apart_s: f64) -> Vec<Blow> {
    let all: Vec<Innovations> = series
        .iter()
        .map(|(series, pole)| Innovations::of(series, *pole))
        .collect();
    let Some((finest, instants)) = all
        .iter()
        .map(|one| (one.rate_hz, one.powers.len()))
        .max_by(|a, b| a.0.total_cmp(&b.0))
    else {
        return Vec::new();
    };
    let mut found: Vec<Blow> = (1..instants)
        .filter_map(|m| {
            let at = m as f64 / finest;
            let near = |one: &Innovations| one.near(at, 0.25 / finest);
            // A mean is above the limit only where a ratio is.
            if !all.iter().any(|one| near(one).any(|i| one.stands_out(i))) {
                return None;
            }
            let highest = |one: &Innovations| near(one).map(|i| one.ratio(i)).fold(0.0, f64::max);
            let ratio = all.iter().map(highest).sum::<f64>() / all.len() as f64;
            (ratio > BLOW).then_some(Blow {
                before_s: at - 1.25 / finest,
                after_s: at + 0.5 / finest,
                ratio,
            })
        })
        .collect();
    found.sort_by(|a, b| b.ratio.total_cmp(&a.ratio));
    let mut kept: Vec<Blow> = Vec::new();
    for blow in found {
        if kept
            .iter()
            .all(|other| (other.after_s - blow.after_s).abs() >= apart_s)
        {
            kept.push(blow);
        }
    }
    kept.sort_by(|a, b| a.after_s.total_cmp(&b.after_s));
    kept
}

/// Factor beyond rounding.
const SURELY: f64 = 1.001;

/// Powers of the innovations of one mode.
struct Innovations {
    rate_hz: f64,
    powers: Vec<f64>,
}

impl Innovations {
    fn of(series: &Subband, pole: Pole) -> Self {
        let factor = series.factor(pole);
        let mut powers = vec![0.0; series.samples.len()];
        for (m, pair) in series.samples.windows(2).enumerate() {
            powers[m + 1] = (pair[1] - factor * pair[0]).norm_sqr();
        }
        Self {
            rate_hz: series.rate_hz,
            powers,
        }
    }

    /// Those about an instant \[s\], half an interval and `slack_s` to either side.
    fn near(&self, at: f64, slack_s: f64) -> Range<usize> {
        let reach = 0.5 / self.rate_hz + slack_s;
        let first = ((at - reach) * self.rate_hz).ceil().max(0.0) as usize;
        let end = (((at + reach) * self.rate_hz).floor() as usize + 1).min(self.powers.len());
        first.min(end)..end
    }

    /// Neighbours of one, before and after it; none at both ends, which hold what is smooth across the band.
    fn around(&self, m: usize) -> [&[f64]; 2] {
        let end = (self.powers.len() + 1).saturating_sub(ENDS);
        if !(ENDS..end).contains(&m) {
            return [&[]; 2];
        }
        let before = m.saturating_sub(FARTHEST).max(ENDS)..(m + 1 - NEAREST).max(ENDS);
        let after = (m + NEAREST).min(end)..(m + FARTHEST + 1).min(end);
        [&self.powers[before], &self.powers[after]]
    }

    /// False for one whose ratio surely does not exceed [`BLOW`]: fewer neighbours than a median needs are so far below it.
    fn stands_out(&self, m: usize) -> bool {
        let limit = self.powers[m] * (SURELY * MEDIAN / BLOW);
        let around = self.around(m);
        let below = |side: &[f64]| side.iter().filter(|power| **power < limit).count();
        around.map(below).iter().sum::<usize>() > around.map(<[f64]>::len).iter().sum::<usize>() / 2
    }

    /// Power of one over the median of its neighbours; 0 without enough of them.
    fn ratio(&self, m: usize) -> f64 {
        let mut around = self.around(m).concat();
        let middle = around.len() / 2;
        if around.len() < FARTHEST - NEAREST {
            return 0.0;
        }
        let (_, median, _) = around.select_nth_unstable_by(middle, f64::total_cmp);
        self.powers[m] * MEDIAN / median.max(f64::MIN_POSITIVE)
    }
}
