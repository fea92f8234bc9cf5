//! Displacement histories of a simulated rod: the truth, the response, the faults.
