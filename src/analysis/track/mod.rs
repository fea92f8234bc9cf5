//! The relative force of one rod over months: a pure fold over its records in event time, and the
//! alarm with a stated false-alarm rate.
//!
//! ```text
//! Observation -> Baseline -> Relative -> Period -> DriftWatch -> Alarms
//! ```
//!
//! Imports go downward only, from the last line of this list to the first:
//! * [`observation`]  input of tracking from one record
//! * [`settings`]     settings of tracking and alarms
//! * [`ordered`]      results of several rods' records in order of their times
//! * [`baseline`]     mean log-frequencies of the first records and particles of the static parameters
//! * [`relative`]     posterior of N_t / N_0 for one record, and a test that the change is axial
//! * [`alternatives`] kinds of change that the pattern of the modes allows
//! * [`drift`]        records of a period as one statistic, the other rods, detectors of a change
//! * [`thermometer`]  temperature readings that cannot be what they claim
//! * [`plausibility`] records that cannot be what they claim: unit, clock, channel
//! * [`alarm`]        kinds, raise, repeat, acknowledge, clear
//! * [`fold`]         one `step` per record: plan, state, verdict

pub mod alarm;
pub mod alternatives;
pub mod baseline;
pub mod drift;
pub mod fold;
pub mod observation;
pub mod ordered;
pub mod plausibility;
pub mod relative;
pub mod settings;
pub mod thermometer;

pub use alarm::{Alarm, AlarmEvent, Kind, What};
pub use baseline::Baseline;
pub use drift::others::Others;
pub use drift::period::Period;
pub use drift::watch::{DriftWatch, Witness};
pub use fold::plan::TrackPlan;
pub use fold::state::{Segment, State};
pub use fold::tracker::{SILENCE_INTERVALS, Tracker};
pub use fold::verdict::{AtReference, Input, RodState, SetAside, Verdict};
pub use observation::{LogMode, Observation};
pub use plausibility::{JUMP_S, Peer};
pub use relative::{Interval, Relative};
pub use settings::{AlarmSettings, TrackSettings};
