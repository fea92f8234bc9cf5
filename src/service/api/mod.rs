//! What a store says to the page and to other programs, as JSON: one struct per answer, docs/openapi.json describes them.
//!
//! * [`standing`] how one rod stands
//! * [`site`](mod@site)     all rods at a glance
//! * [`rod`]      one rod: segments, temperature, charts, what records looked like
//! * [`history`]  a rod's numbers over time, in columns
//! * [`days`]     what years are drawn from
//! * [`listing`]  records and alarms, page by page
//! * [`monitoring`] whether the site is monitored, and what lasts around the daemon

pub mod days;
pub mod history;
pub mod listing;
pub mod monitoring;
pub mod rod;
pub mod site;
pub mod standing;

pub use days::Days;
pub use history::History;
pub use listing::{Alarms, Records};
pub use monitoring::{Lasting, Monitoring};
pub use rod::{Chart, Looks, RodAnswer};
pub use site::SiteAnswer;
pub use standing::{Goals, RodStatus};
