//! From one record to labelled natural frequencies: spectrum, peaks, refinement, labels.

use super::label::{LabelPlan, Labelling, Unlabelled};
use super::parts::Parts;
use super::refine::{Search, refine};
use super::{Labels, Mask, Mode, Motion, MotionKind, Resonance, SteadyTone};
use crate::signal::record::rejection::UNDERSAMPLED;
use crate::signal::record::{Record, Rejection};
use crate::signal::spectrum::{
    Peak, PeakSettings, Spectrum, Transforms, Welch, WelchError, WelchSettings, Window, pick_peaks,
};
use std::borrow::Cow;

/// Half-power half-width in lines of the record below which a masked peak counts as a tone.
const TONE_LINES: f64 = 0.4;
/// Fewest periods of a frequency in a record for it to be searched.
const LEAST_PERIODS: f64 = 15.0;
/// Steady tones beside modes that are taken out of one record.
const MOST_TONES: usize = 8;
/// Least probability of an assignment that shows the rod to be in view.
const LIKELY: f64 = 0.1;
/// Highest frequency searched, as a share of the sample rate.
const HIGHEST: f64 = 0.48;
/// Stretches from the onset searched for the peaks of a free decay \[s\]: a quickly damped mode drowns in the
/// noise of a long one.
const DECAY_STRETCHES_S: [f64; 4] = [4.0, 12.0, 36.0, 108.0];

/// Spectrum and resonances of a record: the evidence for its labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Welch's spectrum, for plots.
    pub spectrum: Spectrum,
    /// Every resonance and line found in the search band, ascending in frequency, labelled or not.
    pub resonances: Vec<Resonance>,
    /// Motion that was recognised.
    pub motion: Motion,
}

/// Natural frequencies of a rod from one record.
#[derive(Debug, Clone, PartialEq)]
pub struct ModalEstimate {
    /// The labelled modes that the force uses, ascending in order.
    pub modes: Vec<Mode>,
    /// Probability of each mode's peak over all assignments, in the same order.
    pub label_probability: Vec<f64>,
    /// Joint probability of the labels, and the alternatives.
    pub labels: Labels,
    /// Spectrum and resonances behind the labels.
    pub evidence: Evidence,
}

/// A record without labelled frequencies, with the evidence found in it.
#[derive(Debug, Clone, PartialEq)]
pub struct Unidentified {
    /// Reason of the rejection.
    pub rejection: Rejection,
    /// Spectrum and resonances, if it has any.
    pub evidence: Option<Box<Evidence>>,
    /// Candidate labels of the peaks, if there are peaks.
    pub labels: Option<Labels>,
}

impl From<Rejection> for Unidentified {
    fn from(rejection: Rejection) -> Self {
        Self {
            rejection,
            evidence: None,
            labels: None,
        }
    }
}

/// Search and labelling of one rod's records; made once per rod.
#[derive(Debug)]
pub struct ModalPlan {
    search: PeakSearch,
    labels: LabelPlan,
}

/// Search of records for resonances, independent of the rod.
#[derive(Debug)]
pub struct PeakSearch {
    welch: WelchSettings,
    peaks: PeakSettings,
    masks: Vec<Mask>,
    transforms: Transforms,
}

impl ModalPlan {
    /// A plan from the spectrum and peak settings and the rod's label plan.
    pub fn new(welch: WelchSettings, peaks: PeakSettings, labels: LabelPlan) -> Self {
        let masks = labels.settings().masks.clone();
        Self {
            search: PeakSearch::new(welch, peaks, masks),
            labels,
        }
    }

    /// Search for resonances.
    pub fn search(&self) -> &PeakSearch {
        &self.search
    }

    /// Plan that labels are inferred from.
    pub fn labels(&self) -> &LabelPlan {
        &self.labels
    }

    /// Labelled natural frequencies of a record, or the reason why there are none. A pure function of the
    /// plan and the record.
    pub fn identify(&self, record: &Record) -> Result<ModalEstimate, Unidentified> {
        let (low_hz, high_hz) = self.labels.band_hz();
        let evidence = self.search.evidence(record, low_hz, high_hz)?;
        let (resonances, kind) = (&evidence.resonances, evidence.motion.kind);
        match self.label(resonances, kind, record.duration_s(), record.fs_hz) {
            Ok(Labelling {
                modes,
                probability,
                labels,
            }) => Ok(ModalEstimate {
                modes,
                label_probability: probability,
                labels,
                evidence,
            }),
            Err((rejection, labels)) => Err(Unidentified {
                rejection,
                evidence: Some(Box::new(evidence)),
                labels,
            }),
        }
    }

    /// Labels the resonances found in a record of a length \[s\] and sample rate \[Hz\], with a motion of `kind`;
    /// of the labelled modes those that the force uses. Needs no samples.
    ///
    /// # Errors
    /// The reason why no label is credible, with the candidates if there are peaks.
    pub fn label(
        &self,
        resonances: &[Resonance],
        kind: MotionKind,
        duration_s: f64,
        fs_hz: f64,
    ) -> Result<Labelling, (Rejection, Option<Labels>)> {
        let (low_hz, high_hz) = self.labels.band_hz();
        let searchable = searchable_hz(duration_s, fs_hz);
        let labelled = if resonances.is_empty() {
            let rejection = Rejection::NoPeak {
                low_hz: low_hz.max(searchable.0),
                high_hz: high_hz.min(searchable.1),
            };
            Err((rejection, None))
        } else {
            self.labels
                .label(resonances, searchable, kind)
                .map_err(|Unlabelled { rejection, labels }| (rejection, Some(labels)))
        };
        match labelled {
            Ok(mut labelling) => {
                let count = self.labels.settings().count;
                let used = labelling.modes.partition_point(|mode| mode.order <= count);
                labelling.modes.truncate(used);
                labelling.probability.truncate(used);
                Ok(labelling)
            }
            Err((rejection, labels)) => {
                // Where the lowest mode may lie above the band there is nothing to wonder about.
                let needed_hz = self.labels.first_mode_below_hz();
                let nothing_seen = matches!(rejection, Rejection::NoPeak { .. });
                let lowest_hz = searchable.0;
                let rejection = if lowest_hz > needed_hz || (nothing_seen && lowest_hz > low_hz) {
                    Rejection::TooShort {
                        duration_s,
                        needed_s: LEAST_PERIODS / low_hz,
                    }
                } else if UNDERSAMPLED * fs_hz < needed_hz && !is_series_seen(labels.as_ref()) {
                    Rejection::Undersampled { fs_hz, needed_hz }
                } else {
                    rejection
                };
                Err((rejection, labels))
            }
        }
    }
}

impl PeakSearch {
    /// A search with the given settings, which leaves out the masked bands.
    pub fn new(welch: WelchSettings, peaks: PeakSettings, masks: Vec<Mask>) -> Self {
        Self {
            welch,
            peaks,
            masks,
            transforms: Transforms::default(),
        }
    }

    /// Welch's spectrum of a record and its refined resonances between two frequencies \[Hz\], as far as they are
    /// [searchable](searchable_hz).
    pub fn evidence(&self, record: &Record, low_hz: f64, high_hz: f64) -> Result<Evidence, Rejection> {
        let (low_hz, high_hz) = searched_hz(record, low_hz, high_hz)?;
        let too_short = |_| too_short(record, high_hz);
        let welch = self.welch_of(record).map_err(too_short)?;
        let spectrum = welch.run(&record.samples).map_err(too_short)?;
        let picked = |record: &Record, spectrum: &Spectrum, has_releases: bool| {
            self.picked(record, spectrum, (low_hz, high_hz), has_releases)
        };
        let (mut parts, mut peaks) = picked(record, &spectrum, true).map_err(too_short)?;
        let refined =
            |record: &Record, peaks: &[Peak], parts: &Parts, masks: &[Mask], tones: &[SteadyTone]| {
                let search = Search {
                    masks,
                    tones,
                    line_hz: spectrum.df_hz,
                    parts,
                };
                refine(&self.transforms, record, peaks, &search)
            };
        let mut found = refined(record, &peaks, &parts, &[], &[]);
        let has_releases = !found.is_gust;
        if !has_releases {
            (parts, peaks) = picked(record, &spectrum, false).map_err(too_short)?;
            found = refined(record, &peaks, &parts, &[], &[]);
        }
        // Without the tones beside its modes the record shows other peaks.
        let mut tones: Vec<SteadyTone> = Vec::new();
        let mut cleaned = Cow::Borrowed(record);
        while !found.tones.is_empty() && tones.len() < MOST_TONES {
            for tone in &found.tones {
                tone.subtract_from(&mut cleaned.to_mut().samples, record.fs_hz);
            }
            tones.append(&mut found.tones);
            let spectrum = welch.run(&cleaned.samples).map_err(too_short)?;
            (parts, peaks) = picked(&cleaned, &spectrum, has_releases).map_err(too_short)?;
            add_beside(&mut peaks, &tones, spectrum.df_hz);
            found = refined(&cleaned, &peaks, &parts, &[], &tones);
        }
        let left_out = self.left_out(&found.resonances, record.duration_s());
        if !left_out.is_empty() {
            peaks.retain(|peak| !left_out.iter().any(|mask| mask.contains(peak.frequency_hz)));
            found = refined(&cleaned, &peaks, &parts, &left_out, &tones);
        }
        let is_masked = |r: &Resonance| self.masks.iter().any(|mask| mask.contains(r.frequency_hz));
        let mut resonances = found.resonances;
        resonances.extend(tones.iter().map(|tone| tone.resonance));
        resonances.retain(|r| !is_masked(r));
        resonances.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
        Ok(Evidence {
            spectrum,
            resonances,
            motion: found.motion,
        })
    }

    /// Welch's spectrum of a record alone, that of [`PeakSearch::evidence`].
    pub fn spectrum(&self, record: &Record, low_hz: f64, high_hz: f64) -> Result<Spectrum, Rejection> {
        let (_, high_hz) = searched_hz(record, low_hz, high_hz)?;
        let spectrum = self.welch_of(record).and_then(|welch| welch.run(&record.samples));
        spectrum.map_err(|_| too_short(record, high_hz))
    }

    /// Parts of a record, cut at its releases if it has any, and the peaks of its spectrum.
    fn picked(
        &self,
        record: &Record,
        spectrum: &Spectrum,
        (low_hz, high_hz): (f64, f64),
        has_releases: bool,
    ) -> Result<(Parts, Vec<Peak>), WelchError> {
        let mut peaks = pick_peaks(spectrum, &self.peaks, low_hz, high_hz);
        let strongest = peaks.iter().max_by(|a, b| a.height_db.total_cmp(&b.height_db));
        let parts = Parts::of(record, strongest.map(|peak| peak.frequency_hz), has_releases);
        if !parts.releases.is_empty() {
            // A segment across an onset has skirts, and peaks on them, that no mode made.
            let part = &record.samples[parts.main.from..parts.main.to];
            let nperseg = self.welch.nperseg(record.fs_hz, part.len());
            let clean = self.welch(record.fs_hz, nperseg)?.run(part)?;
            peaks = pick_peaks(&clean, &self.peaks, low_hz, high_hz);
        }
        if let Some(decay) = parts.decay(&record.samples) {
            for stretch_s in DECAY_STRETCHES_S {
                self.add_decay_peaks(&mut peaks, record.fs_hz, decay, stretch_s, (low_hz, high_hz));
            }
        }
        Ok((parts, peaks))
    }

    /// Masks whose lines are left out of every fit: those without a resonance. The skirts of one reach beyond its mask, and its
    /// neighbours are right only beside its own fit.
    fn left_out(&self, resonances: &[Resonance], duration_s: f64) -> Vec<Mask> {
        let is_wide = |r: &&Resonance| !r.line && r.damping * r.frequency_hz * duration_s > TONE_LINES;
        let holds_one = |mask: &&Mask| {
            let mut wide = resonances.iter().filter(is_wide);
            wide.any(|r| mask.contains(r.frequency_hz))
        };
        self.masks
            .iter()
            .filter(|mask| !holds_one(mask))
            .copied()
            .collect()
    }

    /// Welch's method for a whole record.
    fn welch_of(&self, record: &Record) -> Result<Welch, WelchError> {
        let nperseg = self.welch.nperseg(record.fs_hz, record.samples.len());
        self.welch(record.fs_hz, nperseg)
    }

    /// Welch's method with the plan's window and overlap.
    fn welch(&self, fs_hz: f64, nperseg: usize) -> Result<Welch, WelchError> {
        let noverlap = self.welch.noverlap(nperseg);
        Welch::plan_with(&self.transforms, fs_hz, nperseg, noverlap, self.welch.window)
    }

    /// Adds peaks of the first `stretch_s` seconds of a decay, untapered, unless a peak is there already.
    fn add_decay_peaks(
        &self,
        peaks: &mut Vec<Peak>,
        fs_hz: f64,
        decay: &[f64],
        stretch_s: f64,
        band_hz: (f64, f64),
    ) {
        let n = (stretch_s * fs_hz) as usize;
        let Some(stretch) = decay.get(..n) else {
            return;
        };
        let spectrum = Welch::plan_with(&self.transforms, fs_hz, n, 0, Window::Rectangular)
            .and_then(|welch| welch.run(stretch));
        let Ok(spectrum) = spectrum else { return };
        let near = 2.0 * spectrum.df_hz;
        // A single segment scatters: noise exceeds its median by 10 dB on one line in a thousand, by
        // 14 dB on one in thirty million.
        let settings = PeakSettings {
            prominence_db: self.peaks.prominence_db + 4.0,
            ..self.peaks
        };
        for peak in pick_peaks(&spectrum, &settings, band_hz.0, band_hz.1) {
            if !peaks
                .iter()
                .any(|p| (p.frequency_hz - peak.frequency_hz).abs() < near)
            {
                peaks.push(peak);
            }
        }
        peaks.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    }
}

/// Part of a band in which a record can be searched \[Hz\].
fn searched_hz(record: &Record, low_hz: f64, high_hz: f64) -> Result<(f64, f64), Rejection> {
    check(record, LEAST_PERIODS / high_hz.min(HIGHEST * record.fs_hz))?;
    let (lowest_hz, highest_hz) = searchable_hz(record.duration_s(), record.fs_hz);
    if low_hz >= highest_hz {
        return Err(Rejection::Undersampled {
            fs_hz: record.fs_hz,
            needed_hz: low_hz,
        });
    }
    Ok((low_hz.max(lowest_hz), high_hz.min(highest_hz)))
}

fn too_short(record: &Record, high_hz: f64) -> Rejection {
    Rejection::TooShort {
        duration_s: record.duration_s(),
        needed_s: LEAST_PERIODS / high_hz,
    }
}

/// Adds the resonances beside tones where no peak shows them: a tone that was on one leaves a dent.
fn add_beside(peaks: &mut Vec<Peak>, tones: &[SteadyTone], line_hz: f64) {
    for tone in tones {
        let (hz, half_width_hz) = tone.beside_hz;
        let near_hz = (2.0 * line_hz).max(3.0 * half_width_hz);
        let is_there = |peak: &Peak| (peak.frequency_hz - hz).abs() < near_hz;
        if !peaks.iter().any(is_there) {
            peaks.push(Peak {
                line: (hz / line_hz).round() as usize,
                frequency_hz: hz,
                prominence_db: 0.0,
                height_db: 0.0,
            });
        }
    }
}

/// True if a likely assignment names two orders or more: the rod is in view, and what hinders is something else than the sample rate.
fn is_series_seen(labels: Option<&Labels>) -> bool {
    labels.is_some_and(|labels| {
        let mut all = labels.candidates.iter();
        all.any(|one| one.probability >= LIKELY && one.modes.len() >= 2)
    })
}

/// Range of frequencies with enough periods in a record of a length \[s\] and enough samples per period at its
/// sample rate \[Hz\].
pub fn searchable_hz(duration_s: f64, fs_hz: f64) -> (f64, f64) {
    (LEAST_PERIODS / duration_s, HIGHEST * fs_hz)
}

/// Rejects a record that no spectrum can be made of.
fn check(record: &Record, needed_s: f64) -> Result<(), Rejection> {
    let samples = &record.samples;
    let duration_s = record.duration_s();
    if duration_s.is_nan() || duration_s < needed_s || samples.len() < 64 {
        return Err(Rejection::TooShort { duration_s, needed_s });
    }
    let missing = samples.iter().filter(|x| !x.is_finite()).count();
    if missing > 0 {
        return Err(Rejection::Missing {
            share: missing as f64 / samples.len() as f64,
            allowed: 0.0,
        });
    }
    if samples.iter().all(|&x| x == samples[0]) {
        return Err(Rejection::Constant { value: samples[0] });
    }
    Ok(())
}
