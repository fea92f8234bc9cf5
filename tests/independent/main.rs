//! Truth from generators that share nothing with the program, and coverage of the whole program.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod end_to_end;
mod worlds;
mod years;
