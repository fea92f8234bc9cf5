//! Recordings in: MCAP files, message decoding, samples to records.
