//! Delivery of alarms: each sink against a fake that fails in every way and against the real servers,
//! restarts, outages.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod alertmanager;
mod couriers;
mod desk;
pub mod fake;
mod mail;
mod mosquitto;
pub mod peers;
mod placed;
mod settings;
mod webhook;
