//! Alarms that arrive: the outbox delivered to every sink, in order, at least once.

pub mod settings;

pub use settings::SinkSettings;
