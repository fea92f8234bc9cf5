//! Recordings out: MCAP files.
