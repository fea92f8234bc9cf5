//! Stamps to an even time axis: sample rate by regression, missing samples by their holes.

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
    /// Standard deviation of the stamps about a straight line over the message interval.
    pub jitter: f64,
}

/// Scatter below which a single stamp tells a lost sample from a late one.
const CLEAR: f64 = 0.1;
/// Messages on either side that are averaged over where a single stamp does not tell.
const NEIGHBOURS: usize = 32;

impl Stretch {
    pub fn push(&mut self, time: i64, values: &[f64]) {
        self.times.push(time);
        self.sizes.push(values.len() as u32);
        self.values.extend_from_slice(values);
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

    /// Cuts off what comes before `boundary` \[ns\], samples inside a message included.
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
        self.times.drain(..at);
        self.sizes.drain(..at);
        if let Some((time, moved)) = rest {
            self.times.insert(0, time);
            self.sizes.insert(0, moved);
        }
        front
    }
}

/// The middle of some numbers.
pub(super) fn median(numbers: &mut [f64]) -> f64 {
    if numbers.is_empty() {
        return f64::NAN;
    }
    let middle = numbers.len() / 2;
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The sample interval the stamps suggest \[ns\]: the median over messages.
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
            jitter: 0.0,
        });
    }
    let irregular = |jitter| Rejection::Irregular {
        jitter,
        allowed: settings.max_jitter,
    };
    let Some(dt) = interval(&times, &sizes) else {
        return Err(irregular(1.0));
    };
    let lost = lost_samples(&times, &sizes, dt);
    let all = lost
        .iter()
        .fold(values.len() as u64, |all, &(_, lost)| all.saturating_add(lost));
    // More holes than samples is no record, and no memory for it.
    if all > 2 * values.len() as u64 + 1000 {
        return Err(Rejection::Missing {
            share: 1.0 - values.len() as f64 / all as f64,
            allowed: settings.max_missing,
        });
    }
    let line = regress(&times, &sizes, &lost);
    let unit = dt * median_size(&sizes);
    let jitter = line.scatter / unit;
    if jitter > settings.max_jitter {
        return Err(irregular(jitter));
    }
    let mut fs_hz = nine_digits(1e9 / line.slope);
    if let Some(declared_hz) = declared_hz {
        let error = (fs_hz / declared_hz - 1.0).abs();
        // Standard error of a slope over evenly spaced points.
        let sd = jitter * 12f64.sqrt() / (count as f64).powf(1.5);
        // However few the stamps, twenty percent off is another rate.
        if error > settings.max_rate_error.max((4.0 * sd).min(0.2)) {
            return Err(Rejection::Rate {
                declared_hz,
                measured_hz: fs_hz,
            });
        }
        if error < 1e-9 {
            fs_hz = declared_hz;
        }
    }
    // The first stamp itself where the line agrees with it, so that exact stamps stay exact.
    let start = if line.start.abs() < 0.01 * dt {
        0.0
    } else {
        line.start
    };
    Ok(Even {
        start: Timestamp::from_nanos(origin.saturating_add(start.round() as i64)),
        fs_hz,
        samples: fill(values, &sizes, &lost),
        jitter,
    })
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

/// Samples lost before which message: (message, how many), in order.
///
/// With little scatter each stamp is compared with a slowly corrected prediction. With more, a hole
/// counts if the stamps stay late: late ones alone come back. Where a batch's stamp scatters by more than
/// a sample interval, only whole batches can be seen missing.
fn lost_samples(times: &[i64], sizes: &[u32], dt: f64) -> Vec<(usize, u64)> {
    let mut late: Vec<f64> = times
        .windows(2)
        .zip(sizes)
        .map(|(pair, &size)| pair[1].saturating_sub(pair[0]) as f64 / dt - f64::from(size))
        .collect();
    let mut spread: Vec<f64> = late.iter().map(|late| late.abs()).collect();
    let scatter = 1.4826 * median(&mut spread) / std::f64::consts::SQRT_2;
    let quantum = if scatter < CLEAR { 1.0 } else { median_size(sizes) };
    if scatter / quantum < CLEAR {
        predicted(&mut late, quantum)
    } else {
        persistent(times, sizes, dt, &late, quantum)
    }
}

fn predicted(late: &mut [f64], quantum: f64) -> Vec<(usize, u64)> {
    const GAIN: f64 = 0.2;
    let mut lost = Vec::new();
    let mut phase = 0.0;
    for (i, late) in late.iter().enumerate() {
        let error = (phase + late) / quantum;
        let whole = error.round();
        if whole >= 1.0 {
            lost.push((i + 1, (whole * quantum) as u64));
        }
        // A stamp too early by more than half is a new truth, not an error.
        let error = if whole >= 0.0 { error - whole } else { 0.0 };
        phase = (1.0 - GAIN) * error * quantum;
    }
    lost
}

fn persistent(times: &[i64], sizes: &[u32], dt: f64, late: &[f64], quantum: f64) -> Vec<(usize, u64)> {
    let origin = times[0];
    let mut firsts = Vec::with_capacity(times.len());
    let mut first = 0.0;
    for &size in sizes {
        firsts.push(first);
        first += f64::from(size);
    }
    let offset = |i: usize| times[i].saturating_sub(origin) as f64 / dt - firsts[i];
    let mut lost: Vec<(usize, u64)> = Vec::new();
    let mut last = 0;
    for (i, &late) in late.iter().enumerate() {
        if late < 0.5 * quantum {
            continue;
        }
        let at = i + 1;
        let mut before: Vec<f64> = (at.saturating_sub(NEIGHBOURS).max(last)..at)
            .map(offset)
            .collect();
        let mut after: Vec<f64> = (at..(at + NEIGHBOURS).min(times.len())).map(offset).collect();
        let whole = ((median(&mut after) - median(&mut before)) / quantum).round();
        if whole >= 1.0 {
            lost.push((at, (whole * quantum) as u64));
            last = at;
        }
    }
    lost
}

struct Line {
    /// Nanoseconds a sample.
    slope: f64,
    /// The line at sample 0, from the first stamp \[ns\].
    start: f64,
    /// Standard deviation about the line \[ns\].
    scatter: f64,
}

/// Least squares of the stamps on the sample numbers.
fn regress(times: &[i64], sizes: &[u32], lost: &[(usize, u64)]) -> Line {
    let points = || {
        let mut lost = lost.iter().peekable();
        let mut number = 0.0;
        times
            .iter()
            .zip(sizes)
            .enumerate()
            .map(move |(i, (&time, &size))| {
                if let Some((_, count)) = lost.next_if(|(at, _)| *at == i) {
                    number += *count as f64;
                }
                let point = (number, time.saturating_sub(times[0]) as f64);
                number += f64::from(size);
                point
            })
    };
    let count = times.len() as f64;
    let (sum_k, sum_t) = points().fold((0.0, 0.0), |(k, t), point| (k + point.0, t + point.1));
    let (mean_k, mean_t) = (sum_k / count, sum_t / count);
    let (mut kk, mut kt) = (0.0, 0.0);
    for (k, t) in points() {
        kk += (k - mean_k) * (k - mean_k);
        kt += (k - mean_k) * (t - mean_t);
    }
    let slope = kt / kk;
    let start = mean_t - slope * mean_k;
    let squares: f64 = points().map(|(k, t)| (t - start - slope * k).powi(2)).sum();
    Line {
        slope,
        start,
        scatter: (squares / (count - 2.0).max(1.0)).sqrt(),
    }
}

/// Samples with NaN where one is lost.
fn fill(values: Vec<f64>, sizes: &[u32], lost: &[(usize, u64)]) -> Vec<f64> {
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
