//! The configuration, and the command that writes one.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/common/mod.rs"]
mod common;

mod configuration;
mod init;
