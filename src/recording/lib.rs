//! Recordings: read, write, import.
//!
//! * [`read`]     MCAP files and series of them in: messages decoded, samples cut into records
//! * [`mod@write`] MCAP files out
//! * [`import`]   measurements of other programs in: CSV, UFF58, WAV, MATLAB, LabVIEW, NumPy
//! * `atomic`     files that are whole or not there
//! * [`part`], [`note`] names and notes of the parts that a journal writes and a replay reads

pub mod atomic;
pub mod import;
pub mod note;
pub mod part;
pub mod read;
pub mod write;
