//! Quality checks on an evenly sampled stretch: what disqualifies it, what is only noted.
//!
//! Order matters: samples that are no measurements (missing, frozen, spikes) are found before the signal
//! is judged. Every threshold is relative to the signal itself or to its smallest step, so that coarse
//! sensors, quiet tails of free decays and any unit are treated alike.

use super::clock::median;
use super::{Flag, RecordSettings, Rejection};
use std::ops::Range;

/// A stretch that passed.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// The samples, small faults repaired.
    pub samples: Vec<f64>,
    /// What was noticed.
    pub flags: Vec<Flag>,
}

/// A repeated value counts as held if the signal then jumps by more than this many smallest steps.
const HELD_STEPS: f64 = 3.0;
/// Share of samples that repeat by chance in a noisy coarse signal (at most 0.04 in our trials).
const NATURAL: f64 = 0.05;
/// Spikes stand out by this many robust standard deviations of the local roughness.
const SPIKE: f64 = 12.0;
/// A step is this many times the vibration around it.
const STEP: f64 = 6.0;
/// A change of level that no vibration makes.
const LEVEL: f64 = 30.0;

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

/// Replaces samples that are not finite by straight lines between their neighbours; how many.
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

/// Checks a stretch; `samples` may hold NaN where one is missing.
pub fn check(mut samples: Vec<f64>, fs_hz: f64, settings: &RecordSettings) -> Result<Checked, Rejection> {
    let mut flags = Vec::new();
    let total = samples.len().max(1) as f64;
    let missing = samples.iter().filter(|x| !x.is_finite()).count();
    let too_many = |count: usize| Rejection::Missing {
        share: count as f64 / total,
        allowed: settings.max_missing,
    };
    if missing as f64 > settings.max_missing * total {
        return Err(too_many(missing));
    }
    if missing > 0 {
        fill(&mut samples);
        flags.push(Flag::Filled { samples: missing });
    }
    let Some(range) = Extent::of(&samples) else {
        return Err(Rejection::Constant {
            value: samples.first().copied().unwrap_or(0.0),
        });
    };
    let held = held(&samples, &range) as f64 / total;
    if held > settings.max_held {
        return Err(Rejection::Held {
            share: held,
            allowed: settings.max_held,
        });
    }
    if held > NATURAL {
        flags.push(Flag::Held { share: held });
    }
    let clipped = clipped(&samples, &range) as f64 / total;
    if clipped > settings.max_clipped {
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
        if spikes.energy > rest {
            return Err(Rejection::Spikes { count: spikes.count });
        }
        if (missing + spikes.samples) as f64 > settings.max_missing * total {
            return Err(too_many(missing + spikes.samples));
        }
        flags.push(Flag::Despiked {
            samples: spikes.samples,
        });
    }
    if let Some((height, at)) = step(&samples, fs_hz, range.step) {
        return Err(Rejection::Step {
            height,
            time_s: at as f64 / fs_hz,
        });
    }
    if let Some((ratio, at)) = level_change(&samples, fs_hz, range.step) {
        return Err(Rejection::Level {
            ratio,
            time_s: at as f64 / fs_hz,
        });
    }
    Ok(Checked { samples, flags })
}

/// Extremes and smallest step of a signal.
struct Extent {
    low: f64,
    high: f64,
    /// Smallest difference of neighbours that differ: the resolution of a digital sensor.
    step: f64,
}

impl Extent {
    /// `None` for a constant signal.
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

/// Samples that repeat the one before although the signal moves on by more than its resolution; those at
/// the extremes are the rails' matter.
fn held(samples: &[f64], range: &Extent) -> usize {
    let mut held = 0;
    let mut run = 0;
    for pair in samples.windows(2) {
        if pair[1] == pair[0] {
            run += 1;
        } else {
            // A little slack for steps that are sums of rounded numbers.
            let moves = (pair[1] - pair[0]).abs() > (HELD_STEPS + 0.01) * range.step;
            if run > 0 && moves && pair[0] > range.low && pair[0] < range.high {
                held += run;
            }
            run = 0;
        }
    }
    held
}

/// Samples at a rail: at an extreme that holds far more than the band just inside it.
///
/// Just inside its peak a sine spends no more than half the time it spends in the next eight steps, and
/// a random signal less; a rail piles up what would have gone beyond it. Signals of fewer than some ten
/// steps cannot be told apart.
fn clipped(samples: &[f64], range: &Extent) -> usize {
    let reach = 0.5 * (range.high - range.low);
    let band = (0.05 * reach).max(8.0 * range.step);
    let hair = 1e-9 * reach;
    let (mut at_high, mut near_high, mut at_low, mut near_low) = (0usize, 0usize, 0usize, 0usize);
    for &sample in samples {
        let (down, up) = (range.high - sample, sample - range.low);
        if down <= hair {
            at_high += 1;
        } else if down <= band {
            near_high += 1;
        }
        if up <= hair {
            at_low += 1;
        } else if up <= band {
            near_low += 1;
        }
    }
    // Few samples prove nothing either way.
    let rail = |at: usize, near: usize| {
        if at as f64 > 1.5 * near as f64 + 4.0 {
            at
        } else {
            0
        }
    };
    rail(at_high, near_high) + rail(at_low, near_low)
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
        // Some sixty samples tell the scale well enough for so high a threshold.
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

/// Whether a sample is far from the middle of its nine neighbours, and most of those are not.
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

/// Sums of a signal and its square, in blocks.
struct Blocks {
    /// Running sums at the block boundaries.
    sums: Vec<(f64, f64)>,
    size: usize,
}

impl Blocks {
    fn of(samples: &[f64], size: usize, mean: f64) -> Self {
        let mut sums = Vec::with_capacity(samples.len() / size + 1);
        let (mut first, mut second) = (0.0, 0.0);
        sums.push((first, second));
        for block in samples.chunks_exact(size) {
            let (mut a, mut b) = (0.0, 0.0);
            for x in block {
                let x = x - mean;
                a += x;
                b += x * x;
            }
            first += a;
            second += b;
            sums.push((first, second));
        }
        Self { sums, size }
    }

    /// Number of whole blocks.
    fn len(&self) -> usize {
        self.sums.len() - 1
    }

    /// Mean (less the signal's) and variance over a range of blocks.
    fn stats(&self, range: Range<usize>) -> (f64, f64) {
        let count = (range.len() * self.size) as f64;
        let (from, to) = (self.sums[range.start], self.sums[range.end]);
        let mean = (to.0 - from.0) / count;
        (mean, ((to.1 - from.1) / count - mean * mean).max(0.0))
    }
}

fn mean(samples: &[f64]) -> f64 {
    samples.iter().sum::<f64>() / samples.len().max(1) as f64
}

/// The largest abrupt change of the mean, if it is larger than the vibration around it: height and place.
///
/// Means over a second on either side are compared with the scatter about them; a straight ramp reaches
/// 3.5 of these, a slow oscillation 4.2, so that drift and sway are no steps.
fn step(samples: &[f64], fs_hz: f64, resolution: f64) -> Option<(f64, usize)> {
    // Blocks to a window. A step inside a block adds less than 0.03 of its square to the scatter, so that
    // none larger than asked for falls below the coarse limit; what passes that is looked at closely.
    const WINDOW: usize = 16;
    const COARSE: f64 = 15.0;
    let size = ((fs_hz / WINDOW as f64).round() as usize).max(1);
    let window = WINDOW * size;
    let middle = mean(samples);
    let blocks = Blocks::of(samples, size, middle);
    if blocks.len() < 3 * WINDOW {
        return None;
    }
    let whole = (0..blocks.len() / WINDOW).map(|i| blocks.stats(i * WINDOW..(i + 1) * WINDOW).1);
    let inside = whole.sum::<f64>() / (blocks.len() / WINDOW) as f64;
    let floor = resolution.powi(2).max(0.04 * inside);
    let score = |sums: &Blocks, at: usize, window: usize| {
        let (before, scatter_before) = sums.stats(at - window..at);
        let (after, scatter_after) = sums.stats(at..at + window);
        let height = after - before;
        let scatter = (0.5 * (scatter_before + scatter_after)).max(floor);
        (height * height / scatter, height)
    };
    let mut worst: Option<(f64, f64, usize)> = None;
    for at in WINDOW..=blocks.len() - WINDOW {
        if score(&blocks, at, WINDOW).0 < COARSE {
            continue;
        }
        let from = (at * size).saturating_sub(window + size);
        let to = (at * size + window + size).min(samples.len());
        let near = Blocks::of(&samples[from..to], 1, middle);
        for close in window..=near.len() - window {
            let (score, height) = score(&near, close, window);
            if score > STEP * STEP && worst.is_none_or(|(most, ..)| score > most) {
                worst = Some((score, height, from + close));
            }
        }
    }
    worst.map(|(_, height, at)| (height, at))
}

/// A jump of the vibration level that stays: ratio and place.
///
/// A free decay rises at once and falls slowly; a level that falls at once, or rises at once and then does
/// not fall, is no vibration.
fn level_change(samples: &[f64], fs_hz: f64, resolution: f64) -> Option<(f64, usize)> {
    let window = (fs_hz.round() as usize).max(16);
    let sums = Blocks::of(samples, window, mean(samples));
    let blocks = sums.len();
    if blocks < 8 {
        return None;
    }
    let level: Vec<f64> = (0..blocks)
        .map(|i| sums.stats(i..i + 1).1.sqrt().max(resolution))
        .collect();
    let running = |levels: &mut dyn Iterator<Item = &f64>| -> Vec<(f64, f64)> {
        levels
            .scan((f64::INFINITY, 0.0f64), |(least, most), &level| {
                (*least, *most) = (least.min(level), most.max(level));
                Some((*least, *most))
            })
            .collect()
    };
    let before = running(&mut level.iter());
    let after = running(&mut level.iter().rev());
    // The block with the change in it belongs to neither side.
    for i in 2..blocks - 4 {
        let ((least_before, most_before), (least_after, most_after)) = (before[i - 1], after[blocks - i - 2]);
        let up = least_after / most_before;
        let down = least_before / most_after;
        let third = (blocks - i - 1).div_ceil(3);
        let stays = || mean(&level[blocks - third..]) >= 0.95 * mean(&level[i + 1..i + 1 + third]);
        let ratio = if up > LEVEL && stays() { up } else { down };
        if ratio > LEVEL {
            return Some((ratio, i * window));
        }
    }
    None
}
