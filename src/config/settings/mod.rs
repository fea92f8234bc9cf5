//! Settings of the parts above the configuration: plain data with defaults.

pub mod alert;
pub mod credential;
pub mod forward;
pub mod http;
pub mod hub;
pub mod ingest;
pub mod journal;
pub mod store;
