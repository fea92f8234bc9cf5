//! Interpolates between uneven stamps to an even grid.

use super::grid::{Grid, SHORT_GAP, Stretch, difference, interval_ns};
use super::{ImportError, Stamps};
use crate::read::contents::rounded;

/// Largest interval to resample to, in intervals of the stamps: without a filter, a larger one would alias
/// fast vibration onto slow.
const COARSER: f64 = 1.1;

/// Largest distance of an interpolated sample from its nearest stamp, in intervals: stamps farther apart have lost one between them.
const NEAR: f64 = 0.9;

/// Interpolates linearly to an even grid of `fs_hz`. Samples farther than [`NEAR`] from every stamp, or in gaps of more than three
/// intervals, are missing; a gap of more than [`SHORT_GAP`] intervals begins another stretch. The grid's deviation is the largest
/// distance between one of its samples and the stamp nearest to it.
pub(super) fn resample(
    stamps: &Stamps,
    values: &[f64],
    fs_hz: f64,
    most: usize,
) -> Result<(Grid, Vec<f64>), ImportError> {
    let nanos = &stamps.nanos;
    let step = 1e9 / fs_hz;
    let interval = interval_ns(stamps)?;
    if step > COARSER * interval {
        return Err(ImportError::new(format!(
            "--resample {fs_hz} is less than the {} Hz of the stamps and would fold fast vibration onto slow: give that or more",
            rounded(1e9 / interval)
        )));
    }
    let longest = 3.0 * interval;
    let farthest = SHORT_GAP * interval;
    let mut grid = Grid {
        fs_hz,
        stretches: Vec::new(),
        holes: Vec::new(),
        deviation_s: 0.0,
    };
    let mut out = Vec::new();
    let mut begin = 0;
    while begin < nanos.len() {
        let mut end = begin + 1;
        while end < nanos.len() && difference(nanos[end], nanos[end - 1]) <= farthest {
            end += 1;
        }
        let first = nanos[begin];
        let from = out.len();
        let count = ((difference(nanos[end - 1], first) / step).floor() as usize).saturating_add(1);
        if count.saturating_add(from) > most {
            return Err(ImportError::too_long());
        }
        let mut at = begin;
        for number in 0..count {
            let time = number as f64 * step;
            while at + 1 < end && difference(nanos[at + 1], first) <= time {
                at += 1;
            }
            let left = difference(nanos[at], first);
            let (value, nearest) = if at + 1 < end && time > left {
                let right = difference(nanos[at + 1], first);
                let share = (time - left) / (right - left);
                let nearest = (time - left).min(right - time);
                match right - left <= longest && nearest <= NEAR * interval {
                    true => (values[at] + share * (values[at + 1] - values[at]), nearest),
                    false => (f64::NAN, 0.0),
                }
            } else {
                (values[at], (time - left).abs())
            };
            grid.deviation_s = grid.deviation_s.max(nearest * 1e-9);
            out.push(value);
        }
        grid.stretches.push(Stretch {
            samples: from..out.len(),
            start_ns: first,
        });
        begin = end;
    }
    Ok((grid, out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stamps(nanos: Vec<i64>) -> Stamps {
        Stamps {
            nanos,
            absolute: false,
            resolution_ns: 1,
            says_unit: true,
            lines: Vec::new(),
        }
    }

    /// A straight line over a lost sample would be motion that nobody measured.
    #[test]
    fn single_lost_samples_are_missing_after_resampling() {
        let kept: Vec<i64> = (0..1000).filter(|i| i % 83 != 40).collect();
        let lost = stamps(kept.iter().map(|i| i * 5_000_000).collect());
        let values: Vec<f64> = kept.iter().map(|i| *i as f64).collect();
        let (_, out) = resample(&lost, &values, 200.0, 10_000).unwrap();
        let missing: Vec<usize> = (0..out.len()).filter(|i| out[*i].is_nan()).collect();
        let expected: Vec<usize> = (0..1000).filter(|i| i % 83 == 40).collect();
        assert_eq!((out.len(), missing), (1000, expected));
    }

    #[test]
    fn resampling_interpolates_and_keeps_gaps() {
        let uneven = stamps(vec![
            0,
            4_000_000,
            11_000_000,
            15_000_000,
            900_000_000,
            905_000_000,
        ]);
        let values = [0.0, 4.0, 11.0, 15.0, 900.0, 905.0];
        let (grid, out) = resample(&uneven, &values, 200.0, 100).unwrap();
        assert_eq!(grid.stretches.len(), 2);
        for (value, expected) in out.iter().zip([0.0, 5.0, 10.0, 15.0, 900.0, 905.0]) {
            assert!((value - expected).abs() < 1e-9, "{out:?}");
        }
        assert!((grid.deviation_s - 1e-3).abs() < 1e-12);
        assert!(resample(&uneven, &values, 1e9, 100).is_err());
        let folded = resample(&uneven, &values, 100.0, 100).unwrap_err().to_string();
        assert!(folded.contains("less than the 200 Hz"), "{folded}");
    }
}
