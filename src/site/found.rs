//! Findings of a record's samples, kept so that another prior needs no samples: resonances, motion and what else
//! labels, inference and tracking read. Exact to the bit, a few hundred bytes a record.

use crate::analysis::identify::{Measurement, Plan, Refusal};
use crate::analysis::outcome::{Outcome, Rejected};
use crate::analysis::signal::modes::{Motion, Resonance};
use crate::analysis::signal::record::{Envelope, Flag, Reading, Rejection, RodId, Timestamp};
use crate::analysis::signal::spectrum::Spectrum;
use crate::site::ordered_map::message_of;
use serde::{Deserialize, Serialize};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// First byte of every encoded value: another layout gets another number.
const LAYOUT: u8 = 1;

/// Stands for a waveform that is not kept.
const NO_WAVEFORM: Envelope = Envelope {
    step_s: 0.0,
    low: Vec::new(),
    high: Vec::new(),
};

/// Findings of one input of a rod's fold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Found {
    /// Time of the first sample \[ns since 1970\], if known.
    start_ns: Option<i64>,
    duration_s: Option<f64>,
    fs_hz: Option<f64>,
    /// Temperatures since the rod's previous record: time \[ns since 1970\] and \[degC\].
    readings: Vec<(i64, f64)>,
    seen: Seen,
}

/// Result of the search of the samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Seen {
    /// Resonances were searched for; there may be none.
    Resonances(Search),
    /// The record was refused before, for a reason (JSON) that no prior of the same band changes.
    Refused(String),
    /// Temperatures that belong to no record.
    Readings,
}

/// Findings of the search of one record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Search {
    temperature_c: Option<f64>,
    rms: f64,
    /// Flags of the quality checks (JSON); empty if there are none.
    flags: String,
    motion: Motion,
    /// Distance of the spectrum's lines \[Hz\]: a peak within half of it is the mode.
    df_hz: f64,
    resonances: Vec<Resonance>,
}

/// Bytes that are no findings of this program.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotFindings(String);

impl Found {
    /// Findings of a record; `None` where only its samples can tell more: a table of frequencies, an analysis that
    /// broke, a reason that would not read back.
    pub fn of(outcome: &Outcome) -> Option<Self> {
        match outcome {
            Outcome::Identified(identification) => Self::of_measurement(identification.measurement.as_ref()?),
            Outcome::Tabulated(_) => None,
            Outcome::Rejected(rejected) => match (&rejected.measurement, &rejected.rejection) {
                (_, Rejection::Broken { .. } | Rejection::Quarantined { .. }) => None,
                (Some(measurement), _) => Self::of_measurement(measurement),
                (None, rejection) => {
                    let reason = serde_json::to_string(rejection).ok()?;
                    let back: Rejection = serde_json::from_str(&reason).ok()?;
                    // An infinite number in a reason has no JSON: the sentence would differ.
                    (back.to_string() == rejection.to_string()).then(|| Self {
                        start_ns: rejected.start.map(Timestamp::as_nanos),
                        duration_s: rejected.duration_s,
                        fs_hz: rejected.fs_hz,
                        readings: plain(&rejected.readings),
                        seen: Seen::Refused(reason),
                    })
                }
            },
        }
    }

    fn of_measurement(measurement: &Measurement) -> Option<Self> {
        let flags = match measurement.flags.as_slice() {
            [] => String::new(),
            flags => serde_json::to_string(flags).ok()?,
        };
        Some(Self {
            start_ns: Some(measurement.start.as_nanos()),
            duration_s: Some(measurement.duration_s),
            fs_hz: Some(measurement.fs_hz),
            readings: plain(&measurement.readings),
            seen: Seen::Resonances(Search {
                temperature_c: measurement.temperature_c,
                rms: measurement.rms,
                flags,
                motion: measurement.motion.clone(),
                df_hz: measurement.spectrum.df_hz,
                resonances: measurement.resonances.clone(),
            }),
        })
    }

    /// Temperatures that belong to no record.
    pub fn of_readings(readings: &[Reading]) -> Self {
        Self {
            start_ns: None,
            duration_s: None,
            fs_hz: None,
            readings: plain(readings),
            seen: Seen::Readings,
        }
    }

    /// Bytes of the findings.
    pub fn encode(&self) -> Vec<u8> {
        let begun = vec![LAYOUT];
        // Appending to a vector cannot fail, and every type here has a length beforehand.
        postcard::to_extend(self, begun).unwrap_or_default()
    }

    /// Findings from their bytes.
    ///
    /// # Errors
    /// They are of another layout, or damaged.
    pub fn decode(bytes: &[u8]) -> Result<Self, NotFindings> {
        match bytes.split_first() {
            Some((&LAYOUT, rest)) => {
                postcard::from_bytes(rest).map_err(|error| NotFindings(error.to_string()))
            }
            Some((other, _)) => Err(NotFindings(format!(
                "layout {other} of the findings; this program knows {LAYOUT}"
            ))),
            None => Err(NotFindings("no findings".to_owned())),
        }
    }

    /// Resonances found, ascending in frequency; none for a record refused before its search.
    pub fn resonances(&self) -> &[Resonance] {
        match &self.seen {
            Seen::Resonances(search) => &search.resonances,
            Seen::Refused(_) | Seen::Readings => &[],
        }
    }

    /// Time of the first sample, if known.
    pub fn start(&self) -> Option<Timestamp> {
        self.start_ns.map(Timestamp::from_nanos)
    }

    /// Temperatures that belong to no record; `None` if these are the findings of a record.
    pub fn only_readings(&self) -> Option<Vec<Reading>> {
        matches!(self.seen, Seen::Readings).then(|| self.readings())
    }

    fn readings(&self) -> Vec<Reading> {
        let reading = |&(time_ns, celsius)| Reading {
            time: Timestamp::from_nanos(time_ns),
            celsius,
        };
        self.readings.iter().map(reading).collect()
    }

    /// Outcome of the record by a plan: labels and inference alone. Equal to that of the samples, but for waveform and
    /// spectrum, which are empty, if the plan searches as the one did that found this.
    ///
    /// # Errors
    /// These are no findings of a record, or of a newer program.
    pub fn outcome(&self, rod: &RodId, identity: [u8; 32], plan: &Plan) -> Result<Outcome, NotFindings> {
        let rejected = |refusal: Refusal| {
            Outcome::Rejected(Box::new(Rejected {
                start: self.start_ns.map(Timestamp::from_nanos),
                duration_s: self.duration_s,
                fs_hz: self.fs_hz,
                identity: Some(identity),
                readings: self.readings(),
                measurement: refusal.measurement,
                labels: refusal.labels,
                waveform: Some(NO_WAVEFORM),
                ..Rejected::new(rod.clone(), refusal.rejection)
            }))
        };
        let search = match &self.seen {
            Seen::Resonances(search) => search,
            Seen::Refused(reason) => {
                let reason: Rejection =
                    serde_json::from_str(reason).map_err(|error| NotFindings(error.to_string()))?;
                return Ok(rejected(reason.into()));
            }
            Seen::Readings => return Err(NotFindings("temperatures without a record".to_owned())),
        };
        let measurement = self.measurement(search, identity)?;
        // The plan is only borrowed: nothing shared is left half-changed.
        Ok(
            match catch_unwind(AssertUnwindSafe(|| plan.run_again(measurement))) {
                Ok(Ok(identification)) => Outcome::Identified(Box::new(identification)),
                Ok(Err(refusal)) => rejected(refusal),
                Err(panic) => rejected(
                    Rejection::Broken {
                        detail: message_of(&*panic),
                    }
                    .into(),
                ),
            },
        )
    }

    fn measurement(&self, search: &Search, identity: [u8; 32]) -> Result<Measurement, NotFindings> {
        let (Some(start_ns), Some(duration_s), Some(fs_hz)) = (self.start_ns, self.duration_s, self.fs_hz)
        else {
            return Err(NotFindings("a record without a time".to_owned()));
        };
        let flags: Vec<Flag> = match search.flags.as_str() {
            "" => Vec::new(),
            flags => serde_json::from_str(flags).map_err(|error| NotFindings(error.to_string()))?,
        };
        Ok(Measurement {
            identity,
            start: Timestamp::from_nanos(start_ns),
            duration_s,
            fs_hz,
            temperature_c: search.temperature_c,
            readings: self.readings(),
            rms: search.rms,
            waveform: NO_WAVEFORM,
            flags,
            spectrum: Spectrum {
                df_hz: search.df_hz,
                psd: Vec::new(),
                segments: 0,
            },
            resonances: search.resonances.clone(),
            motion: search.motion.clone(),
        })
    }
}

fn plain(readings: &[Reading]) -> Vec<(i64, f64)> {
    readings
        .iter()
        .map(|reading| (reading.time.as_nanos(), reading.celsius))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::modes::MotionKind;

    fn found() -> Found {
        let resonance = Resonance {
            frequency_hz: 0.1 + 0.2,
            frequency_sd_hz: f64::MIN_POSITIVE,
            damping: 2e-3,
            damping_log_sd: f64::INFINITY,
            peak_to_noise: 1e300,
            evidence: -0.0,
            line: true,
            misfit: f64::NAN,
            foreign_log_odds: f64::NEG_INFINITY,
        };
        Found {
            start_ns: Some(i64::MIN),
            duration_s: Some(60.0),
            fs_hz: Some(200.0),
            readings: vec![(7, -3.25)],
            seen: Seen::Resonances(Search {
                temperature_c: None,
                rms: 1e-5,
                flags: r#"[{"flag":"held","share":0.1}]"#.to_owned(),
                motion: Motion {
                    kind: MotionKind::FreeDecays,
                    onsets_s: vec![1.5],
                },
                df_hz: 0.1,
                resonances: vec![resonance; 3],
            }),
        }
    }

    #[test]
    fn every_bit_comes_back_numbers_that_json_does_not_have_among_them() {
        let bytes = found().encode();
        let back = Found::decode(&bytes).unwrap();
        assert_eq!(back.encode(), bytes);
        let (before, after) = (found().resonances()[0], back.resonances()[0]);
        assert_eq!(after.misfit.to_bits(), before.misfit.to_bits());
        assert_eq!(after.evidence.to_bits(), before.evidence.to_bits());
        assert_eq!(after.damping_log_sd, f64::INFINITY);
    }

    #[test]
    fn another_layout_and_cut_bytes_are_refused() {
        let mut bytes = found().encode();
        assert!(Found::decode(&bytes[..bytes.len() - 1]).is_err());
        bytes[0] = LAYOUT + 1;
        assert!(Found::decode(&bytes).unwrap_err().0.contains("layout 2"));
        assert!(Found::decode(&[]).is_err());
    }

    #[test]
    fn a_reason_that_would_read_back_as_another_sentence_is_not_kept() {
        let refused = |rejection| {
            Outcome::Rejected(Box::new(Rejected {
                duration_s: Some(1.0),
                ..Rejected::new(RodId("r".to_owned()), rejection)
            }))
        };
        let level = |ratio| Rejection::Level { ratio, time_s: 1.0 };
        assert!(Found::of(&refused(level(3.0))).is_some());
        assert!(Found::of(&refused(level(f64::INFINITY))).is_none());
        assert!(Found::of(&refused(Rejection::Quarantined { deaths: 2 })).is_none());
    }
}
