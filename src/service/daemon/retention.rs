//! Schedule of removing old JSON lines: one rod per tick, a few records at a time.

use crate::analysis::signal::record::{RodId, Timestamp};
use std::collections::BTreeMap;
use std::ops::Bound;

/// Position of the removal in each rod's lines, and the rod whose turn it is.
#[derive(Debug, Default)]
pub struct Retention {
    come_to: BTreeMap<RodId, Option<Timestamp>>,
    last: Option<RodId>,
}

impl Retention {
    /// The rod whose turn it is, and the time to continue from.
    pub fn next<T>(&mut self, rods: &BTreeMap<RodId, T>) -> Option<(RodId, Option<Timestamp>)> {
        let behind = match &self.last {
            Some(last) => (Bound::Excluded(last), Bound::Unbounded),
            None => (Bound::Unbounded, Bound::Unbounded),
        };
        let (rod, _) = rods
            .range::<RodId, _>(behind)
            .next()
            .or_else(|| rods.first_key_value())?;
        self.last = Some(rod.clone());
        Some((rod.clone(), self.come_to.get(rod).copied().flatten()))
    }

    /// Notes the time up to which a rod's lines were examined.
    pub fn came_to(&mut self, rod: RodId, time: Option<Timestamp>) {
        self.come_to.insert(rod, time);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rod_has_its_turn() {
        let rods: BTreeMap<RodId, ()> = ["a", "b", "c"].map(|rod| (RodId(rod.into()), ())).into();
        let mut retention = Retention::default();
        let mut turns = Vec::new();
        for number in 0..7 {
            let (rod, from) = retention.next(&rods).unwrap();
            assert_eq!(from.is_some(), number >= 3);
            retention.came_to(rod.clone(), Some(Timestamp::from_nanos(number)));
            turns.push(rod.0);
        }
        assert_eq!(turns.concat(), "abcabca");
        assert_eq!(retention.next::<()>(&BTreeMap::new()), None);
    }
}
