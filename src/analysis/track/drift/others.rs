//! The other rods of a site, as input of one rod's drift watch.

use std::fmt::Debug;

/// R above which another rod counts as moving, too. With 50, no drift was raised for any of 50 rods beside a
/// thermometer that drifts by 0.03 K a day, nor for any of 50 beside one that jumps by 2 K; with 100 one of
/// each, with 300 six and three. Losses of 1 % were detected as soon.
pub(super) const MOVING: f64 = 50.0;

/// Another rod of the site at one moment of event time.
pub trait Neighbour: Debug + Sync {
    /// The rod's name.
    fn name(&self) -> &str;

    /// N_t / N_0 - 1 in a period, closed or still open; `None` if the rod was not measured in it.
    fn ratio_in(&self, index: i64, period_s: f64) -> Option<f64>;

    /// Evidence of a change of its own, given the temperature and the other rods; `None` before its detectors have begun.
    fn evidence(&self) -> Option<f64>;

    /// Evidence of a change from the rod's data without the others; `None` before its detectors have begun.
    fn evidence_alone(&self) -> Option<f64>;

    /// True if an alarm raised by its evidence is active: a drift, or a change that is not axial.
    fn drifts(&self) -> bool;

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

    /// Number of other rods.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The other rods that do not drift, by name, with N_t / N_0 - 1 where they were measured in a period.
    pub(crate) fn ratios(&self, index: i64, period_s: f64) -> impl Iterator<Item = (&str, Option<f64>)> {
        let steady = self.0.iter().filter(|rod| !rod.drifts());
        steady.map(move |rod| (rod.name(), rod.ratio_in(index, period_s)))
    }

    /// Number of them that show evidence of a change themselves, or were reported to have moved together.
    pub(crate) fn moving(&self) -> usize {
        let is_moving = |evidence: Option<f64>| evidence.is_some_and(|evidence| evidence > MOVING);
        let shows = |rod: &dyn Neighbour| is_moving(rod.evidence()) && is_moving(rod.evidence_alone());
        self.0
            .iter()
            .filter(|rod| (!rod.is_confirmed() && shows(**rod)) || rod.has_moved_with_others())
            .count()
    }

    /// True if a rod in the median shows more evidence of a change than this rod: that rod may be the one that moves.
    pub(crate) fn is_one_of_them(&self, evidence: f64) -> bool {
        let in_median = self.0.iter().filter(|rod| !rod.drifts());
        in_median
            .filter_map(|rod| rod.evidence())
            .any(|other| other > evidence)
    }

    /// True if one of them has already reported that rods move together.
    pub(crate) fn has_told_common(&self) -> bool {
        self.0.iter().any(|rod| rod.has_moved_with_others())
    }
}
