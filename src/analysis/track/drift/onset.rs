//! Onsets that one particle stands for, with their law.
//!
//! With b_k the start of the first record of period k and t_k the mean time of its records, a change that period k is the first to
//! show began after b_(k-1) and before t_k: in between, evenly. Before b_(k-1) all of period k - 1 would show it; in the middle of
//! its records it makes a mixture of that period, which looks wild, and after t_k one of period k. Merging adds laws, weighted as the particles; an onset that is ruled out beside its
//! neighbour keeps its small share and does not widen the interval of the rest.

use serde::{Deserialize, Serialize};

/// Most stretches of one law: it is known to a dozenth where all are equally likely.
const MOST: usize = 12;
/// Least share of a stretch.
const NEGLIGIBLE: f64 = 1e-5;

/// Law of an onset: even over each of some stretches of time.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Onsets(Vec<Stretch>);

/// A stretch of time in which every onset is equally likely.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Stretch {
    after: f64,
    until: f64,
    share: f64,
}

impl Stretch {
    /// P(onset <= day) within it.
    fn below(&self, day: f64) -> f64 {
        if day >= self.until {
            1.0
        } else if day <= self.after {
            0.0
        } else {
            (day - self.after) / (self.until - self.after)
        }
    }
}

impl Onsets {
    /// Onsets between two times \[d\].
    pub fn between(after: f64, until: f64) -> Self {
        Self(vec![Stretch {
            after: after.min(until),
            until,
            share: 1.0,
        }])
    }

    /// P(onset > day); one without a day.
    pub fn later_than(&self, day: Option<f64>) -> f64 {
        let Some(day) = day else { return 1.0 };
        self.0.iter().map(|one| one.share * (1.0 - one.below(day))).sum()
    }

    /// The law of an onset later than a day; as it is where all are earlier.
    pub fn after(&self, day: Option<f64>) -> Self {
        let Some(day) = day.filter(|day| self.later_than(Some(*day)) > 0.0) else {
            return self.clone();
        };
        let total = self.later_than(Some(day));
        let left = self.0.iter().filter(|one| one.until > day);
        let cut = |one: &Stretch| Stretch {
            after: one.after.max(day),
            until: one.until,
            share: one.share * (1.0 - one.below(day)) / total,
        };
        Self(left.map(cut).collect())
    }

    /// Both laws together, `newer_share` of the sum the newer one's.
    pub fn with(&self, newer: &Self, newer_share: f64) -> Self {
        let scaled = |law: &Self, by: f64| -> Vec<Stretch> {
            let share = |one: &Stretch| Stretch {
                share: one.share * by,
                ..*one
            };
            law.0.iter().map(share).collect()
        };
        let mut all = scaled(self, 1.0 - newer_share);
        all.extend(scaled(newer, newer_share));
        all.retain(|one| one.share >= NEGLIGIBLE);
        while all.len() > MOST {
            let together = |at: &usize| all[*at].share + all[*at + 1].share;
            let lightest = (0..all.len() - 1).min_by(|a, b| together(a).total_cmp(&together(b)));
            let Some(at) = lightest else { break };
            let second = all.remove(at + 1);
            let first = &mut all[at];
            first.after = first.after.min(second.after);
            first.until = first.until.max(second.until);
            first.share += second.share;
        }
        let total: f64 = all.iter().map(|one| one.share).sum();
        all.iter_mut().for_each(|one| one.share /= total);
        Self(all)
    }
}

/// Quantiles of a mixture of laws, each with its weight; the weights sum to one.
pub(super) fn quantiles<const N: usize>(laws: &[(&Onsets, f64)], wanted: [f64; N]) -> [f64; N] {
    let stretches = || laws.iter().flat_map(|(law, _)| &law.0);
    let first = stretches().map(|one| one.after).fold(f64::INFINITY, f64::min);
    let last = stretches().map(|one| one.until).fold(f64::NEG_INFINITY, f64::max);
    let below = |day: f64| -> f64 {
        let of = |law: &Onsets| -> f64 { law.0.iter().map(|one| one.share * one.below(day)).sum() };
        laws.iter().map(|(law, weight)| weight * of(law)).sum()
    };
    wanted.map(|share| {
        let (mut low, mut high) = (first, last);
        // To 1e-4 s in a century.
        for _ in 0..48 {
            let middle = 0.5 * (low + high);
            *(if below(middle) < share {
                &mut low
            } else {
                &mut high
            }) = middle;
        }
        high
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(found: f64, wanted: f64) {
        assert!((found - wanted).abs() < 1e-9, "{found} {wanted}");
    }

    #[test]
    fn quantiles_are_those_of_even_stretches() {
        let one = Onsets::between(10.0, 12.0);
        let [low, middle, high] = quantiles(&[(&one, 1.0)], [0.025, 0.5, 0.975]);
        near(low, 10.05);
        near(middle, 11.0);
        near(high, 11.95);
        let other = Onsets::between(20.0, 21.0);
        let [before, after] = quantiles(&[(&one, 0.25), (&other, 0.75)], [0.125, 0.625]);
        near(before, 11.0);
        near(after, 20.5);
        // A stretch without length is a moment.
        let moment = Onsets::between(5.0, 5.0);
        near(quantiles(&[(&moment, 1.0)], [0.3])[0], 5.0);
    }

    #[test]
    fn what_is_ruled_out_does_not_widen_the_rest() {
        let mut law = Onsets::between(0.0, 1.0);
        for day in 1..100 {
            law = law.with(&Onsets::between(f64::from(day), f64::from(day + 1)), 1e-4);
        }
        assert!(law.0.len() <= MOST);
        let [low, high] = quantiles(&[(&law, 1.0)], [0.025, 0.975]);
        assert!((0.02..0.03).contains(&low) && high < 1.0, "{low} {high}");
        near(law.0.iter().map(|one| one.share).sum(), 1.0);
    }

    #[test]
    fn onsets_before_a_day_can_be_left_out() {
        let law = Onsets::between(10.0, 12.0).with(&Onsets::between(12.0, 14.0), 0.75);
        near(law.later_than(None), 1.0);
        near(law.later_than(Some(13.0)), 0.375);
        near(law.later_than(Some(11.0)), 0.875);
        near(law.later_than(Some(14.0)), 0.0);
        let late = law.after(Some(11.0));
        near(quantiles(&[(&late, 1.0)], [0.125 / 0.875])[0], 12.0);
        near(late.0.iter().map(|one| one.share).sum(), 1.0);
        assert_eq!(law.after(Some(20.0)), law);
        assert_eq!(law.after(None), law);
    }

    #[test]
    fn equally_likely_onsets_stay_so() {
        let mut law = Onsets::between(0.0, 1.0);
        for day in 1..100_u32 {
            let share = f64::from(day + 1).recip();
            law = law.with(&Onsets::between(f64::from(day), f64::from(day + 1)), share);
        }
        let found = quantiles(&[(&law, 1.0)], [0.025, 0.5, 0.975]);
        for (found, wanted) in found.into_iter().zip([2.5, 50.0, 97.5]) {
            assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
        }
    }
}
