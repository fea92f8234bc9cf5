//! One order of the results of a site's records: that of their times, whatever the order of reading.
//!
//! The items of one rod keep their order. Among several rods, the item complete first goes first; of those
//! complete at one time, that of the first name. An item waits while a rod may still bring an earlier one: a
//! rod without waiting items, not yet read beyond the item's time, and not further behind than the window. So
//! the order depends only on the rods' own histories, not on the progress of reading.

use crate::signal::record::{RodId, Timestamp};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Most items that wait; beyond, they are released in order at once.
const MOST: usize = 4096;

/// Time up to which each rod has been read: no item complete before this time is still to come. `None` for a
/// rod that ended.
pub type Reached = Arc<[(RodId, Option<Timestamp>)]>;

/// Items on their way into the order.
#[derive(Debug)]
pub struct Ordered<T> {
    window_s: f64,
    rods: BTreeMap<RodId, Waiting<T>>,
    count: usize,
}

#[derive(Debug)]
struct Waiting<T> {
    items: VecDeque<(Timestamp, T)>,
    reached: Option<Timestamp>,
}

impl<T> Ordered<T> {
    /// An empty order. A rod more than `window_s` behind another is not waited for \[s\].
    pub fn new(window_s: f64) -> Self {
        Self {
            window_s,
            rods: BTreeMap::new(),
            count: 0,
        }
    }

    /// Changes the window from now on \[s\].
    pub fn set_window(&mut self, window_s: f64) {
        self.window_s = window_s;
    }

    /// Number of items that wait.
    pub fn len(&self) -> usize {
        self.count
    }

    /// True if nothing waits.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Takes an item of a rod, complete at a time.
    pub fn push(&mut self, rod: &RodId, at: Timestamp, item: T) {
        self.of(rod).items.push_back((at, item));
        self.count += 1;
    }

    /// Notes the times up to which rods have been read.
    pub fn note(&mut self, reached: &[(RodId, Option<Timestamp>)]) {
        for (rod, reached) in reached {
            match self.rods.get_mut(rod) {
                Some(waiting) => waiting.reached = *reached,
                None => self.of(rod).reached = *reached,
            }
        }
    }

    /// The next item, if no earlier one can come.
    pub fn next_settled(&mut self) -> Option<T> {
        let (rod, at) = self.first()?;
        let newest = self.rods.values().filter_map(Waiting::newest).max();
        let may_be_earlier = |(name, other): (&RodId, &Waiting<T>)| {
            other.items.is_empty()
                && other.reached.is_some_and(|reached| {
                    let is_behind =
                        newest.is_some_and(|newest| newest.seconds_since(reached) > self.window_s);
                    (reached, name) < (at, &rod) && !is_behind
                })
        };
        if self.count <= MOST && self.rods.iter().any(may_be_earlier) {
            return None;
        }
        self.pop(&rod)
    }

    /// The next item, whatever may still come.
    pub fn next_of_all(&mut self) -> Option<T> {
        let (rod, _) = self.first()?;
        self.pop(&rod)
    }

    /// The rod whose item is next, and its time.
    fn first(&self) -> Option<(RodId, Timestamp)> {
        let heads = self
            .rods
            .iter()
            .filter_map(|(rod, waiting)| Some((waiting.items.front()?.0, rod)));
        heads.min().map(|(at, rod)| (rod.clone(), at))
    }

    fn pop(&mut self, rod: &RodId) -> Option<T> {
        let (_, item) = self.rods.get_mut(rod)?.items.pop_front()?;
        self.count -= 1;
        Some(item)
    }

    fn of(&mut self, rod: &RodId) -> &mut Waiting<T> {
        self.rods.entry(rod.clone()).or_insert_with(|| Waiting {
            items: VecDeque::new(),
            reached: None,
        })
    }
}

impl<T> Waiting<T> {
    /// Latest time known of a rod.
    fn newest(&self) -> Option<Timestamp> {
        self.reached.max(self.items.back().map(|(at, _)| *at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::ChaCha8Rng;
    use rand::{RngExt, SeedableRng};

    fn rod(index: usize) -> RodId {
        RodId(format!("rod-{index}"))
    }

    fn second(second: i64) -> Timestamp {
        Timestamp::from_nanos(second * 1_000_000_000)
    }

    /// Takes all items that may go.
    fn drain(ordered: &mut Ordered<(i64, usize)>, to: &mut Vec<(i64, usize)>) {
        to.extend(std::iter::from_fn(|| ordered.next_settled()));
    }

    #[test]
    fn the_order_is_that_of_time_whatever_is_read_first() {
        // Five rods, an item each in every 60 s at an offset of its own; two share theirs.
        let times: Vec<Vec<i64>> = [0, 7, 7, 20, 59]
            .iter()
            .map(|offset| (0..50).map(|index| 60 * index + offset).collect())
            .collect();
        let mut expected: Vec<(i64, usize)> = times
            .iter()
            .enumerate()
            .flat_map(|(rod, times)| times.iter().map(move |time| (*time, rod)))
            .collect();
        expected.sort_unstable();
        for seed in 0..200 {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut ordered = Ordered::new(1e9);
            let mut next = [0; 5];
            let mut found = Vec::new();
            // All are known from the start, as the channels of a recording are.
            let known: Vec<_> = (0..5).map(|index| (rod(index), Some(second(0)))).collect();
            ordered.note(&known);
            while next.iter().any(|&next| next < 50) {
                let index = rng.random_range(0..5usize);
                // A rod is read ahead of the others by up to seven items.
                for _ in 0..rng.random_range(1..8) {
                    let Some(&time) = times[index].get(next[index]) else {
                        break;
                    };
                    ordered.push(&rod(index), second(time), (time, index));
                    next[index] += 1;
                    ordered.note(&[(rod(index), Some(second(time + 1)))]);
                }
                drain(&mut ordered, &mut found);
            }
            found.extend(std::iter::from_fn(|| ordered.next_of_all()));
            assert_eq!(found, expected, "seed {seed}");
            assert!(ordered.is_empty());
        }
    }

    #[test]
    fn a_rod_that_fell_silent_holds_nobody_beyond_the_window() {
        let mut ordered = Ordered::new(3600.0);
        let mut found = Vec::new();
        ordered.note(&[(rod(0), Some(second(10))), (rod(1), Some(second(10)))]);
        ordered.push(&rod(1), second(100), (100, 1));
        ordered.note(&[(rod(1), Some(second(101)))]);
        drain(&mut ordered, &mut found);
        assert!(found.is_empty());
        ordered.note(&[(rod(1), Some(second(3611)))]);
        drain(&mut ordered, &mut found);
        assert_eq!(found, [(100, 1)]);
        // One that ended is not waited for at all.
        ordered.note(&[(rod(0), Some(second(3700)))]);
        ordered.push(&rod(1), second(3800), (3800, 1));
        drain(&mut ordered, &mut found);
        assert_eq!(found.len(), 1);
        ordered.note(&[(rod(0), None)]);
        drain(&mut ordered, &mut found);
        assert_eq!(found.len(), 2);
    }

    #[test]
    fn a_rod_keeps_its_own_order_through_a_step_of_its_clock() {
        let mut ordered = Ordered::new(3600.0);
        for (index, time) in [50, 4_000_000, 60, 70].into_iter().enumerate() {
            ordered.push(&rod(0), second(time), (time, index));
        }
        ordered.push(&rod(1), second(65), (65, 9));
        let mut found = Vec::new();
        drain(&mut ordered, &mut found);
        found.extend(std::iter::from_fn(|| ordered.next_of_all()));
        let order: Vec<usize> = found.iter().map(|(_, index)| *index).collect();
        assert_eq!(order, [0, 9, 1, 2, 3]);
    }
}
