//! Store, replay and tables of one site.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/archive/mod.rs"]
mod archive;
#[path = "../harness/site/mod.rs"]
mod site;

mod backup;
mod kill;
mod overlap;
mod replay_again;
mod settings_again;
mod store;
mod store_commands;
mod track;
mod upgrade;
