//! The run-length distribution of both charts together, for any path of the residuals' mean.

use super::chart::Design;

/// P(no alarm up to and including period t), t = 1.., of both charts, both sides, from zero, when r_t ~
/// N(`mean(t)`, `sd(t)`^2) independently.
pub fn survival(
    _design: &Design,
    _periods: usize,
    _mean: impl Fn(usize) -> f64,
    _sd: impl Fn(usize) -> f64,
) -> Vec<f64> {
    todo!()
}
