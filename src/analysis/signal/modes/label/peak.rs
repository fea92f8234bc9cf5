//! The peaks of one record as evidence, each with its likelihood if it is no mode of the rod.

use super::super::Resonance;
use super::likeness::Likeness;
use std::f64::consts::TAU;

/// Most peaks considered; those of the strongest evidence are kept.
pub(super) const MOST_PEAKS: usize = 15;
/// Log odds that a pure line is no mode of the rod: ten to one. Lines are not removed: where eight modes
/// were mostly taken for lines, the rest was labelled wrongly.
const LINE_LOG_ODDS: f64 = 2.3;
/// Share of foreign peaks beside stronger ones that are harmonics (quantisation, a sensor driven too far).
const HARMONIC_SHARE: f64 = 0.3;
/// Least scatter of a harmonic about its multiple, in ln f.
const LEAST_HARMONIC_SD: f64 = 5e-4;
/// Least drop from a peak to its harmonic \[dB\].
const HARMONIC_DROP_DB: f64 = 6.0;
/// Peaks this near the strongest \[dB\] are seldom foreign beside modes, weak ones more often: log odds, even in dB between.
const STRONG_DB: f64 = 10.0;
const STRONG_LOG_ODDS: f64 = -1.0;
const WEAK_DB: f64 = 30.0;
const WEAK_LOG_ODDS: f64 = 0.5;
/// After a pull or a blow peaks are hardly ever foreign, since it is the rod that was struck.
const STRUCK_LOG_ODDS: f64 = -5.0;

/// One peak of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Peak {
    /// Index among the resonances.
    pub(super) resonance: usize,
    /// Natural logarithm of the frequency \[Hz\].
    pub(super) log_hz: f64,
    /// Relative standard error of the frequency.
    pub(super) relative_sd: f64,
    /// Log density per unit of ln f if it is foreign, its own odds of being so included.
    pub(super) log_foreign: f64,
    /// Log odds that its strength adds where other peaks are modes.
    pub(super) log_beside: f64,
    /// Log odds added if the rod was struck.
    pub(super) log_struck: f64,
    /// Likeness of its damping to that of the other modes.
    pub(super) likeness: Likeness,
}

/// The peaks inside a band, ascending in frequency.
pub(super) fn peaks(
    resonances: &[Resonance],
    is_searched: impl Fn(f64) -> bool,
    log_band: f64,
    is_struck: bool,
) -> Vec<Peak> {
    let mut chosen: Vec<usize> = (0..resonances.len())
        .filter(|&i| {
            let r = &resonances[i];
            r.frequency_hz > 0.0 && r.frequency_sd_hz >= 0.0 && is_searched(r.frequency_hz)
        })
        .collect();
    chosen.sort_by(|&a, &b| {
        resonances[b]
            .evidence
            .total_cmp(&resonances[a].evidence)
            .then(a.cmp(&b))
    });
    chosen.truncate(MOST_PEAKS);
    chosen.sort_by(|&a, &b| resonances[a].frequency_hz.total_cmp(&resonances[b].frequency_hz));
    let level_db = |i: usize| 10.0 * libm::log10(resonances[i].peak_to_noise.max(1e-3));
    let strongest = chosen
        .iter()
        .filter(|&&i| !resonances[i].line)
        .map(|&i| level_db(i))
        .fold(f64::NEG_INFINITY, f64::max);
    let of = |i: usize| {
        let r = &resonances[i];
        let log_hz = libm::log(r.frequency_hz);
        let relative_sd = r.frequency_sd_hz / r.frequency_hz;
        let own = if r.line {
            r.foreign_log_odds.max(LINE_LOG_ODDS)
        } else {
            r.foreign_log_odds
        };
        let drop_db = strongest - level_db(i);
        let weakness = ((drop_db - STRONG_DB) / (WEAK_DB - STRONG_DB)).clamp(0.0, 1.0);
        let is_strong_or_weak = !r.line && strongest.is_finite();
        let mut harmonic = 0.0;
        let mut stronger = 0;
        for &j in chosen
            .iter()
            .filter(|&&j| level_db(j) >= level_db(i) + HARMONIC_DROP_DB)
        {
            stronger += 1;
            let other = &resonances[j];
            let sd = relative_sd
                .hypot(other.frequency_sd_hz / other.frequency_hz)
                .max(LEAST_HARMONIC_SD);
            for multiple in [2.0, 3.0, 4.0] {
                let z = (log_hz - libm::log(multiple * other.frequency_hz)) / sd;
                harmonic += libm::exp(-0.5 * z * z) / (sd * TAU.sqrt());
            }
        }
        let density = if stronger == 0 {
            1.0 / log_band
        } else {
            (1.0 - HARMONIC_SHARE) / log_band + HARMONIC_SHARE * harmonic / (3.0 * f64::from(stronger))
        };
        Peak {
            resonance: i,
            log_hz,
            relative_sd,
            log_foreign: libm::log(density) + own,
            log_beside: match is_strong_or_weak {
                true => STRONG_LOG_ODDS + weakness * (WEAK_LOG_ODDS - STRONG_LOG_ODDS),
                false => 0.0,
            },
            log_struck: match is_strong_or_weak && is_struck {
                true => STRUCK_LOG_ODDS,
                false => 0.0,
            },
            likeness: Likeness::of(r),
        }
    };
    chosen.iter().map(|&i| of(i)).collect()
}
