//! A site: its prepared configuration, the analysis of each record, the trackers of its rods, the store they commit to.
//!
//! * [`prepared`]       a configuration with the plans of its rods
//! * [`analyse`]        one record through its rod's plan, the same for `replay` and daemon
//! * [`ordered_map`]    reading and computing at once, results in order
//! * [`trackers`]       the trackers of a site's rods, folded in the order of event time
//! * [`store`]          what is remembered: SQLite, one transaction per record
//! * [`record_json`]    a record as one JSON line
//! * [`emulator_cache`] fitted emulators on disk
//! * [`clock`]          the time people's requests carry

pub mod analyse;
pub mod baselines;
pub mod clock;
pub mod emulator_cache;
pub mod ordered_map;
pub mod prepared;
pub mod record_json;
pub mod store;
pub mod trackers;
