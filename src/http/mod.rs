//! The daemon's HTTP server: health, readiness, metrics.
//!
//! [`routes`] is what it answers, a plain function of the daemon's telemetry; [`serve`] is how it listens: at most so many
//! connections, each with limits and deadlines, so that no client can cost the daemon more than a little memory.

mod routes;
mod serve;
pub mod settings;

pub use routes::routes;
pub use serve::{listen, serve};
pub use settings::HttpSettings;
