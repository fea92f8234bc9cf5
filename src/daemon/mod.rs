//! The daemon: sources, pipeline, site and sinks, all live at once.

mod folder;
pub mod generation;
pub mod job;
pub mod reader;

pub use generation::Generation;
pub use job::Job;
pub use reader::Reader;
