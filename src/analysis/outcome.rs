//! Result of one record: a force, or a reason why there is none.

use crate::findings::Doubt;
use crate::identify::{Identification, Joint, LeftOut, Measurement, Plan, Sensors};
use crate::inference::Conflict;
use crate::rod::beam::Quantity;
use crate::signal::modes::{Labels, Mode};
use crate::signal::record::{Envelope, Reading, Rejection, RodId, Timestamp};
use crate::track::{Input, LogMode, Observation};
use sha2::{Digest, Sha256};

/// Result of one record.
#[derive(Debug, Clone)]
pub enum Outcome {
    /// The record gave a force.
    Identified(Box<Identification>),
    /// Its frequencies were identified elsewhere: it is tracked, without a force of its own.
    Tabulated(Box<Tabulated>),
    /// The record gave no force, for a stated reason.
    Rejected(Box<Rejected>),
}

/// A record known only by its natural frequencies in a table, without samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Tabulated {
    /// Id of the rod.
    pub rod: RodId,
    /// Time of the record.
    pub start: Timestamp,
    /// Length \[s\]; zero if the table does not give it.
    pub duration_s: f64,
    /// The measured modes, ascending in order.
    pub modes: Vec<Mode>,
    /// Temperature in its row \[degC\], if given.
    pub temperature_c: Option<f64>,
    /// Temperature readings since the rod's previous record, ascending in time.
    pub readings: Vec<Reading>,
    /// Root mean square of its samples, in one unit throughout the table.
    pub rms: Option<f64>,
    /// Distance of the frequencies from everything the model can produce.
    pub conflict: Conflict,
}

/// Frequencies of one time, identified elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct TableRow {
    /// Time of the record.
    pub start: Timestamp,
    /// Length \[s\]; zero if not known.
    pub duration_s: f64,
    /// The measured modes, ascending in order.
    pub modes: Vec<Mode>,
    /// Temperature \[degC\], if given.
    pub temperature_c: Option<f64>,
    /// Temperature readings since the rod's previous record, ascending in time.
    pub readings: Vec<Reading>,
    /// Root mean square of the samples, in one unit throughout.
    pub rms: Option<f64>,
}

/// A record that gave no force.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejected {
    /// Id of the rod.
    pub rod: RodId,
    /// Time of the first sample, if known.
    pub start: Option<Timestamp>,
    /// Length \[s\], if it is known.
    pub duration_s: Option<f64>,
    /// Sample rate \[Hz\], if known.
    pub fs_hz: Option<f64>,
    /// The record's identity by content, if it has samples.
    pub identity: Option<[u8; 32]>,
    /// Temperature readings that came with it.
    pub readings: Vec<Reading>,
    /// Reason of the rejection.
    pub rejection: Rejection,
    /// Waveform, spectrum and resonances, if the analysis came that far.
    pub measurement: Option<Box<Measurement>>,
    /// Assignments of its peaks to orders, if there are peaks.
    pub labels: Option<Labels>,
    /// Envelope of its samples for drawing, if it was refused before there was a spectrum.
    pub waveform: Option<Envelope>,
    /// Sensors of the moment; `None` for a rod with one.
    pub sensors: Option<Sensors>,
}

impl Outcome {
    /// Reasons to doubt its force.
    pub fn doubts(&self) -> Vec<Doubt> {
        let (conflict, labels, force) = match self {
            Self::Identified(identification) => (
                &identification.conflict,
                identification.labels.as_ref(),
                identification.posterior.marginal(Quantity::AxialForce),
            ),
            Self::Tabulated(tabulated) => (&tabulated.conflict, None, None),
            Self::Rejected(_) => return Vec::new(),
        };
        Doubt::all(
            Some(conflict.score),
            Some(conflict.prior_tail),
            labels.map(|labels| labels.probability),
            force.map(|force| force.interval()),
        )
    }

    /// Outcome of frequencies with a time: tracked, or refused because no rod of the prior has them.
    pub fn of_row(plan: &Plan, row: TableRow) -> Self {
        let rod = plan.settings().rod.clone();
        match plan.conflict(&row.modes) {
            Ok(conflict) => Self::Tabulated(Box::new(Tabulated {
                rod,
                start: row.start,
                duration_s: row.duration_s,
                modes: row.modes,
                temperature_c: row.temperature_c,
                readings: row.readings,
                rms: row.rms,
                conflict,
            })),
            Err(rejection) => Self::Rejected(Box::new(Rejected {
                identity: Some(tabulated_identity(&rod, row.start, &row.modes)),
                start: Some(row.start),
                duration_s: Some(row.duration_s),
                readings: row.readings,
                ..Rejected::new(rod, rejection)
            })),
        }
    }

    /// Outcome of frequencies without a time.
    pub fn of_frequencies(rod: &RodId, found: Result<Identification, Rejection>) -> Self {
        match found {
            Ok(identification) => Self::Identified(Box::new(identification)),
            Err(rejection) => Self::Rejected(Box::new(Rejected::new(rod.clone(), rejection))),
        }
    }

    /// Time of the first sample, if known.
    pub fn start(&self) -> Option<Timestamp> {
        match self {
            Self::Identified(identification) => identification.measurement.as_ref().map(|m| m.start),
            Self::Tabulated(row) => Some(row.start),
            Self::Rejected(rejected) => rejected.start,
        }
    }

    /// Id of the rod.
    pub fn rod(&self) -> &RodId {
        match self {
            Self::Identified(identification) => &identification.rod,
            Self::Tabulated(row) => &row.rod,
            Self::Rejected(rejected) => &rejected.rod,
        }
    }

    /// Identity of the record by content; without samples, by rod, time, length and reason or frequencies.
    /// `None` for frequencies measured elsewhere that have no time.
    pub fn identity(&self) -> Option<[u8; 32]> {
        match self {
            Self::Identified(identification) => identification.measurement.as_ref().map(|m| m.identity),
            Self::Tabulated(row) => Some(tabulated_identity(&row.rod, row.start, &row.modes)),
            Self::Rejected(rejected) => {
                Some(rejected.identity.unwrap_or_else(|| rejected.derived_identity()))
            }
        }
    }

    /// Sensors of the moment; `None` for a rod with one.
    pub fn sensors(&self) -> Option<&Sensors> {
        match self {
            Self::Identified(identification) => identification.joint.as_ref().map(|joint| &joint.sensors),
            Self::Tabulated(_) => None,
            Self::Rejected(rejected) => rejected.sensors.as_ref(),
        }
    }

    /// The outcome with the sensors of its moment, if it is a refusal: an identification has its own.
    #[must_use]
    pub fn with_sensors(mut self, sensors: Option<Sensors>) -> Self {
        if let Self::Rejected(rejected) = &mut self {
            rejected.sensors = sensors;
        }
        self
    }

    /// Root mean square of the samples of a record that gave frequencies, SI of the unit of the rod's first sensor; `None` if another
    /// one leads.
    pub fn rms(&self) -> Option<f64> {
        match self {
            Self::Identified(identification) => {
                let measurement = identification.measurement.as_ref();
                let is_other = |joint: &Joint| joint.lead > 0;
                measurement
                    .map(|measurement| measurement.rms)
                    .filter(|_| !identification.joint.as_ref().is_some_and(is_other))
            }
            Self::Tabulated(row) => row.rms,
            Self::Rejected(_) => None,
        }
    }

    /// Input for tracking; `None` for frequencies measured elsewhere that have no time.
    pub fn input(&self) -> Option<Input> {
        match self {
            Self::Identified(identification) => Observation::of(identification).map(Input::Identified),
            Self::Tabulated(row) => Some(Input::Identified(row.observation())),
            // The rod's other sensors have moments of their own.
            Self::Rejected(rejected) if rejected.sensors.as_ref().is_some_and(Sensors::is_of_one) => {
                Some(Input::Readings(rejected.readings.clone()))
            }
            Self::Rejected(rejected) => Some(Input::Rejected {
                start: rejected.start,
                reason: rejected.rejection.to_string(),
                readings: rejected.readings.clone(),
            }),
        }
    }
}

/// The identity of a row of a table: its rod, time and frequencies with their errors.
pub fn tabulated_identity(rod: &RodId, start: Timestamp, modes: &[Mode]) -> [u8; 32] {
    let mut hash = Sha256::new();
    hash.update(b"tabulated\0");
    hash.update(rod.0.as_bytes());
    hash.update([0]);
    hash.update(start.as_nanos().to_le_bytes());
    for mode in modes {
        hash.update((mode.order as u64).to_le_bytes());
        hash.update(mode.frequency_hz.to_bits().to_le_bytes());
        hash.update(mode.sd_hz.to_bits().to_le_bytes());
    }
    hash.finalize().into()
}

impl Tabulated {
    /// Observation for tracking. Without a root mean square the amplitude is not judged.
    fn observation(&self) -> Observation {
        Observation {
            start: self.start,
            duration_s: self.duration_s,
            modes: self.modes.iter().map(LogMode::from).collect(),
            readings: self.readings.clone(),
            rms: self.rms.unwrap_or(0.0),
            conflict: self.conflict.score,
        }
    }
}

impl Rejected {
    /// A refusal of which nothing else is known.
    pub fn new(rod: RodId, rejection: Rejection) -> Self {
        Self {
            rod,
            start: None,
            duration_s: None,
            fs_hz: None,
            identity: None,
            readings: Vec::new(),
            rejection,
            measurement: None,
            labels: None,
            waveform: None,
            sensors: None,
        }
    }

    /// A refusal of a record that gave a force.
    pub fn of_identified(found: &Identification, rejection: Rejection) -> Self {
        let measurement = found.measurement.as_ref();
        Self {
            start: measurement.map(|measured| measured.start),
            duration_s: measurement.map(|measured| measured.duration_s),
            fs_hz: measurement.map(|measured| measured.fs_hz),
            identity: measurement.map(|measured| measured.identity),
            ..Self::new(found.rod.clone(), rejection)
        }
    }

    fn derived_identity(&self) -> [u8; 32] {
        let mut hash = Sha256::new();
        hash.update(b"rejected\0");
        hash.update(self.rod.0.as_bytes());
        hash.update([0]);
        hash.update(self.start.map_or(i64::MIN, Timestamp::as_nanos).to_le_bytes());
        hash.update(self.duration_s.unwrap_or(-1.0).to_bits().to_le_bytes());
        hash.update(self.rejection.code().as_bytes());
        // Several sensors may be refused alike at one time, each by itself.
        for LeftOut { sensor, .. } in self.sensors.iter().flat_map(|sensors| &sensors.left_out) {
            hash.update([0]);
            hash.update(sensor.as_bytes());
        }
        hash.finalize().into()
    }
}
