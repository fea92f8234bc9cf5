//! Examines one record: its peaks over the whole band, and the result for a configured rod.

use super::Band;
use super::input::Source;
use crate::analysis::findings::{self, Candidate, Doubt, Peak};
use crate::analysis::identify::Measurement;
use crate::analysis::inference::{Conflict, Marginal};
use crate::analysis::outcome::Rejected;
use crate::analysis::record_view::Snapshot;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::signal::modes::{Labels, Mode, Motion, PeakSearch, searchable_hz};
use crate::analysis::signal::record::{Envelope, Event, Flag, Record, Rejection, RodId, Timestamp};
use crate::analysis::signal::spectrum::{PeakSettings, WelchSettings};
use crate::command::report_page::view::SpectrumReport;
use crate::command::setup;
use crate::config::Config;
use crate::site::prepared::Plans;
use serde::Serialize;

/// Most peaks of a record.
const MOST_PEAKS: usize = 40;

/// Examines records, all with the same settings.
pub(super) struct Looker {
    search: PeakSearch,
    plans: Plans,
    band: Band,
    is_configured: bool,
}

/// Findings of a record.
pub(super) struct Look {
    source: Source,
    /// Time of the first sample, if known; 0 in a file that does not say it.
    pub start: Option<Timestamp>,
    /// Length \[s\].
    pub duration_s: f64,
    /// Sample rate \[Hz\], if known.
    pub fs_hz: Option<f64>,
    /// Band searched for peaks \[Hz\].
    pub band_hz: Option<(f64, f64)>,
    /// Faults noticed by the quality checks.
    pub flags: Vec<Flag>,
    /// Reason why there are no peaks, or no force of the configured rod.
    pub rejection: Option<Rejection>,
    /// Waveform, spectrum and peaks, if it has samples.
    pub picture: Option<Snapshot>,
    axial_force_n: Option<Marginal>,
    conflict: Option<Conflict>,
    peaks: Vec<Peak>,
    /// True with a configuration, whose settings may be changed.
    is_configured: bool,
}

/// Result of a configured rod for a record.
#[derive(Default)]
struct Told {
    modes: Vec<Mode>,
    labels: Option<Labels>,
    force: Option<Marginal>,
    conflict: Option<Conflict>,
    rejection: Option<Rejection>,
}

/// Findings as one JSON object.
#[derive(Serialize)]
struct Line<'a> {
    file: &'a str,
    channel: &'a str,
    rod: Option<&'a RodId>,
    unit: Option<&'a str>,
    start: Option<Timestamp>,
    duration_s: f64,
    fs_hz: Option<f64>,
    excitation: Option<&'a Motion>,
    band_hz: Option<(f64, f64)>,
    peaks: &'a [Peak],
    label_probability: Option<f64>,
    candidates: &'a [Candidate],
    axial_force_n: Option<&'a Marginal>,
    conflict: Option<f64>,
    prior_tail: Option<f64>,
    flags: &'a [Flag],
    rejection: Option<Reason<'a>>,
}

#[derive(Serialize)]
struct Reason<'a> {
    code: &'static str,
    message: String,
    #[serde(flatten)]
    detail: &'a Rejection,
}

impl Looker {
    /// A looker; with a configuration, it prepares the plans of its rods.
    pub fn new(config: Option<&Config>, band: Band) -> anyhow::Result<Self> {
        let first = config.and_then(|config| config.rods.first());
        let (welch, peaks) = first.map_or_else(
            || (WelchSettings::default(), PeakSettings::default()),
            |rod| (rod.analysis.welch, rod.analysis.peaks),
        );
        let peaks = PeakSettings {
            max_peaks: peaks.max_peaks.max(MOST_PEAKS),
            ..peaks
        };
        Ok(Self {
            search: PeakSearch::new(welch, peaks, Vec::new()),
            plans: config.map(setup::plans).transpose()?.unwrap_or_default(),
            band,
            is_configured: config.is_some(),
        })
    }

    /// Examines an event; `None` for temperatures.
    pub fn look(&self, source: &Source, event: Event) -> Option<Box<Look>> {
        let look = match event {
            // Spectra are of single sensors.
            Event::Readings { .. } | Event::Moment(_) => return None,
            Event::Rejected {
                rod,
                start,
                duration_s,
                fs_hz,
                waveform,
                rejection,
            } => Look {
                source: source.clone(),
                start,
                duration_s,
                fs_hz,
                band_hz: None,
                flags: Vec::new(),
                rejection: Some(rejection.clone()),
                picture: Snapshot::of_rejected(&Rejected {
                    start,
                    duration_s: Some(duration_s),
                    fs_hz,
                    waveform,
                    ..Rejected::new(rod, rejection)
                }),
                axial_force_n: None,
                conflict: None,
                peaks: Vec::new(),
                is_configured: self.is_configured,
            },
            Event::Record(record) => self.look_at(source, &record),
        };
        Some(Box::new(look))
    }

    fn look_at(&self, source: &Source, record: &Record) -> Look {
        let duration_s = record.duration_s();
        let (lowest_hz, highest_hz) = searchable_hz(duration_s, record.fs_hz);
        let low_hz = self.band.low_hz.map_or(lowest_hz, |low_hz| low_hz.max(lowest_hz));
        let high_hz = self
            .band
            .high_hz
            .map_or(highest_hz, |high_hz| high_hz.min(highest_hz));
        let mut look = Look {
            source: source.clone(),
            start: Some(record.start),
            duration_s,
            fs_hz: Some(record.fs_hz),
            band_hz: Some((low_hz, high_hz)),
            flags: record.flags.clone(),
            rejection: None,
            picture: None,
            axial_force_n: None,
            conflict: None,
            peaks: Vec::new(),
            is_configured: self.is_configured,
        };
        let evidence = match low_hz < high_hz {
            true => self.search.evidence(record, low_hz, high_hz),
            false => Err(Rejection::NoBand {
                low_hz: self.band.low_hz.unwrap_or(lowest_hz),
                high_hz: self.band.high_hz.unwrap_or(highest_hz),
                lowest_hz,
                highest_hz,
            }),
        };
        match evidence {
            Ok(evidence) => {
                let told = self.told(source, record);
                let measurement = Measurement::new(record, [0; 32], evidence);
                look.peaks = findings::peaks(&measurement, &told.modes);
                look.picture = Some(Snapshot::of_measurement(
                    &measurement,
                    &told.modes,
                    told.labels.as_ref(),
                    high_hz,
                ));
                look.conflict = told.conflict;
                look.axial_force_n = told.force;
                look.rejection = told.rejection;
            }
            Err(rejection) => {
                look.band_hz = None;
                look.picture = Snapshot::of_rejected(&Rejected {
                    start: Some(record.start),
                    duration_s: Some(duration_s),
                    fs_hz: Some(record.fs_hz),
                    waveform: Some(Envelope::of(&record.samples, record.fs_hz)),
                    ..Rejected::new(record.rod.clone(), rejection.clone())
                });
                look.rejection = Some(rejection);
            }
        }
        look
    }

    /// Result of the configured rod for a record; empty without one.
    fn told(&self, source: &Source, record: &Record) -> Told {
        let Some(plan) = source.rod.as_ref().and_then(|rod| self.plans.get(rod)) else {
            return Told::default();
        };
        match plan.run(record) {
            Ok(identification) => Told {
                force: identification.posterior.marginal(Quantity::AxialForce),
                modes: identification.modes,
                labels: identification.labels,
                conflict: Some(identification.conflict),
                rejection: None,
            },
            Err(refusal) => Told {
                labels: refusal.labels,
                rejection: Some(refusal.rejection),
                ..Told::default()
            },
        }
    }
}

impl Look {
    /// File, channel, rod and unit.
    pub fn heading(&self) -> String {
        let Source {
            file,
            channel,
            rod,
            unit,
            foreign_unit,
        } = &self.source;
        let rod = rod
            .as_ref()
            .map_or_else(String::new, |rod| format!(", rod {rod}"));
        let unit = match (unit, foreign_unit) {
            (Some(unit), _) => format!(" [{unit}]"),
            (None, Some(unit)) => format!(" ({unit}, as it stands)"),
            (None, None) => " (unit not said)".to_owned(),
        };
        format!("{file}, {channel}{rod}{unit}")
    }

    /// Reason why there are no peaks, or no force, in words.
    pub fn reason(&self) -> Option<String> {
        Some(match self.rejection.as_ref()? {
            Rejection::TooShort { duration_s, needed_s } if !self.is_configured => {
                format!("{duration_s:.2} s long, at least {needed_s:.2} s needed: record longer")
            }
            rejection => rejection.to_string(),
        })
    }

    /// Motion of the record.
    pub fn motion(&self) -> Option<&Motion> {
        self.picture.as_ref()?.motion.as_ref()
    }

    /// Probability of the mode orders, if labelled.
    pub fn label_probability(&self) -> Option<f64> {
        let is_told = self.rejection.is_none();
        self.picture.as_ref()?.label_probability.filter(|_| is_told)
    }

    /// Reasons to doubt the force of the configured rod.
    pub fn doubts(&self) -> Vec<Doubt> {
        Doubt::all(
            self.conflict().map(|conflict| conflict.score),
            self.conflict().map(|conflict| conflict.prior_tail),
            self.label_probability(),
            self.axial_force_n.as_ref().map(|force| force.interval()),
        )
    }

    /// Those of the data in words, as lines.
    pub fn said_doubts(&self) -> Vec<String> {
        let conflict = self.conflict().into_iter();
        conflict
            .flat_map(|conflict| crate::command::findings::doubts(conflict, self.axial_force_n.as_ref()))
            .collect()
    }

    /// Conflict of the configured rod with the record.
    pub fn conflict(&self) -> Option<&Conflict> {
        self.conflict.as_ref()
    }

    /// Force of the configured rod in words, with its mark.
    pub fn force(&self) -> Option<String> {
        let force = self.axial_force_n.as_ref()?;
        let mark = Doubt::mark(&self.doubts());
        Some(format!("{mark}{}", crate::command::findings::force(force)))
    }

    /// The findings as one JSON object, without a line end.
    pub fn json(&self) -> String {
        let line = Line {
            file: &self.source.file,
            channel: &self.source.channel,
            rod: self.source.rod.as_ref(),
            unit: self.source.unit,
            start: self.start.filter(|start| start.as_nanos() != 0),
            duration_s: self.duration_s,
            fs_hz: self.fs_hz,
            excitation: self.motion(),
            band_hz: self.band_hz,
            peaks: &self.peaks,
            label_probability: self.label_probability(),
            candidates: self
                .picture
                .as_ref()
                .map_or(&[][..], |picture| &picture.candidates),
            axial_force_n: self.axial_force_n.as_ref(),
            conflict: self.conflict.as_ref().map(|conflict| conflict.score),
            prior_tail: self.conflict.as_ref().map(|conflict| conflict.prior_tail),
            flags: &self.flags,
            rejection: self.rejection.as_ref().map(|rejection| Reason {
                code: rejection.code(),
                message: self.reason().unwrap_or_default(),
                detail: rejection,
            }),
        };
        // A struct of numbers and strings always serialises.
        serde_json::to_string(&line).unwrap_or_else(|error| format!("{{\"error\":\"{error}\"}}"))
    }

    /// The findings as a part of a page.
    pub fn report(&self) -> SpectrumReport {
        let mut picture = self.picture.clone();
        let fault = self
            .rejection
            .as_ref()
            .zip(self.reason())
            .map(|(rejection, reason)| format!("{reason} ({}).", rejection.code()));
        if let Some(picture) = &mut picture {
            picture.label_probability = self.label_probability();
        }
        let rod = self
            .source
            .rod
            .as_ref()
            .map_or_else(String::new, |rod| format!("Rod {rod}: "));
        SpectrumReport {
            file: self.source.file.to_string(),
            channel: format!("{rod}{}", self.source.channel),
            unit: self
                .source
                .unit
                .map(str::to_owned)
                .or(self.source.foreign_unit.clone()),
            band_hz: self.band_hz,
            flags: self.flags.iter().map(ToString::to_string).collect(),
            force: self.force(),
            doubts: self.doubts(),
            record: picture,
            fault,
        }
    }
}
