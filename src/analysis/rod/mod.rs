//! A rod as a tensioned beam: its natural frequencies, emulators that stand in for them, priors of its parameters.

pub mod beam;
pub mod emulator;
pub mod fixity;
pub mod prior;
pub mod query;
