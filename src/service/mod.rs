//! The service: everything that waits, serves or reports while the program runs unattended (`tirante run`, `serve`).
//!
//! Everything live becomes a file first (docs/daemon.md):
//!
//! ```text
//! ingest -> journal --.
//! watched folder -----+-> daemon: reader -> pipeline -> core -> store -> alert
//! ```
//! * [`daemon`]    its life and its threads: reader, pipeline, core; reload, drain, quarantine
//! * [`ingest`]    sockets: the protocol, named senders and what is acknowledged, limits, TLS
//! * [`journal`]   what the sockets took, as MCAP parts on disk
//! * [`alert`]     news of alarms to the sinks, at least once and in order
//! * [`forward`]   copy of the store's log to a centre
//! * [`bucket`]    copy of the journal's parts to object storage
//! * [`hub`]       the centre: the logs of many sites in one database
//! * [`telemetry`] faults and health, metrics, the log
//! * [`viewer`]    results as messages for robotics viewers, as a file and live
//! * [`api`]       answers of a store to the page and to other programs, as JSON
//! * [`http`]      the page, its API, `/healthz`, `/readyz`, `/metrics`
//! * `memory`      what was freed, back to the system
//! * `tcp`         listeners of http and ingest
//! * `tls`         clients of servers that have a certificate

pub mod alert;
pub mod api;
pub mod bucket;
pub mod daemon;
pub mod forward;
pub mod http;
pub mod hub;
pub mod ingest;
pub mod journal;
mod memory;
mod tcp;
pub mod telemetry;
mod tls;
pub mod viewer;
