//! Predictive densities of a member at a reading: as usual, wild, after a jump of its fluctuation, in a spell of larger noise.

use super::block::{LANES, Lanes};
use super::spells::{FREEDOM, ROUGHER};
use crate::numerics::exp::{exp, ln_1p};
use std::f64::consts::PI;

/// Probability of a wild reading, its spread \[-\], the widening of the rest, and its degrees of freedom.
pub(super) const WILD: f64 = 0.01;
pub(super) const WILD_SD: f64 = 0.06;
pub(super) const WILD_WIDER: f64 = 9.0;
pub(super) const WILD_SHAPE: f64 = 1.5;
/// Growth of the fluctuation's variance in a jump, in the variance a period adds.
pub(super) const KICK: f64 = 24.0;

/// Squared scales of the four laws of a reading, times their degrees of freedom; of members side by side.
pub(super) struct Spreads {
    usual: Lanes,
    kick: Lanes,
    wild: Lanes,
    rough: Lanes,
}

impl Spreads {
    /// Of Student's laws with 2 `shape` degrees of freedom, those of wild and rough readings with three; `own` is the variance of the reading's
    /// usual noise, `kicked` that which a jump adds.
    #[inline(always)]
    pub fn new(total: &Lanes, own: f64, kicked: &Lanes, scale2: &Lanes, shape: &Lanes) -> Self {
        let of = |total: f64, l: usize| 2.0 * shape[l] * total * scale2[l];
        Self {
            usual: std::array::from_fn(|l| of(total[l], l)),
            // The same where a jump adds nothing.
            kick: std::array::from_fn(|l| of(total[l] + kicked[l], l)),
            wild: std::array::from_fn(|l| 3.0 * (WILD_SD * WILD_SD + WILD_WIDER * total[l] * scale2[l])),
            rough: std::array::from_fn(|l| FREEDOM * rougher(total[l], own) * scale2[l]),
        }
    }

    /// z of the usual law and of that after a jump, whose densities go with (1 + z)^-(`shape` + 1/2).
    #[inline(always)]
    pub fn offs(&self, error: &Lanes) -> [Lanes; 2] {
        [&self.usual, &self.kick].map(|spread| std::array::from_fn(|l| error[l] * error[l] / spread[l]))
    }

    /// Densities of the usual, the wild, the kicked and the rough law; `powers` as [`Spreads::offs`] says, `gammas` as [`Gammas::ratio`].
    #[inline(always)]
    pub fn densities(&self, error: &Lanes, powers: &[Lanes; 2], gammas: &Lanes) -> [Lanes; 4] {
        let student = |spread: &Lanes, power: &Lanes| -> Lanes {
            std::array::from_fn(|l| gammas[l] / (PI * spread[l]).sqrt() * power[l])
        };
        let of_three = |spread: &Lanes| -> Lanes {
            std::array::from_fn(|l| {
                let beyond = 1.0 + error[l] * error[l] / spread[l];
                2.0 / (PI * spread[l].sqrt() * beyond * beyond)
            })
        };
        [
            student(&self.usual, &powers[0]),
            of_three(&self.wild),
            student(&self.kick, &powers[1]),
            of_three(&self.rough),
        ]
    }
}

/// Square of the scale of a rough reading, in noise variances: `own` of the usual one is that of its noise.
#[inline(always)]
pub(super) fn rougher(total: f64, own: f64) -> f64 {
    total + (ROUGHER - 1.0) * own
}

/// Puts (1 + z)^-(`shape` + 1/2) in the place of each z.
#[inline(always)]
pub(super) fn raise(offs: &mut [[Lanes; 2]], shapes: impl Iterator<Item = Lanes>) {
    for z in offs.as_flattened_mut().as_flattened_mut() {
        *z = ln_1p(*z);
    }
    for (offs, shape) in offs.iter_mut().zip(shapes) {
        for lanes in offs {
            for l in 0..LANES {
                lanes[l] *= -(shape[l] + 0.5);
            }
        }
    }
    for power in offs.as_flattened_mut().as_flattened_mut() {
        *power = exp(*power);
    }
}

/// Cache of a ratio of gamma functions: most members share a shape.
#[derive(Debug, Default)]
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
