//! Parts of the daemon: streams, journal, sinks, servers, page.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

#[path = "../harness/archive/mod.rs"]
mod archive;
#[path = "../harness/common/mod.rs"]
mod common;
#[path = "../harness/listeners/mod.rs"]
mod listeners;
#[path = "../harness/server/mod.rs"]
mod server;
#[path = "../harness/site/mod.rs"]
mod site;
#[path = "../command/synthetic.rs"]
#[allow(dead_code)] // the other histories are of tests elsewhere
mod synthetic;

mod alerts;
mod browser;
mod bucket;
mod certificates;
mod fault_kinds;
mod folder;
mod http;
mod joins;
mod journal;
mod log;
mod looks;
mod metrics;
mod notify;
mod page;
mod presses;
mod protocol;
mod send;
mod sheet;
mod sockets;
mod taken_away;
mod viewer;
