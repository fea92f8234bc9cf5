//! Puts stamped messages on an even time axis: sample rate by a line through the stamps, missing samples by
//! holes.

use super::clock::{self, Line, median};
use super::holes::{Holes, Offsets};
use super::{RecordSettings, Rejection, Timestamp};
use serde::{Deserialize, Serialize};

/// Messages in time order, not yet on an even axis.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Stretch {
    /// Time of each message's first sample \[ns\].
    pub times: Vec<i64>,
    /// Samples in each message.
    pub sizes: Vec<u32>,
    /// All samples.
    pub values: Vec<f64>,
}

/// Samples on an even axis; NaN where one is missing.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Even {
    pub start: Timestamp,
    pub fs_hz: f64,
    pub samples: Vec<f64>,
    /// Relative standard error of the rate; 0 where the stamps do not give it.
    pub clock_sd: f64,
    /// Standard deviation of the stamps about a straight line over the message interval, strays left out.
    pub jitter: f64,
    /// Messages whose stamps stray from the line.
    pub stray: Stray,
}

/// Messages with wrong stamps; their samples are placed by number.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Stray {
    pub messages: usize,
    /// Largest delay \[s\], negative if early.
    pub worst_s: f64,
}

impl Stray {
    /// Counts a message that is `late` \[ns\].
    pub fn count(&mut self, late: f64) {
        self.messages += 1;
        if (late * 1e-9).abs() > self.worst_s.abs() {
            self.worst_s = late * 1e-9;
        }
    }

    pub fn and(self, other: Self) -> Self {
        let worse = self.worst_s.abs() >= other.worst_s.abs();
        Self {
            messages: self.messages + other.messages,
            worst_s: if worse { self.worst_s } else { other.worst_s },
        }
    }
}

/// Least error of a stray stamp, in standard deviations of the others and in samples.
const STRAY: f64 = 6.0;
const STRAY_SHARE: f64 = 0.1;
/// Relative difference of declared and measured rate below which the declared one counts the samples between
/// stamps.
const NEAR: f64 = 0.01;
/// Residual below which stamps are exact, and least drift a message by which a rate is wrong \[samples\].
const EXACT: f64 = 0.02;

impl Stretch {
    pub fn push(&mut self, time: i64, values: &[f64]) {
        self.times.push(time);
        self.sizes.push(values.len() as u32);
        self.values.extend_from_slice(values);
    }

    /// Its size in memory \[bytes\].
    pub fn bytes(&self) -> usize {
        8 * self.values.len() + (size_of::<i64>() + size_of::<u32>()) * self.times.len()
    }

    /// Puts a late message in its place; `back` messages are younger.
    pub fn insert(&mut self, back: usize, time: i64, values: &[f64]) {
        let at = self.times.len() - back;
        let younger: usize = self.sizes[at..].iter().map(|&size| size as usize).sum();
        let first = self.values.len() - younger;
        self.times.insert(at, time);
        self.sizes.insert(at, values.len() as u32);
        self.values.splice(first..first, values.iter().copied());
    }

    /// Scatter of a stamp, from the last `count` messages and the interval of samples \[ns\].
    pub fn wobble(&self, count: usize, interval: f64) -> f64 {
        let from = self.times.len().saturating_sub(count);
        let mut off: Vec<f64> = self.times[from..]
            .windows(2)
            .zip(&self.sizes[from..])
            .map(|(pair, &size)| (pair[1].saturating_sub(pair[0]) as f64 - interval * f64::from(size)).abs())
            .collect();
        if off.is_empty() {
            return 0.0;
        }
        clock::GAUSSIAN * median(&mut off) / std::f64::consts::SQRT_2
    }

    /// Removes the last message and returns its samples.
    pub fn pop(&mut self) -> Vec<f64> {
        self.times.pop();
        let size = self.sizes.pop().unwrap_or(0) as usize;
        self.values.split_off(self.values.len().saturating_sub(size))
    }

    /// Cuts off all samples before `boundary` \[ns\], including those inside a message.
    pub fn split_front(&mut self, boundary: i64, interval: f64) -> Self {
        let at = self.times.partition_point(|&time| time < boundary);
        let mut first: usize = self.sizes[..at].iter().map(|&size| size as usize).sum();
        let mut front = Self {
            times: self.times[..at].to_vec(),
            sizes: self.sizes[..at].to_vec(),
            values: Vec::new(),
        };
        let mut rest = None;
        if let (Some(&time), Some(size)) = (front.times.last(), front.sizes.last_mut()) {
            let kept = (boundary.saturating_sub(time) as f64 / interval)
                .ceil()
                .clamp(1.0, f64::from(*size)) as u32;
            let moved = *size - kept;
            if moved > 0 {
                *size = kept;
                first -= moved as usize;
                let after = (f64::from(kept) * interval).round() as i64;
                rest = Some((time.saturating_add(after), moved));
            }
        }
        let back = self.values.split_off(first);
        front.values = std::mem::replace(&mut self.values, back);
        // A short record does not keep the room of the stretch it was cut from.
        if front.values.capacity() > front.values.len() + front.values.len() / 4 {
            front.values.shrink_to_fit();
        }
        self.times.drain(..at);
        self.sizes.drain(..at);
        if let Some((time, moved)) = rest {
            self.times.insert(0, time);
            self.sizes.insert(0, moved);
        }
        front
    }
}

/// Sample interval that the stamps suggest \[ns\]: the median over messages.
pub(super) fn interval(times: &[i64], sizes: &[u32]) -> Option<f64> {
    let mut intervals: Vec<f64> = times
        .windows(2)
        .zip(sizes)
        .map(|(pair, &size)| (i128::from(pair[1]) - i128::from(pair[0])) as f64 / f64::from(size.max(1)))
        .collect();
    let middle = median(&mut intervals);
    (middle > 0.0).then_some(middle)
}

/// Puts a stretch on an even axis.
pub(super) fn even(
    stretch: Stretch,
    declared_hz: Option<f64>,
    settings: &RecordSettings,
) -> Result<Even, Rejection> {
    let Stretch { times, sizes, values } = stretch;
    let (Some(&origin), count) = (times.first(), times.len()) else {
        return Err(too_short(0.0, settings));
    };
    if count == 1 {
        let Some(fs_hz) = declared_hz.filter(|_| values.len() > 1) else {
            return Err(too_short(0.0, settings));
        };
        return Ok(Even {
            start: Timestamp::from_nanos(origin),
            fs_hz,
            samples: values,
            clock_sd: 0.0,
            jitter: 0.0,
            stray: Stray::default(),
        });
    }
    let irregular = |jitter| Rejection::Irregular {
        jitter,
        allowed: settings.max_jitter,
    };
    let Some(dt) = interval(&times, &sizes) else {
        return Err(irregular(f64::INFINITY));
    };
    let size = median_size(&sizes);
    // More holes than samples is no record, and no memory for it.
    let too_many = |holes: &Holes| {
        let all = holes
            .iter()
            .fold(values.len() as u64, |all, &(_, lost)| all.saturating_add(lost));
        (all > 2 * values.len() as u64 + 1000).then(|| Rejection::Missing {
            share: 1.0 - values.len() as f64 / all as f64,
            allowed: settings.max_missing,
        })
    };
    let count_lost = |slope| {
        let mut holes = Offsets::of(&times, &sizes, slope, size).holes();
        if let Some(rejection) = too_many(&holes) {
            return Err(rejection);
        }
        let mut line = regress(&times, &sizes, &holes);
        if !holes.is_empty() {
            // With the rate known well, once more.
            holes = Offsets::of(&times, &sizes, line.slope, size).holes();
            if let Some(rejection) = too_many(&holes) {
                return Err(rejection);
            }
            line = regress(&times, &sizes, &holes);
        }
        Ok((holes, line))
    };
    let own = rough_slope(&times, &sizes, dt);
    let told = declared_hz
        .map(|fs_hz| 1e9 / fs_hz)
        .filter(|told| (told / own - 1.0).abs() < NEAR);
    let (mut holes, mut line) = count_lost(told.unwrap_or(own))?;
    let drift = told.map_or(0.0, |told| (told / own - 1.0).abs() * size);
    if drift > EXACT || told.is_some() && !holes.is_empty() {
        // Against the declared rate a slow clock looks like losses, and a fast one hides them: the rate that explains the stamps best counts.
        let misfit =
            |(holes, line): &(Holes, Line)| misfit(line, points(&times, &sizes, holes), holes.len(), dt);
        let mut best = (holes, line);
        let mut least = misfit(&best);
        for slope in [own, dt] {
            if let Ok(other) = count_lost(slope)
                && misfit(&other) < least
            {
                least = misfit(&other);
                best = other;
            }
        }
        (holes, line) = best;
    }
    let jitter = line.scatter / (dt * size);
    // A line that does not rise is no clock.
    if jitter.is_nan() || jitter > settings.max_jitter || line.slope <= 0.0 {
        return Err(irregular(jitter));
    }
    let mut fs_hz = nine_digits(1e9 / line.slope);
    let mut clock_sd = if count > 2 { line.slope_sd } else { 0.0 };
    if let Some(declared_hz) = declared_hz {
        let error = (fs_hz / declared_hz - 1.0).abs();
        // However few the stamps, twenty percent off is another rate.
        if error > settings.max_rate_error.max((4.0 * clock_sd).min(0.2)) {
            return Err(Rejection::Rate {
                declared_hz,
                measured_hz: fs_hz,
            });
        }
        (fs_hz, clock_sd) = clock::weigh(fs_hz, clock_sd, declared_hz, count);
    }
    // The first stamp itself where the line agrees with it, so that exact stamps stay exact.
    let start = if line.start.abs() < 0.01 * dt {
        0.0
    } else {
        line.start
    };
    let mut stray = Stray::default();
    let bound = (STRAY * line.scatter).max(STRAY_SHARE * dt);
    for point in points(&times, &sizes, &holes) {
        let late = line.late(point);
        if late.abs() > bound {
            stray.count(late);
        }
    }
    Ok(Even {
        start: Timestamp::from_nanos(origin.saturating_add(start.round() as i64)),
        fs_hz,
        samples: fill(values, &sizes, &holes),
        clock_sd,
        jitter,
        stray,
    })
}

/// Distance of stamps from a line with holes, less is better: sum of ln(q^2 + r^2) over the residuals r in samples, which single strays
/// hardly move, and 2 ln n for each of the holes among n messages, the price of a place and a size in Schwarz's criterion.
fn misfit(line: &Line, points: impl Iterator<Item = (f64, f64)>, holes: usize, dt: f64) -> f64 {
    let (count, sum) = points.fold((0.0, 0.0), |(count, sum), point| {
        let off = line.late(point) / dt;
        (count + 1.0, sum + libm::log(EXACT * EXACT + off * off))
    });
    sum + 2.0 * holes as f64 * libm::log(count)
}

/// Nanoseconds per sample by the stamps alone, before holes are known: the mean of the intervals without a hole, else (widely
/// scattered stamps) the median over many messages.
fn rough_slope(times: &[i64], sizes: &[u32], dt: f64) -> f64 {
    let gap = |i: usize| times[i + 1].saturating_sub(times[i]) as f64;
    let (mut time, mut samples) = (0.0, 0.0);
    for (i, &size) in sizes[..sizes.len() - 1].iter().enumerate() {
        let due = dt * f64::from(size);
        if (0.5 * due..1.5 * due).contains(&gap(i)) {
            time += gap(i);
            samples += f64::from(size);
        }
    }
    let mut off: Vec<f64> = (0..times.len() - 1)
        .map(|i| (gap(i) / (dt * f64::from(sizes[i])) - 1.0).abs())
        .collect();
    if samples > 0.0 && median(&mut off) < 0.15 {
        time / samples
    } else {
        let lag = 32.min(times.len() / 4).max(1);
        let mut numbers = Vec::with_capacity(times.len());
        let mut number = 0.0;
        for &size in sizes {
            numbers.push(number);
            number += f64::from(size);
        }
        let mut slopes: Vec<f64> = (0..times.len() - lag)
            .map(|i| times[i + lag].saturating_sub(times[i]) as f64 / (numbers[i + lag] - numbers[i]))
            .collect();
        let slope = median(&mut slopes);
        if slope > 0.0 { slope } else { dt }
    }
}

pub(super) fn too_short(duration_s: f64, settings: &RecordSettings) -> Rejection {
    Rejection::TooShort {
        duration_s,
        needed_s: settings.min_duration_s,
    }
}

fn nine_digits(value: f64) -> f64 {
    let scale = 10f64.powi(8 - value.abs().log10().floor() as i32);
    let rounded = (value * scale).round() / scale;
    if rounded.is_finite() && rounded > 0.0 {
        rounded
    } else {
        value
    }
}

fn median_size(sizes: &[u32]) -> f64 {
    let mut sizes: Vec<f64> = sizes.iter().map(|&size| f64::from(size)).collect();
    median(&mut sizes).max(1.0)
}

/// Sample number, holes counted, and time since the first stamp \[ns\] of each message.
fn points(times: &[i64], sizes: &[u32], holes: &Holes) -> impl Iterator<Item = (f64, f64)> {
    let mut holes = holes.iter().peekable();
    let mut number = 0.0;
    times
        .iter()
        .zip(sizes)
        .enumerate()
        .map(move |(i, (&time, &size))| {
            if let Some((_, count)) = holes.next_if(|(at, _)| *at == i) {
                number += *count as f64;
            }
            let point = (number, time.saturating_sub(times[0]) as f64);
            number += f64::from(size);
            point
        })
}

fn regress(times: &[i64], sizes: &[u32], holes: &Holes) -> Line {
    clock::fit(|| points(times, sizes, holes))
}

/// Samples with NaN for each lost one.
fn fill(values: Vec<f64>, sizes: &[u32], lost: &Holes) -> Vec<f64> {
    if lost.is_empty() {
        return values;
    }
    let extra: u64 = lost.iter().map(|&(_, count)| count).sum();
    let mut filled = Vec::with_capacity(values.len() + extra as usize);
    let mut lost = lost.iter().peekable();
    let mut first = 0;
    for (i, &size) in sizes.iter().enumerate() {
        if let Some((_, count)) = lost.next_if(|(at, _)| *at == i) {
            filled.extend(std::iter::repeat_n(f64::NAN, *count as usize));
        }
        let next = first + size as usize;
        filled.extend_from_slice(&values[first..next]);
        first = next;
    }
    filled
}
