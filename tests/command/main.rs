//! The program as users run it.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/archive/mod.rs"]
mod archive;
#[path = "../harness/program/mod.rs"]
mod program;
#[path = "../harness/site/mod.rs"]
mod site;

mod agreement;
mod cli;
mod examples;
mod exports;
mod fleet;
mod import_cli;
mod measure;
mod report;
mod same_numbers;
mod scenes;
mod spectrum_cli;
mod synthetic;
mod tracking_cli;
mod unit_files;
