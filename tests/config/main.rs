//! The configuration, and the command that writes one.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/common/mod.rs"]
mod common;
#[path = "../harness/program/mod.rs"]
mod program;

mod configuration;
mod init;
