//! The daemon as a process: killed, confined, weighed, under load.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/archive/mod.rs"]
mod archive;
#[path = "../harness/site/mod.rs"]
mod site;

mod daemon;
mod day;
mod hub;
mod load;
mod survival;
mod weighed;
