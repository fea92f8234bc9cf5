//! Each picked peak refined to a natural frequency, damping ratio and standard errors, stretch by stretch.
//!
//! A record without onsets is one stretch. At each release or blow it is cut: every stretch is fitted by itself,
//! from an onset on with a free start, and the frequencies are averaged by their precision. So a blow
//! gets its proper weight instead of being averaged with the quiet before it.

use super::band::Coefficients;
use super::fit::{Aim, Fit, Stretch};
use super::likelihood::Start;
use super::onsets::{Blow, blows};
use super::parts::{Beginning, Part, Parts};
use super::softening::Scale;
use super::tone_beside::{Beside, SteadyTone};
use super::{Mask, Motion, MotionKind, Resonance};
use crate::signal::record::{Excitation, Record};
use crate::signal::spectrum::{Peak, Transforms};

/// Relative error of the model itself (sums for integrals, the negative-frequency pole): the floor of the
/// errors of a decay 140 dB above its noise.
const MODEL_SD: f64 = 1e-7;
/// Largest error of ln damping, and least damping, of a usable fit.
const MOST_LOG_SD: f64 = 2.0;
/// Scatter of the parts' frequencies over their errors that chance does not make: the 1 % point of two parts.
const CHANCE_SPREAD: f64 = 2.6;
/// Bandwidth searched for blows, as a share of the frequency.
const BLOW_BAND: f64 = 0.11;
/// Samples of the coarsest series to either end of a stretch where blows are ignored.
const BLOW_MARGIN: f64 = 8.0;
/// Least width of the band searched for blows, in half-power half-widths.
const BLOW_WIDTHS: f64 = 8.0;

/// Input to the refinement of a record's peaks.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// Bands that are left out.
    pub masks: &'a [Mask],
    /// Steady tones that were subtracted from the record.
    pub tones: &'a [SteadyTone],
    /// Line distance of the spectrum the peaks were picked from \[Hz\].
    pub line_hz: f64,
    /// The parts of the record.
    pub parts: &'a Parts,
}

/// Result of the refinement of a record's peaks.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The resonances, ascending in frequency; pure tones are included and marked.
    pub resonances: Vec<Resonance>,
    /// Motion that was recognised.
    pub motion: Motion,
    /// True if what seemed to be a release set in and went on: to be refined again without a cut there.
    pub is_gust: bool,
    /// Steady tones beside resonances, which pull them: to be subtracted from the record before it is refined again.
    pub tones: Vec<SteadyTone>,
}

/// Fits a resonance to the raw Fourier coefficients around each peak; peaks that turn out to be
/// noise, or part of a resonance already fitted, are left out.
///
/// The highest peaks come first; a lower one must rise above the skirts of those already fitted. A record
/// declared as a free decay is used from its first release on.
pub fn refine(transforms: &Transforms, record: &Record, peaks: &[Peak], search: &Search<'_>) -> Refinement {
    let mut by_height: Vec<&Peak> = peaks.iter().collect();
    by_height.sort_by(|a, b| b.height_db.total_cmp(&a.height_db));
    let work = Work {
        transforms,
        record,
        search,
    };
    let main = search.parts.main;
    let stretch = work.stretch(main);
    let aims: Vec<Aim> = by_height
        .iter()
        .map(|peak| Aim {
            peak_hz: peak.frequency_hz,
            before: None,
        })
        .collect();
    let places = stretch.places(&aims);
    let first: Vec<Fit> = places.iter().flatten().map(|place| place.fit).collect();
    let weak = match record.excitation {
        None => work.blows(&stretch, &first),
        Some(_) => Vec::new(),
    };
    let mut whole = stretch.with_errors(&places);
    let beside = stretch.beside(&whole);
    for (fit, beside) in whole.iter_mut().zip(&beside) {
        if let (Some(fit), Beside::Open(sd_hz)) = (fit, beside) {
            fit.resonance.frequency_sd_hz = fit.resonance.frequency_sd_hz.hypot(*sd_hz);
        }
    }
    // Only fits with their errors are classified as mode or tone.
    let judged: Vec<Fit> = whole.iter().flatten().copied().collect();
    let parts = work.parts(&weak);
    let mut fits: Vec<Vec<Fit>> = vec![Vec::new(); aims.len()];
    if record.excitation.is_none() && (parts.len() > 1 || parts.first() != Some(&main)) {
        // Where the modes are is known by now, and their order of height.
        let known: Vec<Aim> = whole
            .iter()
            .zip(&aims)
            .map(|(fit, aim)| Aim {
                peak_hz: fit.map_or(aim.peak_hz, |fit| fit.resonance.frequency_hz),
                before: fit.map(|fit| fit.parameters),
            })
            .collect();
        for part in parts {
            let found = if part == main {
                whole.clone()
            } else {
                work.again(part, &known)
            };
            for (mode, fit) in fits.iter_mut().zip(found) {
                mode.extend(fit);
            }
        }
    }
    let in_parts = !fits.iter().all(Vec::is_empty);
    let scale = if in_parts {
        Scale::of(fits.iter().flatten().filter_map(|fit| fit.softening.as_ref()))
    } else {
        Scale::of(whole.iter().flatten().filter_map(|fit| fit.softening.as_ref()))
    };
    for fit in whole.iter_mut().flatten().chain(fits.iter_mut().flatten()) {
        scale.settle(fit);
    }
    for fit in whole.iter_mut().flatten() {
        fit.resonance.frequency_sd_hz = fit.resonance.frequency_sd_hz.hypot(fit.shared_sd_hz);
    }
    let found: Vec<Resonance> = if !in_parts {
        let mut whole: Vec<Fit> = whole.into_iter().flatten().collect();
        whole.sort_by(|a, b| a.resonance.frequency_hz.total_cmp(&b.resonance.frequency_hz));
        stretch.apart(&whole)
    } else {
        whole
            .iter()
            .zip(&fits)
            .filter_map(|(whole, parts)| Some(combined(&(*whole)?, parts)))
            .collect()
    };
    let mut resonances: Vec<Resonance> = found
        .into_iter()
        .map(|r| Resonance {
            frequency_sd_hz: r
                .frequency_sd_hz
                .hypot(r.frequency_hz * record.clock_sd.hypot(MODEL_SD)),
            ..r
        })
        .collect();
    resonances.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    Refinement {
        resonances,
        // Where further blows lie between the releases, nothing but their sum is stationary.
        is_gust: search.parts.begins_at_release()
            && weak.is_empty()
            && strongest_start(&judged) == Some(Start::Stationary),
        motion: work.motion(main, &judged, &weak),
        tones: beside
            .into_iter()
            .filter_map(|beside| match beside {
                Beside::Tone(tone) => Some(tone.begun(main.from as f64 / record.fs_hz)),
                _ => None,
            })
            .collect(),
    }
}

struct Work<'a> {
    transforms: &'a Transforms,
    record: &'a Record,
    search: &'a Search<'a>,
}

impl<'a> Work<'a> {
    /// All parts to fit, given the blows found in the main one.
    fn parts(&self, weak: &[Blow]) -> Vec<Part> {
        let sample =
            |t: f64| ((t * self.record.fs_hz).round().max(0.0) as usize).min(self.record.samples.len());
        let weak = weak
            .iter()
            .map(|blow| (sample(blow.before_s), sample(blow.after_s)));
        self.search.parts.between(weak)
    }

    fn stretch(&self, part: Part) -> Stretch<'a> {
        let samples = &self.record.samples[part.from..part.to];
        Stretch {
            transforms: self.transforms,
            coefficients: Coefficients::of(self.transforms, self.record.fs_hz, samples),
            beginning: part.beginning,
            masks: self.search.masks,
            tones: self.search.tones,
            line_hz: self.search.line_hz,
            nyquist_hz: 0.5 * self.record.fs_hz,
        }
    }

    /// Blows in the stretch that begins where the main part does, by its fits.
    fn blows(&self, stretch: &Stretch<'_>, fits: &[Fit]) -> Vec<Blow> {
        let series: Vec<_> = fits
            .iter()
            .enumerate()
            .filter_map(|(n, fit)| {
                let others: Vec<Fit> = fits
                    .iter()
                    .enumerate()
                    .filter(|(m, _)| *m != n)
                    .map(|(_, fit)| *fit)
                    .collect();
                let r = &fit.resonance;
                let half_hz = (BLOW_WIDTHS * r.damping).max(BLOW_BAND) * r.frequency_hz;
                Some((stretch.subband(fit, half_hz, &others)?, fit.pole()))
            })
            .collect();
        let main = self.search.parts.main;
        let offset_s = main.from as f64 / self.record.fs_hz;
        let least_s = self.search.parts.least() as f64 / self.record.fs_hz;
        let length_s = (main.to - main.from) as f64 / self.record.fs_hz;
        let coarsest_hz = series
            .iter()
            .map(|(series, _)| series.rate_hz)
            .fold(f64::INFINITY, f64::min);
        let margin_s = least_s.max(BLOW_MARGIN / coarsest_hz);
        blows(&series, 0.5 * least_s)
            .into_iter()
            // A series is periodic: a difference between its end and its beginning leaks across. And the rest
            // behind a later blow is too short for a fit.
            .filter(|blow| blow.after_s > margin_s && blow.after_s < length_s - margin_s)
            .map(|blow| Blow {
                before_s: blow.before_s + offset_s,
                after_s: blow.after_s + offset_s,
                ..blow
            })
            .collect()
    }

    /// Fits of the modes already known to another part of the record.
    fn again(&self, part: Part, aims: &[Aim]) -> Vec<Option<Fit>> {
        let stretch = self.stretch(part);
        let places = stretch.places(aims);
        stretch.with_errors(&places)
    }

    fn motion(&self, main: Part, fits: &[Fit], weak: &[Blow]) -> Motion {
        let fs = self.record.fs_hz;
        let seconds = |sample: usize| sample as f64 / fs;
        if let Some(declared) = self.record.excitation {
            let kind = match declared {
                Excitation::Ambient => MotionKind::Ambient,
                Excitation::FreeDecay => MotionKind::FreeDecay,
            };
            let onsets_s = match declared {
                Excitation::Ambient => Vec::new(),
                Excitation::FreeDecay => vec![seconds(main.from)],
            };
            return Motion { kind, onsets_s };
        }
        let decays_at_once = main.beginning == Beginning::Tested
            && !self.search.parts.begins_at_release()
            && strongest_start(fits) == Some(Start::Free);
        let mut onsets_s: Vec<f64> = self
            .search
            .parts
            .releases
            .iter()
            .map(|at| seconds(at.after))
            .collect();
        if decays_at_once {
            onsets_s.push(0.0);
        }
        let kind = match (onsets_s.len(), weak.len()) {
            (0, 0) => MotionKind::Ambient,
            (0, _) => MotionKind::Blow,
            (1, _) => MotionKind::FreeDecay,
            _ => MotionKind::FreeDecays,
        };
        onsets_s.extend(weak.iter().map(|blow| 0.5 * (blow.before_s + blow.after_s)));
        onsets_s.sort_by(f64::total_cmp);
        Motion { kind, onsets_s }
    }
}

/// Start of the strongest mode.
fn strongest_start(fits: &[Fit]) -> Option<Start> {
    let is_sure = |fit: &Fit| !fit.resonance.line && fit.resonance.foreign_log_odds <= 0.0;
    let is_sure_seen = fits.iter().any(is_sure);
    // A tone goes on from the first sample to the last, which a free start explains, too; so does what may be one, where a sure
    // mode is there to ask.
    let asked = fits
        .iter()
        .filter(|fit| !fit.resonance.line && (!is_sure_seen || is_sure(fit)));
    let strongest = asked.max_by(|a, b| a.resonance.peak_to_noise.total_cmp(&b.resonance.peak_to_noise));
    strongest.map(|fit| fit.start)
}

/// Resonance of one mode averaged over its fits to all parts; `whole` is the fit to the main part.
fn combined(whole: &Fit, parts: &[Fit]) -> Resonance {
    let main = whole.resonance;
    let counted: Vec<&Fit> = parts
        .iter()
        .filter(|fit| {
            let r = &fit.resonance;
            let near = (3.0 * main.damping.max(r.damping) * main.frequency_hz)
                .max(4.0 * main.frequency_sd_hz.hypot(r.frequency_sd_hz));
            r.damping_log_sd < MOST_LOG_SD && !r.line && (r.frequency_hz - main.frequency_hz).abs() < near
        })
        .collect();
    if counted.is_empty() {
        return main;
    }
    let weight = |fit: &Fit| fit.resonance.frequency_sd_hz.powi(-2);
    let total: f64 = counted.iter().map(|fit| weight(fit)).sum();
    let mean = |of: fn(&Fit) -> f64| counted.iter().map(|fit| weight(fit) * of(fit)).sum::<f64>() / total;
    let frequency_hz = mean(|fit| fit.resonance.frequency_hz);
    let chi2: f64 = counted
        .iter()
        .map(|fit| weight(fit) * (fit.resonance.frequency_hz - frequency_hz).powi(2))
        .sum();
    let spread = (chi2 / (counted.len() - 1).max(1) as f64).sqrt().max(1.0);
    let shared_sd_hz = mean(|fit| fit.shared_sd_hz);
    if total.sqrt().recip().hypot(shared_sd_hz) > main.frequency_sd_hz {
        // Parts known less well than the main one still show that they disagree.
        let is_chance = counted.len() < 2 || spread < CHANCE_SPREAD;
        return Resonance {
            frequency_sd_hz: main.frequency_sd_hz * if is_chance { 1.0 } else { spread },
            ..main
        };
    }
    let sd = (spread / total.sqrt()).hypot(shared_sd_hz);
    let counted: Vec<&Resonance> = counted.into_iter().map(|fit| &fit.resonance).collect();
    let log_weight = |r: &Resonance| r.damping_log_sd.max(1e-6).powi(-2);
    let log_total: f64 = counted.iter().map(|r| log_weight(r)).sum();
    let log_damping = counted
        .iter()
        .map(|r| log_weight(r) * r.damping.ln())
        .sum::<f64>()
        / log_total;
    let largest = |of: fn(&Resonance) -> f64| counted.iter().map(|r| of(r)).fold(0.0, f64::max);
    Resonance {
        frequency_hz,
        frequency_sd_hz: sd,
        damping: log_damping.exp(),
        damping_log_sd: log_total.sqrt().recip(),
        peak_to_noise: largest(|r| r.peak_to_noise),
        evidence: largest(|r| r.evidence).max(main.evidence),
        misfit: largest(|r| r.misfit),
        foreign_log_odds: counted
            .iter()
            .map(|r| r.foreign_log_odds)
            .fold(f64::INFINITY, f64::min),
        line: false,
    }
}
