//! The drift watch of one rod: detectors that know the temperature, the other rods, or nothing but the rod, on the same
//! periods, and their joint finding.
//!
//! ```text
//! compensated      temperature, and the median of the other rods once two at least joined   drift
//! by_temperature   temperature alone, once they joined                                      stands in
//! peers            the other rods alone                                                     confirms, or stands in
//! blind            nothing but the rod                                                      stands in
//! ```
//!
//! A drifting thermometer moves every rod's compensated detector, but not the rods relative to each other: a
//! drift that `peers` also detects is confirmed; rods whose compensated detectors move together are one notice
//! of the site. Any of its J rods may bring that on, so that it needs J times the evidence of an alarm: the bound on false ones is
//! one for the site. A detector that stands in counts only what began since a better-informed one last looked and saw little: before,
//! that one saw more, and what it had begun to see is not lost with it. Another rod that drifts moves the median: a rod that shows a change only relative to the
//! median waits a few periods while a rod in the median shows a larger one. Once that rod is reported, the
//! median goes on without its change.

mod beside;
mod evidence;
mod finding;

pub(crate) use finding::Finding;
pub use finding::Witness;

use super::compensated::Compensated;
use super::others::Others;
use super::period::{Charted, Evidence, Period};
use super::{BankPrior, Companions, Detector, Law, Regressors, Seen, ThermalPrior};
use finding::Above;
use serde::{Deserialize, Serialize};

/// Upper limit of the evidence: R grows without bound while a change lasts.
const MOST_EVIDENCE: f64 = 1e12;

/// Periods between true changes of one rod, in periods between its false alarms: a change that the other rods confirm, and that is
/// taken off their median, must be as much more certain than an alarm.
const RARER: f64 = 10.0;

/// R above which a detector has some evidence of a change: one period by itself, whose part in R is bounded, reaches 60.
const BEGUN: f64 = 25.0;

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
    /// Start of the last period of commissioning \[d\], where a change ended it.
    pub commissioned_until: Option<f64>,
    /// Time since which a change of the force is told \[d\]: later periods are none of commissioning.
    pub told_since: Option<f64>,
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
    /// Newest period of the site when enough other rods had a baseline.
    awaited_since: Option<i64>,
    /// Start of the first record from which on the other rods' median is known \[d\]; `None` before they joined.
    others_since: Option<f64>,
    /// True once this rod moved together with others of which one reported it.
    has_joined: bool,
    /// Sources of the last period: temperature, other rods.
    last: Sources,
    /// Detectors above their limit after the last period.
    above: Above,
    /// True in a look ahead in which the detector by temperature stands in for the other rods.
    #[serde(skip)]
    are_others_late: bool,
    /// Last ratio, and its laws by each of the two other rods in the middle, where there was no temperature.
    last_ratio: f64,
    beside_others: Option<[Law; 2]>,
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
        let is_suspicious = detector.statistic_since(self.until) > BEGUN;
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
            awaited_since: None,
            others_since: None,
            has_joined: false,
            last: Sources::default(),
            above: Above::default(),
            are_others_late: false,
            last_ratio: 0.0,
            beside_others: None,
        }
    }

    /// Number of periods seen.
    pub fn periods(&self) -> usize {
        self.blind.periods()
    }

    /// Typical stated error of a period's ratio.
    pub(crate) fn noise_sd(&self) -> f64 {
        self.noise_sd
    }

    /// True if a temperature has ever come, or none is needed.
    pub fn is_compensated(&self) -> bool {
        self.compensated.is_some()
    }

    /// Takes a period; `history`: those before it, ascending.
    pub(crate) fn step(
        &mut self,
        terms: &Terms,
        period: &Period,
        history: &[Period],
        is_sparse: bool,
        others: &Others,
        period_s: f64,
    ) -> Charted {
        self.limit = terms.limit;
        let (day, measured) = (period.start.days(), period.time().days());
        self.begin(terms, period);
        self.await_others(terms, period, history, is_sparse, others, period_s);
        let found = self.take_others(period, others, period_s);
        let median = found.ratio;
        self.without_others = match median {
            Some(_) => 0,
            None if found.has_few => u32::MAX,
            None => self.without_others.saturating_add(1),
        };
        let regressors = Regressors {
            reference_c: 0.0,
            origin: self.origin,
        };
        let mut law = None;
        let is_commissioned = terms.commissioned_until.is_some_and(|until| day > until);
        let is_after_told = (is_commissioned || terms.commissioned_until.is_none())
            && terms.told_since.is_some_and(|since| measured > since);
        let (mut by_temperature, mut unread) = (None, 0.0);
        let mut seen_alone = None;
        self.last = Sources::default();
        if let Some(compensated) = &mut self.compensated
            && let Some(columns) = compensated.columns(day, period.filtered_c.as_ref(), median)
        {
            compensated
                .detector
                .set_sparse(is_sparse && compensated.knows_temperature);
            let is_told = self.above.any();
            if is_commissioned {
                compensated.end_level();
            }
            if !is_after_told {
                compensated.learn_level(measured, period.delta, &columns, terms.learning_periods, is_told);
            }
            let seen = seen(period, &columns, compensated.knows_temperature);
            unread = compensated.detector.unread(&seen);
            law = compensated.detector.step_with(&seen, unread);
            seen_alone = Some(columns);
            self.last.temperature = law.is_some();
            self.last.alone = law.is_some() && !compensated.knows_others;
        }
        if let Some(alone) = &mut self.by_temperature
            && let Some(columns) = alone.columns(day, period.filtered_c.as_ref(), None)
        {
            alone.detector.set_sparse(is_sparse);
            let is_told = self.above.any();
            if is_commissioned {
                alone.end_level();
            }
            if !is_after_told {
                alone.learn_level(measured, period.delta, &columns, terms.learning_periods, is_told);
            }
            let seen = seen(period, &columns, alone.knows_temperature);
            unread = alone.detector.unread(&seen);
            by_temperature = alone.detector.step_with(&seen, unread);
            self.last.alone = by_temperature.is_some();
            seen_alone = Some(columns);
        }
        if self.stands_in() {
            self.last.temperature |= by_temperature.is_some();
            law = by_temperature.or(law);
        }
        let middle = found
            .middle
            .filter(|_| !self.last.temperature && median.is_some());
        self.beside_others = middle.and_then(|middle| self.laws_beside_others(period, middle));
        self.last_ratio = period.delta;
        if let Some(median) = median
            && let Some(peers) = &mut self.peers
        {
            let seen_law = peers.step(&seen(period, &regressors.peers(day, median), false));
            self.last.others = seen_law.is_some();
            law = law.or(seen_law);
        }
        self.without_temperature = if self.last.temperature {
            0
        } else {
            self.without_temperature.saturating_add(1)
        };
        self.note_what_looked(measured);
        let blind_law = self.blind.step(&seen(period, &regressors.blind(day), false));
        self.look(terms.limit);
        // After the look: periods since the onset of a change that is reported now are no part of the level.
        let at_reference = seen_alone.and_then(|columns: Vec<f64>| {
            let measured_by = self.by_temperature.as_ref().or(self.compensated.as_ref())?;
            let seen = seen(period, &columns, measured_by.knows_temperature);
            measured_by.change(&seen, terms.limit, self.above.any() || is_after_told)
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
            unread_sd: Some(unread.sqrt()).filter(|sd| *sd > 0.0 && sd.is_finite()),
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

    /// In a look ahead at a period, lets the detector by temperature stand in for the other rods, most of which have not been measured yet:
    /// they did have their say on the period before, and left evidence of a change.
    pub(crate) fn stand_in_for_late(&mut self, others: &Others, index: i64, period_s: f64) {
        let has_begun = self.by_both_until.suspicious > 0;
        self.are_others_late = has_begun && self.has_witnesses() && others.are_late(index, period_s);
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
}

/// Input of a detector for a period.
fn seen<'a>(period: &'a Period, columns: &'a [f64], has_filters: bool) -> Seen<'a> {
    Seen {
        day: period.start.days(),
        began: period.began().days(),
        measured: period.time().days(),
        ratio: period.delta,
        sd: period.delta_sd,
        columns,
        unread_k2: period.unread_k2.as_ref().filter(|_| has_filters),
    }
}

/// Index of the filter shown as the rod's temperature: six hours.
const SHOWN: usize = 1;

#[cfg(test)]
mod tests {
    use super::super::filters::FILTERS_D;
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
            commissioned_until: None,
            told_since: None,
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
                unread_k2: None,
                lagged_c: None,
                misfit: Vec::new(),
                not_axial_p: 1.0,
                charted: None,
            };
            let charted = watch.step(&terms(), &period, &[], false, &Others::default(), DAY_S);
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
