//! Settings of the parts above the configuration: plain data with defaults.

#[cfg(feature = "daemon")]
pub mod alert;
#[cfg(feature = "daemon")]
pub mod bucket;
pub mod credential;
#[cfg(feature = "daemon")]
pub mod forward;
pub mod http;
#[cfg(feature = "daemon")]
pub mod hub;
pub mod ingest;
pub mod journal;
pub mod store;
