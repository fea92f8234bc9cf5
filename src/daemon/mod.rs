//! The daemon: sources, pipeline, site and sinks, all live at once.

pub mod generation;
pub mod job;
pub mod notify;

pub use generation::Generation;
pub use job::Job;
