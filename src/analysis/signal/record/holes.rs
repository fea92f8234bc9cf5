//! Finds samples lost on the way, by stamps that stay late.
//!
//! A stamp that is late alone, or a run of them that comes back (a stall of the line and what catches up behind it), is no hole:
//! samples are counted as lost only where the stamps behind confirm it.

use super::clock::{GAUSSIAN, median};

/// Lost samples by the message they precede: (index of the message, number of samples), ascending.
pub(super) type Holes = Vec<(usize, u64)>;

/// Scatter below which single stamps reveal a lost sample \[samples, or messages\].
const CLEAR: f64 = 0.1;
/// Scatter up to which means over neighbours reveal single samples; beyond, only whole messages \[samples\].
const COUNTABLE: f64 = 1.1;
/// Messages behind a hole that confirm it, and the fewest that must where single stamps scatter.
const CONFIRM: usize = 10;
const LEAST: usize = 5;
/// Messages averaged on either side where single stamps do not suffice.
const NEIGHBOURS: usize = 32;
/// Most messages examined behind a late one.
const FAR: usize = 512;
/// Least height of a hole, in standard errors and in samples.
const SURE: f64 = 6.0;
const SHARE: f64 = 0.75;

/// The stamps of a stretch in samples, the sample numbers taken off: flat but for holes, jitter and an error of the rate.
pub(super) struct Offsets {
    late: Vec<f64>,
    /// Scatter of one stamp \[samples\].
    scatter: f64,
    /// Samples in a message.
    size: f64,
}

impl Offsets {
    /// Offsets of stamps with `slope` nanoseconds per sample.
    pub fn of(times: &[i64], sizes: &[u32], slope: f64, size: f64) -> Self {
        let mut number = 0.0;
        let late: Vec<f64> = times
            .iter()
            .zip(sizes)
            .map(|(&time, &size)| {
                let late = time.saturating_sub(times[0]) as f64 / slope - number;
                number += f64::from(size);
                late
            })
            .collect();
        let mut steps: Vec<f64> = late.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
        let scatter = GAUSSIAN * median(&mut steps) / std::f64::consts::SQRT_2;
        Self { late, scatter, size }
    }

    /// Finds the holes.
    pub fn holes(&self) -> Holes {
        let quantum = if self.scatter < COUNTABLE { 1.0 } else { self.size };
        if self.scatter < CLEAR * quantum {
            self.one_by_one(quantum)
        } else {
            self.by_neighbours(quantum)
        }
    }

    /// Compares each stamp with a slowly corrected prediction.
    fn one_by_one(&self, quantum: f64) -> Holes {
        const GAIN: f64 = 0.2;
        let mut holes = Holes::new();
        let (mut base, mut lost) = (0.0, 0.0);
        for i in 1..self.late.len() {
            let error = self.late[i] - lost - base;
            if error.abs() < 0.5 * quantum {
                base += GAIN * error;
                continue;
            }
            let stays = self.stays(i, error) - lost - base;
            let whole = (stays / quantum).round();
            if i == 1 || whole < 0.0 {
                // The first stamp was early, or there are more samples than time: a new truth, not a hole.
                base += stays;
            } else if whole >= 1.0 {
                holes.push((i, (whole * quantum) as u64));
                lost += whole * quantum;
                base += GAIN * (stays - whole * quantum);
            }
        }
        holes
    }

    /// Offset that message `i` and those behind it keep: their least if it is late, their most if it is
    /// early. The offset of the last message alone proves nothing.
    fn stays(&self, i: usize, error: f64) -> f64 {
        let behind = self.behind(i, error.abs());
        let last = self.late[i - 1];
        match &self.late[i..behind] {
            [] | [_] => last,
            stamps if error > 0.0 => stamps.iter().fold(f64::INFINITY, |least, x| least.min(*x)),
            stamps => stamps.iter().fold(f64::NEG_INFINITY, |most, x| most.max(*x)),
        }
    }

    /// End of the messages that distinguish a hole of `lost` samples before message `i` from a stall: by then
    /// all delayed messages have arrived.
    fn behind(&self, i: usize, lost: f64) -> usize {
        let stalled = (2.0 * lost / self.size).ceil() as usize;
        i.saturating_add(stalled.clamp(CONFIRM, FAR)).min(self.late.len())
    }

    /// Compares medians over the messages on either side.
    fn by_neighbours(&self, quantum: f64) -> Holes {
        let count = self.late.len();
        let mut sums = Vec::with_capacity(count + 1);
        let mut sum = 0.0;
        sums.push(sum);
        for late in &self.late {
            sum += late;
            sums.push(sum);
        }
        let mean = |from: usize, to: usize| (sums[to] - sums[from]) / (to - from) as f64;
        let mut holes = Holes::new();
        // Where the stretch without a hole begins.
        let mut begin = 0;
        let mut i = LEAST;
        while i + LEAST <= count {
            let rise =
                |i: usize| mean(i, (i + CONFIRM).min(count)) - mean(i.saturating_sub(CONFIRM).max(begin), i);
            if rise(i) < 0.4 * quantum {
                i += 1;
                continue;
            }
            let most = (i..(i + CONFIRM).min(count + 1 - LEAST)).max_by(|&a, &b| rise(a).total_cmp(&rise(b)));
            let at = most.unwrap_or(i);
            let step = self.step(begin, at);
            let whole = (step / quantum).round();
            if step >= SHARE * quantum && whole >= 1.0 {
                holes.push((at, (whole * quantum) as u64));
                begin = at;
                i = at + LEAST;
            } else {
                i += 1;
            }
        }
        holes
    }

    /// Height of a step at message `at` that is significant and stays, or 0.
    fn step(&self, begin: usize, at: usize) -> f64 {
        let middle = |from: usize, to: usize| median(&mut self.late[from..to].to_vec());
        let (from, to) = (
            at.saturating_sub(NEIGHBOURS).max(begin),
            (at + NEIGHBOURS).min(self.late.len()),
        );
        let before = middle(from, at);
        let step = middle(at, to) - before;
        let error = 1.25 * self.scatter * (1.0 / (at - from) as f64 + 1.0 / (to - at) as f64).sqrt();
        if step < SURE * error {
            return 0.0;
        }
        // After the samples held back by a stall have arrived, the stamps must still be late.
        let later = self.behind(at, step);
        let until = (later + NEIGHBOURS).min(self.late.len());
        if until - later < LEAST {
            return step;
        }
        // A hole behind this one makes them later still.
        step.min(middle(later, until) - before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Messages of `size` samples at 100 Hz, the stamps off by `off` \[s\], samples lost before some.
    fn offsets(count: usize, size: u32, lost: &[(usize, u64)], off: impl Fn(usize) -> f64) -> Holes {
        let mut number = 0u64;
        let times: Vec<i64> = (0..count)
            .map(|i| {
                number += lost
                    .iter()
                    .filter(|(at, _)| *at == i)
                    .map(|(_, n)| n)
                    .sum::<u64>();
                let time = number as f64 * 0.01 + off(i);
                number += u64::from(size);
                (time * 1e9).round() as i64
            })
            .collect();
        Offsets::of(&times, &vec![size; count], 1e7, f64::from(size)).holes()
    }

    #[test]
    fn late_stamps_and_stalls_are_no_holes() {
        for size in [1, 32, 100] {
            for late in [0.003, 0.02, 0.08, 0.4] {
                let lone = offsets(200, size, &[], |i| if i == 77 { late } else { 0.0 });
                assert!(lone.is_empty(), "{size} {late}: {lone:?}");
                // Samples that arrive during a stall are stamped at its end.
                let end = 0.77 * f64::from(size) + late;
                let stall = offsets(200, size, &[], |i| {
                    let due = i as f64 * 0.01 * f64::from(size);
                    if i >= 77 { (end - due).max(0.0) } else { 0.0 }
                });
                assert!(stall.is_empty(), "{size} {late}: {stall:?}");
            }
        }
        assert!(offsets(200, 1, &[], |i| if i == 199 { 0.05 } else { 0.0 }).is_empty());
        assert!(offsets(200, 1, &[], |i| if i == 0 { -0.05 } else { 0.0 }).is_empty());
    }

    #[test]
    fn confirmed_holes_are_counted_to_the_sample() {
        for size in [1, 32] {
            let lost = [(20, 1), (60, 2), (61, 40), (150, 7)];
            assert_eq!(offsets(200, size, &lost, |_| 0.0), lost);
            // Stamps in whole milliseconds, as many loggers write them.
            let off = |i: usize| ((i * 7919) % 10) as f64 * 1e-4 - 5e-4;
            assert_eq!(offsets(200, size, &lost, off), lost);
        }
    }
}
