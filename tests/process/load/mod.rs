//! The daemon under load, in real time or faster: latency, saturation, a day of fast channels, dead sinks, a long store, hostile
//! input. Every figure is printed and held to its limit.
//!
//! One at a time, on a machine that does nothing else:
//! `cargo test --release --test process -- --ignored --nocapture --test-threads 1 load::NAME`. docs/performance.md has the figures.
//! On a machine that is busy, `chrt -f 5` before the built test binary puts all of it before everything else.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod day;
mod hostile;
mod latency;
mod plant;
pub mod server;
mod sinks;
mod start;
mod thousand;
pub mod usage;
mod witness;

pub use day::slope;
