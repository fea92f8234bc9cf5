//! Losses so large that nothing else explains them: reported from single records, in every state of the
//! tracker.
//!
//! With f^2 = a (N + b), b >= 0 for every mode of a beam under tension, a fall of a natural frequency bounds the force that is
//! left: N_t / N_0 <= (f_t / f_0)^2. That needs neither temperature nor training.
//!
//! Within the prepared range the ratio is compared with the law by which the rod's own data predicted it before the first
//! suspicious record ([`Before`]): the detector without temperature learns a lasting loss as normal within days. With a temperature,
//! the loss at the reference temperature must be certain as well, and the frequencies themselves must have fallen: a thermometer
//! that was replaced or moved to a colder place moves the first alone.
//!
//! Two records decide; one, if three modes or more agree on a loss of a fifth that shows in the frequencies themselves.

use super::change::SIGNAL_NOT_AXIAL_P;
use super::further::Further;
use super::tracker::{LOSS_RECORDS, Tracker};
use super::verdict::AtReference;
use crate::signal::record::Timestamp;
use crate::track::alarm::{Alarm, Cause, Kind};
use crate::track::baseline::Baseline;
use crate::track::drift::watch::{DriftWatch, Witness};
use crate::track::drift::{Change, Law};
use crate::track::observation::Observation;
use crate::track::relative::{Relative, Shift};
use serde::{Deserialize, Serialize};

/// A loss is sudden and certain if it exceeds the limit by this factor, or by this much.
const TIMES_LIMIT: f64 = 2.0;
const BEYOND_LIMIT: f64 = 0.1;

/// Least distance of a certain loss from the limit, in standard deviations.
const CERTAIN_SD: f64 = 4.0;

/// The same for the fall as measured where the loss at the reference temperature is certain already; within as much of the level
/// before, a loss is over.
const FALLEN_SD: f64 = 2.0;

/// Least loss, less [`FALLEN_SD`] standard deviations, that one record decides if its modes agree on it: no weather, no thermometer and no
/// peak beside the mode's makes it.
pub(super) const DECIDES_ALONE: f64 = 0.2;

/// Fewest modes that agree on the loss of one record: two have one degree of freedom, that a wild peak may fit.
const AGREEING_MODES: usize = 3;

/// Largest distance between the shares of force that the modes of a record beyond the prepared range leave, if they agree.
const AGREEING_SHARE: f64 = 0.05;

/// Longest time between two records of which the second confirms the first \[s\].
const CONFIRMS_S: f64 = 10.0 * 86_400.0;

/// Lower bound of the loss of force that a record shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Loss {
    /// Relative loss \[-\].
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// Ratio that one record shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Fall {
    /// N_t / N_0 - 1.
    pub ratio: f64,
    /// True if three modes or more agree that the change is one of force.
    pub is_agreed: bool,
}

impl From<&Relative> for Fall {
    fn from(relative: &Relative) -> Self {
        Self {
            ratio: relative.ratio.mean - 1.0,
            is_agreed: relative.freedom + 1 >= AGREEING_MODES && relative.not_axial_p >= SIGNAL_NOT_AXIAL_P,
        }
    }
}

/// Loss that one record shows by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Shown {
    /// The loss, with what is known of temperature taken off.
    loss: Loss,
    /// True if the frequencies themselves fell by as much as the limit; `None` of a bound, which asks for no temperature.
    fall: Option<bool>,
}

impl Shown {
    /// Of a record that the rod's own records predicted by a law.
    pub fn within(loss: Loss, fall: Fall, law: &Law, limit: f64) -> Self {
        let fall = Loss::from_law(fall.ratio, law).mean > limit;
        Self {
            loss,
            fall: Some(fall),
        }
    }

    /// Of a record beyond the prepared range.
    fn bound(loss: Loss) -> Self {
        Self { loss, fall: None }
    }
}

/// Law of a rod's ratio before the first record of a loss.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Before {
    /// Mean of N_t / N_0 - 1.
    mean: f64,
    /// Standard deviation of a record.
    sd: f64,
    /// Time of that record.
    pub(super) since: Timestamp,
    /// Loss that was told last; `None` before one is, and from earlier versions.
    #[serde(default)]
    pub(super) told: Option<f64>,
}

impl Before {
    /// The law with another error beside its own.
    pub(super) fn widened(self, sd: f64) -> Self {
        Self {
            sd: self.sd.hypot(sd),
            ..self
        }
    }

    /// The law in units of another baseline, with the force of this one as a share of its own.
    pub(super) fn scaled(self, share: f64) -> Self {
        Self {
            mean: (1.0 + self.mean) * share - 1.0,
            sd: self.sd * share,
            told: self.told.map(|told| told * share),
            ..self
        }
    }
}

impl From<&Change> for Loss {
    fn from(change: &Change) -> Self {
        Self {
            mean: -change.size,
            sd: change.size_sd,
        }
    }
}

impl Loss {
    /// True if it certainly exceeds a limit.
    pub fn exceeds(self, limit: f64) -> bool {
        self.is_beyond(limit, CERTAIN_SD)
    }

    fn is_beyond(self, limit: f64, distance_sd: f64) -> bool {
        self.mean > (TIMES_LIMIT * limit).min(limit + BEYOND_LIMIT)
            && self.mean - distance_sd * self.sd > limit
    }

    /// True if the ratio is back where it was before.
    fn is_over(self, limit: f64) -> bool {
        self.mean <= limit.max(FALLEN_SD * self.sd)
    }

    /// The loss of a record of this ratio, N_t / N_0 - 1, that was predicted by a law.
    pub fn from_law(ratio: f64, law: &Law) -> Self {
        Self {
            mean: law.mean - ratio,
            sd: law.sd,
        }
    }

    /// The law by which a record of this ratio shows the loss.
    pub(super) fn law_of(self, ratio: f64) -> Law {
        Law {
            mean: ratio + self.mean,
            sd: self.sd,
            leverage: 1.0,
        }
    }

    pub fn at_reference(at_reference: &AtReference) -> Self {
        Self {
            mean: 1.0 - at_reference.ratio.mean,
            sd: at_reference.ratio.sd,
        }
    }

    /// Lower end, beyond which the loss is certain.
    pub(super) fn certain(self) -> f64 {
        self.mean - CERTAIN_SD * self.sd
    }

    /// True if there is certainly none beyond a limit.
    pub(super) fn is_denied(self, limit: f64) -> bool {
        self.mean + CERTAIN_SD * self.sd < limit
    }

    /// Lower end, beyond which the loss is credible.
    fn least(self) -> f64 {
        self.mean - FALLEN_SD * self.sd
    }
}

/// Loss of a record beyond the prepared range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bound {
    pub loss: Loss,
    /// True if three modes or more agree that the change is one of force.
    is_agreed: bool,
}

impl Bound {
    /// The loss that a record shows; `None` unless all modes fell. With f^2 = a (N + b), a mode of the slope s = d ln f / d ln N leaves the
    /// share N_t / N_0 = 1 - (1 - (f_t / f_0)^2) / 2 s. Where the modes agree on it, the loss is that of their mean, with an error as large
    /// as their distance; else that of the mode that fell least, with b = 0.
    pub fn of(baseline: &Baseline, shift: &Shift, observation: &Observation) -> Option<Self> {
        let falls: Vec<(Loss, f64)> = (baseline.modes.iter())
            .filter_map(|known| {
                let mode = observation.mode(known.order)?;
                let least = Loss {
                    mean: -libm::expm1(2.0 * (mode.log_frequency - known.log_frequency)),
                    sd: 2.0 * mode.log_sd.hypot(known.log_sd),
                };
                Some((least, 0.5 / shift.slope(known.order)?))
            })
            .collect();
        let (least, _) = *falls.iter().min_by(|a, b| a.0.mean.total_cmp(&b.0.mean))?;
        if least.mean <= 0.0 {
            return None;
        }
        let lost = || falls.iter().map(|(fall, scale)| fall.mean * scale);
        let width = lost().fold(f64::MIN, f64::max) - lost().fold(f64::MAX, f64::min);
        let is_agreed = falls.len() >= AGREEING_MODES && width <= AGREEING_SHARE;
        let noise = falls
            .iter()
            .map(|(fall, scale)| fall.sd * scale)
            .fold(width, f64::max);
        let mean = Loss {
            mean: (lost().sum::<f64>() / falls.len() as f64).min(1.0),
            sd: noise,
        };
        Some(Self {
            loss: if is_agreed { mean } else { least },
            is_agreed,
        })
    }
}

/// Judges a loss as measured, and at the reference temperature if that is known: whether it holds, and the smaller one.
pub(super) fn judged(measured: Loss, at_reference: Option<Loss>, limit: f64) -> (Option<bool>, Loss) {
    let Some(known) = at_reference else {
        let holds = measured.exceeds(limit);
        return (
            holds.then_some(true).or(measured.is_over(limit).then_some(false)),
            measured,
        );
    };
    let smaller = if known.least() < measured.least() {
        known
    } else {
        measured
    };
    let holds = match (known.exceeds(limit), measured.is_beyond(limit, FALLEN_SD)) {
        (true, true) => Some(true),
        (false, _) => Some(false),
        (true, false) => None,
    };
    (holds, smaller)
}

impl Tracker {
    /// Checks the limit by one record, whose ratio the rod's own data predicted by `law`; `known` is its loss with the temperature taken
    /// off.
    pub(super) fn look_at_loss(
        &mut self,
        fall: Fall,
        law: Option<Law>,
        known: Option<Loss>,
        time: Timestamp,
    ) {
        let Some(law) = law else { return };
        let limit = self.plan.alarm.limit_loss;
        let stands = self.state.watches.stands(Cause::Loss);
        let is_recent = |before: &Before| stands || time.seconds_since(before.since) <= CONFIRMS_S;
        let kept = self.state.before.filter(is_recent);
        let mut before = kept.unwrap_or(Before {
            mean: law.mean,
            sd: law.sd,
            since: time,
            told: None,
        });
        let measured = Loss {
            mean: before.mean - fall.ratio,
            sd: before.sd,
        };
        // The signal of another rod decides nothing by itself, nor does a thermometer that may have died.
        let is_misled = known.is_some() && self.state.thermometer.may_have_died(time);
        let is_trusted = fall.is_agreed && !self.shows_another && !is_misled;
        let decides = is_trusted
            && known.unwrap_or(measured).least() >= DECIDES_ALONE
            && measured.mean >= DECIDES_ALONE;
        let (mut holds, loss) = judged(measured, known, limit);
        // What is uncertain at the reference temperature ends no loss.
        if stands && known.is_some_and(|known| !known.is_over(limit)) {
            holds = holds.filter(|holds| *holds);
        }
        // The level before is not known of a loss that the bound told, or an earlier version: its evidence keeps it.
        if stands && kept.is_none() && known.is_none() {
            let lasts = self.state.watch.get().is_none_or(DriftWatch::is_blind_above);
            holds = holds.filter(|holds| *holds || !lasts);
        }
        // The season may bring the ratio back, and leave the loss beside the other rods: they tell it now, or told it.
        if stands && known.is_none() && self.shows_beside_others(limit) {
            holds = holds.filter(|holds| *holds);
        }
        let is_further = !stands && known.is_none() && self.state.holds(Kind::Limit);
        self.find_loss(holds, loss, decides, time);
        if !self.state.watches.stands(Cause::Loss) {
            self.state.watches.end(Cause::Further);
        } else if is_further {
            self.tell_further_loss(loss.least(), time);
        } else if known.is_none() {
            let again = Loss::from_law(fall.ratio, &law);
            let further = Further {
                total: measured.mean,
                least: measured.least(),
                is_certain: again.exceeds(limit),
                decides: is_trusted && again.least() >= DECIDES_ALONE,
            };
            self.look_at_further_loss(&mut before, further, time);
        }
        let is_kept = holds == Some(true) || (kept.is_some() && self.state.watches.stands(Cause::Loss));
        self.state.before = is_kept.then_some(before);
    }

    /// True while a loss beyond a limit shows beside the other rods: to a rod that never had a temperature when they told it, still if it has
    /// one now.
    fn shows_beside_others(&self, limit: f64) -> bool {
        let by_others = |alarm: &&Alarm| alarm.cleared.is_none() && alarm.witness == Some(Witness::Peers);
        let told = self.state.alarms.iter().find(by_others);
        let watch = self.state.watch.get();
        let since_told = (watch.zip(told)).and_then(|(watch, told)| watch.testimony(told.latest_onset()).1);
        let exceeds =
            |change: Option<Change>| change.is_some_and(|change| Loss::from(&change).exceeds(limit));
        exceeds(since_told) || exceeds(self.change_without_temperature())
    }

    /// Change that shows beside the other rods, where there was no temperature.
    pub(super) fn change_without_temperature(&self) -> Option<Change> {
        self.state
            .watch
            .get()
            .and_then(DriftWatch::change_without_temperature)
    }

    /// Checks the limit by a record beyond the prepared range; returns the loss that it shows.
    pub(super) fn look_at_range(&mut self, observation: &Observation, time: Timestamp) -> Option<Shown> {
        let bound = Bound::of(
            self.state.segment.baseline.as_ref()?,
            self.shift.as_ref()?,
            observation,
        );
        self.look_at_bound(bound, time)
    }

    /// Checks the limit by the bound of a record beyond the prepared range, which is the loss that it shows. A bound below the limit does not
    /// end a loss.
    pub(super) fn look_at_bound(&mut self, bound: Option<Bound>, time: Timestamp) -> Option<Shown> {
        let Bound { loss, is_agreed } = bound?;
        let holds = loss.exceeds(self.plan.alarm.limit_loss).then_some(true);
        let decides = is_agreed && !self.shows_another && loss.least() >= DECIDES_ALONE;
        self.find_loss(holds, loss, decides, time);
        Some(Shown::bound(loss))
    }

    /// Checks a record that by itself shows a loss beyond the limit: one may be wild, so that nothing is decided by it, but nobody should
    /// wait for the next one without knowing. What is told already is nothing to suspect. A bound below the limit does not end it.
    pub(super) fn look_at_suspicion(&mut self, shown: Option<Shown>, time: Timestamp) {
        let Some(Shown { loss, fall }) = shown else { return };
        let limit = self.plan.alarm.limit_loss;
        let told = self.loss_told();
        // A thermometer that jumped moves no frequency.
        let fell = fall != Some(false);
        let holds = fell && told.is_some_and(|told| loss.mean - told - CERTAIN_SD * loss.sd > limit);
        let holds = (holds || fall.is_some() || told.is_none()).then_some(holds);
        self.look(Cause::Suspicion, holds, time, || {
            format!(
                "one record shows a loss of axial force of {:.1} ± {:.1} %, beyond the limit of {:.1} %: the force fell, or the record \
                 or the thermometer is wild; the next records decide",
                100.0 * loss.mean,
                100.0 * loss.sd,
                100.0 * limit
            )
        });
    }

    /// The loss that alarms have told; `None` under a `limit`, beyond which there is nothing to tell.
    fn loss_told(&self) -> Option<f64> {
        let mut told: f64 = 0.0;
        for alarm in (self.state.alarms.iter()).filter(|alarm| alarm.cleared.is_none()) {
            match alarm.kind {
                Kind::Limit => return None,
                kind if kind.is_latched() => {
                    let size = alarm.change.as_ref().map(|change| change.size.mean);
                    let stands = self.state.watch.get().map(DriftWatch::size);
                    told = told.max(-size.unwrap_or(0.0)).max(-stands.unwrap_or(0.0));
                }
                _ => {}
            }
        }
        Some(told)
    }

    /// Ends a suspicion with the records that it came from.
    pub(super) fn drop_suspicion(&mut self, time: Timestamp) {
        self.look(Cause::Suspicion, Some(false), time, String::new);
    }

    /// Notes if a loss holds; one that decides by itself counts as often as it takes.
    pub(super) fn find_loss(&mut self, holds: Option<bool>, loss: Loss, decides: bool, time: Timestamp) {
        let limit = self.plan.alarm.limit_loss;
        let decides = decides && holds == Some(true);
        for _ in 0..if decides { LOSS_RECORDS } else { 1 } {
            self.look(Cause::Loss, holds, time, || {
                format!(
                    "the axial force fell by {:.0} % at least, above the limit of {:.1} %, faster and further than any temperature moves it",
                    100.0 * loss.least(),
                    100.0 * limit
                )
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: f64 = 0.05;

    fn loss(mean: f64, sd: f64) -> Loss {
        Loss { mean, sd }
    }

    #[test]
    fn a_loss_at_the_reference_needs_frequencies_that_fell() {
        let certain = Some(loss(0.135, 0.003));
        // A thermometer that reads 9 K too low beside a rod of -1.5 % a kelvin: no frequency moved.
        assert_eq!(judged(loss(0.0, 0.02), certain, LIMIT).0, None);
        assert_eq!(judged(loss(0.04, 0.002), certain, LIMIT).0, None);
        let (holds, told) = judged(loss(0.13, 0.03), certain, LIMIT);
        assert_eq!((holds, told), (Some(true), loss(0.13, 0.03)));
        // A restrained rod: days of weather move it by 6.5 %.
        assert_eq!(
            judged(loss(0.2, 0.065), Some(loss(0.2, 0.003)), LIMIT).0,
            Some(true)
        );
        // Weather alone.
        assert_eq!(
            judged(loss(0.2, 0.01), Some(loss(0.01, 0.003)), LIMIT).0,
            Some(false)
        );
    }

    #[test]
    fn a_loss_without_a_temperature_ends_where_the_ratio_is_back() {
        let sd = 0.065;
        assert_eq!(judged(loss(0.4, sd), None, LIMIT).0, Some(true));
        assert_eq!(judged(loss(0.3, sd), None, LIMIT).0, None);
        assert_eq!(judged(loss(0.14, sd), None, LIMIT).0, None);
        assert_eq!(judged(loss(0.12, sd), None, LIMIT).0, Some(false));
        assert_eq!(judged(loss(0.04, 0.005), None, LIMIT).0, Some(false));
    }

    #[test]
    fn a_law_goes_into_the_units_of_another_baseline() {
        let before = Before {
            mean: 0.02,
            sd: 0.01,
            since: Timestamp::from_nanos(0),
            told: Some(0.2),
        };
        // The force of the first baseline is 1.25 times that of the second.
        let scaled = before.scaled(1.25);
        assert!((scaled.mean - 0.275).abs() < 1e-12 && (scaled.sd - 0.0125).abs() < 1e-12);
        assert_eq!(scaled.told, Some(0.25));
    }
}
