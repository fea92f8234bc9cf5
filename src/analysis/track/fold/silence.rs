//! Losses that show after a long silence, when a rod's own data say little: its yearly cycle is not known, and its clock may be wrong.
//!
//! The other rods were silent as long, and moved with the same weather. Each predicts a record's ratio by a straight line through their
//! common periods,
//!
//! ```text
//! y = mean(y) + b (x - mean(x)),    var = s^2 (1 + 1 / n + (x - mean(x))^2 / Sxx),
//! ```
//!
//! without a temperature, whatever was learned of it. A loss counts as large as it shows beside most of them, two at least: beside one
//! other rod nothing tells which of the two moved.
//!
//! Records whose clock is doubted ([`Doubted`]) are looked at as well: the loss may have come with the silence that makes it doubtful.

use super::loss::{Fall, Loss, Shown, judged};
use super::tracker::Tracker;
use crate::signal::record::{Reading, Timestamp};
use crate::track::drift::Law;
use crate::track::drift::companions::FEWEST;
use crate::track::drift::others::{Neighbour, Others};
use crate::track::drift::period::{self, Pending, Period};
use crate::track::observation::Observation;
use crate::track::plausibility::SILENCE_S;
use crate::track::relative::NoRelative;
use serde::{Deserialize, Serialize};

/// Largest distance in time of records that are compared \[s\].
const NEAR_S: f64 = 1.5 * 86_400.0;

/// Fewest common periods of two rods that tell how one follows the other.
const COMMON_PERIODS: usize = 15;

/// Least share of a loss beside the others by which a rod's own ratio fell: the season may hide the rest of it, and the others' rise may make
/// all of it.
const OWN_SHARE: f64 = 0.5;

/// The same where its temperature shows the loss as well.
const CONFIRMED_SHARE: f64 = 0.25;

/// Share of a loss that an error of the thermometer makes of any other rod at least, and its standard deviations: temperature moves no rod
/// three times as far as another.
const LEAST_SHARE: f64 = 1.0 / 3.0;
const LEAST_SD: f64 = 2.0;

/// Record of a clock that is doubted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Doubted {
    /// Its time.
    pub(super) start: Timestamp,
    /// N_t / N_0 - 1.
    pub(super) delta: f64,
    /// Loss that it shows by its temperature: mean and standard deviation.
    #[serde(default)]
    pub(super) loss: Option<(f64, f64)>,
}

impl Doubted {
    pub(super) fn new(start: Timestamp, delta: f64, loss: Option<Loss>) -> Self {
        Self {
            start,
            delta,
            loss: loss.map(|loss| (loss.mean, loss.sd)),
        }
    }
}

impl Tracker {
    /// Checks the limit by a record after a long silence, beside the other rods' latest ones; returns false if they show no loss beyond it, or
    /// say nothing, or if its temperature denies the loss.
    pub(super) fn look_at_loss_after_silence(
        &mut self,
        pending: &Pending,
        fall: Fall,
        known: Option<Loss>,
        others: &Others,
        time: Timestamp,
    ) -> bool {
        let limit = self.plan.alarm.limit_loss;
        if known.is_some_and(|loss| loss.is_denied(limit)) {
            return false;
        }
        let Some(before) = self.periods_before_silence(pending.start) else {
            return false;
        };
        let is_confirmed = known.is_some_and(|loss| loss.exceeds(limit));
        let share = if is_confirmed && !self.state.thermometer.may_have_died(time) {
            CONFIRMED_SHARE
        } else {
            OWN_SHARE
        };
        let law = self.law_beside_others(pending, before, others).filter(|law| {
            let loss = Loss::from_law(fall.ratio, law);
            loss.exceeds(limit) && self.has_fallen(fall.ratio, before, share, loss)
        });
        if law.is_some() {
            // What the rod's own data predicted before is less certain.
            self.state.before = None;
            self.look_at_loss(fall, law, None, time);
            // Later records are of other days.
            let step_sd = self.state.step_sd();
            self.state.before = self.state.before.map(|before| before.widened(step_sd));
        }
        law.is_some()
    }

    /// True if a ratio has itself fallen from the periods before a silence, by the limit and a share of its loss beside the others: they may
    /// have been tightened in it.
    fn has_fallen(&self, ratio: f64, before: &[Period], share: f64, loss: Loss) -> bool {
        let level = before.iter().map(|period| period.delta).sum::<f64>() / before.len() as f64;
        level - ratio > self.plan.alarm.limit_loss.max(share * loss.mean)
    }

    /// True if most of the other rods, two at least, show by their temperature nothing like a loss that one shows by its own while all clocks are
    /// doubted: another thermometer makes a loss of each.
    pub(super) fn falls_alone(&self, start: Timestamp, loss: Loss, others: &Others) -> bool {
        let near: Vec<_> = (others.rods())
            .filter_map(|other| other.doubted_loss())
            .filter(|(time, ..)| start.seconds_since(*time).abs() <= NEAR_S)
            .collect();
        let unlike = (near.iter())
            .filter(|(_, mean, sd)| mean.abs() + LEAST_SD * sd < LEAST_SHARE * loss.mean)
            .count();
        unlike >= FEWEST && 2 * unlike > near.len()
    }

    /// Law of a record after a long silence beside the other rods' latest ones; `None` with too few of them.
    fn law_beside_others(&self, pending: &Pending, before: &[Period], others: &Others) -> Option<Law> {
        let mut laws: Vec<Law> = others
            .rods()
            .filter_map(|other| self.law_beside(pending, other, before))
            .collect();
        let witnesses = FEWEST.max(laws.len() / 2 + 1);
        let certain = |law: &Law| Loss::from_law(pending.delta, law).certain();
        laws.sort_by(|one, other| certain(other).total_cmp(&certain(one)));
        laws.get(witnesses - 1).copied()
    }

    /// Periods before a silence that ended with a record, or not long before it: those after it may hold the loss. `None` without one.
    fn periods_before_silence(&self, start: Timestamp) -> Option<&[Period]> {
        let periods = &self.state.periods;
        let earlier = periods.partition_point(|period| period.time() < start);
        let mut later = start;
        for (place, period) in periods[..earlier].iter().enumerate().rev() {
            let time = period.time();
            if later.seconds_since(time) >= SILENCE_S {
                return Some(&periods[..=place]);
            }
            if start.seconds_since(time) >= SILENCE_S {
                return None;
            }
            later = time;
        }
        None
    }

    /// Law of a record beside another rod's latest one, by the periods before a silence.
    fn law_beside(&self, pending: &Pending, other: &dyn Neighbour, before: &[Period]) -> Option<Law> {
        let period_s = self.plan.track.period_s;
        let index = |time| period::index_of(time, period_s);
        let (time, now) = other.latest_record()?;
        let is_near = pending.start.seconds_since(time).abs() <= NEAR_S;
        if !is_near || other.drifts() || other.is_in_doubt(index(time), period_s) {
            return None;
        }
        let common: Vec<(f64, f64)> = (before.iter())
            .filter_map(|period| Some((other.ratio_in(period.index, period_s)?, period.delta)))
            .collect();
        if common.len() < COMMON_PERIODS {
            return None;
        }
        let count = common.len() as f64;
        let (x, y) = common.iter().fold((0.0, 0.0), |sum, pair| {
            (sum.0 + pair.0 / count, sum.1 + pair.1 / count)
        });
        let (sxx, sxy) = common.iter().fold((0.0, 0.0), |sum, pair| {
            let off = pair.0 - x;
            (sum.0 + off * off, sum.1 + off * (pair.1 - y))
        });
        let slope = if sxx > 0.0 { sxy / sxx } else { 0.0 };
        let squares: f64 = common
            .iter()
            .map(|pair| (pair.1 - y - slope * (pair.0 - x)).powi(2))
            .sum();
        let off = now - x;
        let leverage = 1.0 / count + if sxx > 0.0 { off * off / sxx } else { 0.0 };
        let variance = squares / (count - 2.0) * (1.0 + leverage) + pending.sd * pending.sd;
        // The weather moves both from one period to the next, unknown without adjacent ones.
        let step_sd = match self.state.step_sd() {
            _ if index(time) == index(pending.start) => 0.0,
            unknown if unknown <= 0.0 => return None,
            known => known,
        };
        Some(Law {
            mean: y + slope * off,
            sd: variance.sqrt().hypot(step_sd),
            leverage,
        })
    }

    /// Checks the limit by a closed period without a temperature, beside the other rods: after a long silence the rod's own data say little.
    /// The records of the open period confirm it, as far as the weather moves the rod from one period to the next. A change that is told
    /// beside the others has two periods behind it.
    pub(super) fn look_at_loss_beside_others(&mut self, period: &Period, others: &Others, time: Timestamp) {
        let limit = self.plan.alarm.limit_loss;
        let watch = self.state.watch.get();
        let law = watch.and_then(|watch| watch.law_without_temperature(others, period.index));
        let law = law.map(|law| Law {
            sd: law.sd.hypot(self.state.step_sd()),
            ..law
        });
        let change = self.change_without_temperature();
        // The first period that certainly holds the change.
        let first = change.and_then(|change| {
            let holds = |period: &&Period| period.time().days() >= change.onset_interval[1];
            self.state.periods.iter().find(holds)
        });
        let before = self.periods_before_silence(first.unwrap_or(period).time());
        let shows = |ratio: f64, loss: Loss| {
            let has_fallen = |before| self.has_fallen(ratio, before, OWN_SHARE, loss);
            loss.exceeds(limit) && before.is_none_or(has_fallen)
        };
        let exceeds = |ratio: f64| law.is_some_and(|law| shows(ratio, Loss::from_law(ratio, &law)));
        let open: Vec<f64> = self.state.open.iter().map(|pending| pending.delta).collect();
        if exceeds(period.delta) && !open.is_empty() && open.iter().copied().all(exceeds) {
            for ratio in std::iter::once(period.delta).chain(open) {
                let fall = Fall {
                    ratio,
                    is_agreed: false,
                };
                self.look_at_loss(fall, law, None, time);
            }
        } else if let Some(loss) = change.as_ref().map(Loss::from)
            && shows(period.delta, loss)
        {
            self.find_loss(Some(true), loss, true, time);
        }
    }

    /// Checks a record whose clock is doubted for a loss, by what the rod's own data and the record's own temperature predict of its time. It
    /// ends none.
    pub(super) fn look_at_doubted(&mut self, observation: &Observation, others: &Others) {
        let (time, limit) = (self.known_at(observation.start), self.plan.alarm.limit_loss);
        // They teach the thermometer's memory nothing.
        let mut thermometer = self.state.thermometer.clone();
        let credible = |reading: &&Reading| thermometer.believes(reading);
        let readings: Vec<Reading> = observation.readings.iter().filter(credible).copied().collect();
        if self.state.segment.baseline.is_none() {
            return self.look_early_at_doubted(observation, &readings, others, time);
        }
        let relative = match self.relative(observation) {
            Some(Ok(relative)) => relative,
            Some(Err(NoRelative::OutsideRange)) => {
                let shown = self.look_at_range(observation, time);
                return self.look_at_suspicion(shown, time);
            }
            Some(Err(NoRelative::NoCommonMode)) | None => return,
        };
        let pending = Pending::new(observation, &relative);
        let fall = Fall::from(&relative);
        let Some(watch) = self.state.watch.get() else {
            return;
        };
        let Some(law) = watch.blind_law(pending.start.days(), pending.delta, pending.sd) else {
            return;
        };
        let filters = self.state.filters.advanced(&readings, pending.end);
        let by_temperature = watch
            .law_by_temperature(&pending, &filters)
            .filter(|_| !readings.is_empty());
        let known = by_temperature.map(|law| Loss::from_law(pending.delta, &law));
        let measured = Loss::from_law(pending.delta, &law);
        let is_told = self.look_at_loss_after_silence(&pending, fall, known, others, time);
        self.state.doubted = Some(Doubted::new(pending.start, pending.delta, known));
        if !is_told {
            if judged(measured, known, limit).0 == Some(true) {
                self.look_at_loss(fall, Some(law), known, time);
            } else {
                self.find_loss(None, measured, false, time);
            }
        }
        let loss = known.unwrap_or(measured);
        if loss.exceeds(limit) {
            self.look_at_suspicion(Some(Shown::within(loss, fall, &law, limit)), time);
        }
    }
}
