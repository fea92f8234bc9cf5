//! The relative force of one rod over months: a pure fold over its records in event time, and the
//! alarm with a stated false-alarm rate.
//!
//! ```text
//! Observation -> Baseline -> Relative -> Period -> DriftWatch -> Alarms
//! ```
//!
//! * [`observation`] what tracking takes from one record
//! * [`baseline`]    mean log-frequencies of the first records and particles of the static parameters
//! * [`relative`]    posterior of N_t / N_0 for one record, and whether the change is axial at all
//! * [`plausibility`] records that cannot be what they claim: unit, clock, channel
//! * `exchange`      whether two channels show each other's rods: the odds of what explains both
//! * [`thermometer`] temperature readings that cannot be what they claim
//! * [`period`]      the records of one period as one statistic
//! * [`drift`]       detectors of a change: banks of filters with Shiryaev-Roberts statistics
//! * [`watch`]       the detectors of one rod, and what they say together
//! * [`others`]      the other rods of the site
//! * [`change`]      onset, size and rate of a drift as they are told
//! * [`alarm`]       kinds, raise, repeat, acknowledge, clear
//! * [`alternatives`] which kind of change the pattern of the modes allows
//! * [`settings`]    what can be chosen
//! * [`state`]       everything remembered of one rod from record to record
//! * [`plan`]        what the tracking of one rod depends on besides its records
//! * [`verdict`]     what came of one record, and what it changed
//! * [`tracker`]     the fold: one `step` per record
//! * `levels`, `particles`, `shift` parts of the baseline and of the relative force
//! * `intake`        the way of one identified record
//! * `early`         the watch over the records that will make the baseline
//! * `reference`     force and relative force at the reference temperature
//! * `monitor`       what a closed period says: detectors moved on, conditions looked at
//! * `explain`       what an alarm may be about: the alternatives, asked for the periods since an onset
//! * `packed`        filter banks as text
//! * `loss`          losses so large that nothing else explains them

pub mod alarm;
pub mod alternatives;
pub mod baseline;
pub mod change;
pub mod drift;
mod early;
mod exchange;
mod explain;
mod intake;
mod levels;
mod loss;
mod monitor;
pub mod observation;
pub mod others;
mod packed;
mod particles;
pub mod period;
pub mod plan;
pub mod plausibility;
mod reference;
pub mod relative;
pub mod settings;
mod shift;
pub mod state;
mod tail;
pub mod thermometer;
pub mod tracker;
pub mod verdict;
pub mod watch;

pub use alarm::{Alarm, AlarmEvent, Kind, What};
pub use baseline::Baseline;
pub use observation::{LogMode, Observation};
pub use others::Others;
pub use period::Period;
pub use plan::TrackPlan;
pub use plausibility::Peer;
pub use relative::{Interval, Relative};
pub use settings::{AlarmSettings, TrackSettings};
pub use state::{Segment, State};
pub use tracker::Tracker;
pub use verdict::{AtReference, Input, RodState, SetAside, Verdict};
pub use watch::{DriftWatch, Witness};
