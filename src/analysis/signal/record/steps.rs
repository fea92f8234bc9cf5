//! Steps of a signal's mean and of its level that no vibration makes.
//!
//! A rod that is pulled and let go makes steps too. They differ from those of a moved sensor by what follows:
//! after a release the rod swings through, as far again on the other side, and a pull ends in a release. A
//! level changes with every gust, blow or hand on the rod; only a changed unit, range or sensor changes the
//! noise between the resonances along with it, and at once.

use realfft::RealFftPlanner;
use std::ops::Range;

/// Least height of a step over the vibration around it.
const STEP: f64 = 6.0;
/// Ratio of levels worth a closer look.
const LEVEL: f64 = 30.0;
/// Factor within which the noise must change along with the level.
const ALONG: f64 = 3.0;
/// Least swing after a release, as a share of its height, and over the motion before it.
const THROUGH: f64 = 0.2;
const ANSWER: f64 = 3.0;
/// Time within which the swing comes after a release \[s\].
const SWING_S: f64 = 1.0;
/// Tolerance of the same level, as a share of a step.
const SAME: f64 = 0.3;

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

pub(super) fn mean(samples: &[f64]) -> f64 {
    samples.iter().sum::<f64>() / samples.len().max(1) as f64
}

/// Blocks per window of a second. A step inside a block adds less than 0.03 of its square to the scatter, so
/// that none larger than asked for falls below the coarse limit; candidates above it are examined closely.
const WINDOW: usize = 16;
const COARSE: f64 = 15.0;

/// The largest abrupt change of the mean, if it is larger than the vibration around it and neither a release nor a pull
/// that ends in one: height and place. `middle` is the mean of all samples.
///
/// Means over a second on either side are compared with the scatter about them; a straight ramp reaches
/// 3.5 of these, a slow oscillation 4.2, so that drift and sway are no steps.
pub(super) fn step(samples: &[f64], middle: f64, fs_hz: f64, resolution: f64) -> Option<(f64, usize)> {
    let size = ((fs_hz / WINDOW as f64).round() as usize).max(1);
    let window = WINDOW * size;
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
    // The best place of each run of blocks that see a step.
    let mut steps: Vec<(f64, f64, usize)> = Vec::new();
    let mut seen = 0;
    for at in WINDOW..=blocks.len() - WINDOW {
        if score(&blocks, at, WINDOW).0 < COARSE {
            continue;
        }
        let from = (at * size).saturating_sub(window + size);
        let to = (at * size + window + size).min(samples.len());
        let near = Blocks::of(&samples[from..to], 1, middle);
        for close in window..=near.len() - window {
            let (score, height) = score(&near, close, window);
            if score <= STEP * STEP {
                continue;
            }
            let found = (score, height, from + close);
            match steps.last_mut() {
                Some(last) if at - seen <= 1 && (last.1 > 0.0) == (height > 0.0) => {
                    if score > last.0 {
                        *last = found;
                    }
                }
                _ => steps.push(found),
            }
            seen = at;
        }
    }
    steps
        .into_iter()
        .filter(|&(_, height, at)| {
            !is_release(samples, fs_hz, height, at) && !is_pull(samples, fs_hz, height, at)
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, height, at)| (height, at))
}

/// True if the signal swings through the level it steps to, as a released rod does.
fn is_release(samples: &[f64], fs_hz: f64, height: f64, at: usize) -> bool {
    let count = |seconds: f64| ((seconds * fs_hz).round() as usize).max(4);
    // The place is known to a sixteenth of a second or so.
    let (near, reach) = (count(0.1), count(SWING_S));
    let before = &samples[at.saturating_sub(reach)..at.saturating_sub(near)];
    let after = &samples[at.saturating_sub(near)..(at + reach).min(samples.len())];
    let rest = &samples[(at + reach / 2).min(samples.len() - 1)..(at + 2 * reach).min(samples.len())];
    if before.len() < 4 {
        return false;
    }
    let level = mean(rest);
    let through = after.iter().fold(0.0f64, |most, x| {
        let beyond = (x - level) * height.signum();
        most.max(beyond)
    });
    through > THROUGH * height.abs() && through > ANSWER * swing(before)
}

/// Half the sway of a signal about a straight line, without its largest tenth.
fn swing(samples: &[f64]) -> f64 {
    let half = samples.len() / 2;
    let (first, second) = (mean(&samples[..half]), mean(&samples[half..]));
    let slope = (second - first) / half.max(1) as f64;
    let middle = 0.5 * (first + second);
    let mut off: Vec<f64> = samples
        .iter()
        .enumerate()
        .map(|(i, x)| (x - middle - slope * (i as f64 - half as f64)).abs())
        .collect();
    let most = off.len() * 9 / 10;
    if off.is_empty() {
        return 0.0;
    }
    *off.select_nth_unstable_by(most.min(samples.len() - 1), f64::total_cmp)
        .1
}

/// True if the signal leaves the level it steps to by a release, back to its former level.
fn is_pull(samples: &[f64], fs_hz: f64, height: f64, at: usize) -> bool {
    let size = ((fs_hz / WINDOW as f64).round() as usize).max(1);
    let before = &samples[at.saturating_sub(WINDOW * size)..at.saturating_sub(size)];
    let base = mean(before);
    let held = |block: &[f64]| (mean(block) - base - height).abs() < SAME * height.abs();
    // The hold begins once the pull is done, within the second after the step.
    let mut is_held = false;
    for (i, block) in samples[at..].chunks_exact(size).enumerate() {
        if held(block) {
            is_held = true;
        } else if is_held || i > WINDOW {
            let left = at + i * size;
            let after = &samples[left.saturating_sub(size)..(left + WINDOW * size).min(samples.len())];
            let through = after
                .iter()
                .fold(0.0f64, |most, x| most.max((base - x) * height.signum()));
            return is_held && through > THROUGH * height.abs() && through > ANSWER * swing(before);
        }
    }
    false
}

/// A jump of the vibration level, and of the noise with it, that stays: ratio and place. `middle` is the mean of all samples.
///
/// A free decay rises at once and falls slowly; a level that falls at once, or rises at once and then does
/// not fall, is examined closely.
pub(super) fn level_change(
    samples: &[f64],
    middle: f64,
    fs_hz: f64,
    resolution: f64,
) -> Option<(f64, usize)> {
    let window = (fs_hz.round() as usize).max(16);
    let sums = Blocks::of(samples, window, middle);
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
        if ratio <= LEVEL {
            continue;
        }
        let (quiet, loud) = (&samples[..i * window], &samples[(i + 1) * window..]);
        let (quiet, loud) = if up > down { (quiet, loud) } else { (loud, quiet) };
        // Standard deviation of rounding to a sensor's smallest step; below it there is no noise to compare.
        let least = resolution / 12f64.sqrt();
        let noise = noise(loud).max(least) / noise(quiet).max(least);
        let whole = spread(loud) / spread(quiet).max(least);
        if noise * ALONG > whole && is_at_once(samples, fs_hz, i * window, ratio) {
            return Some((ratio, i * window));
        }
    }
    None
}

fn spread(samples: &[f64]) -> f64 {
    let middle = mean(samples);
    (samples.iter().map(|x| (x - middle).powi(2)).sum::<f64>() / samples.len().max(1) as f64).sqrt()
}

/// Root mean square of the noise between the resonances: white noise at the density of the spectrum's lowest
/// tenth.
fn noise(samples: &[f64]) -> f64 {
    const LONGEST: usize = 1 << 12;
    const MOST: usize = 16;
    let size = LONGEST.min(1 << samples.len().max(2).ilog2());
    let transform = RealFftPlanner::<f64>::new().plan_fft_forward(size);
    let mut spectrum = transform.make_output_vec();
    let mut power = vec![0.0; spectrum.len()];
    let segments = (samples.len() / size).max(1);
    let every = segments.div_ceil(MOST);
    let mut taken = 0.0;
    for segment in samples.chunks_exact(size).step_by(every) {
        let middle = mean(segment);
        let mut tapered: Vec<f64> = segment
            .iter()
            .enumerate()
            .map(|(i, x)| {
                let phase = std::f64::consts::TAU * (i as f64 + 0.5) / size as f64;
                // Blackman-Harris window: leakage from a resonance lies 92 dB below it.
                let taper = 0.35875 - 0.48829 * phase.cos() + 0.14128 * (2.0 * phase).cos()
                    - 0.01168 * (3.0 * phase).cos();
                (x - middle) * taper
            })
            .collect();
        // Lengths fit by construction.
        if transform.process(&mut tapered, &mut spectrum).is_err() {
            return 0.0;
        }
        for (sum, line) in power.iter_mut().zip(&spectrum) {
            *sum += line.norm_sqr();
        }
        taken += 1.0;
    }
    let lowest = power.len() / 10;
    let density = *power.select_nth_unstable_by(lowest, f64::total_cmp).1;
    // The taper keeps 0.258 of the power.
    (density / (f64::max(taken, 1.0) * 0.258 * size as f64)).sqrt()
}

/// True if half of a change (of its logarithm) near `at` comes within a quarter of a second.
fn is_at_once(samples: &[f64], fs_hz: f64, at: usize, ratio: f64) -> bool {
    let size = ((fs_hz / WINDOW as f64).round() as usize).max(4);
    let quarter = WINDOW / 4;
    let second = WINDOW * size;
    let near = &samples[at.saturating_sub(second)..(at + 2 * second).min(samples.len())];
    let blocks = Blocks::of(near, size, mean(near));
    let level = |block: usize| blocks.stats(block..block + quarter).1.sqrt();
    (quarter..blocks.len().saturating_sub(2 * quarter)).any(|block| {
        let (before, after) = (level(block - quarter), level(block + 1));
        let change = (before / after).max(after / before);
        change * change > ratio
    })
}
