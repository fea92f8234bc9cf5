//! Joining of the other rods: their detectors learn the rod's periods so far beside the median of that time.
//!
//! A rod has its baseline some periods before or after the others, and all of them measured in the same time. What a bank has learned of
//! the temperature does not hold beside the median, which follows the temperature itself: a part of the slope becomes the median's, and
//! the level of the weeks before would seem to have changed with it. Of 48 rods beside two others with a reading a day 26 told a change in a
//! year for it, and none does now (`beside_others.rs`).

use super::evidence::latest;
use super::{DriftWatch, Terms, seen};
use crate::signal::record::time::YEAR_D;
use crate::track::drift::companions::{self, Median};
use crate::track::drift::compensated::Compensated;
use crate::track::drift::others::Others;
use crate::track::drift::period::Period;
use crate::track::drift::{BankPrior, Companions, Detector, Law, Regressors};

/// Least number of periods of a detector that takes over from one that has more: those of a usual baseline.
const LEARNED_PERIODS: usize = 30;

impl DriftWatch {
    /// Begins the compensated detector with the first period that has its inputs; after the other rods joined, one with them beside it.
    pub(super) fn begin(&mut self, terms: &Terms, period: &Period) {
        if self.compensated.is_some() {
            return;
        }
        let (prior, reference_c) = match terms.thermal {
            None => (BankPrior::unmoved(self.noise_sd), 0.0),
            Some(thermal) => {
                let (Some(reference_c), Some(_)) = (terms.reference_c, period.filtered_c) else {
                    return;
                };
                (BankPrior::thermal(self.noise_sd, thermal), reference_c)
            }
        };
        let (origin, knows_temperature) = (period.start.days(), terms.thermal.is_some());
        self.compensated = Some(Compensated::new(
            prior,
            reference_c,
            origin,
            terms.limit,
            knows_temperature,
        ));
        if self.peers.is_some() {
            self.set_beside_others(terms);
        }
    }

    /// Lets the other rods join once two are followed and all have a baseline. Those that get none for long are not waited for.
    pub(super) fn await_others(
        &mut self,
        terms: &Terms,
        period: &Period,
        history: &[Period],
        is_sparse: bool,
        others: &Others,
        period_s: f64,
    ) {
        if self.peers.is_some() || others.known(period.index) < companions::FEWEST {
            return;
        }
        // The periods of a baseline close at once when it is there: waiting is counted by the site's newest.
        let newest = others
            .newest_period()
            .map_or(period.index, |newest| newest.max(period.index));
        let waited = newest.saturating_sub(*self.awaited_since.get_or_insert(newest));
        if !others.are_all_known() && waited <= i64::from(companions::PATIENCE) {
            return;
        }
        self.set_beside_others(terms);
        let regressors = Regressors {
            reference_c: 0.0,
            origin: self.origin,
        };
        let mut peers = Detector::new(BankPrior::peers(self.noise_sd));
        self.companions = Companions::default();
        self.others_since = None;
        // A change that was accepted in between is no part of what is learned.
        let since = history.len().saturating_sub(self.blind.fresh());
        for past in history.iter().skip(since) {
            let found = self.companions.take(others.in_period(past.index, period_s));
            let Some(median) = found.ratio else { continue };
            let day = past.start.days();
            self.others_since.get_or_insert(past.began().days());
            peers.step(&seen(past, &regressors.peers(day, median), false));
            if let Some(both) = self.compensated.as_mut().filter(|one| one.knows_others)
                && let Some(columns) = both.columns(day, past.filtered_c.as_ref(), Some(median))
            {
                both.detector.set_sparse(is_sparse);
                let unread_sd = past.charted.and_then(|charted| charted.unread_sd);
                let unread = unread_sd.unwrap_or(0.0).powi(2);
                both.detector.step_with(&seen(past, &columns, true), unread);
            }
        }
        // Of a watch made anew, the other rods had their say on the periods before.
        if self.by_both_until.until.is_some() {
            peers.forget_suspicions();
            if let Some(both) = self.compensated.as_mut().filter(|one| one.knows_others) {
                both.detector.forget_suspicions();
            }
        }
        self.peers = Some(peers);
        self.others_since.get_or_insert(period.began().days());
    }

    /// Sets a detector with temperature and the other rods beside the one with temperature, if there is one.
    fn set_beside_others(&mut self, terms: &Terms) {
        if let Some(thermal) = terms.thermal
            && let Some(alone) = self.compensated.take_if(|one| one.knows_temperature)
        {
            let prior = BankPrior::thermal_and_peers(self.noise_sd, thermal);
            self.compensated = Some(alone.beside_others(prior, terms.limit));
            self.by_temperature = Some(alone);
        }
    }

    /// The other rods in a period; none before they joined.
    pub(super) fn take_others(&mut self, period: &Period, others: &Others, period_s: f64) -> Median {
        if self.peers.is_none() {
            return Median {
                ratio: None,
                middle: None,
                has_few: true,
            };
        }
        self.companions.take(others.in_period(period.index, period_s))
    }

    /// Laws of a period's ratio by each of the two other rods in the middle, before it is learned: one of them may have moved by itself.
    pub(super) fn laws_beside_others(&self, period: &Period, middle: [f64; 2]) -> Option<[Law; 2]> {
        let peers = self.peers.as_ref()?;
        let day = period.start.days();
        let regressors = Regressors {
            reference_c: 0.0,
            origin: self.origin,
        };
        let by = |median| peers.predict(&seen(period, &regressors.peers(day, median), false));
        let [one, other] = middle;
        Some([by(one)?, by(other)?])
    }

    /// True while the detector with the other rods knows too little to take over from the one with temperature only: it has learned for
    /// less than half as long, up to a year, or most of the evidence for which the other is above its limit is of changes before the
    /// others' median is known.
    pub(super) fn knows_too_little(&self) -> bool {
        let (Some(alone), Some(both)) = (&self.by_temperature, &self.compensated) else {
            return false;
        };
        let (alone, both) = (&alone.detector, &both.detector);
        if both.periods() < alone.periods().min(LEARNED_PERIODS) {
            return true;
        }
        if let Some((since, now)) = self.others_since.zip(alone.last_day())
            && now - since < (0.5 * (now - self.origin)).min(YEAR_D)
        {
            return true;
        }
        let since = self.by_both_until.until;
        let evidence = alone.statistic_since(since);
        let before = evidence - alone.statistic_since(latest(since, self.others_since));
        before > self.limit.max(0.5 * evidence)
    }
}

#[cfg(test)]
mod tests {
    use crate::track::drift::beside_others::{QUIET, Story, follow};

    /// Others whose records begin on day 60 take over once they were there for half of the time. A small change from before, which the detector by
    /// temperature alone comes to tell after that, does not take the rod from them again.
    #[test]
    fn what_has_taken_over_stays_in_use() {
        let of = |days| {
            let story = Story {
                known: &[0, 100],
                days,
                change: (40, -0.008),
                ..QUIET
            };
            follow(4, &story).0
        };
        let (early, late) = (of(115), of(260));
        assert!(early.knows_too_little() && !late.knows_too_little());
        let alone = &late.by_temperature.as_ref().unwrap().detector;
        let (all, young) = (alone.statistic(), alone.statistic_since(late.others_since));
        assert!(all > 3652.0 && young < 0.5 * all, "{all} {young}");
    }
}
