//! Fits an even grid to stamps: the rate, the beginnings and ends of stretches, and the stamps' distance from
//! it.

use super::{ImportError, Stamps};
use crate::read::contents::rounded;
use std::ops::Range;

/// Largest distance of even stamps from the grid, as a share of the interval; more is allowed where they are
/// written that coarsely.
const UNEVEN: f64 = 0.1;

/// Largest relative change of the measured rate to a rounder one, however coarse the stamps are.
const SURE: f64 = 1e-4;
/// Longest gap, in intervals, that becomes missing samples of a stretch: many short stretches would hide from the record how many samples
/// are missing, and their few stamps its rate.
pub(super) const SHORT_GAP: f64 = 64.0;

/// Longest interval that is no gap, in intervals.
const GAP: f64 = 1.5;

/// Evenly spaced samples without a gap.
#[derive(Debug, Clone, PartialEq)]
pub struct Stretch {
    /// Range of its samples, lost ones among them.
    pub samples: Range<usize>,
    /// Time of the first one \[ns\], on the clock of the stamps.
    pub start_ns: i64,
}

/// Times of stamped samples on a grid.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Grid {
    pub(super) fs_hz: f64,
    pub(super) stretches: Vec<Stretch>,
    /// Stamps before which samples of the grid are lost, and how many.
    pub(super) holes: Vec<(usize, usize)>,
    /// Largest distance of a stamp from the grid \[s\].
    pub(super) deviation_s: f64,
}

/// Grid on which the stamps lie.
///
/// # Errors
/// They go back, repeat, or lie unevenly; the sentence names the place and the largest deviation.
pub(super) fn even(stamps: &Stamps) -> Result<Grid, ImportError> {
    let (grid, worst) = fit(stamps)?;
    let interval_s = 1.0 / grid.fs_hz;
    let allowed_s = allowed_ns(1e9 * interval_s, stamps) * 1e-9;
    // A few gaps are a recorder's; one in ten samples is no rate.
    let gaps = grid.stretches.len() - 1 + grid.holes.len();
    let is_broken = gaps > stamps.nanos.len() / 10;
    if grid.deviation_s > allowed_s || is_broken {
        let what = if is_broken && grid.deviation_s <= allowed_s {
            format!("{gaps} gaps in {} samples", stamps.nanos.len())
        } else {
            format!(
                "this stamp lies {:.3e} s ({:.0} % of the interval) from an even grid of {} Hz, the farthest",
                grid.deviation_s,
                100.0 * grid.deviation_s / interval_s,
                rounded(grid.fs_hz),
            )
        };
        return Err(ImportError::at(
            stamps.place(worst),
            format!("the stamps are uneven: {what}. --resample HZ interpolates between them"),
        ));
    }
    Ok(grid)
}

/// Largest distance of a stamp from an even grid \[ns\].
fn allowed_ns(interval: f64, stamps: &Stamps) -> f64 {
    (UNEVEN * interval).max(stamps.resolution_ns as f64)
}

/// Most samples that keep one stamp each.
const STAMPED: usize = 1 << 21;

/// Uneven samples, each at its own stamp; `None` if they are too many or their stamps do not increase.
pub(super) fn uneven(stamps: &Stamps) -> Option<Grid> {
    if stamps.nanos.len() > STAMPED {
        return None;
    }
    let (mut grid, _) = fit(stamps).ok()?;
    let stamped = stamps.nanos.iter().enumerate().map(|(index, nano)| Stretch {
        samples: index..index + 1,
        start_ns: *nano,
    });
    grid.stretches = stamped.collect();
    grid.holes.clear();
    Some(grid)
}

impl Grid {
    /// The samples of the stamps with NaN in place of lost ones.
    pub(super) fn filled(&self, values: Vec<f64>) -> Vec<f64> {
        if self.holes.is_empty() {
            return values;
        }
        let lost: usize = self.holes.iter().map(|(_, count)| count).sum();
        let mut filled = Vec::with_capacity(values.len() + lost);
        let mut rest = &values[..];
        let mut at = 0;
        for (index, count) in &self.holes {
            let (before, after) = rest.split_at((index - at).min(rest.len()));
            filled.extend_from_slice(before);
            filled.resize(filled.len() + count, f64::NAN);
            (rest, at) = (after, *index);
        }
        filled.extend_from_slice(rest);
        filled
    }
}

/// Stamps on one grid, from the first to the last.
#[derive(Clone)]
struct Run {
    samples: Range<usize>,
    /// As of [`Grid::holes`].
    holes: Vec<(usize, usize)>,
}

impl Run {
    fn lost(&self) -> usize {
        self.holes.iter().map(|(_, count)| count).sum()
    }

    /// Place of each stamp on the grid, from 0.
    fn places(&self) -> impl Iterator<Item = usize> {
        let (mut holes, mut lost) = (self.holes.iter().peekable(), 0);
        self.samples.clone().map(move |index| {
            if let Some((_, count)) = holes.next_if(|(at, _)| *at == index) {
                lost += count;
            }
            index - self.samples.start + lost
        })
    }
}

/// Joins runs whose gap is short and a whole number of intervals: the samples between them are lost.
fn joined(runs: &[Run], nanos: &[i64], slope: f64, allowed_ns: f64) -> Vec<Run> {
    let mut joined: Vec<Run> = Vec::new();
    for run in runs {
        if let Some(before) = joined.last_mut() {
            let (last, next) = (before.samples.end - 1, run.samples.start);
            let steps = difference(nanos[next], nanos[last]) / slope;
            let whole = steps.round();
            let is_on_grid = (steps - whole).abs() * slope <= allowed_ns;
            if is_on_grid && (2.0..=SHORT_GAP).contains(&whole) {
                before.holes.push((next, whole as usize - 1));
                before.samples.end = run.samples.end;
                continue;
            }
        }
        joined.push(run.clone());
    }
    joined
}

/// Best grid, and the stamp farthest from it.
fn fit(stamps: &Stamps) -> Result<(Grid, usize), ImportError> {
    let nanos = &stamps.nanos;
    let interval = interval_ns(stamps)?;
    let longest = GAP * interval + stamps.resolution_ns as f64;
    let run = |samples| Run {
        samples,
        holes: Vec::new(),
    };
    let mut runs: Vec<Run> = Vec::new();
    let mut begin = 0;
    for (index, pair) in nanos.windows(2).enumerate() {
        if difference(pair[1], pair[0]) > longest {
            runs.push(run(begin..index + 1));
            begin = index + 1;
        }
    }
    runs.push(run(begin..nanos.len()));
    let slope = slope_ns(nanos, &runs, interval);
    let plain = of_runs(stamps, slope, runs.clone());
    // Behind a gap of the grid stamps lie on it as well as elsewhere.
    let as_well_ns = 2e9 * plain.0.deviation_s + stamps.resolution_ns as f64;
    let as_well_ns = as_well_ns.min(allowed_ns(slope, stamps));
    let joined = joined(&runs, nanos, slope, as_well_ns);
    if joined.len() < runs.len() {
        let found = of_runs(stamps, slope_ns(nanos, &joined, slope), joined);
        if found.0.deviation_s * 1e9 <= as_well_ns {
            return Ok(found);
        }
    }
    Ok(plain)
}

/// Grid of runs whose common slope is known, and the stamp farthest from it.
fn of_runs(stamps: &Stamps, slope: f64, runs: Vec<Run>) -> (Grid, usize) {
    let nanos = &stamps.nanos;
    let steps = |run: &Run| run.samples.len() + run.lost() - 1;
    let longest = runs.iter().map(steps).max().unwrap_or(1).max(1);
    let tolerance = (stamps.resolution_ns as f64 / longest as f64).min(SURE * slope);
    let slope = simplest(slope, tolerance);
    let mut grid = Grid {
        fs_hz: 1e9 / slope,
        stretches: Vec::with_capacity(runs.len()),
        holes: Vec::new(),
        deviation_s: 0.0,
    };
    let (mut worst, mut from) = (0, 0);
    for run in runs {
        let first = nanos[run.samples.start];
        let offs = || {
            let stamped = run.samples.clone().zip(run.places());
            stamped.map(|(index, place)| (index, difference(nanos[index], first) - place as f64 * slope))
        };
        let mean = offs().map(|(_, off)| off).sum::<f64>() / run.samples.len() as f64;
        // An exact grid begins at its first stamp, a scattered one at the mean of the starts that its stamps imply.
        let shift = if mean.abs() <= stamps.resolution_ns as f64 {
            0.0
        } else {
            mean
        };
        for (index, off) in offs() {
            let deviation_s = (off - shift).abs() * 1e-9;
            if deviation_s > grid.deviation_s {
                (grid.deviation_s, worst) = (deviation_s, index);
            }
        }
        let start_ns = first.saturating_add(shift.round() as i64);
        let samples = from..from + run.samples.len() + run.lost();
        from = samples.end;
        grid.stretches.push(Stretch { samples, start_ns });
        grid.holes.extend(run.holes);
    }
    (grid, worst)
}

/// `later - earlier` without overflow \[ns\].
pub(super) fn difference(later: i64, earlier: i64) -> f64 {
    (i128::from(later) - i128::from(earlier)) as f64
}

/// Median interval \[ns\]; an error if the stamps are fewer than two, or do not increase.
pub(super) fn interval_ns(stamps: &Stamps) -> Result<f64, ImportError> {
    if stamps.nanos.len() < 2 {
        return Err(ImportError::new("fewer than two stamps give no rate"));
    }
    let mut steps = Vec::with_capacity(stamps.nanos.len());
    let mut equal = None;
    for (index, pair) in stamps.nanos.windows(2).enumerate() {
        if pair[1] < pair[0] {
            return Err(ImportError::at(
                stamps.place(index + 1),
                format!(
                    "the time goes back by {:.3e} s: cut the file there, or if its samples are one interval apart and none is twice in \
                     it, --time none --rate HZ leaves the stamps out",
                    difference(pair[0], pair[1]) * 1e-9
                ),
            ));
        }
        if pair[1] == pair[0] {
            equal.get_or_insert(index + 1);
        }
        steps.push(pair[1].saturating_sub(pair[0]));
    }
    if let Some(index) = equal {
        return Err(ImportError::at(
            stamps.place(index),
            "the same stamp as the sample before: doubled lines, to be taken out, or stamps too coarse for the rate: --time none --rate HZ \
             leaves them out",
        ));
    }
    let middle = steps.len() / 2;
    let (_, median, _) = steps.select_nth_unstable(middle);
    Ok(*median as f64)
}

/// Common slope of all runs by least squares \[ns\], from one that is about right.
fn slope_ns(nanos: &[i64], runs: &[Run], about: f64) -> f64 {
    let (mut up, mut down) = (0.0, 0.0);
    for run in runs.iter().filter(|run| run.samples.len() > 1) {
        let first = nanos[run.samples.start];
        let middle = run.places().sum::<usize>() as f64 / run.samples.len() as f64;
        for (place, nano) in run.places().zip(&nanos[run.samples.clone()]) {
            let off = place as f64 - middle;
            // About a slope that is near, so that little is lost to rounding.
            up += off * (difference(*nano, first) - place as f64 * about);
            down += off * off;
        }
    }
    let slope = if down > 0.0 { about + up / down } else { about };
    // Stamps that scatter wildly could turn it over; the median cannot.
    if slope > 0.0 { slope } else { about }
}

/// The interval nearest to `slope` whose rate, or else which itself, has the fewest digits within `tolerance` \[ns\].
pub(super) fn simplest(slope: f64, tolerance: f64) -> f64 {
    for digits in 0..9 {
        for candidate in [
            format!("{:.digits$e}", 1e9 / slope)
                .parse()
                .map(|fs: f64| 1e9 / fs),
            format!("{slope:.digits$e}").parse(),
        ] {
            if let Ok(candidate) = candidate
                && (candidate - slope).abs() <= tolerance
            {
                return candidate;
            }
        }
    }
    slope
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::resample::resample;

    fn stamps(nanos: Vec<i64>, resolution_ns: i64) -> Stamps {
        Stamps {
            nanos,
            absolute: false,
            resolution_ns,
            says_unit: true,
            lines: Vec::new(),
        }
    }

    /// Stamps of `count` samples at `fs_hz`, written to `resolution_ns`.
    fn written(count: i64, fs_hz: f64, resolution_ns: i64) -> Vec<i64> {
        let round = |nanos: f64| (nanos / resolution_ns as f64).round() as i64 * resolution_ns;
        (0..count).map(|i| round(i as f64 / fs_hz * 1e9)).collect()
    }

    #[test]
    fn round_rates_come_out_round() {
        for (fs_hz, resolution_ns) in [
            (200.0, 1),
            (1024.0, 1),
            (1024.0, 1000),
            (300.0, 1_000_000),
            (800.0, 1_000_000),
            (1.0 / 60.0, 1_000_000_000),
            (102.4, 1_000_000),
            (4096.0, 10_000),
        ] {
            let grid = even(&stamps(written(6000, fs_hz, resolution_ns), resolution_ns)).unwrap();
            assert!(
                (grid.fs_hz / fs_hz - 1.0).abs() < 1e-12,
                "{fs_hz} at {resolution_ns} ns: {}",
                grid.fs_hz
            );
            assert_eq!(grid.stretches.len(), 1);
            assert_eq!(grid.stretches[0].start_ns, 0);
        }
    }

    #[test]
    fn a_slow_clock_is_measured_and_not_rounded() {
        let grid = even(&stamps(written(60_000, 199.987_654, 1000), 1000)).unwrap();
        assert!((grid.fs_hz / 199.987_654 - 1.0).abs() < 1e-8, "{}", grid.fs_hz);
    }

    #[test]
    fn a_gap_begins_another_stretch_at_its_own_time() {
        let mut nanos = written(1000, 200.0, 1);
        nanos[400..].iter_mut().for_each(|nano| *nano += 123_456_789);
        let grid = even(&stamps(nanos, 1)).unwrap();
        assert_eq!(grid.fs_hz, 200.0);
        assert_eq!(
            grid.stretches[1],
            Stretch {
                samples: 400..1000,
                start_ns: 2_123_456_789
            }
        );
    }

    /// One sample in a hundred lost, here and there: the rate is that of the stamps, not of the samples by their number.
    #[test]
    fn samples_lost_from_a_grid_are_missing_and_their_rate_is_the_grids() {
        for (fs_hz, resolution_ns) in [(100.0, 1000), (300.0, 1_000_000), (199.987_654, 1000)] {
            let is_lost = |i: usize| i % 97 == 50 || i % 61 == 7 || (4000..4050).contains(&i);
            let all = written(6000, fs_hz, resolution_ns);
            let kept: Vec<usize> = (0..6000).filter(|i| !is_lost(*i)).collect();
            let grid = even(&stamps(kept.iter().map(|i| all[*i]).collect(), resolution_ns)).unwrap();
            assert!((grid.fs_hz / fs_hz - 1.0).abs() < 1e-7, "{}", grid.fs_hz);
            assert_eq!(grid.stretches.len(), 1, "{fs_hz}");
            let filled = grid.filled(kept.iter().map(|i| *i as f64).collect());
            assert_eq!(filled.len(), grid.stretches[0].samples.len());
            for (i, value) in filled.iter().enumerate() {
                assert!(
                    if is_lost(i) {
                        value.is_nan()
                    } else {
                        *value == i as f64
                    },
                    "{i}: {value}"
                );
            }
        }
    }

    /// Gaps that nearly fit the grid would change its rate.
    #[test]
    fn gaps_beside_the_grid_begin_other_stretches() {
        let mut nanos = written(1000, 200.0, 1);
        for at in [100, 200, 300, 400, 500, 600, 700, 800] {
            nanos[at..].iter_mut().for_each(|nano| *nano += 20_400_000);
        }
        let grid = even(&stamps(nanos, 1)).unwrap();
        assert_eq!(
            (grid.fs_hz, grid.stretches.len(), grid.holes.len()),
            (200.0, 9, 0)
        );
    }

    #[test]
    fn uneven_doubled_and_backward_stamps_are_refused_with_their_place() {
        let mut nanos = written(1000, 200.0, 1);
        nanos[500] += 2_000_000;
        let error = even(&stamps(nanos.clone(), 1)).unwrap_err().to_string();
        assert!(
            error.starts_with("sample 501: ") && error.contains("e-3 s (40 %"),
            "{error}"
        );
        nanos[500] = nanos[499];
        assert!(
            even(&stamps(nanos.clone(), 1))
                .unwrap_err()
                .to_string()
                .contains("too coarse for the rate: --time none --rate HZ")
        );
        nanos[500] = nanos[499] - 1;
        assert!(
            even(&stamps(nanos, 1))
                .unwrap_err()
                .to_string()
                .contains("--time none --rate HZ")
        );
        let growing: Vec<i64> = (0..200).map(|i| i * i * 1_000_000).collect();
        assert!(even(&stamps(growing, 1)).is_err());
        let extremes = vec![i64::MIN, -1, 0, i64::MAX];
        let _ = even(&stamps(extremes, 1));
    }

    /// Samples lost four at a time are missing samples of one stretch, not stretches of another rate.
    #[test]
    fn short_gaps_are_missing_samples_of_one_stretch() {
        let kept: Vec<i64> = (0..1000).filter(|i| i % 10 < 6 || *i == 999).collect();
        let lost = stamps(kept.iter().map(|i| i * 5_000_000).collect(), 1);
        let values: Vec<f64> = kept.iter().map(|i| *i as f64).collect();
        let (grid, out) = resample(&lost, &values, 200.0, 10_000).unwrap();
        assert_eq!((grid.stretches.len(), out.len()), (1, 1000));
        assert_eq!(grid.deviation_s, 0.0);
        for (i, value) in out.iter().enumerate() {
            match i % 10 < 6 || i == 999 {
                true => assert_eq!(*value, i as f64),
                false => assert!(value.is_nan(), "{i} {value}"),
            }
        }
    }
}
