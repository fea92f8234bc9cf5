//! A site: its prepared configuration, the analysis of each record, the trackers of its rods, the store they commit to.
//!
//! * [`prepared`]       a configuration with the plans of its rods
//! * [`analyse`]        one record through its rod's plan, the same for `replay` and daemon
//! * [`driver`]         jobs of a source through analysis and into the order of event time
//! * [`ordered_map`]    reading and computing at once, results in order
//! * [`reanalysis`]     records analysed again from a store, without samples
//! * [`pictures`]       waveforms and spectra of a store's pictures
//! * [`trackers`]       the trackers of a site's rods, folded in the order of event time
//! * [`store`]          what is remembered: SQLite, one transaction per record
//! * [`found`]          what a record's samples showed, kept for an analysis without them
//! * [`fleet`]          many sites as a job array
//! * [`record_row`]     a record's result: one row of the store, one JSON line
//! * [`emulator_cache`] fitted emulators on disk
//! * [`hex`]            bytes as hexadecimal digits
//! * [`clock`]          the time people's requests carry

pub mod analyse;
pub mod baselines;
pub mod clock;
pub mod driver;
pub mod emulator_cache;
pub mod fleet;
pub mod found;
pub mod hex;
pub mod ordered_map;
pub mod pictures;
pub mod prepared;
pub mod reanalysis;
pub mod record_row;
pub mod store;
pub mod trackers;
