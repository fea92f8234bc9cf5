//! Spells of larger noise: storms, works and crowds beside a rod make the readings of some days worse than those of others.
//!
//! Each period is calm or rough. A spell goes on for 3 d in the mean; at which rate r spells begin, the rod's own periods teach, among three
//! rates beforehand. With p(r, .) the joint law of rate and period,
//!
//! ```text
//! p(r, rough) <- e^(-gap / 3 d) p(r, rough) + r ((1 - e^(-gap / 3 d)) p(r, rough) + p(r, calm))
//! ```
//!
//! and then Bayes' rule by the densities of the reading. A rough reading has Student's t law with three degrees of freedom about the
//! prediction, its noise R fourteen times as large: for noise of two to eight times the usual standard deviation.

use super::block::{LANES, Lanes};
use serde::{Deserialize, Serialize};

/// Time a spell goes on \[d\].
const LASTS_D: f64 = 3.0;
/// Rates at which spells begin, per calm period: never, a few times a year, two or three times a month.
const RATES: [f64; 3] = [0.0, 0.01, 0.1];
/// Their probabilities beforehand.
pub(super) const PRIOR: [f64; 3] = [0.82, 0.1, 0.08];
/// Half the degrees of freedom of the noise beyond which periods may be rough: from the fourth on, when something is known of the usual.
const LEARNED: f64 = 3.0;
/// Square of the scale of rough readings' noise, in usual ones, and degrees of freedom of their law.
pub(super) const ROUGHER: f64 = 14.0;
pub(super) const FREEDOM: f64 = 3.0;

/// Probability that a spell goes on after a gap \[d\].
pub(super) fn goes_on(gap_d: f64) -> f64 {
    libm::exp(-gap_d / LASTS_D)
}

/// Joint law of rate and last period as one member of a bank knows it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Spell {
    calm: [f64; 3],
    rough: [f64; 3],
}

impl Spell {
    /// The law before the first period, by the probabilities of the rates.
    pub fn new(rates: [f64; 3]) -> Self {
        Self {
            calm: rates,
            rough: [0.0; 3],
        }
    }
}

/// The same of members side by side.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spells {
    calm: [Lanes; 3],
    rough: [Lanes; 3],
}

impl Spells {
    pub fn new(of: [Spell; LANES]) -> Self {
        Self {
            calm: std::array::from_fn(|rate| of.map(|spell| spell.calm[rate])),
            rough: std::array::from_fn(|rate| of.map(|spell| spell.rough[rate])),
        }
    }

    pub fn of(&self, lane: usize) -> Spell {
        Spell {
            calm: self.calm.map(|lanes| lanes[lane]),
            rough: self.rough.map(|lanes| lanes[lane]),
        }
    }

    /// Passes from one period to the next; `shape`: half the noise's degrees of freedom.
    #[inline(always)]
    pub fn advance(&mut self, goes_on: f64, shape: &Lanes) {
        for (rate, (calm, rough)) in RATES.into_iter().zip(self.calm.iter_mut().zip(&mut self.rough)) {
            for l in 0..LANES {
                let rate = if shape[l] > LEARNED { rate } else { 0.0 };
                let both = calm[l] + rough[l];
                let stays = goes_on * rough[l];
                rough[l] = stays + rate * (both - stays);
                calm[l] = both - rough[l];
            }
        }
    }

    /// Probability that a period is rough.
    #[inline(always)]
    pub fn rough(&self) -> Lanes {
        let [one, two, three] = &self.rough;
        std::array::from_fn(|l| one[l] + two[l] + three[l])
    }

    /// Takes the densities of a reading, if it is calm or rough.
    #[inline(always)]
    pub fn learn(&mut self, lane: usize, [if_calm, if_rough]: [f64; 2]) {
        let mut total = 0.0;
        for (calm, rough) in self.calm.iter_mut().zip(&mut self.rough) {
            calm[lane] *= if_calm;
            rough[lane] *= if_rough;
            total += calm[lane] + rough[lane];
        }
        for lanes in self.calm.iter_mut().chain(&mut self.rough) {
            lanes[lane] /= total;
        }
    }

    /// Variances of a period's noise, in usual ones.
    #[inline(always)]
    pub fn noise(&self) -> Lanes {
        const VARIANCE: f64 = ROUGHER * FREEDOM / (FREEDOM - 2.0);
        self.rough().map(|rough| 1.0 + rough * (VARIANCE - 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every sequence of calm and rough periods at every rate, added up.
    #[test]
    fn the_recursion_is_that_of_all_sequences() {
        let (gaps_d, periods) = ([1.0, 1.0, 2.5, 0.5, 1.0, 4.0], 6);
        let densities = [
            [1.0, 0.3],
            [0.02, 0.4],
            [0.1, 0.3],
            [0.9, 0.3],
            [0.05, 0.5],
            [0.7, 0.2],
        ];
        let mut spells = Spells::new([Spell::new(PRIOR); LANES]);
        for (gap_d, densities) in gaps_d.into_iter().zip(densities) {
            spells.advance(goes_on(gap_d), &[LEARNED + 0.5; LANES]);
            (0..LANES).for_each(|lane| spells.learn(lane, densities));
        }
        let (mut all, mut ends_rough, mut of_rates) = (0.0, 0.0, [0.0; 3]);
        for (at, (rate, prior)) in RATES.into_iter().zip(PRIOR).enumerate() {
            for sequence in 0..1_u32 << periods {
                let (mut weight, mut was_rough) = (prior, false);
                for (period, gap_d) in gaps_d.iter().enumerate() {
                    let is_rough = sequence >> period & 1 == 1;
                    // A spell that ends may be followed by another at once.
                    let stays = if was_rough { (-gap_d / 3.0_f64).exp() } else { 0.0 };
                    let rough = stays + (1.0 - stays) * rate;
                    weight *= if is_rough { rough } else { 1.0 - rough };
                    weight *= densities[period][usize::from(is_rough)];
                    was_rough = is_rough;
                }
                all += weight;
                ends_rough += if was_rough { weight } else { 0.0 };
                of_rates[at] += weight;
            }
        }
        for lane in 0..LANES {
            let found = spells.rough()[lane];
            assert!(
                (found - ends_rough / all).abs() < 1e-12,
                "{found} {}",
                ends_rough / all
            );
            for (at, of_rate) in of_rates.into_iter().enumerate() {
                let found = spells.calm[at][lane] + spells.rough[at][lane];
                assert!(
                    (found - of_rate / all).abs() < 1e-12,
                    "{at}: {found} {}",
                    of_rate / all
                );
            }
        }
    }

    #[test]
    fn nothing_is_rough_before_the_noise_is_known() {
        let mut spells = Spells::new([Spell::new(PRIOR); LANES]);
        spells.advance(goes_on(1.0), &[LEARNED; LANES]);
        assert_eq!((spells.rough(), spells.noise()), ([0.0; LANES], [1.0; LANES]));
    }
}
