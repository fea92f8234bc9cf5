//! Live data in: sockets that speak MCAP or JSON lines, into the journal.
//!
//! A client's bytes go one way:
//!
//! ```text
//! listener -> entrance (tls) -> connection -> protocol (bytes to batches, no socket) -> intake (the journal)
//!                          '<------- replies: welcome, ack, done, error <----- what is durable
//! ```
//!
//! `docs/streams.md` has the protocol and the limits.

pub(crate) mod certificate;
mod clients;
mod connection;
pub mod counts;
mod entrance;
mod foreign;
pub mod intake;
pub mod line;
pub mod listener;
pub mod protocol;
mod queue;
pub mod reply;
pub mod server;
mod shares;
mod socket_file;
mod stream;
pub(crate) mod tls;
mod writer;

pub use counts::Counts;
pub use intake::{Intake, IntakeLine};
pub use listener::{ListenError, Listener};
pub use protocol::{Protocol, Refusal, Step};
pub use reply::{LeftOut, Reply};
pub use server::{Server, TopicSet, Topics, serve, topics_of};
