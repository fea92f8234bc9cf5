//! The journal: what came through the sockets, on disk before anything is made of it.
//!
//! All live data go into one series of MCAP files, `journal.000001.mcap` and so on, in the order they arrived. Data are
//! acknowledged to their sender when they are durable here, and the daemon reads them from here like any recording. So
//! a replay of the journal gives the daemon's results by construction, and nothing acknowledged is ever lost.

pub mod handle;
pub mod note;
pub mod settings;

pub use handle::{Batch, Closed, End, Entry, Handle, Line};
pub use settings::JournalSettings;
