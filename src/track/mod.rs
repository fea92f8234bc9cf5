//! The relative force of one rod over months: a pure fold over its records in event time, and the
//! alarm with a stated false-alarm rate.
//!
//! ```text
//! Observation -> Baseline -> Relative -> Period -> Regression -> Charts -> Alarms
//! ```
//!
//! * [`observation`] what tracking takes from one record
//! * [`baseline`]    mean log-frequencies of the first records and particles of the static parameters
//! * [`relative`]    posterior of N_t / N_0 for one record, and whether the change is axial at all
//! * [`plausibility`] records that cannot be what they claim: unit, clock, channel
//! * `exchange`      whether two channels show each other's rods: the odds of what explains both
//! * [`thermometer`] temperature readings that cannot be what they claim
//! * [`thermal`]     the rod's temperature from the air's: low-passed by a thermal lag
//! * [`period`]      the records of one decorrelation period as one statistic
//! * [`regression`]  what the temperature explains, and residuals that are N(0, 1) without a change
//! * [`chart`]       two CUSUM charts that share one false-alarm budget
//! * [`arl`]         average run lengths from the integral equation
//! * [`run_length`]  the run-length distribution of both charts together
//! * [`change`]      onset, size and rate of a drift with credible intervals
//! * [`drift`]       filter banks and Shiryaev-Roberts detection of drifts
//! * [`alarm`]       kinds, raise, repeat, acknowledge, clear
//! * [`alternatives`] which kind of change the pattern of the modes allows
//! * [`settings`]    what can be chosen
//! * [`state`]       everything remembered of one rod from record to record
//! * [`plan`]        what the tracking of one rod depends on besides its records
//! * [`whiteness`]   whether residuals are independent, as the stated rate supposes
//! * [`verdict`]     what came of one record, and what it changed
//! * [`tracker`]     the fold: one `step` per record
//! * `levels`, `particles`, `shift` parts of the baseline and of the relative force
//! * `intake`        the way of one identified record
//! * `reference`     force and relative force at the reference temperature
//! * `monitor`       what a closed period says: charts moved on, conditions looked at

pub mod alarm;
pub mod alternatives;
pub mod arl;
pub mod baseline;
pub mod change;
pub mod chart;
pub mod drift;
mod exchange;
mod intake;
mod lattice;
mod levels;
mod member;
mod monitor;
pub mod observation;
mod particles;
pub mod period;
pub mod plan;
pub mod plausibility;
mod reference;
pub mod regression;
pub mod relative;
pub mod run_length;
pub mod settings;
mod shift;
pub mod state;
mod tail;
pub mod thermal;
pub mod thermometer;
pub mod tracker;
pub mod verdict;
pub mod whiteness;

pub use alarm::{Alarm, AlarmEvent, Kind, What};
pub use baseline::Baseline;
pub use observation::{LogMode, Observation};
pub use period::Period;
pub use plan::TrackPlan;
pub use plausibility::Peer;
pub use relative::{Interval, Relative};
pub use settings::{AlarmSettings, TrackSettings};
pub use state::{Segment, State};
pub use tracker::Tracker;
pub use verdict::{AtReference, Input, RodState, SetAside, Verdict};
