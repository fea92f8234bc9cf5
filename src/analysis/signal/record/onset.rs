//! The onset of free decays: short-term over long-term level.
//!
//! The level is that of a smoothed derivative, which the slow pull before a release hardly moves, in a
//! short window over that in a long window before it (STA/LTA, Allen 1978). A single spike is no onset:
//! the motion must go on.

use super::slope::Slope;

/// Half width of the smoothed derivative \[s\].
const HALF_S: f64 = 0.01;
/// Short window \[s\].
const SHORT_S: f64 = 0.2;
/// Long window \[s\], and its least length at the start.
const LONG_S: f64 = 4.0;
const LONG_LEAST_S: f64 = 0.4;
/// Time that motion must last after an onset \[s\].
const PERSIST_S: f64 = 0.5;

/// Samples needed before the first onset that can be seen.
pub(super) fn context(fs_hz: f64) -> usize {
    ((LONG_S + SHORT_S + 2.0 * HALF_S) * fs_hz).ceil() as usize + 2
}

/// Indices of the first sample of each free decay; `samples` are finite.
pub(super) fn onsets(samples: &[f64], fs_hz: f64, ratio: f64) -> Vec<usize> {
    let count = |seconds: f64| ((seconds * fs_hz).round() as usize).max(1);
    let half = count(HALF_S);
    let short = count(SHORT_S).max(2 * half);
    let (long, least) = (count(LONG_S), count(LONG_LEAST_S).max(short));
    let persist = count(PERSIST_S);
    let total = samples.len();
    if total < least + short + persist + 2 * half {
        return Vec::new();
    }
    let slope = Slope::of(samples, half);
    let mean = |from: usize, to: usize| slope.mean_square(from, to);
    let floor = slope.floor();
    let mut found = Vec::new();
    let mut armed = true;
    for end in (half + least + short)..(total - half) {
        let from = end - short;
        let quiet = mean(from.saturating_sub(long).max(half), from).max(floor);
        let level = (mean(from, end) / quiet).sqrt();
        if !armed {
            armed = level < 0.5 * ratio;
            continue;
        }
        if level <= ratio || level.is_nan() {
            continue;
        }
        // Beyond the reach of a single spike in the derivative.
        let (later, after) = (end + 2 * half, (end + 2 * half + persist).min(total - half));
        if after <= later || (mean(later, after) / quiet).sqrt() < 0.5 * ratio {
            continue;
        }
        armed = false;
        let window = from..(end + short).min(total - half);
        let threshold = (0.25 * slope.peak(window.clone())).max(3.0 * quiet.sqrt());
        let first = slope.first_above(window, threshold).unwrap_or(end);
        // The derivative looks `half` samples ahead.
        found.push(first + half);
    }
    found
}

/// Motion at the first sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum UnderWay {
    /// A free decay: far above the later level.
    Decays,
    /// Falls all the way, as a slow decay does and an ambient response sometimes.
    Perhaps,
    /// Does not fall.
    No,
}

/// Detects a decay that began before the first sample: a recorder that is triggered by the blow, or starts late.
///
/// A decay is sure where the first half second exceeds the quietest `LONG_S` (or third) that follows by `ratio` and no later part is
/// louder. One too slow for that falls from each quarter to the next, by a fifth in all at least.
pub(super) fn under_way(samples: &[f64], fs_hz: f64, ratio: f64) -> UnderWay {
    let count = |seconds: f64| ((seconds * fs_hz).round() as usize).max(1);
    let half = count(HALF_S);
    let total = samples.len();
    let first = count(PERSIST_S).min(total / 8);
    if first < 4 * half {
        return UnderWay::No;
    }
    let slope = Slope::of(samples, half);
    let inner = half..total - half;
    let level = |range: std::ops::Range<usize>| slope.mean_square(range.start, range.end).max(0.0).sqrt();
    let start = level(half..half + first);
    let quiet = count(LONG_S).min(total / 3);
    let quietest = inner
        .clone()
        .step_by(quiet)
        .map(|at| level(at.min(total - half - quiet)..at.min(total - half - quiet) + quiet))
        .fold(f64::INFINITY, f64::min);
    let loudest = inner
        .step_by(first)
        .map(|at| level(at.min(total - half - first)..at.min(total - half - first) + first))
        .fold(0.0, f64::max);
    // Beats between modes raise a later level by a few percent.
    if start > ratio * quietest && start > 0.8 * loudest {
        return UnderWay::Decays;
    }
    let quarter = (total - 2 * half) / 4;
    let quarters: Vec<f64> = (0..4)
        .map(|i| level(half + i * quarter..half + (i + 1) * quarter))
        .collect();
    let falls = quarters.windows(2).all(|pair| pair[1] < pair[0]);
    if falls && quarters[3] < 0.8 * quarters[0] {
        UnderWay::Perhaps
    } else {
        UnderWay::No
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pulls and releases at the given times; deterministic noise.
    fn pulls(times: &[f64], seconds: f64, fs_hz: f64, noise: f64) -> Vec<f64> {
        let mut state = 1u64;
        (0..(seconds * fs_hz) as usize)
            .map(|i| {
                let t = i as f64 / fs_hz;
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let mut x = noise * ((state >> 33) as f64 / f64::from(1u32 << 31) - 0.5);
                for &onset in times {
                    if t >= onset {
                        x += (-(t - onset) * 0.6).exp() * (28.0 * (t - onset)).cos();
                    } else if t > onset - 2.0 {
                        x += (t - onset + 2.0) / 2.0;
                    }
                }
                x
            })
            .collect()
    }

    #[test]
    fn a_release_is_found_where_it_is_and_a_pull_is_none() {
        for fs_hz in [100.0, 200.0, 1000.0] {
            let times = [6.0, 20.0, 34.5];
            let found = onsets(&pulls(&times, 50.0, fs_hz, 0.02), fs_hz, 5.0);
            assert_eq!(found.len(), 3, "{fs_hz} {found:?}");
            for (found, time) in found.iter().zip(times) {
                let late = *found as f64 / fs_hz - time;
                // A tenth of a period of the motion (0.22 s), and not before the release by more than the filter.
                assert!((-0.011..0.06).contains(&late), "{fs_hz}: {late}");
            }
        }
    }

    #[test]
    fn noise_and_a_spike_are_no_onset() {
        let mut samples = pulls(&[], 60.0, 200.0, 0.02);
        assert!(onsets(&samples, 200.0, 4.0).is_empty());
        samples[6000] += 5.0;
        assert!(onsets(&samples, 200.0, 4.0).is_empty());
        assert!(onsets(&[0.0; 5000], 200.0, 4.0).is_empty());
        assert!(onsets(&[], 200.0, 4.0).is_empty());
    }
}
