//! The `tirante` program: dispatch, logging, exit codes.

fn main() {}
