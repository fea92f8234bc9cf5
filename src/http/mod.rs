//! The daemon's HTTP server: health, readiness, metrics.

pub mod settings;

pub use settings::HttpSettings;
