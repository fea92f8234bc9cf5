//! Settings of parts above the configuration, as it hands them on: plain data with defaults.

pub mod alert;
pub mod credential;
pub mod http;
pub mod ingest;
pub mod journal;
pub mod store;
