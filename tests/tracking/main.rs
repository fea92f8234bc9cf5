//! A rod over months and years: baseline, relative force, drift, alternatives, trouble.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/scenario/mod.rs"]
mod scenario;

mod alternatives;
mod late_others;
mod losses;
mod months;
mod relative;
mod rods;
mod silence;
mod tested;
mod together;
mod tracking_coverage;
mod tracking_trouble;
