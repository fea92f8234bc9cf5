//! Spectral peaks: local maxima by prominence above a robust local noise floor.

use super::{PeakSettings, Spectrum};

/// Half width of the stretch that gives the local noise floor, as a share of the frequency, and its least
/// \[Hz\].
const REACH: f64 = 0.2;
const LEAST_REACH_HZ: f64 = 2.0;

/// A local maximum of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Index of the line of the maximum.
    pub line: usize,
    /// Frequency of the parabola through the maximum and its neighbours, in decibels \[Hz\].
    pub frequency_hz: f64,
    /// Prominence: height over the higher of the two saddles that part it from higher ground \[dB\].
    pub prominence_db: f64,
    /// Height above the local noise floor \[dB\].
    pub height_db: f64,
}

/// Local maxima of `values` with their prominences; a plateau counts once, at its middle.
pub fn find_peaks(values: &[f64]) -> Vec<(usize, f64)> {
    let mut peaks = Vec::new();
    let mut i = 1;
    while i + 1 < values.len() {
        if values[i - 1] < values[i] {
            let mut end = i;
            while end + 1 < values.len() && values[end + 1] == values[i] {
                end += 1;
            }
            if end + 1 < values.len() && values[end + 1] < values[i] {
                let middle = (i + end) / 2;
                peaks.push((middle, prominence(values, middle)));
            }
            i = end + 1;
        } else {
            i += 1;
        }
    }
    peaks
}

fn prominence(values: &[f64], peak: usize) -> f64 {
    let height = values[peak];
    let lowest = |side: &mut dyn Iterator<Item = &f64>| {
        side.take_while(|&&v| v <= height)
            .fold(height, |low, &v| low.min(v))
    };
    let left = lowest(&mut values[..=peak].iter().rev());
    let right = lowest(&mut values[peak..].iter());
    height - left.max(right)
}

/// A robust local noise floor of a spectrum in decibels, one value a line.
///
/// The lower quartile of the levels within 2 Hz or a fifth of the frequency (at least 20 lines) to either side,
/// raised to the median that noise of the same quartile would have with this many segments. A resonance of
/// damping `zeta` fills a share of its frequency: at 0.15 f it has fallen by 20 log10(0.15 / zeta), 17 dB at
/// 2 %, so that the quartile still lies well below its top. Computed every few lines, linear between;
/// `level_db` begins at line `first`.
pub fn noise_floor(spectrum: &Spectrum, first: usize, level_db: &[f64]) -> Vec<f64> {
    let n = level_db.len();
    if n == 0 {
        return Vec::new();
    }
    let least = (LEAST_REACH_HZ / spectrum.df_hz).ceil().max(20.0);
    let reach = |centre: usize| (REACH * (first + centre) as f64).max(least) as usize;
    // Quartile to median of a chi-square of 2m degrees of freedom in decibels: 3.83 dB for m = 1,
    // falling like 10 log10(e) 0.674 / sqrt(m); overlapping segments count for less than one each.
    let raise = 2.93 / (0.8 * spectrum.segments as f64).max(0.6).sqrt();
    let mut scratch = Vec::new();
    let mut knots = Vec::new();
    let mut next = 0;
    while knots.last().is_none_or(|&(last, _)| last + 1 < n) {
        let centre = next.min(n - 1);
        let reach = reach(centre);
        next = centre + (reach / 8).max(1);
        scratch.clear();
        scratch.extend_from_slice(&level_db[centre.saturating_sub(reach)..(centre + reach + 1).min(n)]);
        let quarter = scratch.len() / 4;
        let (_, value, _) = scratch.select_nth_unstable_by(quarter, f64::total_cmp);
        knots.push((centre, *value + raise));
    }
    let mut floor = Vec::with_capacity(n);
    let mut k = 0;
    for i in 0..n {
        while k + 2 < knots.len() && knots[k + 1].0 <= i {
            k += 1;
        }
        let (a, low) = knots[k];
        let (b, high) = knots[(k + 1).min(knots.len() - 1)];
        let share = if b > a {
            (i - a) as f64 / (b - a) as f64
        } else {
            0.0
        };
        floor.push(low + share.min(1.0) * (high - low));
    }
    floor
}

/// The peaks of a spectrum between `low_hz` and `high_hz` that rise `settings.prominence_db` above the local
/// noise floor with a prominence of at least half of that; the highest above the floor are kept, in ascending
/// order of frequency.
pub fn pick_peaks(spectrum: &Spectrum, settings: &PeakSettings, low_hz: f64, high_hz: f64) -> Vec<Peak> {
    let tiny = f64::MIN_POSITIVE;
    // Levels are needed only around the band; its neighbourhood feeds the floor and the prominences.
    let last = spectrum.psd.len();
    let margin = |hz: f64| 1.5 * (REACH * hz).max(LEAST_REACH_HZ);
    let first = (((low_hz - margin(low_hz)) / spectrum.df_hz).floor().max(1.0) as usize).min(last);
    let end = (((high_hz + margin(high_hz)) / spectrum.df_hz).ceil().max(0.0) as usize).clamp(first, last);
    let level_db: Vec<f64> = spectrum.psd[first..end]
        .iter()
        .map(|p| 10.0 * p.max(tiny).log10())
        .collect();
    if level_db.len() < 3 {
        return Vec::new();
    }
    let floor_db = noise_floor(spectrum, first, &level_db);
    let mut peaks: Vec<Peak> = find_peaks(&level_db)
        .into_iter()
        .map(|(i, prominence_db)| {
            let (a, b, c) = (level_db[i - 1], level_db[i], level_db[i + 1]);
            let bend = a - 2.0 * b + c;
            let shift = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
            Peak {
                line: first + i,
                frequency_hz: ((first + i) as f64 + shift.clamp(-0.5, 0.5)) * spectrum.df_hz,
                prominence_db,
                height_db: b - floor_db[i],
            }
        })
        .filter(|peak| {
            (low_hz..=high_hz).contains(&peak.frequency_hz)
                && peak.height_db >= settings.prominence_db
                && peak.prominence_db >= 0.5 * settings.prominence_db
        })
        .collect();
    peaks.sort_by(|a, b| b.height_db.total_cmp(&a.height_db));
    peaks.truncate(settings.max_peaks);
    peaks.sort_by_key(|peak| peak.line);
    peaks
}
