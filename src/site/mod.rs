//! A site: its prepared configuration, the analysis of each record, the trackers of its rods, the store they commit to.
//!
//! * [`prepared`]       a configuration with the plans of its rods
//! * [`records`]        records of files, in the order in which a replay takes them
//! * [`analyse`]        one record through its rod's plan, the same for `replay` and daemon
//! * [`driver`]         jobs of a source through analysis and into the order of event time
//! * [`ordered_map`]    reading and computing at once, results in order
//! * [`reanalysis`]     records analysed again from a store, without samples
//! * [`pictures`]       waveforms and spectra of a store's pictures
//! * [`resumption`]     a rod's tracker from its state in the store
//! * [`trackers`]       the trackers of a site's rods, folded in the order of event time
//! * [`store`]          what is remembered: SQLite, one transaction per record
//! * [`found`]          what a record's samples showed, kept for an analysis without them
//! * [`fleet`]          many sites as a job array
//! * [`record_row`]     a record's result: one row of the store, one JSON line
//! * [`emulator_cache`] fitted emulators on disk
//! * [`hex`]            bytes as hexadecimal digits
//! * [`text`]           text of unknown origin, fit for a line
//! * [`motion`]         one row of a motion of several sensors
//! * [`overlap`]        records of two sources under one topic
//! * [`clock`]          the time people's requests carry

pub mod analyse;
#[cfg(feature = "daemon")]
pub mod baselines;
#[cfg(feature = "daemon")]
pub mod clock;
#[cfg(feature = "daemon")]
pub mod driver;
pub mod emulator_cache;
#[cfg(feature = "daemon")]
pub mod fleet;
#[cfg(feature = "daemon")]
pub mod found;
pub mod hex;
#[cfg(feature = "daemon")]
pub mod motion;
pub mod ordered_map;
#[cfg(feature = "daemon")]
pub mod overlap;
#[cfg(feature = "daemon")]
pub mod pictures;
pub mod prepared;
#[cfg(feature = "daemon")]
pub mod reanalysis;
pub mod record_row;
pub mod records;
#[cfg(feature = "daemon")]
pub mod resumption;
#[cfg(feature = "daemon")]
pub mod store;
pub mod text;
#[cfg(feature = "daemon")]
pub mod trackers;
