//! What a daemon says of itself while it runs: faults that happened, conditions that last, counts.

pub mod fault;
pub mod health;

pub use fault::Fault;
pub use health::{Condition, Health};
