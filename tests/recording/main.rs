//! Recordings in and out, measurements of other programs, simulated recordings, any packaging.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/common/mod.rs"]
mod common;
#[path = "../harness/site/mod.rs"]
mod site;

mod damage;
mod import;
mod many_channels;
mod mcap;
mod mutation;
mod out_of_order;
mod packaging;
mod sensor_files;
mod sensors;
mod simulate;
mod watched;
mod with_mass;
