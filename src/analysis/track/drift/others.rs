//! The other rods of a site, as input of one rod's drift watch.

use super::companions::{InPeriod, PATIENCE};
use super::gain::middle;
use crate::signal::record::Timestamp;
use std::fmt::Debug;

/// R above which another rod counts as moving, too. With 50, no drift was raised for any of 50 rods beside a
/// thermometer that drifts by 0.03 K a day, nor for any of 50 beside one that jumps by 2 K; with 100 one of
/// each, with 300 six and three. Losses of 1 % were detected as soon.
pub(crate) const MOVING: f64 = 50.0;

/// Deviation of a rod's latest ratio, in standard deviations, from which it may show the movement of another rod.
pub(crate) const DEVIATING_SD: f64 = 2.0;

/// Oldest movement that a rod can deny by its latest ratio \[d\].
const DENIED_D: f64 = 4.0;
/// Standard deviations of a rod's latest ratio by which a movement would have to show in it, if it stands still.
const DENYING_SD: f64 = 5.0;

/// Least share of the size expected from another rod's change that moves with it: less is a fluctuation of its own.
const SHARED: f64 = 0.3;
/// Least share of the larger of two changes that the smaller one is, if the rods changed alike.
const ALIKE: f64 = 0.5;
/// Most and least credible ratio of the slopes by which two rods follow a temperature.
const SLOPES: [f64; 2] = [1.0 / 3.0, 3.0];

/// A change of one rod that others may share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Movement {
    /// Time since which another rod's change may be the same \[d\].
    pub since: f64,
    /// Time since its earliest credible onset \[d\].
    pub age_d: f64,
    /// Change as a share of the force.
    pub size: f64,
    /// Slope of the ratio with temperature \[1/K\], if it is known.
    pub slope_per_k: Option<f64>,
}

impl Movement {
    /// True if another rod moved by as much in the same direction, each by its slope: as a wrong temperature, the weather, or the whole
    /// structure would move it.
    fn is_shared_by(&self, other: &dyn Neighbour, size: f64) -> bool {
        size / self.size > SHARED * self.by_slopes(other)
    }

    /// Movement of another rod over this one, by the slopes of both.
    fn by_slopes(&self, other: &dyn Neighbour) -> f64 {
        let [least, most] = SLOPES;
        let slopes = self.slope_per_k.zip(other.slope_per_k());
        let ratio = slopes.map_or(1.0, |(own, other)| (other / own).clamp(least, most));
        if ratio.is_nan() { 1.0 } else { ratio }
    }

    /// True if another rod stands still where a wrong temperature, the weather or the whole structure would have moved it far beyond its
    /// error. Only of the last days: what moves rods by and by is learned as a fluctuation of the one that moves less.
    fn is_denied_by(&self, other: &dyn Neighbour) -> bool {
        if self.age_d > DENIED_D {
            return false;
        }
        let latest = other.latest_deviations(self.since).into_iter().flatten().last();
        let expected = self.size * self.by_slopes(other).min(1.0);
        let moved = other.moved_alone(self.since) / expected;
        latest.is_some_and(|(off, sd)| {
            expected.abs() > DENYING_SD * sd && off / expected < SHARED && moved.abs() < SHARED
        })
    }

    /// True if another rod's watch shows evidence of this movement.
    fn shows_in(&self, other: &dyn Neighbour) -> bool {
        let since = Some(self.since);
        other.evidence(since) > MOVING
            && other.evidence_alone(since) > MOVING
            && self.is_shared_by(other, other.size())
    }

    /// True if another rod shows by its temperature alone that it changed by much the same share of force: what a whole structure does.
    /// The median holds such a change, so that beside it none may show.
    fn is_shared_alike(&self, other: &dyn Neighbour) -> bool {
        let share = other.moved_alone(self.since) / self.size;
        (ALIKE..=ALIKE.recip()).contains(&share)
    }

    /// True if the latest ratios of another rod lie off by as much: one period is no evidence by itself, and the rod that comes first
    /// with its second record would be told alone.
    fn begins_in(&self, other: &dyn Neighbour) -> bool {
        let mut latest = other.latest_deviations(self.since).into_iter().flatten();
        latest.any(|(off, sd)| off.abs() > DEVIATING_SD * sd && self.is_shared_by(other, off))
    }
}

/// Another rod of the site at one moment of event time.
pub trait Neighbour: Debug + Sync {
    /// The rod's name.
    fn name(&self) -> &str;

    /// N_t / N_0 - 1 in a period, closed or still open; `None` if the rod was not measured in it.
    fn ratio_in(&self, index: i64, period_s: f64) -> Option<f64>;

    /// Deviations of its last period from its law, and of its latest record that the watch has not taken yet from what its temperature
    /// predicted, as shares of the force with their standard deviations; `None` without one later than a time \[d\], or without a
    /// temperature.
    fn latest_deviations(&self, since: f64) -> [Option<(f64, f64)>; 2];

    /// Time of its latest record that is in no closed period, of a doubted clock, too, and N_t / N_0 - 1.
    fn latest_record(&self) -> Option<(Timestamp, f64)>;

    /// Time of its last record, if the clock of that is doubted, and the loss that it shows by its temperature, with its standard deviation.
    fn doubted_loss(&self) -> Option<(Timestamp, f64, f64)>;

    /// Number of the last period that ended; `None` before the first.
    fn last_period(&self) -> Option<i64>;

    /// Usual distance from one of its periods to the next, in periods: 1 if it is measured in each of them, 14 in daily ones if somebody
    /// comes every fortnight.
    fn usual_distance(&self) -> i64;

    /// Evidence of a change of its own that began after a time \[d\], given all that is known.
    fn evidence(&self, since: Option<f64>) -> f64;

    /// Evidence of such a change from the rod's data without the others.
    fn evidence_alone(&self, since: Option<f64>) -> f64;

    /// Change as it stands now, as a share of the force.
    fn size(&self) -> f64;

    /// Change that the rod shows by its temperature alone, as a share of the force: what began after a time \[d\] where that is evident,
    /// else the deviation of its latest record; zero without either.
    fn moved_alone(&self, since: f64) -> f64;

    /// Slope of the ratio with temperature \[1/K\], if it is known.
    fn slope_per_k(&self) -> Option<f64>;

    /// Expected change of the ratio beside the other rods: zero while there is little evidence of one.
    fn moved_beside_others(&self) -> f64;

    /// True while its records show a change whose size beside the other rods is not known yet: one that a single record suspects, or
    /// that was told of late. It bears no witness in such a period.
    fn is_in_doubt(&self, index: i64, period_s: f64) -> bool;

    /// True if an alarm raised by its evidence is active: a drift, or a change that is not axial.
    fn drifts(&self) -> bool;

    /// True if the change of such an alarm may be in a period, of the past, too.
    fn drifts_in(&self, index: i64, period_s: f64) -> bool;

    /// True if it has a baseline.
    fn has_baseline(&self) -> bool;

    /// True if the other rods confirm its drift: it moves by itself.
    fn is_confirmed(&self) -> bool;

    /// True if it was reported to have moved together with others.
    fn has_moved_with_others(&self) -> bool;
}

/// The other rods of the site at one moment of event time.
#[derive(Debug, Clone, Default)]
pub struct Others<'a>(Vec<&'a dyn Neighbour>);

impl<'a> Others<'a> {
    /// Collects these rods.
    pub fn new<N: Neighbour + 'a>(rods: impl IntoIterator<Item = &'a N>) -> Self {
        Self(rods.into_iter().map(|rod| rod as &dyn Neighbour).collect())
    }

    /// The other rods.
    pub(crate) fn rods(&self) -> impl Iterator<Item = &dyn Neighbour> {
        self.0.iter().copied()
    }

    /// Number of other rods.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The other rods in a period.
    pub(crate) fn in_period(&self, index: i64, period_s: f64) -> impl Iterator<Item = InPeriod<'_>> {
        self.0.iter().map(move |rod| InPeriod {
            rod: rod.name(),
            ratio: rod.ratio_in(index, period_s),
            is_in_doubt: rod.is_in_doubt(index, period_s),
            drift: (rod.drifts_in(index, period_s)).then(|| rod.moved_beside_others()),
        })
    }

    /// Number of them that are followed and have a baseline.
    pub(crate) fn known(&self, index: i64) -> usize {
        self.followed(index).filter(|rod| rod.has_baseline()).count()
    }

    /// True once all of them have a baseline.
    pub(crate) fn are_all_known(&self) -> bool {
        self.0.iter().all(|rod| rod.has_baseline())
    }

    /// Newest period of any that ended.
    pub(crate) fn newest_period(&self) -> Option<i64> {
        self.0.iter().filter_map(|rod| rod.last_period()).max()
    }

    /// Those of which a period ended of late, by their own rhythm: what a rod showed before its sensor died counts no more.
    fn followed(&self, index: i64) -> impl Iterator<Item = &dyn Neighbour> {
        self.0.iter().copied().filter(move |rod| {
            let patience = i64::from(PATIENCE) * rod.usual_distance();
            (rod.last_period()).is_some_and(|last| index.saturating_sub(last) <= patience)
        })
    }

    /// Number of them that show the same movement or begin to, or were reported to have moved together.
    pub(crate) fn moving(&self, index: i64, movement: &Movement) -> usize {
        let moves = |rod: &dyn Neighbour| {
            movement.shows_in(rod) || movement.begins_in(rod) || movement.is_shared_alike(rod)
        };
        self.followed(index)
            .filter(|rod| (!rod.is_confirmed() && moves(*rod)) || rod.has_moved_with_others())
            .count()
    }

    /// Number of them that stand still where this movement would have moved them.
    pub(crate) fn denying(&self, index: i64, movement: &Movement) -> usize {
        self.followed(index)
            .filter(|rod| movement.is_denied_by(*rod))
            .count()
    }

    /// Change that they show by temperature alone since a time \[d\], as a share of the force: the median, of two in the middle the lesser.
    pub(crate) fn moved_alone(&self, index: i64, since: f64) -> f64 {
        let moved = self.followed(index).map(|rod| rod.moved_alone(since)).collect();
        let [one, other] = middle(moved).unwrap_or_default();
        if one.abs() < other.abs() { one } else { other }
    }

    /// True while fewer than half of those that are followed have been measured in a period.
    pub(crate) fn are_late(&self, index: i64, period_s: f64) -> bool {
        let (mut followed, mut measured) = (0, 0);
        for rod in self.followed(index) {
            followed += 1;
            measured += usize::from(rod.ratio_in(index, period_s).is_some());
        }
        2 * measured < followed
    }

    /// True if one of those in the median shows evidence of a larger change than this one, no older, that moves it: what is taken off a
    /// rod that drifts does not.
    pub(crate) fn is_one_of_them(&self, index: i64, movement: &Movement) -> bool {
        let since = Some(movement.since);
        let in_median = |rod: &dyn Neighbour| {
            let taken_off = if rod.drifts() {
                rod.moved_beside_others().abs()
            } else {
                0.0
            };
            rod.size().abs() - taken_off
        };
        self.followed(index)
            .any(|rod| rod.evidence(since) > MOVING && in_median(rod) > movement.size.abs())
    }

    /// True if one of them has already reported that rods move together.
    pub(crate) fn has_told_common(&self, index: i64) -> bool {
        self.followed(index).any(|rod| rod.has_moved_with_others())
    }
}
