//! Conditions that cause alarms, and their runs: how often in a row each held or was absent.

use super::Kind;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Condition that is checked repeatedly. Two of them may cause one kind of alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Cause {
    /// The loss at the reference temperature exceeds the limit.
    Limit,
    /// A record shows a loss beyond the limit that nothing else explains.
    Loss,
    /// The change that the charts found is still significant over all periods together.
    Change,
    /// A period's misfit is not that of an axial change.
    Misfit,
    /// A change found by the evidence is not one of the axial force.
    Pattern,
    /// A record's conflict with the model.
    Conflict,
    /// A record cannot be used.
    Unusable,
    /// A record comes without a credible temperature.
    NoTemperature,
    /// A record differs from the baseline by more than the prepared range.
    OutsideRange,
    /// The temperature is far outside the learned range.
    Unlearned,
    /// One record by itself shows a loss beyond the limit.
    Suspicion,
    /// A record shows a further loss while one stands.
    Further,
}

impl Cause {
    /// Every cause.
    const ALL: [Self; 12] = [
        Self::Limit,
        Self::Loss,
        Self::Further,
        Self::Suspicion,
        Self::Change,
        Self::Misfit,
        Self::Pattern,
        Self::Conflict,
        Self::Unusable,
        Self::NoTemperature,
        Self::OutsideRange,
        Self::Unlearned,
    ];

    /// Kind of alarm that it raises.
    pub fn kind(self) -> Kind {
        match self {
            Self::Limit | Self::Loss | Self::Further => Kind::Limit,
            Self::Suspicion => Kind::Suspected,
            Self::Change => Kind::Drift,
            Self::Misfit | Self::Pattern => Kind::NotAxial,
            Self::Conflict => Kind::Conflict,
            Self::Unusable | Self::NoTemperature => Kind::Sensor,
            Self::OutsideRange | Self::Unlearned => Kind::OutsideTraining,
        }
    }
}

/// Counts of how often in a row a condition was found, and found absent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Run {
    held: usize,
    absent: usize,
    /// True if it was found to hold and has not ended since.
    stands: bool,
}

/// State of a condition by its run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// It holds.
    Holds,
    /// It has ended, and so has every other cause of its kind of alarm.
    Over,
    /// Too few in a row to decide, or another cause still holds.
    Undecided,
}

/// Runs of all conditions.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Watches(BTreeMap<Cause, Run>);

impl Watches {
    /// Adds one check of a condition: it holds (`Some(true)`), it is absent (`Some(false)`), or it lies
    /// between the raising and the clearing level (`None`), which breaks both runs.
    pub fn look(&mut self, cause: Cause, holds: Option<bool>, raise: usize, clear: usize) -> Standing {
        let run = self.0.entry(cause).or_default();
        (run.held, run.absent) = match holds {
            Some(true) => (run.held.saturating_add(1), 0),
            Some(false) => (0, run.absent.saturating_add(1)),
            None => (0, 0),
        };
        if run.held >= raise {
            run.stands = true;
            Standing::Holds
        } else if run.absent >= clear {
            run.stands = false;
            if self.any_stands(cause.kind()) {
                Standing::Undecided
            } else {
                Standing::Over
            }
        } else {
            Standing::Undecided
        }
    }

    /// Notes that a condition holds from now on, whatever its state was.
    pub fn begin(&mut self, cause: Cause) {
        self.0.insert(
            cause,
            Run {
                stands: true,
                ..Run::default()
            },
        );
    }

    /// Notes that a condition is over.
    pub fn end(&mut self, cause: Cause) {
        self.0.remove(&cause);
    }

    /// True if a condition was found to hold and has not ended since.
    pub fn stands(&self, cause: Cause) -> bool {
        self.0.get(&cause).is_some_and(|run| run.stands)
    }

    /// True if a cause of this kind of alarm was found to hold and has not ended since.
    fn any_stands(&self, kind: Kind) -> bool {
        let of_kind = Cause::ALL.iter().filter(|cause| cause.kind() == kind);
        of_kind
            .filter_map(|cause| self.0.get(cause))
            .any(|run| run.stands)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_condition_needs_a_run_to_raise_and_a_run_to_clear() {
        let mut watches = Watches::default();
        let mut look = |holds| watches.look(Cause::Limit, holds, 2, 3);
        assert_eq!(look(Some(true)), Standing::Undecided);
        assert_eq!(look(None), Standing::Undecided);
        assert_eq!(look(Some(true)), Standing::Undecided);
        assert_eq!(look(Some(true)), Standing::Holds);
        assert_eq!(look(Some(false)), Standing::Undecided);
        assert_eq!(look(Some(false)), Standing::Undecided);
        assert_eq!(look(Some(false)), Standing::Over);
    }

    #[test]
    fn an_alarm_of_two_causes_ends_with_the_last_of_them() {
        let mut watches = Watches::default();
        assert_eq!(watches.look(Cause::Unusable, Some(true), 1, 2), Standing::Holds);
        assert_eq!(
            watches.look(Cause::NoTemperature, Some(true), 1, 2),
            Standing::Holds
        );
        for _ in 0..2 {
            assert_eq!(
                watches.look(Cause::Unusable, Some(false), 1, 2),
                Standing::Undecided
            );
        }
        assert_eq!(
            watches.look(Cause::NoTemperature, Some(false), 1, 2),
            Standing::Undecided
        );
        assert_eq!(
            watches.look(Cause::NoTemperature, Some(false), 1, 2),
            Standing::Over
        );
    }
}
