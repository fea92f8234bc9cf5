//! The pure part, from samples to the posterior of the force: closed forms, other methods, ranks.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/doubles/mod.rs"]
mod doubles;
#[path = "../harness/labels/mod.rs"]
mod labels;
#[path = "../harness/program/mod.rs"]
mod program;
#[path = "../harness/simulator/mod.rs"]
mod simulator;

mod abc;
mod beam;
mod campaigns;
mod emulator;
mod mcmc;
mod modes;
mod quality;
mod rod_tests;
mod sbc;
mod sensors;
mod spectrum;
mod stamps;
mod study;
