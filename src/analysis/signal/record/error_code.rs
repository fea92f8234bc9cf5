//! Error codes among the samples: the one value that a sensor gives while it has lost its target.
//!
//! A value is taken for a code if several samples have exactly it, and it lies farther from every other sample than all of
//! these lie apart. No motion leaves such a void: a rail is reached through the range just inside it, a rod held by a
//! rope swings through when it is let go, and what a sensor holds it has measured before.

use super::clock::median;
use super::{Flag, RecordSettings, Rejection};
use std::ops::Range;

/// Fewest samples at a code; fewer are spikes.
const LEAST: usize = 4;
/// Least distance of a code from the motion, in the sensor's smallest steps.
const STEPS: f64 = 10.0;
/// Values at either extreme that may be codes, or spikes beside them.
const VALUES: usize = 8;
/// Least motion that is left: samples, and share of all.
const LEAST_LEFT: usize = 64;
const LEAST_SHARE: f64 = 0.1;

/// Ratio of the roughness behind a blow to that before it, at least.
const BLOW: f64 = 4.0;
/// Length that tells how rough the motion is \[s\], and the fewest and most samples of it.
const BESIDE_S: f64 = 0.3;
const BESIDE: (usize, usize) = (64, 4096);
/// Most runs that are looked at for blows, evenly among all: thousands of runs say no more, and each costs its neighbourhood.
const JUDGED: usize = 256;

/// Samples at an error code.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ErrorCode {
    pub value: f64,
    /// Runs of samples, ascending; never empty.
    pub runs: Vec<Range<usize>>,
}

impl ErrorCode {
    fn samples(&self) -> usize {
        self.runs.iter().map(Range::len).sum()
    }

    /// The runs inside `range`, counted from its start; `None` if there are none.
    pub fn within(&self, range: &Range<usize>) -> Option<Self> {
        let inside = self.runs.iter().filter_map(|run| {
            let (from, to) = (run.start.max(range.start), run.end.min(range.end));
            (from < to).then(|| from - range.start..to - range.start)
        });
        let runs: Vec<Range<usize>> = inside.collect();
        (!runs.is_empty()).then_some(Self {
            value: self.value,
            runs,
        })
    }

    pub fn flag(&self) -> Flag {
        Flag::ErrorCode {
            value: self.value,
            runs: self.runs.len(),
            samples: self.samples(),
        }
    }
}

/// Refusal of `total` samples for the codes among them, of which the most frequent one is named; `None` without codes.
pub(super) fn refusal(
    codes: &[ErrorCode],
    total: usize,
    fs_hz: f64,
    settings: &RecordSettings,
) -> Option<Rejection> {
    let most = codes.iter().max_by_key(|code| code.samples())?;
    Some(Rejection::ErrorCode {
        value: most.value,
        runs: most.runs.len(),
        time_s: most.runs.first()?.start as f64 / fs_hz,
        share: share(codes, total),
        allowed: settings.max_missing,
    })
}

/// Share of `total` samples at codes.
pub(super) fn share(codes: &[ErrorCode], total: usize) -> f64 {
    codes.iter().map(ErrorCode::samples).sum::<usize>() as f64 / total.max(1) as f64
}

/// Replaces samples at error codes by NaN.
pub(super) fn strike(samples: &mut [f64], fs_hz: f64) -> Vec<ErrorCode> {
    let mut struck: Vec<ErrorCode> = Vec::new();
    while struck.len() < VALUES {
        let codes = find(samples, fs_hz);
        if codes.is_empty() {
            break;
        }
        for code in codes {
            for run in &code.runs {
                samples[run.clone()].fill(f64::NAN);
            }
            struck.push(code);
        }
    }
    struck
}

/// Codes beyond the widest void, with the fewest other values beyond it.
fn find(samples: &[f64], fs_hz: f64) -> Vec<ErrorCode> {
    let (low, high) = extremes(samples);
    for beyond in 1..2 * VALUES - 1 {
        for above in 0..=beyond {
            let below = beyond - above;
            let (Some(bottom), Some(top)) = (low.get(below), high.get(above)) else {
                continue;
            };
            let (bottom, top) = (bottom.0, top.0);
            let range = top - bottom;
            let void = |at: usize, side: &[(f64, usize)]| match at.checked_sub(1) {
                Some(outer) => (side[outer].0 - side[at].0).abs(),
                None => f64::INFINITY,
            };
            let void = void(above, &high).min(void(below, &low));
            let values = || low[..below].iter().chain(&high[..above]);
            if !(range > 0.0 && void > range && values().any(|&(_, count)| count >= LEAST)) {
                continue;
            }
            let motion = bottom..=top;
            let left = samples.iter().filter(|x| motion.contains(x)).count();
            let is_left = left >= LEAST_LEFT && left as f64 >= LEAST_SHARE * samples.len() as f64;
            let step = resolution(samples, &motion);
            if !is_left || void < STEPS * step {
                continue;
            }
            let codes: Vec<ErrorCode> = values()
                .filter(|&&(_, count)| count >= LEAST)
                .map(|&(value, _)| at(samples, value))
                .filter(|code| {
                    let judged = code.runs.iter().step_by(code.runs.len().div_ceil(JUDGED));
                    let blows = judged.clone().filter(|run| is_blow(samples, fs_hz, run, step));
                    2 * blows.count() <= judged.len()
                })
                .collect();
            if !codes.is_empty() {
                return codes;
            }
        }
    }
    Vec::new()
}

/// Values with their numbers of samples.
type Values = Vec<(f64, usize)>;

/// The lowest and the highest values, outermost first.
fn extremes(samples: &[f64]) -> (Values, Values) {
    let (mut low, mut high) = (Vec::with_capacity(VALUES + 1), Vec::with_capacity(VALUES + 1));
    for &x in samples.iter().filter(|x| x.is_finite()) {
        note(&mut low, x, |a, b| a < b);
        note(&mut high, x, |a, b| a > b);
    }
    (low, high)
}

#[inline]
fn note(side: &mut Values, x: f64, is_outside: impl Fn(f64, f64) -> bool) {
    if side.len() == VALUES && side.last().is_some_and(|last| is_outside(last.0, x)) {
        return;
    }
    let at = side.iter().position(|&(value, _)| !is_outside(value, x));
    match at {
        Some(at) if side[at].0 == x => side[at].1 += 1,
        _ => {
            side.insert(at.unwrap_or(side.len()), (x, 1));
            side.truncate(VALUES);
        }
    }
}

/// Smallest difference of neighbours within the motion.
fn resolution(samples: &[f64], motion: &std::ops::RangeInclusive<f64>) -> f64 {
    samples
        .windows(2)
        .filter(|pair| motion.contains(&pair[0]) && motion.contains(&pair[1]) && pair[0] != pair[1])
        .map(|pair| (pair[1] - pair[0]).abs())
        .fold(f64::INFINITY, f64::min)
}

fn at(samples: &[f64], value: f64) -> ErrorCode {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (i, _) in samples.iter().enumerate().filter(|(_, x)| **x == value) {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end += 1,
            _ => runs.push(i..i + 1),
        }
    }
    ErrorCode { value, runs }
}

/// True if the motion is much rougher behind a run than before it: a blow that overloads the sensor clips it, and
/// excites high modes, which had died away.
fn is_blow(samples: &[f64], fs_hz: f64, run: &Range<usize>, step: f64) -> bool {
    let reach = ((BESIDE_S * fs_hz).round() as usize).clamp(BESIDE.0, BESIDE.1);
    let rough = |range: Range<usize>| {
        let bends = samples[range]
            .windows(3)
            .map(|near| (near[1] - 0.5 * (near[0] + near[2])).abs());
        median(&mut bends.filter(|bend| bend.is_finite()).collect::<Vec<f64>>())
    };
    let before = rough(run.start.saturating_sub(reach)..run.start);
    let after = rough(run.end..(run.end + reach).min(samples.len()));
    before.is_finite() && after > BLOW * before.max(step)
}
