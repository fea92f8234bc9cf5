//! The fold over a rod's records: state and record in, state and verdict out.
//!
//! * [`plan`]    everything the tracking of one rod depends on besides its records
//! * [`state`]   everything remembered of one rod from record to record
//! * [`verdict`] what came of one record, and what it changed
//! * [`tracker`] one `step` per record
//! * `intake`    the way of one identified record
//! * `early`     the watch over the records that will make the baseline
//! * `reference` force and relative force at the reference temperature
//! * `monitor`   closes a period: moves the detectors on, raises and clears alarms
//! * `loss`      losses so large that nothing else explains them
//! * `explain`   the kinds of change an alarm may be about
//! * [`packed`]  filter banks as text

mod early;
mod explain;
mod intake;
mod loss;
mod monitor;
pub mod packed;
pub mod plan;
mod reference;
pub mod state;
pub mod tracker;
pub mod verdict;
