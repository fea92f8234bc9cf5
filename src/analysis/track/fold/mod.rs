//! The fold over a rod's records: state and record in, state and verdict out.
//!
//! * [`plan`]    settings and prepared data of the tracking of one rod
//! * [`state`]   state of one rod from record to record
//! * [`verdict`] result of one record, and the changes it made
//! * [`tracker`] one `step` per record
//! * `intake`    intake of one identified record
//! * `learning`  records that wait for the baseline
//! * `early`     watch over the records of the future baseline
//! * `provisional` the baselines of that watch
//! * `reference` force and relative force at the reference temperature
//! * `monitor`   closes a period: moves the detectors on, checks conditions
//! * `change`    alarms of a change that the detectors found
//! * `loss`      losses so large that nothing else explains them
//! * `growth`    a drift that grows is told anew
//! * `explain`   kinds of change behind an alarm
//! * `scatter`   scatter of the records within a period
//! * `wording`   sentences of drifts and notices
//! * [`packed`]  filter banks as text

mod change;
mod early;
mod explain;
mod further;
mod growth;
mod intake;
mod learning;
mod loss;
mod monitor;
mod neighbour;
pub mod packed;
pub mod plan;
mod provisional;
mod reference;
mod scatter;
mod silence;
pub mod state;
pub mod tracker;
pub mod verdict;
mod wording;
