//! Predictive densities of a member at a reading: as usual, wild, after a jump of its fluctuation.

use super::member::Ahead;
use std::f64::consts::PI;

/// Probability of a wild reading, its spread \[-\], the widening of the rest, and its degrees of freedom.
pub(super) const WILD: f64 = 0.01;
pub(super) const WILD_SD: f64 = 0.06;
pub(super) const WILD_WIDER: f64 = 9.0;
pub(super) const WILD_SHAPE: f64 = 1.5;
/// Growth of the fluctuation's variance in a jump, in the variance a period adds.
pub(super) const KICK: f64 = 24.0;

/// Term of the predictive law by which a reading was learned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Term {
    Usual,
    Wild,
    Kick,
}

/// The three predictive densities of a member at a reading.
pub(super) struct Densities {
    pub usual: f64,
    pub wild: f64,
    pub kick: f64,
}

impl Densities {
    /// Student's t densities with 2 `shape` degrees of freedom, that of a wild reading with three; `gammas` as [`Gammas::ratio`].
    #[inline(always)]
    pub fn new(ahead: &Ahead, kicked: f64, scale2: f64, shape: f64, gammas: f64) -> Self {
        let (square, dof, total) = (ahead.error * ahead.error, 2.0 * shape, ahead.total * scale2);
        let student = |spread: f64| {
            let fall = -(shape + 0.5) * libm::log1p(square / spread);
            gammas / (PI * spread).sqrt() * libm::exp(fall)
        };
        let usual = student(dof * total);
        let kick = if kicked > 0.0 {
            student(dof * (total + kicked * scale2))
        } else {
            usual
        };
        let spread2 = 3.0 * (WILD_SD * WILD_SD + WILD_WIDER * total);
        let beyond = 1.0 + square / spread2;
        Self {
            usual,
            wild: 2.0 / (PI * spread2.sqrt() * beyond * beyond),
            kick,
        }
    }
}

/// Cache of a ratio of gamma functions: most members share a shape.
#[derive(Default)]
pub(super) struct Gammas {
    shape: f64,
    value: f64,
}

impl Gammas {
    /// Gamma(shape + 1/2) / Gamma(shape).
    pub fn ratio(&mut self, shape: f64) -> f64 {
        if self.shape != shape {
            let value = libm::exp(libm::lgamma(shape + 0.5) - libm::lgamma(shape));
            *self = Self { shape, value };
        }
        self.value
    }
}
