//! From samples to modes: records, spectra, natural frequencies with their orders and standard errors.

pub mod array;
pub mod modes;
pub mod record;
pub mod spectrum;
