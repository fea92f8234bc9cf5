//! The drift watch of one rod: detectors that know the temperature, the other rods, or nothing but the rod, on the same
//! periods, and their joint finding.
//!
//! ```text
//! compensated   temperature, and the median of the other rods if there are two at least   drift
//! peers         the other rods alone                                                      confirms, or stands in
//! blind         nothing but the rod                                                       stands in
//! ```
//!
//! A drifting thermometer moves every rod's compensated detector, but not the rods relative to each other: a
//! drift that `peers` also detects is confirmed; rods whose compensated detectors move together are one notice
//! of the site. Any of its J rods may bring that on, so that it needs J times the evidence of an alarm: the bound on false ones is
//! one for the site. A detector that stands in counts only what began since a better-informed one last looked and saw little: before,
//! that one saw more, and what it had begun to see is not lost with it. Another rod that drifts moves the median: a rod that shows a change only relative to the
//! median waits a few periods while a rod in the median shows a larger one. Once that rod is reported, the
//! median goes on without its change.

use super::companions;
use super::compensated::Compensated;
use super::others::{MOVING, Movement, Others};
use super::period::{Charted, Evidence, Period};
use super::regressors::FILTERS_D;
use super::{BankPrior, Change, Companions, Detector, Law, Regressors, Seen, ThermalPrior};
use serde::{Deserialize, Serialize};

/// Number of periods since the last restart after which absence of evidence counts.
const SETTLED_PERIODS: usize = 30;

/// Largest share of the other rods that may move beside a drifting rod.
const MOVING_SHARE: f64 = 0.25;

/// Upper limit of the evidence: R grows without bound while a change lasts.
const MOST_EVIDENCE: f64 = 1e12;

/// Standard deviations of the predictive law from which a sudden change is reported within days without a temperature: a smaller
/// one is learned as weather by the broadest members of the bank.
const TOLD_SD: f64 = 5.0;

/// Periods between true changes of one rod, in periods between its false alarms: a change that the other rods confirm, and that is
/// taken off their median, must be as much more certain than an alarm.
const RARER: f64 = 10.0;

/// Most periods with evidence of a change that a detector leaves to one that stands in for it.
const SUSPICIOUS_PERIODS: u8 = 3;

/// Settings of a watch besides its periods.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Terms {
    /// Limit R of an alarm: the mean number of periods between false alarms.
    pub limit: f64,
    /// Prior of the effect of temperature on the rod; `None` if the force is not compensated.
    pub thermal: Option<ThermalPrior>,
    /// Temperature to which force is referred \[degC\], once known.
    pub reference_c: Option<f64>,
    /// Number of periods before the change since commissioning is measured.
    pub learning_periods: usize,
}

/// Detectors of one rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DriftWatch {
    /// Time of the first period \[d\].
    origin: f64,
    /// Typical stated error of a period's ratio.
    noise_sd: f64,
    /// Periods between false alarms: one over the odds of an onset.
    #[serde(default)]
    limit: f64,
    compensated: Option<Compensated>,
    /// Detector with temperature only, besides one with the other rods, too: a single record must not wait
    /// for them.
    by_temperature: Option<Compensated>,
    peers: Option<Detector>,
    blind: Detector,
    /// Last ratios of the other rods.
    #[serde(default)]
    companions: Companions,
    /// Number of periods in a row without the other rods' median; many if there are too few rods for one.
    without_others: u32,
    /// Number of periods in a row that no detector with temperature took.
    without_temperature: u32,
    /// Until when a detector with temperature looked, one with the other rods, and the one with both.
    by_temperature_until: Looked,
    by_others_until: Looked,
    by_both_until: Looked,
    /// True once this rod moved together with others of which one reported it.
    has_joined: bool,
    /// Sources of the last period: temperature, other rods.
    last: Sources,
    /// Detectors above their limit after the last period.
    above: Above,
}

/// Mean time \[d\] of the last period that a detector took with little evidence of a change afterwards, or of one soon after it: what
/// it had begun to see must not be forgotten when it loses its inputs, and it tells a large change within so many periods.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
struct Looked {
    until: Option<f64>,
    /// Number of periods since, with more evidence.
    suspicious: u8,
}

impl Looked {
    /// Takes a period after which a detector has some evidence of a change since.
    fn note(&mut self, measured: f64, detector: Option<&Detector>) {
        let Some(detector) = detector else { return };
        let is_suspicious = detector.statistic_since(self.until) > MOVING;
        if is_suspicious && self.suspicious < SUSPICIOUS_PERIODS {
            self.suspicious += 1;
        } else {
            (self.until, self.suspicious) = (Some(measured), 0);
        }
    }
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Sources {
    temperature: bool,
    others: bool,
    /// True if a detector took it that knows the temperature and not the others.
    alone: bool,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Above {
    compensated: bool,
    /// The other rods confirm a change.
    peers: bool,
    /// Those that stand in, by changes since a better-informed one last looked.
    peers_alone: bool,
    blind: bool,
}

impl Above {
    fn any(self) -> bool {
        self.compensated || self.peers || self.peers_alone || self.blind
    }
}

/// Detectors behind a change of force.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Witness {
    /// Temperature is compensated, and the other rods confirm the change.
    Confirmed,
    /// Temperature is compensated; the other rods do not confirm the change yet.
    Unconfirmed,
    /// Temperature is compensated; there are too few rods to distinguish force from thermometer.
    Alone,
    /// Compared with the other rods; there is no temperature.
    Peers,
    /// The rod's own data only: there is neither temperature nor other rods.
    Blind,
}

/// Joint finding of the detectors after a period.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Finding {
    /// No change.
    Quiet,
    /// The rod's force changed.
    Drift(Witness),
    /// It moved together with other rods: thermometer, weather, or the whole structure.
    Common,
    /// It seems to move together with other rods; a notice of the site needs more evidence.
    Waiting,
}

impl DriftWatch {
    /// A watch before its first period, of day `origin`.
    pub(crate) fn new(origin: f64, noise_sd: f64) -> Self {
        Self {
            origin,
            noise_sd,
            limit: 1.0,
            compensated: None,
            by_temperature: None,
            peers: None,
            blind: Detector::new(BankPrior::blind(noise_sd)),
            companions: Companions::default(),
            without_others: 0,
            without_temperature: 0,
            by_temperature_until: Looked::default(),
            by_others_until: Looked::default(),
            by_both_until: Looked::default(),
            has_joined: false,
            last: Sources::default(),
            above: Above::default(),
        }
    }

    /// Number of periods seen.
    pub fn periods(&self) -> usize {
        self.blind.periods()
    }

    /// True if a temperature has ever come, or none is needed.
    pub fn is_compensated(&self) -> bool {
        self.compensated.is_some()
    }

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
        let knows_no_others = || self.compensated.as_ref().filter(|one| !one.knows_others);
        let by_temperature = self.by_temperature.as_ref().or_else(knows_no_others);
        match by_temperature.filter(|_| self.last.alone) {
            Some(one) => one.detector.statistic_since(since),
            None => self
                .blind
                .statistic_since(latest(since, self.by_temperature_until.until)),
        }
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

    /// Time until which a detector with temperature or other rods looked \[d\].
    fn informed_until(&self) -> Option<f64> {
        let looked = [self.by_temperature_until, self.by_others_until];
        looked
            .into_iter()
            .filter_map(|looked| looked.until)
            .reduce(f64::max)
    }

    /// Change as it stands now, as a share of the force; zero without one.
    pub fn size(&self) -> f64 {
        let size = |(detector, since): (&Detector, _)| detector.size_since(since);
        self.informed().find_map(size).unwrap_or(0.0)
    }

    /// The change as other rods may share it: theirs may be up to twice as old as its earliest credible onset.
    pub(crate) fn movement(&self) -> Option<Movement> {
        let (change, now) = (self.change()?, self.blind.began()?);
        Some(Movement {
            since: 2.0 * change.onset_interval[0] - now,
            size: change.size,
            slope_per_k: self.slope().map(|(slope, _)| slope),
        })
    }

    /// Number of other rods that share the change.
    pub(crate) fn moving(&self, others: &Others, index: i64) -> usize {
        self.movement()
            .map_or(0, |movement| others.moving(index, &movement))
    }

    /// True unless too many of the other rods move: what moves them together is no change of one.
    pub(crate) fn is_calm(&self, others: &Others, index: i64) -> bool {
        let count = others.count();
        count < companions::FEWEST || self.moving(others, index) as f64 <= MOVING_SHARE * count as f64
    }

    /// The detector with temperature, unless it has taken no period for long, or the other rods stand in.
    fn current_watching(&self) -> Option<&Compensated> {
        let pauses = !self.last.others && self.without_temperature <= companions::PATIENCE;
        self.watching().filter(|_| self.last.temperature || pauses)
    }

    /// The detector with the other rods, unless it has taken no period for long.
    fn current_peers(&self) -> Option<&Detector> {
        let peers = self.peers.as_ref();
        peers.filter(|_| self.without_others <= companions::PATIENCE)
    }

    /// Slope of N_t / N_0 with a constant temperature, and its standard deviation \[1/K\]; `None` without a
    /// temperature.
    pub fn slope(&self) -> Option<(f64, f64)> {
        let compensated = self.by_temperature.as_ref().or(self.compensated.as_ref())?;
        let compensated = Some(compensated).filter(|one| one.knows_temperature)?;
        Some(compensated.detector.slope(self.limit, FILTERS_D.len()))
    }

    /// Takes a period; `median`: that of the other rods' ratios.
    pub(crate) fn step(
        &mut self,
        terms: &Terms,
        period: &Period,
        is_sparse: bool,
        others: &Others,
        period_s: f64,
    ) -> Charted {
        self.limit = terms.limit;
        let (day, measured) = (period.start.days(), period.time().days());
        let found = self.companions.take(others.in_period(period.index, period_s));
        let median = found.ratio;
        self.without_others = match median {
            Some(_) => 0,
            None if found.has_few => u32::MAX,
            None => self.without_others.saturating_add(1),
        };
        self.begin(terms, period, median.is_some());
        let regressors = Regressors {
            reference_c: 0.0,
            origin: self.origin,
        };
        let mut law = None;
        let mut seen_alone = None;
        self.last = Sources::default();
        if let Some(compensated) = &mut self.compensated
            && let Some(columns) = compensated.columns(day, period.filtered_c.as_ref(), median)
        {
            compensated
                .detector
                .set_sparse(is_sparse && compensated.knows_temperature);
            let is_told = self.above.any();
            compensated.learn_level(measured, period.delta, &columns, terms.learning_periods, is_told);
            let seen = seen(period, &columns);
            law = compensated.detector.step(&seen);
            seen_alone = Some(columns);
            self.last.temperature = law.is_some();
            self.last.alone = law.is_some() && !compensated.knows_others;
        }
        if let Some(alone) = &mut self.by_temperature
            && let Some(columns) = alone.columns(day, period.filtered_c.as_ref(), None)
        {
            alone.detector.set_sparse(is_sparse);
            let is_told = self.above.any();
            alone.learn_level(measured, period.delta, &columns, terms.learning_periods, is_told);
            let seen = seen(period, &columns);
            let by_temperature = alone.detector.step(&seen);
            self.last.alone = by_temperature.is_some();
            if self.without_others > companions::PATIENCE {
                self.last.temperature |= by_temperature.is_some();
                law = law.or(by_temperature);
            }
            seen_alone = Some(columns);
        }
        if let Some(median) = median {
            let peers = self
                .peers
                .get_or_insert_with(|| Detector::new(BankPrior::peers(self.noise_sd)));
            let seen_law = peers.step(&seen(period, &regressors.peers(day, median)));
            self.last.others = seen_law.is_some();
            law = law.or(seen_law);
        }
        self.without_temperature = if self.last.temperature {
            0
        } else {
            self.without_temperature.saturating_add(1)
        };
        self.note_what_looked(measured);
        let blind_law = self.blind.step(&seen(period, &regressors.blind(day)));
        self.look(terms.limit);
        // After the look: periods since the onset of a change that is reported now are no part of the level.
        let at_reference = seen_alone.and_then(|columns: Vec<f64>| {
            let measured_by = self.by_temperature.as_ref().or(self.compensated.as_ref())?;
            measured_by.change(&seen(period, &columns), terms.limit, self.above.any())
        });
        let law = law.or(blind_law).unwrap_or(Law {
            mean: period.delta,
            sd: period.delta_sd,
            leverage: 1.0,
        });
        // Beside a better-informed one its evidence is shown whole; standing in, it counts as that of an alarm does.
        let stands_in = !(self.last.temperature || self.last.others);
        let blind_since = self.informed_until().filter(|_| stands_in);
        let over = |statistic: f64| (statistic / terms.limit).min(MOST_EVIDENCE);
        Charted {
            expected: law.mean,
            expected_sd: law.sd,
            residual: law.residual(period.delta),
            leverage: law.leverage,
            at_reference: at_reference.map(|change| change.0),
            at_reference_sd: at_reference.map(|change| change.1),
            temperature_c: period
                .filtered_c
                .map(|filtered| filtered[SHOWN])
                .filter(|_| terms.thermal.is_some()),
            evidence: Evidence {
                // What did not take the period says nothing of it.
                compensated: (self.last.temperature).then(|| over(self.watching_statistic())),
                peers: (self.peers.as_ref().filter(|_| self.last.others)).map(|one| over(one.statistic())),
                blind: Some(over(self.blind.statistic_since(blind_since))),
            },
        }
    }

    /// Begins the compensated detector with the first period that has its inputs. Once there are other rods, one with them goes on
    /// beside it, with all it learned.
    fn begin(&mut self, terms: &Terms, period: &Period, has_median: bool) {
        if self.compensated.is_none() {
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
        }
        let is_alone = |one: &Compensated| one.knows_temperature && !one.knows_others;
        if has_median
            && period.filtered_c.is_some()
            && let Some(alone) = self.compensated.take_if(|one| is_alone(one))
        {
            // Of a watch made anew, the other rods had their say on what began before.
            self.compensated = Some(alone.with_others(self.by_both_until.until.is_none()));
            self.by_temperature = Some(alone);
        }
    }

    /// Notes until when the detectors of this period, measured in the mean at a time \[d\], looked.
    fn note_what_looked(&mut self, measured: f64) {
        let [mut temperature, mut both, mut others] = [
            self.by_temperature_until,
            self.by_both_until,
            self.by_others_until,
        ];
        let watching = self.watching().filter(|_| self.last.temperature);
        temperature.note(measured, watching.map(|one| &one.detector));
        let with_others = watching.filter(|one| one.knows_others);
        both.note(measured, with_others.map(|one| &one.detector));
        others.note(measured, self.peers.as_ref().filter(|_| self.last.others));
        self.by_temperature_until = temperature;
        self.by_both_until = both;
        self.by_others_until = others;
    }

    /// Notes that a detector with the other rods, which is not there any more, looked until a time \[d\].
    pub(crate) fn looked_beside_others(&mut self, until: f64) {
        self.by_both_until.until = Some(until);
    }

    /// Compensated detector in use: that with the other rods, unless they are absent.
    fn watching(&self) -> Option<&Compensated> {
        let stands_in = self.without_others > companions::PATIENCE;
        let alone = self.by_temperature.as_ref().filter(|_| stands_in);
        alone.or(self.compensated.as_ref())
    }

    /// Time from which on changes count for the detector in use: one with temperature only stands in for one with the other rods.
    fn watching_since(&self) -> Option<f64> {
        self.watching()
            .filter(|one| !one.knows_others)
            .and(self.by_both_until.until)
    }

    /// R of the detector in use.
    fn watching_statistic(&self) -> f64 {
        let since = self.watching_since();
        self.watching()
            .map_or(0.0, |one| one.detector.statistic_since(since))
    }

    /// Finds the detectors above their limit. Periods since the onset of a change reported now do not count
    /// for commissioning.
    fn look(&mut self, limit: f64) {
        let was_told = self.above.any();
        let is_above = |detector: &Detector, since, limit| detector.statistic_since(since) > limit;
        let peers = |since, limit| (self.peers.as_ref()).is_some_and(|peers| is_above(peers, since, limit));
        self.above = Above {
            compensated: self.watching_statistic() > limit,
            peers: peers(None, RARER * limit),
            peers_alone: peers(self.by_temperature_until.until, limit),
            blind: is_above(&self.blind, self.informed_until(), limit),
        };
        if !was_told
            && self.above.any()
            && let Some(change) = self.change()
        {
            for known in [&mut self.compensated, &mut self.by_temperature]
                .into_iter()
                .flatten()
            {
                known.withdraw(change.onset_interval[0]);
            }
        }
    }

    /// True while other rods bear witness.
    pub(crate) fn has_witnesses(&self) -> bool {
        self.peers.is_some() && self.without_others <= companions::PATIENCE
    }

    /// Joint finding of the detectors after the last period, `index`. What shows only relative to the median may be another rod;
    /// `is_new`: not for so long that it would have been reported.
    pub(crate) fn finding(&self, others: &Others, index: i64, is_new: bool) -> Finding {
        let is_smaller = || others.is_one_of_them(index, || self.size().abs());
        if is_new && self.evidence_alone(None) <= MOVING && is_smaller() {
            return Finding::Quiet;
        }
        let has_witnesses = self.has_witnesses();
        if self.above.compensated {
            if has_witnesses && self.above.peers {
                Finding::Drift(Witness::Confirmed)
            } else if !self.is_calm(others, index) {
                let rods = (others.count() + 1) as f64;
                if self.watching_statistic() > rods * self.limit {
                    Finding::Common
                } else {
                    Finding::Waiting
                }
            } else if has_witnesses {
                Finding::Drift(Witness::Unconfirmed)
            } else {
                Finding::Drift(Witness::Alone)
            }
        } else if self.last.temperature {
            Finding::Quiet
        } else if self.last.others {
            if self.above.peers_alone {
                Finding::Drift(Witness::Peers)
            } else {
                Finding::Quiet
            }
        } else if self.above.blind {
            Finding::Drift(Witness::Blind)
        } else {
            Finding::Quiet
        }
    }

    /// Onset, size and shape of the change, by the best-informed detector of the last period.
    pub(crate) fn change(&self) -> Option<Change> {
        // What stands in counts onsets since the middle of the last period that a better-informed one took. That period may have
        // been a mixture: the onset may lie in it.
        let change = |(detector, since): (&Detector, Option<f64>)| {
            detector.change_since(
                since,
                since
                    .zip(self.informed_from())
                    .map(|(since, from)| since.min(from)),
            )
        };
        self.informed().find_map(change)
    }

    /// Start of the last period that any detector with temperature or other rods took \[d\].
    fn informed_from(&self) -> Option<f64> {
        let thermal = [&self.compensated, &self.by_temperature].into_iter().flatten();
        let detectors = thermal.map(|one| &one.detector).chain(&self.peers);
        detectors.filter_map(Detector::began).reduce(f64::max)
    }

    /// Detectors that had their inputs in the last period, the best-informed first, each with the time from which on its changes
    /// count.
    fn informed(&self) -> impl Iterator<Item = (&Detector, Option<f64>)> {
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

    /// Change of the ratio of a record since commissioning at the reference temperature, and its standard deviation; `None`
    /// without its temperature.
    pub(crate) fn change_of(
        &self,
        day: f64,
        ratio: f64,
        sd: f64,
        filtered_c: Option<&[f64; FILTERS_D.len()]>,
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
        };
        compensated.change(&seen, self.limit, self.above.any())
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
        })
    }

    /// Sudden change that would be reported at the next period without a temperature, as a share of the
    /// force.
    pub(crate) fn least_told_blind(&self, day: f64) -> Option<f64> {
        Some(TOLD_SD * self.blind_law(day, 0.0, self.noise_sd)?.sd)
    }

    /// Restarts after a change that ended: the effect of temperature stays known.
    pub(crate) fn restart(&mut self) {
        if let Some(compensated) = &mut self.compensated {
            compensated.detector.restart();
        }
        if let Some(alone) = &mut self.by_temperature {
            alone.detector.restart();
        }
        if let Some(peers) = &mut self.peers {
            peers.restart();
        }
        self.blind.restart();
        self.above = Above::default();
        self.has_joined = false;
    }

    /// True while the detector with the rod's own data only sees a change.
    pub(crate) fn is_blind_above(&self) -> bool {
        self.blind.statistic() > self.limit
    }

    /// True once it has run long enough for absence of evidence to count.
    pub(crate) fn is_settled(&self) -> bool {
        self.blind.fresh() >= SETTLED_PERIODS
    }

    /// Notes if the rod moves with others of which one reported it; returns true if that is over now.
    pub(crate) fn joins(&mut self, others: &Others, index: i64, moves: bool) -> bool {
        let was_joined = self.has_joined;
        self.has_joined = others.has_told_common(index) && (was_joined || moves);
        was_joined && !self.has_joined
    }

    /// True while it moves with others of which one reported it.
    pub(crate) fn has_joined(&self) -> bool {
        self.has_joined
    }
}

/// The later of two times \[d\] after which changes count.
fn latest(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    one.into_iter().chain(other).reduce(f64::max)
}

/// Input of a detector for a period.
fn seen<'a>(period: &Period, columns: &'a [f64]) -> Seen<'a> {
    Seen {
        day: period.start.days(),
        began: period.began().days(),
        measured: period.time().days(),
        ratio: period.delta,
        sd: period.delta_sd,
        columns,
    }
}

/// Index of the filter shown as the rod's temperature: six hours.
const SHOWN: usize = 1;

#[cfg(test)]
mod tests {
    use super::super::period::start_of;
    use super::*;

    const DAY_S: f64 = 86_400.0;

    fn terms() -> Terms {
        Terms {
            limit: 3652.0,
            thermal: Some(ThermalPrior {
                slope_mean_per_k: -0.01,
                slope_sd_per_k: 0.01,
                curvature_sd_per_k2: 1e-5,
                is_sparse: false,
            }),
            reference_c: Some(10.0),
            learning_periods: 30,
        }
    }

    /// Follows a rod without others: -1 % a kelvin, no temperature in `dark` days.
    fn follow(days: i64, celsius: impl Fn(i64) -> f64, dark: impl Fn(i64) -> bool) -> Vec<Finding> {
        let all = chart(days, celsius, dark, |_| 0.0);
        all.into_iter().map(|(_, finding)| finding).collect()
    }

    /// The same, with a change of force.
    fn chart(
        days: i64,
        celsius: impl Fn(i64) -> f64,
        dark: impl Fn(i64) -> bool,
        change: impl Fn(i64) -> f64,
    ) -> Vec<(Charted, Finding)> {
        let mut watch = DriftWatch::new(0.0, 0.002);
        let one = |index: i64| {
            let warmer = celsius(index) - 10.0;
            let noise = 0.002 * (3.7 * index as f64).sin();
            let period = Period {
                index,
                start: start_of(index, DAY_S),
                began: None,
                measured: None,
                records: 1,
                delta: -0.01 * warmer + noise + change(index),
                delta_sd: 0.002,
                filtered_c: (!dark(index)).then_some([celsius(index); FILTERS_D.len()]),
                lagged_c: None,
                misfit: Vec::new(),
                not_axial_p: 1.0,
                charted: None,
            };
            let charted = watch.step(&terms(), &period, false, &Others::default(), DAY_S);
            (charted, watch.finding(&Others::default(), index, false))
        };
        (0..days).map(one).collect()
    }

    #[test]
    fn what_stands_in_tells_only_what_began_since() {
        // A warm spell that the temperature explains and nothing else does.
        let celsius = |day: i64| 10.0 + 2.0 * (day as f64 / 5.0).sin() + if day >= 60 { 25.0 } else { 0.0 };
        let blind = follow(80, celsius, |_| true);
        assert!(blind.contains(&Finding::Drift(Witness::Blind)), "{blind:?}");
        let gaps = follow(80, celsius, |day| matches!(day, 66 | 70));
        assert!(gaps.iter().all(|found| *found == Finding::Quiet), "{gaps:?}");
    }

    #[test]
    fn a_change_before_the_tenth_period_is_not_learned_into_the_level() {
        let celsius = |day: i64| 10.0 + 2.0 * (day as f64 / 5.0).sin();
        // The sixth period holds the change and is a mixture.
        let change = |day: i64| {
            if day < 6 {
                0.0
            } else {
                -0.08 * if day == 6 { 0.4 } else { 1.0 }
            }
        };
        let charted = chart(40, celsius, |_| false, change);
        let told = charted
            .iter()
            .position(|(_, finding)| *finding == Finding::Drift(Witness::Alone));
        assert!(matches!(told, Some(7..=9)), "{told:?}");
        let told = told.unwrap();
        assert!(
            charted[..told]
                .iter()
                .all(|(charted, _)| charted.at_reference.is_none())
        );
        for (charted, _) in &charted[told + 1..] {
            let (change, sd) = (charted.at_reference.unwrap(), charted.at_reference_sd.unwrap());
            assert!((change + 0.08).abs() < 3.0 * sd && sd < 0.02, "{change} {sd}");
        }
    }

    #[test]
    fn a_detector_that_did_not_take_a_period_has_no_evidence_of_it() {
        let celsius = |day: i64| 10.0 + 2.0 * (day as f64 / 5.0).sin();
        let charted = chart(70, celsius, |day| day >= 60, |_| 0.0);
        for (day, (charted, _)) in charted.iter().enumerate() {
            assert_eq!(charted.evidence.compensated.is_some(), day < 60, "{day}");
            assert!(charted.evidence.blind.is_some());
        }
    }
}
