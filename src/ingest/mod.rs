//! Live data in: sockets that speak MCAP or JSON lines, into the journal.

pub mod settings;

pub use settings::{IngestSettings, Listen, TlsSettings};
