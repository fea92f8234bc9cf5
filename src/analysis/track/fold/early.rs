//! Watch over the records of the future baseline: a change during learning is reported on the next record,
//! not a month later.
//!
//! The first five records, fewer if one of them shows a large loss, give a provisional baseline; a drift watch runs on the periods measured against it until the baseline
//! is there. Both are dropped then: the baseline's own watch begins with its first record. A sudden large loss is a `limit` from
//! single records, as later.

use super::change::change_told;
use super::learning::mean_temperature;
use super::loss::{Bound, DECIDES_ALONE, Fall, Loss, Shown, judged};
use super::monitor::is_suspect;
use super::packed::Packed;
use super::plan::TrackPlan;
use super::provisional::Provisionals;
use super::silence::Doubted;
use super::tracker::Tracker;
use super::wording::sized;
use crate::signal::record::{Reading, Timestamp};
use crate::track::alarm::change::Change;
use crate::track::alarm::{Cause, Kind, Known};
use crate::track::baseline::Baseline;
use crate::track::drift::others::Others;
use crate::track::drift::period::{self, Pending};
use crate::track::drift::watch::{DriftWatch, Finding, Witness};
use crate::track::drift::{Filters, Law};
use crate::track::observation::Observation;
use crate::track::relative::{NoRelative, Relative, Shift};
use serde::{Deserialize, Serialize};

/// Number of records of the provisional baseline; fewest before a loss among them.
pub(super) const RECORDS: usize = 5;
const FEWEST: usize = 2;

/// Standard deviation of a rod's temperature from day to day \[K\]: days of 3 K and weather of 2.5 K.
const WEATHER_K: f64 = 4.0;

/// The same beside readings of the air, which a rod follows by hours \[K\].
const LAG_K: f64 = 1.5;

/// A provisional baseline and the periods measured against it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EarlyWatch {
    pub(crate) baseline: Baseline,
    filters: Filters,
    reference_c: Option<f64>,
    /// Mean temperature of the baseline's records.
    #[serde(default)]
    mean_c: Option<f64>,
    /// Records of the period that is still open.
    open: Vec<Pending>,
    watch: Packed<DriftWatch>,
    /// Start of the last record taken.
    taken: Option<Timestamp>,
    /// True if the last period closed may show the beginning of a change.
    #[serde(default)]
    is_suspect: bool,
}

/// A change found by the early watch, with the detectors behind it.
type Found = (Change, Witness);

/// One record against the provisional baseline.
enum Taken {
    /// Within the prepared range.
    Within {
        fall: Fall,
        /// Law by which the records before predicted it by themselves.
        alone: Law,
        /// Its loss by its temperature.
        by_temperature: Option<Loss>,
    },
    /// Beyond the prepared range, with the bound of its loss.
    Beyond(Option<Bound>),
    /// Without a mode of the baseline.
    Without,
}

impl EarlyWatch {
    /// A watch before its first record.
    fn new(baseline: Baseline, mean_c: Option<f64>) -> Self {
        Self {
            baseline,
            filters: Filters::default(),
            reference_c: None,
            mean_c,
            open: Vec::new(),
            watch: Packed::default(),
            taken: None,
            is_suspect: false,
        }
    }

    /// Takes a record; returns the change, if the periods closed so far show one.
    fn take(
        &mut self,
        plan: &TrackPlan,
        shift: &Shift,
        observation: &Observation,
        readings: &[Reading],
    ) -> (Taken, Option<Found>) {
        self.taken = Some(observation.start);
        let seed = plan.seed_of(b"early", 0, Some(observation.start));
        let relative = match shift.relative(observation, seed) {
            Ok(relative) => relative,
            Err(NoRelative::OutsideRange) => {
                return (Taken::Beyond(Bound::of(&self.baseline, shift, observation)), None);
            }
            Err(NoRelative::NoCommonMode) => return (Taken::Without, None),
        };
        let period_s = plan.track.period_s;
        let index = period::index_of(observation.start, period_s);
        let is_later = self
            .open
            .first()
            .is_some_and(|first| period::index_of(first.start, period_s) < index);
        let found = if is_later {
            self.close(plan, shift, readings)
        } else {
            None
        };
        let ratio = relative.ratio.mean - 1.0;
        let by_itself = (self.watch.get())
            .and_then(|watch| watch.blind_law(observation.start.days(), ratio, relative.ratio.sd));
        // Before the first period ends nothing but the provisional baseline is known.
        let of_baseline = Law {
            mean: 0.0,
            sd: relative.ratio.sd,
            leverage: 1.0,
        };
        let law = by_itself.unwrap_or(of_baseline);
        let alone = Law {
            sd: law.sd.hypot(self.weather_sd(plan, shift)),
            ..law
        };
        let by_temperature = (self.loss_by_temperature(observation, &relative, readings))
            .or_else(|| self.loss_by_prior(plan, shift, observation, &relative, readings));
        self.open.push(Pending::new(observation, &relative));
        let taken = Taken::Within {
            fall: Fall::from(&relative),
            alone,
            by_temperature,
        };
        (taken, found)
    }

    /// The change that the end of the open period would show, if one is suspected. Nothing moves on.
    fn ahead(&self, plan: &TrackPlan, shift: &Shift, readings: &[Reading]) -> Option<Found> {
        let mut ahead = Some(self).filter(|early| early.is_suspect)?.clone();
        ahead.close(plan, shift, readings)
    }

    /// Loss of a record by its temperature; `None` without one.
    fn loss_by_temperature(
        &self,
        observation: &Observation,
        relative: &Relative,
        readings: &[Reading],
    ) -> Option<Loss> {
        let pending = Pending::new(observation, relative);
        let filters = self.filters.advanced(readings, pending.end);
        let law = self.watch.get()?.law_by_temperature(&pending, &filters)?;
        Some(Loss::from_law(pending.delta, &law))
    }

    /// Loss of a record by its temperature and the prior of its effect, before the first period ends; `None` without one.
    fn loss_by_prior(
        &self,
        plan: &TrackPlan,
        shift: &Shift,
        observation: &Observation,
        relative: &Relative,
        readings: &[Reading],
    ) -> Option<Loss> {
        let pending = Pending::new(observation, relative);
        let prior = plan.terms(&self.baseline, shift, None).thermal?;
        let [now_c, ..] = self
            .filters
            .advanced(readings, pending.end)
            .at(pending.end.days())?;
        let warmer_k = now_c - self.mean_c?;
        let by_lag = LAG_K * prior.slope_mean_per_k.hypot(prior.slope_sd_per_k);
        Some(Loss {
            mean: prior.slope_mean_per_k * warmer_k - pending.delta,
            sd: pending.sd.hypot(prior.slope_sd_per_k * warmer_k).hypot(by_lag),
        })
    }

    /// Standard deviation of the ratio by weather, before the rod has shown its own: a calm week teaches too little.
    fn weather_sd(&self, plan: &TrackPlan, shift: &Shift) -> f64 {
        let thermal = plan.terms(&self.baseline, shift, self.reference_c).thermal;
        thermal.map_or(0.0, |prior| {
            WEATHER_K * prior.slope_mean_per_k.hypot(prior.slope_sd_per_k)
        })
    }

    /// True if periods were closed, and their watch was of another layout.
    fn has_lost_its_watch(&self, period_s: f64) -> bool {
        let index = |time| period::index_of(time, period_s);
        let open = self.open.first().map(|first| index(first.start));
        self.watch.get().is_none() && open.is_some_and(|open| open > index(self.baseline.first))
    }

    /// Closes the open period.
    fn close(&mut self, plan: &TrackPlan, shift: &Shift, readings: &[Reading]) -> Option<Found> {
        let records = std::mem::take(&mut self.open);
        let period_s = plan.track.period_s;
        let index = period::index_of(records.first()?.start, period_s);
        let mut readings = readings.to_vec();
        let not_axial_p = |delta: f64, misfit: &[_]| shift.not_axial_p(delta, misfit);
        let period = period::combine(
            index,
            period_s,
            &records,
            &mut self.filters,
            &mut readings,
            None,
            not_axial_p,
        );
        self.reference_c = self.reference_c.or(period.filtered_c.map(|filtered| filtered[0]));
        let terms = plan.terms(&self.baseline, shift, self.reference_c);
        let watch = self.watch.get_or_insert_with(|| {
            DriftWatch::new(period.start.days(), period.delta_sd.max(f64::MIN_POSITIVE))
        });
        let others = Others::default();
        let charted = watch.step(&terms, &period, &[], self.filters.is_sparse(), &others, period_s);
        self.is_suspect = is_suspect(&charted);
        // There are no others: what moves, moves alone.
        match watch.finding(&others, index, false) {
            Finding::Drift(witness) => Some((change_told(watch, Some(shift))?, witness)),
            Finding::Quiet | Finding::Waiting | Finding::Common => None,
        }
    }
}

impl Tracker {
    /// Passes the latest observation that waits for the baseline to the early watch; returns the loss that it shows by itself.
    pub(crate) fn watch_early(&mut self, time: Timestamp) -> Option<Shown> {
        let segment = self.state.segment.number;
        // Records that were withdrawn take the provisional baseline with them; a watch that cannot be read any more is made anew
        // from all records.
        let first = self.state.learning.first().map(|first| first.start);
        let period_s = self.plan.track.period_s;
        if self
            .state
            .early
            .as_ref()
            .is_some_and(|early| Some(early.baseline.first) != first || early.has_lost_its_watch(period_s))
        {
            self.end_early();
        }
        if self.state.early.is_none() {
            let records = self.provisional_records(segment)?;
            let first = &self.state.learning[..records];
            let (baseline, shift) = self.provisionals.take(&self.plan, first, segment)?;
            self.state.early = Some(EarlyWatch::new(baseline, mean_temperature(&self.state, records)));
            self.early_shift = Some(shift);
        }
        let mut early = self.state.early.take()?;
        if self.early_shift.is_none() {
            self.early_shift = Some(self.plan.shift(&early.baseline));
        }
        let (mut found, mut last) = (None, None);
        let is_misled = self.plan.compensates() && self.state.thermometer.may_have_died(time);
        if let Some(shift) = &self.early_shift {
            let known = early.taken;
            for observation in self.state.learning.iter().filter(|one| Some(one.start) > known) {
                let (taken, change) = early.take(&self.plan, shift, observation, &self.state.readings);
                (found, last) = (change.or(found), Some(taken));
            }
            if found.is_none() && !is_misled {
                found = early.ahead(&self.plan, shift, &self.state.readings);
            }
        }
        self.state.early = Some(early);
        let shown = match last {
            Some(Taken::Within {
                fall,
                alone,
                by_temperature,
            }) => {
                // A loss that lasts is learned as an effect of temperature, or as the level.
                let is_led = is_misled || self.state.watches.stands(Cause::Loss);
                let by_temperature = by_temperature.filter(|_| !is_led);
                self.look_at_loss(fall, Some(alone), by_temperature, time);
                let loss = by_temperature.unwrap_or_else(|| Loss::from_law(fall.ratio, &alone));
                Some(Shown::within(loss, fall, &alone, self.plan.alarm.limit_loss))
            }
            Some(Taken::Beyond(bound)) => self.look_at_bound(bound, time),
            Some(Taken::Without) | None => None,
        };
        if let Some((change, witness)) = found {
            let message = message(&change);
            let known = Known {
                change: Some(change),
                witness: Some(witness),
                ..Known::default()
            };
            self.on_board(|board| board.raise(Kind::Drift, time, message, known));
        }
        shown
    }

    /// Checks a record whose clock is doubted against the provisional baseline: by its own readings, or by the bound beyond the prepared
    /// range. It teaches nothing and ends no loss; what stands was learned meanwhile, and is not looked at.
    pub(super) fn look_early_at_doubted(
        &mut self,
        observation: &Observation,
        own: &[Reading],
        others: &Others,
        time: Timestamp,
    ) {
        let limit = self.plan.alarm.limit_loss;
        let Some(mut early) = self.state.early.clone() else {
            return;
        };
        if self.state.watches.stands(Cause::Loss) {
            return;
        }
        let shift = (self.early_shift.take()).unwrap_or_else(|| self.plan.shift(&early.baseline));
        let readings = [&self.state.readings, own].concat();
        let (taken, _) = early.take(&self.plan, &shift, observation, &readings);
        self.early_shift = Some(shift);
        // The last record that is believed came before it, and may be one of the baseline.
        let time = time.plus_seconds(1.0);
        let shown = match taken {
            Taken::Within {
                fall,
                alone,
                by_temperature: Some(loss),
            } if !own.is_empty() => {
                let falls_alone = -fall.ratio > limit && self.falls_alone(observation.start, loss, others);
                self.state.doubted = Some(Doubted::new(observation.start, fall.ratio, Some(loss)));
                if !loss.exceeds(limit) {
                    return;
                }
                let (law, known) = if falls_alone {
                    (loss.law_of(fall.ratio), None)
                } else {
                    (alone, Some(loss))
                };
                // By itself it decides nothing that its frequencies do not show.
                let is_trusted = !self.state.thermometer.may_have_died(time);
                let fall = Fall {
                    is_agreed: fall.is_agreed && is_trusted && -fall.ratio >= DECIDES_ALONE,
                    ..fall
                };
                if judged(Loss::from_law(fall.ratio, &law), known, limit).0 == Some(true) {
                    self.look_at_loss(fall, Some(law), known, time);
                }
                Some(Shown::within(loss, fall, &law, limit))
            }
            Taken::Beyond(Some(bound)) => self.look_at_bound(Some(bound), time),
            Taken::Within { .. } | Taken::Beyond(None) | Taken::Without => return,
        };
        self.look_at_suspicion(shown, time);
    }

    /// Number of records of the provisional baseline: the first five, or those before one of these that shows a certain loss. `None` if
    /// there are too few yet.
    fn provisional_records(&mut self, segment: u32) -> Option<usize> {
        let count = self.state.learning.len();
        let intact = (FEWEST..count.min(RECORDS))
            .rev()
            .find(|&before| self.shows_loss(before, segment));
        intact.or((count >= RECORDS).then_some(RECORDS))
    }

    /// True if a record after the first `before` shows a certain loss against the baseline of these.
    fn shows_loss(&mut self, before: usize, segment: u32) -> bool {
        let (learning, readings) = (&self.state.learning, &self.state.readings);
        let limit = self.plan.alarm.limit_loss;
        let prepared = self.provisionals.of(&self.plan, &learning[..before], segment);
        let Some((baseline, shift)) = prepared else {
            return false;
        };
        let early = EarlyWatch::new(baseline.clone(), mean_temperature(&self.state, before));
        learning[before..].iter().any(|record| {
            match early.clone().take(&self.plan, shift, record, readings).0 {
                Taken::Within {
                    fall,
                    alone,
                    by_temperature,
                } => judged(Loss::from_law(fall.ratio, &alone), by_temperature, limit).0 == Some(true),
                Taken::Beyond(bound) => bound.is_some_and(|bound| bound.loss.exceeds(limit)),
                Taken::Without => false,
            }
        })
    }

    /// Number of the first `wanted` records that wait for a baseline which came before a change told of them, two
    /// at least; all without such a change. A baseline of both would be one of no force that the rod ever had.
    pub(crate) fn intact_records(&self, wanted: usize) -> usize {
        let state = &self.state;
        let Some(early) = &state.early else { return wanted };
        let learning = &state.learning[..wanted];
        let before = |time: Timestamp| learning.partition_point(|record| record.start < time);
        let first = early.baseline.first;
        let told = (state.alarms.iter()).filter(|alarm| alarm.cleared.is_none() && alarm.raised >= first);
        let counts = told.filter_map(|alarm| match (alarm.kind, &alarm.change) {
            (Kind::Drift, Some(change)) => Some(before(change.onset_q025)),
            // Beyond the prepared range, the second record of the loss may have raised it.
            (Kind::Limit, _) => Some(
                state
                    .before
                    .map_or(before(alarm.raised).saturating_sub(1), |law| before(law.since)),
            ),
            _ => None,
        });
        // A provisional baseline of fewer than five records ends where the loss begins.
        let shown = Some(early.baseline.records).filter(|records| *records < RECORDS);
        let count = counts.min().map(|count| count.min(shown.unwrap_or(count)));
        count.map_or(wanted, |count| count.clamp(FEWEST.min(wanted), wanted))
    }

    /// Drops the early watch: its baseline is there, or could not be learned.
    pub(crate) fn end_early(&mut self) {
        (self.state.early, self.early_shift) = (None, None);
        self.provisionals = Provisionals::default();
    }

    /// Puts the law before a loss, told while learning, into the units of the baseline: the provisional one's `records` have the
    /// ratio one in the mean.
    pub(crate) fn take_over_loss(&mut self, records: usize) {
        let first = &self.state.open[..records.min(self.state.open.len())];
        let share = 1.0 + first.iter().map(|pending| pending.delta).sum::<f64>() / first.len().max(1) as f64;
        self.state.before = self.state.before.map(|before| before.scaled(share));
    }
}

fn message(change: &Change) -> String {
    format!(
        "the axial force {} while the baseline is being learned: if that is known and accepted, begin the baseline anew with \
         `tirante rebaseline`",
        sized(&change.size)
    )
}
