//! The other rods of a site, as one rod's drift watch sees them.

use super::site_rule::MOVING;
use crate::analysis::track::alarm::Kind;
use crate::analysis::track::fold::state::State;

/// The other rods of the site as they are at one moment of event time.
#[derive(Debug, Clone, Default)]
pub struct Others<'a>(Vec<&'a State>);

impl<'a> Others<'a> {
    /// The rods' states.
    pub fn new(states: impl IntoIterator<Item = &'a State>) -> Self {
        Self(states.into_iter().collect())
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The other rods that do not drift, by name, with N_t / N_0 - 1 where they were measured in a period.
    pub(crate) fn ratios(&self, index: i64, period_s: f64) -> impl Iterator<Item = (&str, Option<f64>)> {
        let steady = self.0.iter().filter(|state| !state.holds(Kind::Drift));
        steady.map(move |state| (state.rod.0.as_str(), state.ratio_in(index, period_s)))
    }

    /// How many of them show evidence of a change themselves, or were told to have moved together.
    pub(crate) fn moving(&self) -> usize {
        let shows = |state: &State| {
            state
                .watch
                .as_ref()
                .is_some_and(|watch| watch.evidence() > MOVING)
        };
        self.0
            .iter()
            .filter(|state| shows(state) || state.holds(Kind::Common))
            .count()
    }

    /// Whether one of them has told already that rods move together.
    pub(crate) fn has_told_common(&self) -> bool {
        self.0.iter().any(|state| state.holds(Kind::Common))
    }
}
