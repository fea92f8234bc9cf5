//! Quality checks on an evenly sampled stretch: faults that reject it, and faults that are only flagged.
//!
//! Order matters: samples that are no measurements (missing, frozen, spikes) are found before the signal
//! is judged. Every threshold is relative to the signal itself or to its smallest step, so that coarse
//! sensors, quiet tails of free decays and any unit are treated alike.

use super::clock::median;
use super::error_code::{self, ErrorCode};
use super::hold;
use super::steps::{level_change, mean, step};
use super::{Flag, RecordSettings, Rejection};
use std::ops::Range;

/// A stretch that passed.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// The samples, small faults repaired.
    pub samples: Vec<f64>,
    /// Faults noticed.
    pub flags: Vec<Flag>,
}

/// Height of a spike, in robust standard deviations of the local roughness.
const SPIKE: f64 = 12.0;
/// Most samples at an extreme that prove nothing either way.
const FEW_AT_RAIL: f64 = 4.0;
/// Fewest visits that make a rail; one or two are a sensor overloaded once.
const VISITS: usize = 3;
/// Longest stay of a vibration at an extreme \[s\].
pub(super) const STAY_S: f64 = 0.25;
/// Number of spikes below which all are repaired, however large.
const FEW_SPIKES: usize = 3;
/// Ratio of the motion after a blow to that before it, at least.
const BLOW: f64 = 5.0;
/// Samples to either side of an outlier that tell how rough the motion is there, and the fewest that do.
const SURROUNDINGS: usize = 32;
const LEAST_SURROUNDINGS: usize = 16;
/// Most samples that measure the motion beside a spike: a tenth of a second at rates to 40 kHz, thinned
/// evenly beyond.
const BESIDE: usize = 4096;

/// Runs without a hole of more than `hole` samples, ends trimmed to finite samples.
pub(super) fn spans(samples: &[f64], hole: usize) -> Vec<Range<usize>> {
    let mut spans = Vec::new();
    let mut start = None;
    let mut end = 0;
    for (i, sample) in samples.iter().enumerate() {
        if !sample.is_finite() {
            continue;
        }
        match start {
            Some(from) if i - end > hole => {
                spans.push(from..end);
                start = Some(i);
            }
            None => start = Some(i),
            Some(_) => {}
        }
        end = i + 1;
    }
    if let Some(from) = start {
        spans.push(from..end);
    }
    spans
}

/// Replaces samples that are not finite by straight lines between their neighbours; returns their number.
pub(super) fn fill(samples: &mut [f64]) -> usize {
    let mut filled = 0;
    let mut i = 0;
    while i < samples.len() {
        if samples[i].is_finite() {
            i += 1;
            continue;
        }
        let end = samples[i..]
            .iter()
            .position(|sample| sample.is_finite())
            .map_or(samples.len(), |ahead| i + ahead);
        let before = i.checked_sub(1).map(|at| samples[at]);
        let after = samples.get(end).copied();
        let (from, to) = match (before, after) {
            (Some(from), Some(to)) => (from, to),
            (Some(value), None) | (None, Some(value)) => (value, value),
            (None, None) => (0.0, 0.0),
        };
        let steps = (end - i + 1) as f64;
        for (step, sample) in samples[i..end].iter_mut().enumerate() {
            let share = (step + 1) as f64 / steps;
            *sample = from * (1.0 - share) + to * share;
        }
        filled += end - i;
        i = end;
    }
    filled
}

/// Checks a stretch; missing samples are NaN.
pub fn check(mut samples: Vec<f64>, fs_hz: f64, settings: &RecordSettings) -> Result<Checked, Rejection> {
    let codes = error_code::strike(&mut samples, fs_hz);
    let mut checked = check_struck(samples, &codes, fs_hz, settings)?;
    checked.flags.extend(codes.iter().map(ErrorCode::flag));
    Ok(checked)
}

/// The same for a stretch whose error codes are NaN already.
pub(super) fn check_struck(
    mut samples: Vec<f64>,
    codes: &[ErrorCode],
    fs_hz: f64,
    settings: &RecordSettings,
) -> Result<Checked, Rejection> {
    let mut flags = Vec::new();
    let total = samples.len().max(1) as f64;
    let missing = samples.iter().filter(|x| !x.is_finite()).count();
    let too_many = |count: usize| Rejection::Missing {
        share: count as f64 / total,
        allowed: settings.max_missing,
    };
    if missing as f64 > settings.max_missing * total {
        let named = error_code::refusal(codes, samples.len(), fs_hz, settings);
        let is_enough = error_code::share(codes, samples.len()) > settings.max_missing;
        return Err(named.filter(|_| is_enough).unwrap_or_else(|| too_many(missing)));
    }
    // Straight lines would have steps of their own.
    let extent = Extent::of(&samples);
    if missing > 0 {
        fill(&mut samples);
        flags.push(Flag::Filled { samples: missing });
    }
    let Some(range) = extent else {
        return Err(Rejection::Constant {
            value: samples.first().copied().unwrap_or(0.0),
        });
    };
    let held = hold::held(&samples, fs_hz, &range) as f64 / total;
    if held > settings.max_held {
        return Err(Rejection::Held {
            share: held,
            allowed: settings.max_held,
        });
    }
    if held > hold::NATURAL {
        flags.push(Flag::Held { share: held });
    }
    let rails = clipped(&samples, &range, fs_hz);
    let clipped = rails.samples as f64 / total;
    if rails.is_sure && clipped > settings.max_clipped {
        return Err(Rejection::Clipped {
            share: clipped,
            allowed: settings.max_clipped,
        });
    }
    if clipped > 0.0 {
        flags.push(Flag::Clipped { share: clipped });
    }
    let spikes = despike(&mut samples, fs_hz, range.step);
    if spikes.count > 0 {
        let rest = variance(&samples) * total;
        if spikes.energy > rest && spikes.count >= FEW_SPIKES {
            return Err(Rejection::Spikes { count: spikes.count });
        }
        if (missing + spikes.samples) as f64 > settings.max_missing * total {
            return Err(too_many(missing + spikes.samples));
        }
        flags.push(Flag::Despiked {
            samples: spikes.samples,
        });
    }
    let middle = mean(&samples);
    if let Some((height, at)) = step(&samples, middle, fs_hz, range.step) {
        return Err(Rejection::Step {
            height,
            time_s: at as f64 / fs_hz,
        });
    }
    if let Some((ratio, at)) = level_change(&samples, middle, fs_hz, range.step) {
        return Err(Rejection::Level {
            ratio,
            time_s: at as f64 / fs_hz,
        });
    }
    Ok(Checked { samples, flags })
}

/// Extremes and smallest step of a signal.
pub(super) struct Extent {
    pub(super) low: f64,
    pub(super) high: f64,
    /// Smallest difference of neighbours that differ: the resolution of a digital sensor.
    pub(super) step: f64,
}

impl Extent {
    /// Of the samples that are finite; `None` for a constant signal.
    fn of(samples: &[f64]) -> Option<Self> {
        let (mut low, mut high, mut step) = (f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY);
        let mut last = *samples.first()?;
        for &sample in samples {
            low = low.min(sample);
            high = high.max(sample);
            let change = (sample - last).abs();
            if change > 0.0 && change < step {
                step = change;
            }
            last = sample;
        }
        (high > low).then_some(Self { low, high, step })
    }
}

/// Samples at the rails.
struct Rails {
    samples: usize,
    /// True if the signal reached them often enough to refuse it.
    is_sure: bool,
}

/// Samples at a rail: at an extreme that holds far more than the band just inside it.
///
/// Just inside its peak a sine spends no more than half the time it spends in the next eight steps, and
/// a random signal less; a rail piles up what would have gone beyond it. Signals of fewer than about ten
/// steps cannot be judged. A rod held still by a rope stays at an extreme for long.
fn clipped(samples: &[f64], range: &Extent, fs_hz: f64) -> Rails {
    let reach = 0.5 * (range.high - range.low);
    let band = (0.05 * reach).max(8.0 * range.step);
    let hair = 1e-9 * reach;
    let high = rail(samples, |x| range.high - x, (hair, band), fs_hz);
    let low = rail(samples, |x| x - range.low, (hair, band), fs_hz);
    Rails {
        samples: high.samples + low.samples,
        is_sure: high.is_sure || low.is_sure,
    }
}

/// Samples at one extreme, by the distance from it: at most a `hair`, and others in the `band` beside it.
fn rail(samples: &[f64], down: impl Fn(f64) -> f64, (hair, band): (f64, f64), fs_hz: f64) -> Rails {
    let none = Rails {
        samples: 0,
        is_sure: false,
    };
    let at = samples.iter().filter(|&&sample| down(sample) <= hair).count();
    // Few samples prove nothing either way; the rest is not looked at.
    if at as f64 <= FEW_AT_RAIL {
        return none;
    }
    let (mut near, mut visits) = (0usize, 0usize);
    let mut is_there = false;
    for &sample in samples {
        let down = down(sample);
        if down <= hair {
            visits += usize::from(!is_there);
            is_there = true;
        } else if down <= band {
            near += 1;
        } else {
            is_there = false;
        }
    }
    if at as f64 <= 1.5 * near as f64 + FEW_AT_RAIL {
        return none;
    }
    let is_still = at as f64 > STAY_S * fs_hz * visits as f64;
    let is_sure = visits >= VISITS && !is_still;
    Rails {
        samples: if is_still { 0 } else { at },
        is_sure,
    }
}

struct Spikes {
    count: usize,
    samples: usize,
    energy: f64,
}

/// Replaces isolated outliers, up to three samples wide, by straight lines.
fn despike(samples: &mut [f64], fs_hz: f64, step: f64) -> Spikes {
    let mut spikes = Spikes {
        count: 0,
        samples: 0,
        energy: 0.0,
    };
    let total = samples.len();
    let block = (fs_hz.round() as usize).clamp(64, 1 << 16);
    if total < 2 * 9 {
        return spikes;
    }
    let rough = |samples: &[f64], i: usize| (samples[i] - 0.5 * (samples[i - 1] + samples[i + 1])).abs();
    let mut bad: Vec<usize> = Vec::new();
    let mut some = Vec::with_capacity(block);
    for from in (1..total - 1).step_by(block) {
        let to = (from + block).min(total - 1);
        // About sixty samples give the scale well enough for so high a threshold.
        some.clear();
        some.extend((from..to).step_by((block / 64).max(1)).map(|i| rough(samples, i)));
        let scale = (median(&mut some) / 0.6745).max(step);
        let limit = 0.5 * SPIKE * scale;
        let around = &samples[from - 1..to + 1];
        let largest = around
            .windows(3)
            .fold(0.0f64, |most, w| most.max((w[1] - 0.5 * (w[0] + w[2])).abs()));
        if largest <= limit {
            continue;
        }
        for i in from..to {
            if rough(samples, i) > limit {
                // The neighbours of a spike are rough too; each candidate is judged against its surroundings.
                for candidate in i - 1..=i + 1 {
                    if bad.last().is_none_or(|&last| candidate > last) && outlier(samples, candidate, scale) {
                        bad.push(candidate);
                    }
                }
            }
        }
    }
    let mut runs: Vec<Range<usize>> = Vec::new();
    for &i in &bad {
        match runs.last_mut() {
            Some(run) if run.end == i => run.end += 1,
            _ => runs.push(i..i + 1),
        }
    }
    for run in runs.into_iter().filter(|run| run.len() <= 3) {
        if is_blow(samples, fs_hz, &run) || is_motion(samples, &run) {
            continue;
        }
        let original = samples[run.clone()].to_vec();
        samples[run.clone()].fill(f64::NAN);
        let around = run.start.saturating_sub(1)..(run.end + 1).min(total);
        fill(&mut samples[around]);
        spikes.count += 1;
        spikes.samples += run.len();
        spikes.energy += original
            .iter()
            .zip(&samples[run])
            .map(|(was, is)| (was - is).powi(2))
            .sum::<f64>();
    }
    spikes
}

/// True if the samples beside an outlier are about as rough as itself: a struck rod's returning wave, not a spike. The scale of
/// a block of one second is that of the quiet before a blow, wherever that is most of the block.
fn is_motion(samples: &[f64], run: &Range<usize>) -> bool {
    // Neither the run nor the samples that its own roughness reaches.
    let before = run.start.saturating_sub(SURROUNDINGS + 1).max(1)..run.start.saturating_sub(1);
    let after = (run.end + 1)..(run.end + 1 + SURROUNDINGS).min(samples.len() - 1);
    let level = |range: Range<usize>| {
        let mut rough: Vec<f64> = range
            .map(|i| (samples[i] - 0.5 * (samples[i - 1] + samples[i + 1])).abs())
            .collect();
        median(&mut rough) / 0.6745
    };
    let middle = |range: Range<usize>| {
        let mut near = samples[range].to_vec();
        median(&mut near)
    };
    let near = middle(run.start.saturating_sub(4)..(run.end + 4).min(samples.len()));
    let height = samples[run.clone()]
        .iter()
        .fold(0.0, |most: f64, x| most.max((x - near).abs()));
    let sides = [before, after]
        .into_iter()
        .filter(|side| side.len() >= LEAST_SURROUNDINGS);
    sides.map(level).any(|level| height < SPIKE * level)
}

/// True if the rod moves much more behind an outlier than before it: a hammer's blow, not an electric spike.
fn is_blow(samples: &[f64], fs_hz: f64, run: &Range<usize>) -> bool {
    let window = ((0.1 * fs_hz).round() as usize).max(64);
    // Medians, so that other spikes do not count.
    let level = |range: Range<usize>| {
        let step = range.len().div_ceil(BESIDE).max(1);
        let mut near: Vec<f64> = samples[range].iter().step_by(step).copied().collect();
        let middle = median(&mut near);
        for x in &mut near {
            *x = (*x - middle).abs();
        }
        median(&mut near)
    };
    let margin = 4;
    let after = (run.end + margin).min(samples.len())..(run.end + margin + window).min(samples.len());
    let before = run.start.saturating_sub(window + margin)..run.start.saturating_sub(margin);
    before.len() >= 16 && after.len() >= 16 && level(after) > BLOW * level(before)
}

/// True if a sample is far from the middle of its nine neighbours, and most of those are not.
fn outlier(samples: &[f64], at: usize, scale: f64) -> bool {
    let from = at.saturating_sub(4);
    let to = (at + 5).min(samples.len());
    let mut near = [0.0; 9];
    let near = &mut near[..to - from];
    near.copy_from_slice(&samples[from..to]);
    let middle = median(near);
    let distance = (samples[at] - middle).abs();
    if distance <= SPIKE * scale {
        return false;
    }
    for x in near.iter_mut() {
        *x = (*x - middle).abs();
    }
    near.sort_unstable_by(f64::total_cmp);
    // Six of nine lie close together; the spike is far outside.
    near.get(5).is_some_and(|&inner| distance > 4.0 * inner)
}

fn variance(samples: &[f64]) -> f64 {
    let count = samples.len().max(1) as f64;
    let mean = samples.iter().sum::<f64>() / count;
    samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count
}
