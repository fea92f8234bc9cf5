//! Tirante: the axial force of historic tie-rods from contactless vibration records.
//!
//! The program `tirante` is the usual way in. As a library this crate adds files to [`tirante_analysis`], whose
//! first page is the tour: a [`Config`] says what is known of the rods of a site, [`Records`] reads recordings (MCAP)
//! and other programs' files, and [`plans`] prepares each rod. Everything of [`tirante_analysis`] is here, too.
//!
//! ```
//! use std::path::PathBuf;
//! use tirante::{Config, Event, Others, Records, Tracker, plans};
//!
//! // The rod of the paper is built in; Config::load reads a file.
//! let config = Config::built_in();
//! let plans = plans(&config, |_| |_, _| ())?;
//! let files = [PathBuf::from("recordings/todi-pull.mcap")];
//! for event in Records::open(&files, &config, Others::default()) {
//!     let Event::Record(record) = event else { continue };
//!     let rod = &plans[&record.rod];
//!     match rod.run(&record) {
//!         Ok(found) => println!("{}: {:.0} kN", record.start, found.axial_force().mean / 1e3),
//!         Err(refusal) => println!("{}: {}", record.start, refusal.rejection),
//!     }
//!     # assert!((500e3..700e3).contains(&rod.run(&record).map_err(|r| r.rejection)?.axial_force().mean));
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Without the feature `daemon`, which is on by default, no server, database, mail, TLS or MQTT crate is built, and
//! neither is the program:
//!
//! ```toml
//! [dependencies]
//! tirante = { path = "../tirante", default-features = false }
//! ```
//!
//! A configuration's `[[sink]]` and `[alert]` are then not looked at. Units are SI throughout; where no documentation
//! is at hand, the unit is a suffix of the name.
//!
//! # Inside
//!
//! A record flows one way:
//!
//! ```text
//! Source -> Record -> Spectrum -> Modes -> Identification -> Track -> Verdict -> Store -> output
//! ```
//!
//! Six wings, public for the program and its tests alone. Imports go downward only, and `tests/purity.rs` proves it:
//! * `command`   arguments as typed, one file per subcommand, the report page
//! * `service`   the daemon: ingest, journal, alert, telemetry, http, api, viewer
//! * `site`      prepared configuration, analysis of each record, trackers, store
//! * `config`    the TOML configuration, every fault reported at once, and every part's settings
//! * `recording` recordings in and out, measurements of other programs
//! * `analysis`  the pure part: numerics, rod, signal, inference, track, lab; it has no file, clock, thread
//!   pool of its own or global generator
//!
//! docs/development.md has the drawing, and the way of a record through it; docs/library.md more of the library.

#[doc(hidden)]
pub use tirante_analysis as analysis;
#[doc(no_inline)]
pub use tirante_analysis::*;
#[doc(hidden)]
pub use tirante_recording as recording;

#[cfg(feature = "daemon")]
#[doc(hidden)]
pub mod command;
#[doc(hidden)]
pub mod config;
#[cfg(feature = "daemon")]
#[doc(hidden)]
pub mod service;
#[doc(hidden)]
pub mod site;

pub use config::{Config, ConfigError, RodConfig, Setting};
pub use recording::import::How;
pub use site::prepared::{Plans, plans};
pub use site::records::{Others, Records};
