//! Samples that repeat because the sensor holds its value, told from those of a coarse sensor on a rod at rest.

use super::quality::{Extent, STAY_S};

/// Jump after a repeated value, in smallest steps, above which the value counts as held; a little slack for steps that
/// are sums of rounded numbers.
const HELD_STEPS: f64 = 3.01;
/// Share of samples that repeat by chance in a noisy coarse signal (at most 0.04 in our trials).
pub(super) const NATURAL: f64 = 0.05;
/// Jump to a repeated value, in smallest steps, above which it counts as held: at rest the jump is one.
const CAME_STEPS: f64 = 1.5;
/// Fewest samples that tell the motion beside a hold.
const LEAST_STAY: usize = 16;
/// Range of the motion, in smallest steps, beyond which a decay that comes to rest loses three quarters in [`STAY_S`].
const LIVELY_STEPS: f64 = 8.0;
/// Path of a vibration over its range within a second, at least; that of a pull is one.
const VIBRATES: f64 = 2.5;

/// Samples that repeat the one before although the rod moves.
pub(super) fn held(samples: &[f64], fs_hz: f64, range: &Extent) -> usize {
    let mut repeats = moved_on(samples, range, range.step);
    if repeats as f64 > NATURAL * samples.len() as f64 {
        // The smallest step of a signal whose last digits vary (a text of four digits) is not its resolution.
        repeats = repeats.min(moved_on(samples, range, common_step(samples)));
    }
    repeats.max(broken_off(samples, fs_hz))
}

/// Samples that repeat the one before although the signal comes and moves on by more than its resolution; those at
/// the extremes belong to the rails, and what repeats from the start on may be at rest.
fn moved_on(samples: &[f64], range: &Extent, step: f64) -> usize {
    let mut held = 0;
    let mut run = 0;
    let mut came = 0.0;
    for pair in samples.windows(2) {
        if pair[1] == pair[0] {
            run += 1;
        } else {
            let change = (pair[1] - pair[0]).abs();
            let moves = change > HELD_STEPS * step && came > CAME_STEPS * step;
            if run > 0 && moves && pair[0] > range.low && pair[0] < range.high {
                held += run;
            }
            run = 0;
            came = change;
        }
    }
    held
}

/// Samples of holds of [`STAY_S`] and more that begin in the midst of a vibration, at whatever phase of it, and end in
/// motion or with the record.
///
/// A decay that comes to rest has less than three steps left a quarter of a second before, or has lost half of its
/// motion within it, and three quarters of more than eight steps; a rod that is pulled and held still comes there without
/// a vibration. What repeats from the start on may be at rest.
fn broken_off(samples: &[f64], fs_hz: f64) -> usize {
    let stay = ((STAY_S * fs_hz).round() as usize).max(LEAST_STAY);
    let mut runs = Vec::new();
    let mut from = 0;
    for (at, pair) in samples.windows(2).enumerate() {
        if pair[1] != pair[0] {
            if at - from >= stay {
                runs.push(from..at + 1);
            }
            from = at + 1;
        }
    }
    if samples.len() - from > stay {
        runs.push(from..samples.len());
    }
    if runs.is_empty() {
        return 0;
    }
    let step = common_step(samples);
    runs.iter()
        .filter(|run| is_broken_off(&samples[..run.start + 1], stay, step))
        .filter(|run| {
            let after = &samples[run.end - 1..samples.len().min(run.end + stay)];
            after.len() == 1 || range_of(after) > HELD_STEPS * step
        })
        .map(|run| run.len() - 1)
        .sum()
}

/// True if the samples end in the midst of a vibration, not in a rest or at the end of a pull.
fn is_broken_off(before: &[f64], stay: usize, step: f64) -> bool {
    let last = |count: usize| &before[before.len().saturating_sub(count)..];
    let (near, second) = (range_of(last(stay)), last(4 * stay));
    let half = last(2 * stay);
    let earlier = range_of(&half[..half.len().saturating_sub(stay)]);
    let path: f64 = second.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
    let left = if near > LIVELY_STEPS * step { 0.25 } else { 0.5 };
    let goes_on = near.min(earlier) > HELD_STEPS * step && near > left * earlier;
    goes_on && path > VIBRATES * range_of(second)
}

/// Highest less lowest sample.
fn range_of(samples: &[f64]) -> f64 {
    let (low, high) = samples
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| {
            (low.min(x), high.max(x))
        });
    high - low
}

/// Smallest change between neighbours, less the lowest hundredth.
fn common_step(samples: &[f64]) -> f64 {
    let mut changes: Vec<f64> = samples
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).abs())
        .filter(|change| *change > 0.0)
        .collect();
    if changes.is_empty() {
        return 0.0;
    }
    let at = changes.len() / 100;
    *changes.select_nth_unstable_by(at, f64::total_cmp).1
}
