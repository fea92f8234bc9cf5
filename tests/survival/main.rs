//! The daemon under faults, as a process: killed at random and at every durable step, refused by the disk, told to stop, stalled, and
//! confined to what its unit allows. After each: exactly once, the same answer, nothing acknowledged lost, every alarm told.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod campaign;
mod feed;
mod hook;
mod kill;
mod poison;
mod process;
mod refusals;
mod sandbox;
mod signals;
mod steps;
mod watchdog;
