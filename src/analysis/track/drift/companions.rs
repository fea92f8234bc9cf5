//! The other rods' median, kept steady while some of them are not measured, drift, or come back.
//!
//! Rods differ in how they follow the temperature, so that the median of those measured jumps by per cents when one is missing on
//! a warm day. A missing rod is therefore continued with the median step of the others,
//!
//! ```text
//! y_j(t) = y_j(t') + median over the rods measured now of (y_i(t) - y_i(t'))
//! ```
//!
//! and so is a rod that drifts, from [`PATIENCE`] periods before it was told: what it moved the median by is taken back. A rod that
//! comes, or comes back after more than [`PATIENCE`] periods or after a drift, has an offset with which the median does not jump.

use super::regressors::median;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};

/// Periods for which a rod that is not measured bears witness.
pub const PATIENCE: u32 = 10;
/// Fewest other rods that give a median.
pub const FEWEST: usize = 2;

/// A rod's companions.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Companions {
    rods: BTreeMap<String, Companion>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Companion {
    /// Share in the median: its ratio and an offset, or the continuation.
    level: f64,
    offset: f64,
    /// Number of periods since it was measured.
    missing: u32,
    drifts: bool,
    /// Levels of the last periods, oldest first.
    before: VecDeque<f64>,
}

impl Companion {
    fn bears_witness(&self) -> bool {
        !self.drifts && self.missing <= PATIENCE
    }
}

/// Another rod in one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InPeriod<'a> {
    /// The rod's name.
    pub rod: &'a str,
    /// N_t / N_0 - 1, if it was measured.
    pub ratio: Option<f64>,
    /// True if it is told to drift.
    pub drifts: bool,
}

/// Companions in one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Median {
    /// Median of their levels, if at least two bear witness and one of them was measured.
    pub ratio: Option<f64>,
    /// True if fewer than two bear witness.
    pub has_few: bool,
}

impl Companions {
    /// Takes a period with every companion; one that is not listed is forgotten.
    pub fn take<'a>(&mut self, rods: impl IntoIterator<Item = InPeriod<'a>>) -> Median {
        let listed: BTreeMap<&str, InPeriod> = rods.into_iter().map(|one| (one.rod, one)).collect();
        let measured = |one: &InPeriod| one.ratio.filter(|ratio| ratio.is_finite() && !one.drifts);
        let steps = listed.values().filter_map(|one| {
            let known = self.rods.get(one.rod).filter(|known| known.bears_witness())?;
            Some(measured(one)? + known.offset - known.level)
        });
        let step = median(steps).unwrap_or(0.0);
        self.rods.retain(|rod, _| listed.contains_key(rod.as_str()));
        for known in self.rods.values_mut() {
            if known.before.len() == PATIENCE as usize {
                known.before.pop_front();
            }
            known.before.push_back(known.level);
            known.level += step;
            known.missing = known.missing.saturating_add(1);
        }
        let now = self
            .witnesses()
            .count()
            .ge(&FEWEST)
            .then(|| self.median())
            .flatten();
        for one in listed.values() {
            let Some(ratio) = measured(one) else { continue };
            match self.rods.get_mut(one.rod) {
                Some(known) => {
                    if known.bears_witness() {
                        known.level = ratio + known.offset;
                    } else {
                        known.offset = known.level - ratio;
                    }
                    (known.missing, known.drifts) = (0, false);
                }
                None => {
                    let level = now.unwrap_or(ratio);
                    let offset = level - ratio;
                    let (missing, drifts, before) = (0, false, VecDeque::new());
                    let fresh = Companion {
                        level,
                        offset,
                        missing,
                        drifts,
                        before,
                    };
                    self.rods.insert(one.rod.to_owned(), fresh);
                }
            }
        }
        for one in listed.values().filter(|one| one.drifts) {
            self.take_back(one.rod);
        }
        let is_fresh = listed.values().any(|one| measured(one).is_some());
        let has_few = self.witnesses().count() < FEWEST;
        Median {
            ratio: self.median().filter(|_| is_fresh && !has_few),
            has_few,
        }
    }

    /// Continues a rod that drifts from the oldest level known of it.
    fn take_back(&mut self, rod: &str) {
        let Some(lost) = self.rods.get(rod).filter(|known| !known.drifts) else {
            return;
        };
        let periods = lost.before.len();
        let since = |known: &Companion| {
            let first = known.before.len().checked_sub(periods)?;
            Some(known.level - known.before.get(first)?)
        };
        let others = self
            .rods
            .iter()
            .filter(|(name, known)| *name != rod && known.bears_witness());
        let moved = median(others.filter_map(|(_, known)| since(known)));
        let level = lost.before.front().zip(moved).map(|(first, moved)| first + moved);
        if let Some(lost) = self.rods.get_mut(rod) {
            lost.level = level.unwrap_or(lost.level);
            lost.drifts = true;
        }
    }

    fn witnesses(&self) -> impl Iterator<Item = &Companion> {
        self.rods.values().filter(|known| known.bears_witness())
    }

    fn median(&self) -> Option<f64> {
        median(self.rods.values().map(|known| known.level))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(rod: &'static str, ratio: Option<f64>) -> InPeriod<'static> {
        InPeriod {
            rod,
            ratio,
            drifts: false,
        }
    }

    fn near(found: Median, expected: f64) {
        assert!(
            (found.ratio.unwrap() - expected).abs() < 1e-12,
            "{found:?} {expected}"
        );
    }

    #[test]
    fn a_missing_rod_is_continued_with_the_others() {
        let mut companions = Companions::default();
        near(companions.take([at("a", Some(0.01)), at("b", Some(0.05))]), 0.03);
        // One that comes later does not move the median.
        near(
            companions.take([at("a", Some(0.01)), at("b", Some(0.05)), at("c", Some(0.4))]),
            0.03,
        );
        // b is missing while all grow by 0.02.
        near(
            companions.take([at("a", Some(0.03)), at("b", None), at("c", Some(0.42))]),
            0.05,
        );
        near(
            companions.take([at("a", None), at("b", None), at("c", Some(0.43))]),
            0.06,
        );
        near(
            companions.take([at("a", Some(0.04)), at("b", Some(0.08)), at("c", Some(0.43))]),
            0.06,
        );
        assert_eq!(
            companions
                .take([at("a", None), at("b", None), at("c", None)])
                .ratio,
            None
        );
    }

    #[test]
    fn a_rod_that_stays_away_bears_no_witness_and_comes_back_without_a_jump() {
        let mut companions = Companions::default();
        let three = |b: Option<f64>| [at("a", Some(0.01)), at("b", b), at("c", Some(0.09))];
        near(companions.take(three(Some(0.02))), 0.02);
        for _ in 0..=PATIENCE {
            near(companions.take(three(None)), 0.02);
        }
        // A new baseline: the same rod reads another ratio.
        near(companions.take(three(Some(-0.3))), 0.02);
        near(companions.take(three(Some(-0.29))), 0.03);
        let mut two = Companions::default();
        near(two.take([at("a", Some(0.01)), at("b", Some(0.03))]), 0.02);
        for _ in 0..PATIENCE {
            assert!(!two.take([at("a", Some(0.01)), at("b", None)]).has_few);
        }
        let alone = two.take([at("a", Some(0.01)), at("b", None)]);
        assert!(alone.has_few && alone.ratio.is_none());
        let alone = two.take([at("a", Some(0.01)), at("b", Some(f64::NAN))]);
        assert!(alone.has_few && alone.ratio.is_none());
    }

    #[test]
    fn what_a_drift_moved_the_median_by_is_taken_back() {
        let mut companions = Companions::default();
        let period = |day: u32, loss: f64, drifts: bool| {
            let weather = 0.01 * f64::from(day).sin();
            let c = InPeriod {
                rod: "c",
                ratio: Some(weather - loss),
                drifts,
            };
            [at("a", Some(weather - 0.02)), at("b", Some(weather + 0.02)), c]
        };
        for day in 0..20 {
            near(
                companions.take(period(day, 0.0, false)),
                0.01 * f64::from(day).sin(),
            );
        }
        for day in 20..23 {
            let found = companions.take(period(day, 0.5, false)).ratio.unwrap();
            assert!(
                (found - (0.01 * f64::from(day).sin() - 0.02)).abs() < 1e-12,
                "{found}"
            );
        }
        for day in 23..60 {
            near(
                companions.take(period(day, 0.5, true)),
                0.01 * f64::from(day).sin(),
            );
        }
        // Somebody accepted it: it bears witness again, and nothing jumps.
        for day in 60..70 {
            near(
                companions.take(period(day, 0.5, false)),
                0.01 * f64::from(day).sin(),
            );
        }
    }
}
