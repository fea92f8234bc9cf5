//! One file per subcommand, each with one `run`.

pub mod check;
pub mod emulator;
pub mod frequencies;
pub mod simulate;
