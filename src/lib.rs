//! Tirante: the axial force of historic tie-rods from contactless vibration records.
//!
//! A record flows one way:
//!
//! ```text
//! Source -> Record -> Spectrum -> Modes -> Identification -> Track -> Verdict -> Store -> output
//! ```
//!
//! Six wings. Imports go downward only, and `tests/purity.rs` proves it:
//! * [`command`]   arguments as typed, one file per subcommand, the report page
//! * [`service`]   the daemon: ingest, journal, alert, telemetry, http, api, viewer
//! * [`site`]      prepared configuration, analysis of each record, trackers, store
//! * [`config`]    the TOML configuration, every fault reported at once, and every part's settings
//! * [`recording`] recordings in and out, measurements of other programs
//! * [`analysis`]  the pure part: numerics, rod, signal, inference, track, lab; it has no file, clock, thread
//!   pool of its own or global generator
//!
//! docs/development.md has the drawing, and the way of a record through it.
//!
//! Units are SI throughout; where no documentation is at hand, the unit is a suffix of the name.

#[doc(inline)]
pub use tirante_analysis as analysis;

pub mod command;
pub mod config;
pub mod recording;
pub mod service;
pub mod site;
