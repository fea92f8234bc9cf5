//! Gain of a rod on the median of its site: its part in what all rods follow.

use super::regressors;
use serde::{Deserialize, Serialize};

/// Fewest periods from which a gain is taken; one before.
const FEWEST_PERIODS: f64 = 30.0;
/// Squares of the median that weigh as much as the gain of one expected beforehand: a residual of 0.5 % over 0.5 times the median.
const RIDGE: f64 = 1e-4;
/// Largest credible gain: of a rod that its walls hold beside ones that are nearly free.
const GREATEST: f64 = 5.0;
/// Least gain by which a rod says what the median is.
const LEAST: f64 = 0.1;

/// Regression of a rod's level on the median, with an intercept.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Gain {
    periods: f64,
    median: f64,
    level: f64,
    squares: f64,
    products: f64,
}

impl Gain {
    /// Takes a period in which the rod was measured.
    pub fn learn(&mut self, median: f64, level: f64) {
        self.periods += 1.0;
        let off = median - self.median;
        self.median += off / self.periods;
        self.level += (level - self.level) / self.periods;
        self.squares += off * (median - self.median);
        self.products += off * (level - self.level);
    }

    /// The median by this rod's level alone; `None` before its gain is learned, or where it follows the median by less than a tenth.
    pub fn implied(&self, level: f64) -> Option<f64> {
        let gain = Some(self.value()).filter(|gain| self.is_learned() && *gain > LEAST)?;
        Some(self.median + (level - self.level) / gain)
    }

    fn is_learned(&self) -> bool {
        self.periods >= FEWEST_PERIODS
    }

    /// Change of the rod's level by one of the median.
    pub fn value(&self) -> f64 {
        let gain = (self.products + RIDGE) / (self.squares + RIDGE);
        if self.is_learned() && gain.is_finite() {
            gain.clamp(0.0, GREATEST)
        } else {
            1.0
        }
    }
}

/// The two in the middle, the same one twice among an odd number; `None` with fewer than two.
pub(super) fn middle(mut values: Vec<f64>) -> Option<[f64; 2]> {
    values.sort_by(f64::total_cmp);
    let count = values.len();
    (count >= 2).then(|| [values[(count - 1) / 2], values[count / 2]])
}

/// Step D of the median by steps d of rods with gains g: the least sum of |d - g D|, a median of d / g weighed by g. Where gains are
/// learned, a rod of which it is not does not count. `None` without any that is finite.
pub(super) fn common_step(steps: impl Iterator<Item = (f64, Gain)>) -> Option<f64> {
    let steps: Vec<(f64, Gain)> = steps.collect();
    let are_learned = steps.iter().any(|(_, gain)| gain.is_learned());
    let mut scaled: Vec<(f64, f64)> = steps
        .iter()
        .filter(|(_, gain)| gain.is_learned() || !are_learned)
        .map(|(step, gain)| (step / gain.value(), gain.value()))
        .filter(|(step, _)| step.is_finite())
        .collect();
    scaled.sort_by(|one, other| one.0.total_cmp(&other.0));
    let half = 0.5 * scaled.iter().map(|one| one.1).sum::<f64>();
    let mut below = 0.0;
    for (at, (step, weight)) in scaled.iter().enumerate() {
        below += weight;
        if below > half {
            return Some(*step);
        }
        if below == half {
            let next = scaled.get(at + 1).map_or(*step, |next| next.0);
            return regressors::median([*step, next].into_iter());
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gain_is_one_until_it_is_learned() {
        let mut gain = Gain::default();
        for day in 0..60 {
            if day < 30 {
                assert_eq!(gain.value(), 1.0);
            }
            let median = 0.03 * (f64::from(day) / 7.0).sin();
            gain.learn(median, 0.02 + 1.6 * median);
        }
        // The ridge is 0.4 % of the squares.
        assert!((gain.value() - 1.6).abs() < 0.005, "{}", gain.value());
        // Where nothing moves, it stays near one.
        let mut still = Gain::default();
        for day in 0..60 {
            still.learn(0.0, if day % 2 == 0 { 1e-3 } else { -1e-3 });
        }
        assert_eq!(still.value(), 1.0);
        still.learn(f64::MAX, f64::MAX);
        assert_eq!(still.value(), 1.0);
    }

    /// A gain learned from 60 periods.
    fn learned(value: f64) -> Gain {
        let mut gain = Gain::default();
        (0..60).for_each(|day| {
            let median = (f64::from(day) / 7.0).sin();
            gain.learn(median, value * median);
        });
        gain
    }

    #[test]
    fn one_rod_that_jumps_is_no_common_step() {
        let step = |steps: &[(f64, Gain)]| common_step(steps.iter().copied());
        // The ridge is 4e-6 of the squares.
        let near = |found: Option<f64>, wanted: f64| (found.unwrap() - wanted).abs() < 1e-6;
        let [half, one, more] = [0.5, 1.0, 1.6].map(learned);
        assert!(near(step(&[(0.005, half), (0.01, one), (0.016, more)]), 0.01));
        assert!(near(step(&[(-0.3, half), (0.01, one), (0.016, more)]), 0.01));
        assert!(near(step(&[(0.01, one), (0.5, learned(-1.0))]), 0.01));
        // One that came of late counts only where all did.
        let fresh = Gain::default();
        assert!(near(step(&[(0.005, half), (0.03, fresh)]), 0.01));
        assert!(near(step(&[(0.01, fresh), (0.03, fresh)]), 0.02));
        assert_eq!(step(&[]), None);
        assert_eq!(step(&[(f64::NAN, one), (0.0, learned(-1.0))]), None);
    }
}
