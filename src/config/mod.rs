//! The TOML configuration: every fault reported at once, with its key and line.
