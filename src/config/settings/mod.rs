//! Settings of the parts above the configuration: plain data with defaults.

pub mod alert;
pub mod credential;
pub mod http;
pub mod ingest;
pub mod journal;
pub mod store;
