//! Displacement histories of a simulated rod: the truth, the response, the faults.

/// What is simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Simulation {}
