//! Evidence, size and onset of a change, by the detectors that had their inputs of late.

use super::{DriftWatch, MOST_EVIDENCE, RARER};
use crate::track::drift::Covariance;
use crate::track::drift::companions;
use crate::track::drift::compensated::Compensated;
use crate::track::drift::filters::FILTERS_D;
use crate::track::drift::period::{Evidence, Pending};
use crate::track::drift::{Change, Detector, Filters, Law, Regressors, Seen};

/// Standard deviations of the predictive law from which a sudden change is reported within days without a temperature: a smaller
/// one is learned as weather by the broadest members of the bank.
const TOLD_SD: f64 = 5.0;

impl DriftWatch {
    /// R of the detector with the most inputs of late, by changes that began after a time \[d\].
    pub fn evidence(&self, since: Option<f64>) -> f64 {
        if let Some(watching) = self.current_watching() {
            return watching
                .detector
                .statistic_since(latest(since, self.watching_since()));
        }
        match self.current_peers() {
            Some(peers) => peers.statistic_since(latest(since, self.by_temperature_until.until)),
            None => self.blind.statistic_since(latest(since, self.informed_until())),
        }
    }

    /// R of the detector with the most inputs that does not use the other rods, so that no other rod can raise it, by changes that
    /// began after a time \[d\].
    pub fn evidence_alone(&self, since: Option<f64>) -> f64 {
        match self.alone() {
            Some(one) => one.detector.statistic_since(since),
            None => self
                .blind
                .statistic_since(latest(since, self.by_temperature_until.until)),
        }
    }

    /// Change by temperature alone of what began after a time \[d\], as a share of the force; `None` without a temperature.
    pub(crate) fn size_alone(&self, since: f64) -> Option<f64> {
        self.alone()?.detector.size_since(Some(since))
    }

    /// The detector with temperature that does not use the other rods, if it took the last period.
    fn alone(&self) -> Option<&Compensated> {
        let knows_no_others = || self.compensated.as_ref().filter(|one| !one.knows_others);
        let by_temperature = self.by_temperature.as_ref().or_else(knows_no_others);
        by_temperature.filter(|_| self.last.alone)
    }

    /// Expected change of the ratio beside the other rods, true changes being rarer than false alarms: zero while there is little
    /// evidence of one. A wrong thermometer has no part in it.
    pub fn moved_beside_others(&self) -> f64 {
        let Some(peers) = self.current_peers() else {
            return 0.0;
        };
        let odds = peers.statistic() / (RARER * self.limit);
        peers
            .size_since(None)
            .map_or(0.0, |size| size * odds / (1.0 + odds))
    }

    /// True once that is all but certain: a share of 1 % is left out of it.
    pub(crate) fn knows_what_moved(&self) -> bool {
        (self.current_peers()).is_some_and(|peers| peers.statistic() > 100.0 * RARER * self.limit)
    }

    /// Change as it stands now, as a share of the force; zero without one.
    pub fn size(&self) -> f64 {
        let size = |(detector, since): (&Detector, _)| detector.size_since(since);
        self.informed().find_map(size).unwrap_or(0.0)
    }

    /// Slope of N_t / N_0 with a constant temperature, and its standard deviation \[1/K\]; `None` without a
    /// temperature.
    pub fn slope(&self) -> Option<(f64, f64)> {
        let compensated = self.by_temperature.as_ref().or(self.compensated.as_ref())?;
        let compensated = Some(compensated).filter(|one| one.knows_temperature)?;
        Some(compensated.detector.slope(self.limit, FILTERS_D.len()))
    }

    /// Onset, size and shape of the change, by the best-informed detector of the last period.
    pub(crate) fn change(&self) -> Option<Change> {
        self.by_informed(Detector::change_since)
    }

    /// Its earliest credible onset \[d\] and its size.
    pub(super) fn onset_and_size(&self) -> Option<(f64, f64)> {
        self.by_informed(Detector::movement_since)
    }

    /// An answer about changes that began after a time, with onsets after another, of the best-informed detector that has one.
    fn by_informed<T>(&self, of: impl Fn(&Detector, Option<f64>, Option<f64>) -> Option<T>) -> Option<T> {
        // What stands in counts onsets since the middle of the last period that a better-informed one took. That period may have
        // been a mixture: the onset may lie in it.
        let answer = |(detector, since): (&Detector, Option<f64>)| {
            let from = since
                .zip(self.informed_from())
                .map(|(since, from)| since.min(from));
            of(detector, since, from)
        };
        self.informed().find_map(answer)
    }

    /// Change of the ratio of a record since commissioning at the reference temperature, and its standard deviation; `None`
    /// without its temperature. `is_told`: a change is told that stands.
    pub(crate) fn change_of(
        &self,
        day: f64,
        ratio: f64,
        sd: f64,
        filtered_c: Option<&[f64; FILTERS_D.len()]>,
        unread_k2: Option<&Covariance>,
        is_told: bool,
    ) -> Option<(f64, f64)> {
        let compensated = self.by_temperature.as_ref().or(self.compensated.as_ref())?;
        let columns = compensated.columns(day, filtered_c, None)?;
        let seen = Seen {
            day,
            began: day,
            measured: day,
            ratio,
            sd,
            columns: &columns,
            unread_k2: unread_k2.filter(|_| compensated.knows_temperature),
        };
        compensated.change(&seen, self.limit, self.above.any() || is_told)
    }

    /// Predictive law of a record by the rod's own data only.
    pub(crate) fn blind_law(&self, day: f64, ratio: f64, sd: f64) -> Option<Law> {
        let regressors = Regressors {
            reference_c: 0.0,
            origin: self.origin,
        };
        self.blind.predict(&Seen {
            day,
            began: day,
            measured: day,
            ratio,
            sd,
            columns: &regressors.blind(day),
            unread_k2: None,
        })
    }

    /// Predictive law of a record by its temperature, without the other rods; `None` without a temperature, and before a detector
    /// with temperature began. `filters`: of the readings up to the record's end.
    pub(crate) fn law_by_temperature(&self, pending: &Pending, filters: &Filters) -> Option<Law> {
        let day = pending.end.days();
        let compensated = self.by_temperature.as_ref().or(self.compensated.as_ref())?;
        let columns = compensated.columns(day, Some(&filters.at(day)?), None)?;
        let unread_k2 = filters.unread_k2(day).filter(|_| compensated.knows_temperature);
        compensated.detector.predict(&Seen {
            day,
            began: day,
            measured: day,
            ratio: pending.delta,
            sd: pending.sd,
            columns: &columns,
            unread_k2: unread_k2.as_ref(),
        })
    }

    /// Sudden change that would be reported at the next period without a temperature, as a share of the
    /// force.
    pub(crate) fn least_told_blind(&self, day: f64) -> Option<f64> {
        Some(TOLD_SD * self.blind_law(day, 0.0, self.noise_sd)?.sd)
    }

    /// The detector with temperature, unless it has taken no period for long, or the other rods stand in.
    pub(super) fn current_watching(&self) -> Option<&Compensated> {
        let pauses = !self.last.others && self.without_temperature <= companions::PATIENCE;
        self.watching().filter(|_| self.last.temperature || pauses)
    }

    /// The detector with the other rods, unless it has taken no period for long.
    pub(super) fn current_peers(&self) -> Option<&Detector> {
        let peers = self.peers.as_ref();
        peers.filter(|_| self.without_others <= companions::PATIENCE)
    }

    /// True if the detector with temperature only is in use beside one with the other rods, too.
    pub(super) fn stands_in(&self) -> bool {
        self.are_others_late || self.without_others > companions::PATIENCE || self.knows_too_little()
    }

    /// Compensated detector in use: that with the other rods, unless they are absent or new.
    pub(super) fn watching(&self) -> Option<&Compensated> {
        let alone = self.by_temperature.as_ref().filter(|_| self.stands_in());
        alone.or(self.compensated.as_ref())
    }

    /// Time from which on changes count for the detector in use: one with temperature only stands in for one with the other rods.
    pub(super) fn watching_since(&self) -> Option<f64> {
        self.watching()
            .filter(|one| !one.knows_others)
            .and(self.by_both_until.until)
    }

    /// R of the detector in use.
    pub(super) fn watching_statistic(&self) -> f64 {
        let since = self.watching_since();
        self.watching()
            .map_or(0.0, |one| one.detector.statistic_since(since))
    }

    /// Time until which a detector with temperature or other rods looked \[d\].
    pub(super) fn informed_until(&self) -> Option<f64> {
        let looked = [self.by_temperature_until, self.by_others_until];
        looked
            .into_iter()
            .filter_map(|looked| looked.until)
            .reduce(f64::max)
    }

    /// Start of the last period that any detector with temperature or other rods took \[d\].
    pub(super) fn informed_from(&self) -> Option<f64> {
        let thermal = [&self.compensated, &self.by_temperature].into_iter().flatten();
        let detectors = thermal.map(|one| &one.detector).chain(&self.peers);
        detectors.filter_map(Detector::began).reduce(f64::max)
    }

    /// Evidence after the last period, as a share of the limit, of a change that began by a time \[d\], and the change, by the best-informed
    /// detector that tells it. Only a detector that had periods before says anything of it: to one that began later it is the level. What
    /// stands in counts from before it.
    pub(crate) fn testimony(&self, onset: f64) -> (Evidence, Option<Change>) {
        let since = |since: Option<f64>| since.filter(|since| *since <= onset);
        let knew = |one: &&Compensated| {
            let others_since = self.others_since.filter(|_| one.knows_others);
            self.last.temperature && latest(Some(one.origin()), others_since) <= Some(onset)
        };
        let compensated = (self.watching().filter(knew))
            .or_else(|| {
                self.by_temperature
                    .as_ref()
                    .filter(|one| self.last.alone && knew(one))
            })
            .map(|one| (&one.detector, since(self.watching_since())));
        let peers = (self.peers.as_ref())
            .filter(|_| self.last.others && self.others_since <= Some(onset))
            .map(|peers| (peers, None));
        let stands_in = !(self.last.temperature || self.last.others);
        let blind = (&self.blind, since(self.informed_until().filter(|_| stands_in)));
        let over = |(detector, since): (&Detector, _)| {
            (detector.statistic_since(since) / self.limit).min(MOST_EVIDENCE)
        };
        let evidence = Evidence {
            compensated: compensated.map(over),
            peers: peers.map(over),
            blind: Some(over(blind)),
        };
        let all = [compensated, peers, Some(blind)].into_iter().flatten();
        let change = all
            .filter_map(|(detector, since)| detector.change_since(since, since))
            .next();
        (evidence, change)
    }

    /// Detectors that had their inputs in the last period, the best-informed first, each with the time from which on its changes
    /// count.
    pub(super) fn informed(&self) -> impl Iterator<Item = (&Detector, Option<f64>)> {
        let is_compensated = self.last.temperature || self.above.compensated;
        let compensated = self.watching().filter(|_| is_compensated);
        let peers = self.peers.as_ref().filter(|_| self.last.others);
        let first = compensated
            .map(|one| (&one.detector, self.watching_since()))
            .into_iter();
        let second = peers
            .map(|peers| (peers, self.by_temperature_until.until))
            .into_iter();
        first.chain(second).chain([(&self.blind, self.informed_until())])
    }
}

/// The later of two times \[d\] after which changes count.
pub(super) fn latest(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    one.into_iter().chain(other).reduce(f64::max)
}
