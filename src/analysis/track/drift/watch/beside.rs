//! Joining of the other rods: their detectors learn the rod's periods so far beside the median of that time.
//!
//! A rod has its baseline some periods before or after the others, and all of them measured in the same time. What a bank has learned of
//! the temperature does not hold beside the median, which follows the temperature itself: a part of the slope becomes the median's, and
//! the level of the weeks before would seem to have changed with it. Of 48 rods beside two others with a reading a day 26 told a change in a
//! year for it, and none does now (`beside_others.rs`).

use super::DriftWatch;
use super::{Terms, seen};
use crate::track::drift::companions::{self, Median};
use crate::track::drift::compensated::Compensated;
use crate::track::drift::others::Others;
use crate::track::drift::period::Period;
use crate::track::drift::{BankPrior, Companions, Detector, Regressors};

/// Number of periods after which a detector knows as much as it needs to take over.
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
        self.compensated = Some(Compensated::new(prior, reference_c, origin, knows_temperature));
        if self.peers.is_some() {
            self.set_beside_others(terms);
        }
    }

    /// Lets the other rods join once two were measured in a period and all have a baseline. Those that get none for long are not waited
    /// for.
    pub(super) fn await_others(
        &mut self,
        terms: &Terms,
        period: &Period,
        history: &[Period],
        is_sparse: bool,
        others: &Others,
        period_s: f64,
    ) {
        if self.peers.is_some() || others.measured(period.index, period_s) < companions::FEWEST {
            return;
        }
        self.awaited += 1;
        if !others.are_all_known() && self.awaited <= companions::PATIENCE {
            return;
        }
        self.set_beside_others(terms);
        let regressors = Regressors {
            reference_c: 0.0,
            origin: self.origin,
        };
        let mut peers = Detector::new(BankPrior::peers(self.noise_sd));
        self.companions = Companions::default();
        // A change that was accepted in between is no part of what is learned.
        let since = history.len().saturating_sub(self.blind.fresh());
        for period in history.iter().skip(since) {
            let found = self.companions.take(others.in_period(period.index, period_s));
            let Some(median) = found.ratio else { continue };
            let day = period.start.days();
            self.beside_since = self.beside_since.or(Some(period.began().days()));
            peers.step(&seen(period, &regressors.peers(day, median), false));
            if let Some(both) = self.compensated.as_mut().filter(|one| one.knows_others)
                && let Some(columns) = both.columns(day, period.filtered_c.as_ref(), Some(median))
            {
                both.detector.set_sparse(is_sparse);
                let unread_sd = period.charted.and_then(|charted| charted.unread_sd);
                let unread = unread_sd.unwrap_or(0.0).powi(2);
                both.detector.step_with(&seen(period, &columns, true), unread);
            }
        }
        self.peers = Some(peers);
        self.beside_since = self.beside_since.or(Some(period.began().days()));
    }

    /// Sets a detector with temperature and the other rods beside the one with temperature, if there is one.
    fn set_beside_others(&mut self, terms: &Terms) {
        if let Some(thermal) = terms.thermal
            && let Some(alone) = self.compensated.take_if(|one| one.knows_temperature)
        {
            let prior = BankPrior::thermal_and_peers(self.noise_sd, thermal);
            self.compensated = Some(alone.beside_others(prior));
            self.by_temperature = Some(alone);
        }
    }

    /// The other rods in a period, once they joined.
    pub(super) fn take_others(&mut self, period: &Period, others: &Others, period_s: f64) -> Median {
        if self.peers.is_none() {
            return Median {
                ratio: None,
                has_few: true,
            };
        }
        self.companions.take(others.in_period(period.index, period_s))
    }

    /// True while the detector with the other rods knows too little to take over from the one with temperature only: it has learned fewer
    /// periods, or most of the evidence for which the other is above its limit began before the others joined.
    pub(super) fn knows_too_little(&self) -> bool {
        let (Some(alone), Some(both)) = (&self.by_temperature, &self.compensated) else {
            return false;
        };
        let (alone, both) = (&alone.detector, &both.detector);
        let evidence = alone.statistic();
        let before = evidence - alone.statistic_since(self.beside_since);
        both.periods() < alone.periods().min(LEARNED_PERIODS) || before > self.limit.max(0.5 * evidence)
    }
}
