//! Settings of the parts above the configuration: plain data with defaults.

#[cfg(feature = "daemon")]
pub mod alert;
pub mod credential;
pub mod http;
pub mod ingest;
pub mod journal;
pub mod store;
