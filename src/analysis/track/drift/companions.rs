//! The other rods' median, kept steady while some of them are not measured, drift, or come back.
//!
//! Rods differ in how they follow the temperature, so that the median of those measured jumps by per cents when one is missing on
//! a warm day. A missing rod is therefore continued with the step D of the others, each by its gain g (`Gain`),
//!
//! ```text
//! y_j(t) = y_j(t') + g_j D,    D the weighed median over the rods measured now of (y_i(t) - y_i(t')) / g_i
//! ```
//!
//! whether its sensor died or it was taken out of the configuration. After more than [`PATIENCE`] periods it bears no witness any more.
//! A rod that comes later than `SETTLED` periods after the first median is left out as long as two others bear witness: the median
//! would follow the temperature otherwise from then on than the one the rods have been compared with.
//!
//! A rod that is told to drift keeps its part: only what it moved by beside the other rods is taken off, as far as that is certain
//! ([`InPeriod::drift`]). Left out for months, it would leave a median that follows the temperature otherwise than the one the rods
//! have been compared with, and they would seem to drift one after the other. What was taken off stays off when its alarm ends. A
//! rod that comes, or comes back after more than [`PATIENCE`] periods, has an offset with which the median does not jump.
//!
//! Between its first changed record and the day when its change is certain, what to take off is not known: the others would see the rest
//! as changes of their own. A rod in doubt is continued like a missing one, from the level before the last `FORGOTTEN` periods, which hold
//! the change already.

use super::gain::{Gain, common_step, middle};
use super::regressors::median;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};

/// Periods for which a rod that is not measured bears witness.
pub const PATIENCE: u32 = 10;
/// Fewest other rods that give a median.
pub const FEWEST: usize = 2;
/// Periods before a doubt that are left out with it: a change is told with its second or third record.
pub const FORGOTTEN: usize = 2;
/// Number of periods with a median after which no rod joins those in it.
const SETTLED: u32 = 30;

/// A rod's companions.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Companions {
    rods: BTreeMap<String, Companion>,
    /// Number of periods that had a median.
    periods: u32,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Companion {
    /// Share in the median: its ratio and an offset, less its drift, or the continuation.
    level: f64,
    /// The levels before, the newest first.
    before: VecDeque<f64>,
    is_in_doubt: bool,
    offset: f64,
    /// Number of periods since it was measured.
    missing: u32,
    /// Drift taken off, while it is told to drift.
    drift: Option<f64>,
    gain: Gain,
}

impl Companion {
    fn bears_witness(&self) -> bool {
        self.drift.is_none() && self.missing <= PATIENCE
    }

    /// Its level before the last periods, or the earliest known.
    fn level_before(&self, periods: usize) -> f64 {
        let earlier = self.before.iter().take(periods).next_back();
        *earlier.unwrap_or(&self.level)
    }

    /// Goes on from the level before the last periods with the common step of the others since then.
    fn go_on(&mut self, periods: usize, step: f64) {
        let level = self.level_before(periods) + self.gain.value() * step;
        self.before.push_front(self.level);
        self.before.truncate(FORGOTTEN);
        self.level = level;
        self.missing = self.missing.saturating_add(1);
    }

    /// Takes the drift that the rod is told to have in this period; one that ended stays off.
    fn set_drift(&mut self, drift: Option<f64>) {
        match drift {
            Some(now) if now.is_finite() => self.drift = Some(now),
            Some(_) => self.drift = self.drift.or(Some(0.0)),
            None => {
                if let Some(moved) = self.drift.take() {
                    self.offset -= moved;
                    self.before.clear();
                }
            }
        }
    }
}

/// Another rod in one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InPeriod<'a> {
    /// The rod's name.
    pub rod: &'a str,
    /// N_t / N_0 - 1, if it was measured.
    pub ratio: Option<f64>,
    /// Expected share of it that is a change beside the other rods; `None` if the rod is not told to drift.
    pub drift: Option<f64>,
    /// True if it may hold a change of unknown size: it does not count.
    pub is_in_doubt: bool,
}

/// Companions in one period.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Median {
    /// Median of their levels, if at least two bear witness and one of them was measured.
    pub ratio: Option<f64>,
    /// The same by the levels of the two rods in the middle, each alone: one of them may have moved by itself. `None` with fewer than two
    /// measured of which the gain is learned.
    pub middle: Option<[f64; 2]>,
    /// True if fewer than two bear witness.
    pub has_few: bool,
}

impl Companions {
    /// Takes a period with every companion; one that is not listed any more was not measured.
    pub fn take<'a>(&mut self, rods: impl IntoIterator<Item = InPeriod<'a>>) -> Median {
        let listed: BTreeMap<&str, InPeriod> = rods.into_iter().map(|one| (one.rod, one)).collect();
        for (rod, known) in &mut self.rods {
            known.set_drift(listed.get(rod.as_str()).and_then(|one| one.drift));
        }
        let measured = |one: &InPeriod| (one.ratio).filter(|ratio| ratio.is_finite() && !one.is_in_doubt);
        let step_since = |periods: usize| {
            let steps = listed.values().filter_map(|one| {
                let known = self.rods.get(one.rod).filter(|known| known.bears_witness())?;
                let level = measured(one)? + known.offset;
                Some((level - known.level_before(periods), known.gain))
            });
            common_step(steps).unwrap_or(0.0)
        };
        let (step, longer) = (step_since(0), step_since(FORGOTTEN));
        for (rod, known) in &mut self.rods {
            let is_in_doubt = listed.get(rod.as_str()).is_some_and(|one| one.is_in_doubt);
            if is_in_doubt && !known.is_in_doubt {
                known.go_on(FORGOTTEN, longer);
            } else {
                known.go_on(0, step);
            }
            known.is_in_doubt = is_in_doubt;
        }
        let (is_settled, has_median) = (self.periods >= SETTLED, self.witnesses().count() >= FEWEST);
        let now = self.median().filter(|_| is_settled || has_median);
        for one in listed.values() {
            let Some(ratio) = measured(one) else { continue };
            match self.rods.get_mut(one.rod) {
                Some(known) => {
                    let moved = known.drift.unwrap_or(0.0);
                    if known.missing <= PATIENCE {
                        known.level = ratio + known.offset - moved;
                    } else {
                        known.offset = known.level - ratio + moved;
                    }
                    known.missing = 0;
                }
                None if is_settled && has_median => {}
                None => {
                    let level = now.unwrap_or(ratio);
                    let fresh = Companion {
                        level,
                        before: VecDeque::new(),
                        is_in_doubt: false,
                        offset: level - ratio + one.drift.unwrap_or(0.0),
                        missing: 0,
                        drift: one.drift,
                        gain: Gain::default(),
                    };
                    self.rods.insert(one.rod.to_owned(), fresh);
                }
            }
        }
        let is_witness = |rod: &str| self.rods.get(rod).is_some_and(Companion::bears_witness);
        let is_fresh = listed
            .values()
            .any(|one| measured(one).is_some() && is_witness(one.rod));
        let has_few = self.witnesses().count() < FEWEST;
        let ratio = self.median().filter(|_| is_fresh && !has_few);
        let measured = self.witnesses().filter(|known| known.missing == 0);
        let middle = middle(
            measured
                .filter_map(|known| known.gain.implied(known.level))
                .collect(),
        );
        if let Some(ratio) = ratio {
            self.periods = self.periods.saturating_add(1);
            let measured = self
                .rods
                .values_mut()
                .filter(|known| known.missing == 0 && known.drift.is_none());
            measured.for_each(|known| known.gain.learn(ratio, known.level));
        }
        Median {
            ratio,
            middle,
            has_few,
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
            drift: None,
            is_in_doubt: false,
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
    fn what_a_drift_moved_the_median_by_is_taken_off_and_stays_off() {
        let mut companions = Companions::default();
        let weather = |day: u32| 0.01 * f64::from(day).sin();
        let period = |day: u32, loss: f64, drift: Option<f64>| {
            let c = InPeriod {
                rod: "c",
                ratio: Some(weather(day) - loss),
                drift,
                is_in_doubt: false,
            };
            [
                at("a", Some(weather(day) - 0.02)),
                at("b", Some(weather(day) + 0.02)),
                c,
            ]
        };
        for day in 0..20 {
            near(companions.take(period(day, 0.0, None)), weather(day));
        }
        for day in 20..23 {
            let found = companions.take(period(day, 0.5, None)).ratio.unwrap();
            assert!((found - (weather(day) - 0.02)).abs() < 1e-12, "{found}");
        }
        for day in 23..60 {
            near(companions.take(period(day, 0.5, Some(-0.5))), weather(day));
        }
        // Somebody accepted it: it bears witness again, and nothing jumps. A second loss adds to the first.
        for day in 60..70 {
            near(companions.take(period(day, 0.5, None)), weather(day));
        }
        for day in 70..80 {
            near(companions.take(period(day, 0.6, Some(-0.1))), weather(day));
        }
    }

    /// A loss from day 20 on, in doubt from day 22 to 25, told and sure then: the median is that of the weather from the doubt on, beside
    /// two others and beside one.
    #[test]
    fn a_rod_in_doubt_goes_on_as_it_was_before_its_change() {
        for others in [&["a", "b"][..], &["b"]] {
            let mut companions = Companions::default();
            let weather = |day: u32| 0.01 * f64::from(day).sin();
            for day in 0..40 {
                let loss = if day < 20 { 0.0 } else { 0.5 };
                let c = InPeriod {
                    rod: "c",
                    ratio: Some(weather(day) - loss),
                    drift: (day >= 22).then_some(if day < 26 { -0.1 } else { -0.5 }),
                    is_in_doubt: (22..26).contains(&day),
                };
                let others = others.iter().map(|rod| at(rod, Some(weather(day))));
                let found = companions.take(others.chain([c]));
                // A rod told to drift bears no witness: one other alone has no median.
                if day < 20 || (day >= 22 && found.ratio.is_some()) {
                    near(found, weather(day));
                }
            }
            for level in companions.rods.values().map(|known| known.level) {
                assert!((level - weather(39)).abs() < 1e-12, "{others:?} {level}");
            }
        }
    }

    /// Rods of unlike slope, a cold spell and a warm one: (temperature less that of the baseline, ratio by slope).
    fn warmer(day: u32) -> f64 {
        10.0 * (f64::from(day) / 9.0).sin()
    }

    fn by(rod: &'static str, per_k: f64, day: u32) -> InPeriod<'static> {
        at(rod, Some(per_k * warmer(day)))
    }

    fn within(found: Median, expected: f64, tolerance: f64) {
        let ratio = found.ratio.unwrap();
        assert!((ratio - expected).abs() < tolerance, "{ratio} {expected}");
    }

    /// Warm days, when what follows the temperature by most is taken out or dies: the median stays, then and through the season.
    #[test]
    fn a_rod_that_is_taken_out_leaves_the_median_as_it_was() {
        for is_listed in [false, true] {
            let mut companions = Companions::default();
            let others = |day| [by("b", -0.004, day), by("c", -0.008, day)];
            for day in 0..70 {
                let d = by("d", -0.013, day);
                near(
                    companions.take(others(day).into_iter().chain([d])),
                    -0.008 * warmer(day),
                );
            }
            for day in 70..200 {
                let d = is_listed.then(|| at("d", None));
                let found = companions.take(others(day).into_iter().chain(d));
                // The ridge is a thousandth of the squares learned: 1e-3 of the gain's distance from one, of 20 K.
                within(found, -0.008 * warmer(day), 2e-4);
            }
        }
    }

    #[test]
    fn a_rod_that_comes_later_leaves_the_median_as_it_was() {
        let mut companions = Companions::default();
        let others = |day| [by("b", -0.004, day), by("c", -0.008, day)];
        for day in 0..200 {
            let d = (day > 40).then(|| by("d", -0.013, day));
            let found = companions.take(others(day).into_iter().chain(d));
            near(found, -0.006 * warmer(day));
        }
        // One of the two dies: the one that came later bears witness, and nothing jumps.
        let mut last = -0.006 * warmer(199);
        for day in 200..230 {
            let found = companions.take([by("b", -0.004, day), at("c", None), by("d", -0.013, day)]);
            let ratio = found.ratio.unwrap();
            // A day's 1.1 K of the steepest.
            assert!((ratio - last).abs() < 0.015, "{day}: {last} {ratio}");
            last = ratio;
        }
    }

    /// A rod that is told to drift and does not leaves the median as it was: in how it follows the temperature, too.
    #[test]
    fn a_false_drift_leaves_the_median_alone() {
        let mut companions = Companions::default();
        for day in 0..100 {
            let warm = (f64::from(day) / 20.0).sin();
            let c = InPeriod {
                rod: "c",
                ratio: Some(-0.1 * warm),
                drift: (day > 20).then_some(0.0),
                is_in_doubt: false,
            };
            let found = companions.take([at("a", Some(-0.05 * warm)), at("b", Some(-0.15 * warm)), c]);
            near(found, -0.1 * warm);
        }
    }
}
