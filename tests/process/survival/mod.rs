//! The daemon under faults, as a process: killed at random and at every durable step, with errors of the
//! disk, stopped, stalled, and confined to the rights of its unit. After each: exactly once, the same answer,
//! no acknowledged data lost, every alarm sent.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

pub mod campaign;
pub mod feed;
mod hook;
mod kill;
mod poison;
pub mod process;
mod refusals;
mod sandbox;
mod signals;
mod steps;
mod watchdog;
