//! Answers of a store to the page and to other programs, as JSON: one struct per answer, described by
//! docs/openapi.json.
//!
//! * [`standing`] status of one rod
//! * [`site`](mod@site)     all rods at a glance
//! * [`rod`]      one rod: segments, temperature, charts, views of records
//! * [`history`]  a rod's numbers over time, in columns
//! * [`days`]     daily means, for histories of years
//! * [`listing`]  records and alarms, page by page
//! * [`monitoring`] state of the monitoring, and the daemon's present conditions

pub mod days;
pub mod history;
pub mod listing;
pub mod monitoring;
pub mod rod;
pub mod site;
pub mod standing;

pub use days::Days;
pub use history::{Frequencies, History};
pub use listing::{Alarms, Records};
pub use monitoring::{Lasting, Monitoring};
pub use rod::{Chart, Looks, RodAnswer};
pub use site::SiteAnswer;
pub use standing::{Goals, RodStatus, Terms};
