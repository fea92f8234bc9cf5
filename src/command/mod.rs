//! One file per subcommand, each with one `run`.

pub mod emulator;
pub mod frequencies;
