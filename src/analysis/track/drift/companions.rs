//! The other rods' median, kept steady while some of them are not measured.
//!
//! Rods differ in how they follow the temperature, so that the median of those measured jumps by per cents when one is missing on
//! a warm day. A missing rod is therefore continued with the median step of the others,
//!
//! ```text
//! y_j(t) = y_j(t') + median over the rods measured now of (y_i(t) - y_i(t'))
//! ```
//!
//! for [`PATIENCE`] periods at most.

use super::regressors::median;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Periods for which a rod that is not measured is continued.
pub const PATIENCE: u32 = 10;
/// Fewest other rods that give a median.
pub const FEWEST: usize = 2;

/// Last ratios of a rod's companions.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Companions {
    rods: BTreeMap<String, Last>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Last {
    ratio: f64,
    /// Number of periods since it was measured.
    missing: u32,
}

/// Companions in one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Median {
    /// Median of their ratios, if at least two companions are known and one of them was measured.
    pub ratio: Option<f64>,
    /// True if a rod that counted until now is found to drift: what was learned beside the median is void.
    pub has_lost_one: bool,
}

impl Companions {
    /// Takes a period: every companion by name, with its ratio if it was measured. A companion that is not listed, because it
    /// drifts or is gone, is forgotten.
    pub fn take<'a>(&mut self, rods: impl IntoIterator<Item = (&'a str, Option<f64>)>) -> Median {
        let listed: BTreeMap<&str, Option<f64>> = rods
            .into_iter()
            .map(|(rod, ratio)| (rod, ratio.filter(|ratio| ratio.is_finite())))
            .collect();
        let steps = listed
            .iter()
            .filter_map(|(rod, ratio)| Some((*ratio)? - self.rods.get(*rod)?.ratio));
        let step = median(steps);
        let has_lost_one = self.rods.keys().any(|rod| !listed.contains_key(rod.as_str()));
        self.rods.retain(|rod, last| {
            last.missing += 1;
            listed.contains_key(rod.as_str()) && last.missing <= PATIENCE
        });
        if let Some(step) = step {
            self.rods.values_mut().for_each(|last| last.ratio += step);
        }
        for (rod, ratio) in &listed {
            if let Some(ratio) = *ratio {
                self.rods.insert((*rod).to_owned(), Last { ratio, missing: 0 });
            }
        }
        let is_fresh = listed.values().any(Option::is_some);
        let ratio = median(self.rods.values().map(|last| last.ratio));
        Median {
            ratio: ratio.filter(|_| is_fresh && self.rods.len() >= FEWEST),
            has_lost_one,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_rod_goes_on_with_the_others() {
        let mut companions = Companions::default();
        let near = |found: Median, expected: f64| {
            assert!((found.ratio.unwrap() - expected).abs() < 1e-15, "{found:?}");
            assert!(!found.has_lost_one);
        };
        near(
            companions.take([("a", Some(0.01)), ("b", Some(0.05)), ("c", Some(0.09))]),
            0.05,
        );
        // b is missing while all grow by 0.02: the median of a and c alone would be right, that of c alone not.
        near(
            companions.take([("a", Some(0.03)), ("b", None), ("c", Some(0.11))]),
            0.07,
        );
        near(
            companions.take([("a", None), ("b", None), ("c", Some(0.12))]),
            0.08,
        );
        near(
            companions.take([("a", Some(0.05)), ("b", Some(0.02)), ("c", Some(0.12))]),
            0.05,
        );
        assert_eq!(
            companions.take([("a", None), ("b", None), ("c", None)]).ratio,
            None
        );
    }

    #[test]
    fn rods_that_drift_or_stay_away_are_forgotten() {
        let mut companions = Companions::default();
        companions.take([("a", Some(0.01)), ("b", Some(0.05)), ("c", Some(0.09))]);
        // c drifts: it is not listed any more.
        let of_two = companions.take([("a", Some(0.01)), ("b", Some(0.05))]);
        assert!((of_two.ratio.unwrap() - 0.03).abs() < 1e-15 && of_two.has_lost_one);
        for _ in 0..PATIENCE {
            let found = companions.take([("a", Some(0.01)), ("b", None)]);
            assert!(found.ratio.is_some() && !found.has_lost_one);
        }
        // One rod alone is no witness.
        let of_one = companions.take([("a", Some(0.01)), ("b", None)]);
        assert!(of_one.ratio.is_none() && !of_one.has_lost_one);
        assert_eq!(
            companions.take([("a", Some(0.01)), ("b", Some(f64::NAN))]).ratio,
            None
        );
        assert_eq!(Companions::default().take([("a", Some(0.01))]).ratio, None);
    }
}
