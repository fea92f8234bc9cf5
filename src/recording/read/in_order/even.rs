//! Stretches of a channel that are in order by their log times, and those that are not.
//!
//! Messages that were written late fill the hole that they left: in the order of their times the channel is even.
//! Where stamps scatter, one is late or wild, a block is there twice, or the clock was set back, they come
//! between others that are there already, or leave a hole where they stand: the order of the file is the true one.

use super::window::Entry;
use std::collections::{BTreeMap, BTreeSet};

/// Messages of all channels that are judged together, at most.
const TOGETHER: usize = 256 << 10;
/// Longest stretch that keeps its order among chunks that do not \[ns\].
const LONGEST_NS: u64 = 60_000_000_000;
/// Least and greatest distance of a message that is in its place from its neighbours, by the usual one.
const NEAREST: f64 = 0.6;
const FARTHEST: f64 = 1.5;
/// Share of the messages out of order that must be in their place when they are ordered.
const FITTING: f64 = 0.75;

/// A message by its log time \[ns\] and its place in the file.
type Stamp = (u64, (u32, u32));

/// Stretches of log times of each channel whose messages keep the order of the file.
#[derive(Debug, Default)]
pub(super) struct Kept(BTreeMap<u16, Vec<Stretch>>);

#[derive(Debug)]
struct Stretch {
    from: u64,
    to: u64,
    /// Latest time so far.
    latest: u64,
}

impl Kept {
    /// Time by which a message is ordered \[ns\]. Those of a channel come in the order of the file.
    pub fn time(&mut self, channel: u16, time: u64) -> u64 {
        let Some(stretches) = self.0.get_mut(&channel) else {
            return time;
        };
        let at = stretches.partition_point(|stretch| stretch.to < time);
        match stretches.get_mut(at).filter(|stretch| stretch.from <= time) {
            Some(stretch) => {
                stretch.latest = stretch.latest.max(time);
                stretch.latest
            }
            None => time,
        }
    }
}

/// Judges the messages of a file, which come in the order of their times.
pub(super) struct Even<'a> {
    /// Log time at which each chunk of the file begins \[ns\].
    begins: &'a [u64],
    /// Channels of samples: readings of others need not be even.
    sampled: &'a BTreeSet<u16>,
    channels: BTreeMap<u16, Vec<Stamp>>,
    count: usize,
    kept: Kept,
    /// True while chunks can be read by time.
    is_possible: bool,
}

impl<'a> Even<'a> {
    pub fn new(begins: &'a [u64], sampled: &'a BTreeSet<u16>) -> Self {
        Self {
            begins,
            sampled,
            channels: BTreeMap::new(),
            count: 0,
            kept: Kept::default(),
            is_possible: true,
        }
    }

    /// Takes the next message.
    pub fn push(&mut self, entry: Entry) {
        if !self.sampled.contains(&entry.channel) {
            return;
        }
        let stamps = self.channels.entry(entry.channel).or_default();
        stamps.push((entry.time, (entry.chunk, entry.offset)));
        self.count += 1;
        if self.count >= TOGETHER {
            self.judge();
        }
    }

    /// Stretches that keep their order; `None` if one is too long, or lies in chunks that are read in another order.
    pub fn finish(mut self) -> Option<Kept> {
        self.judge();
        self.is_possible.then_some(self.kept)
    }

    fn judge(&mut self) {
        self.count = 0;
        for (channel, stamps) in std::mem::take(&mut self.channels) {
            for stretch in uneven(&stamps) {
                let (from, to) = (stretch.first(), stretch.last());
                let (Some((from, _)), Some((to, _))) = (from, to) else {
                    continue;
                };
                let mut chunks: Vec<u32> = stretch.iter().map(|(_, place)| place.0).collect();
                chunks.sort_unstable();
                let begin = |chunk: &u32| self.begins.get(*chunk as usize);
                self.is_possible &= to - from <= LONGEST_NS && chunks.is_sorted_by_key(begin);
                let kept = self.kept.0.entry(channel).or_default();
                kept.push(Stretch {
                    from: *from,
                    to: *to,
                    latest: 0,
                });
            }
        }
    }
}

/// Stretches that are out of order in the file, and no better by time. `stamps` are in the order of their times.
fn uneven(stamps: &[Stamp]) -> Vec<&[Stamp]> {
    if stamps.is_sorted_by_key(|(_, place)| *place) {
        return Vec::new();
    }
    // Of each place in the file the rank by time.
    let mut ranks: Vec<usize> = (0..stamps.len()).collect();
    ranks.sort_unstable_by_key(|rank| stamps[*rank].1);
    let mut steps: Vec<u64> = stamps.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let middle = steps.len() / 2;
    let usual = *steps.select_nth_unstable(middle).1 as f64;
    let mut found = Vec::new();
    let (mut from, mut latest) = (0, 0);
    for (place, rank) in ranks.iter().enumerate() {
        latest = latest.max(*rank);
        if latest == place {
            if place > from && !is_even(stamps, &ranks[from..=place], usual) {
                found.push(&stamps[from..=place]);
            }
            from = place + 1;
        }
    }
    found
}

/// True if the messages of a stretch out of order are in their place by time. `ranks`: in the order of the file.
fn is_even(stamps: &[Stamp], ranks: &[usize], usual: f64) -> bool {
    // Either these were written late or those early: the fewer.
    let behind = overtaken(ranks.iter().copied(), |rank, latest| rank < latest, usize::max);
    let ahead = overtaken(
        ranks.iter().rev().copied(),
        |rank, first| rank > first,
        usize::min,
    );
    let moved = if behind.len() <= ahead.len() {
        behind
    } else {
        ahead
    };
    let step = |rank: usize| Some((stamps.get(rank + 1)?.0 - stamps.get(rank)?.0) as f64);
    let fits = |rank: &&usize| {
        let beside = [rank.checked_sub(1).and_then(step), step(**rank)];
        let mut steps = beside.iter().flatten();
        steps.clone().all(|step| *step >= NEAREST * usual) && steps.any(|step| *step <= FARTHEST * usual)
    };
    let fitting = moved.iter().filter(fits).count();
    usual > 0.0 && fitting as f64 >= FITTING * moved.len() as f64
}

/// Ranks that are beyond the extreme of those before them.
fn overtaken(
    ranks: impl Iterator<Item = usize>,
    is_beyond: impl Fn(usize, usize) -> bool,
    extreme: impl Fn(usize, usize) -> usize,
) -> Vec<usize> {
    let mut so_far = None;
    let mut found = Vec::new();
    for rank in ranks {
        let reached = so_far.map_or(rank, |so_far| extreme(so_far, rank));
        if is_beyond(rank, reached) {
            found.push(rank);
        }
        so_far = Some(reached);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Stretches kept of messages whose stamps stand in the file as given.
    fn kept(times: &[u64]) -> Vec<(u64, u64)> {
        let mut stamps: Vec<Stamp> = times.iter().zip(0..).map(|(time, at)| (*time, (0, at))).collect();
        stamps.sort_unstable();
        let ends = |stretch: &[Stamp]| (stretch[0].0, stretch[stretch.len() - 1].0);
        uneven(&stamps).into_iter().map(ends).collect()
    }

    fn every_five(count: u64) -> Vec<u64> {
        (0..count).map(|i| 5 * i).collect()
    }

    #[test]
    fn what_was_written_late_or_shuffled_is_ordered() {
        let mut times = every_five(200);
        times[40..90].rotate_left(20);
        times.swap(120, 121);
        times[150..160].reverse();
        // Samples are lost before and behind.
        times.drain(147..149);
        times.drain(30..33);
        assert_eq!(kept(&times), []);
        // Scatter below a fifth of the interval does no harm.
        let scattered: Vec<u64> = times.iter().map(|time| 10 * time + time % 7).collect();
        assert_eq!(kept(&scattered), []);
    }

    #[test]
    fn late_and_wild_stamps_and_scatter_and_a_clock_set_back_stay() {
        let mut late = every_five(200);
        late[50] += 152;
        assert_eq!(kept(&late), [(255, 402)]);
        let mut wild = every_five(200);
        wild[50] = 100_000;
        assert_eq!(kept(&wild), [(255, 100_000)]);
        let mut swapped = every_five(200);
        (swapped[50], swapped[51]) = (254, 252);
        assert_eq!(kept(&swapped), [(252, 254)]);
        let back: Vec<u64> = (0..200).map(|i| 5 * i - if i < 100 { 0 } else { 102 }).collect();
        assert_eq!(kept(&back), [(398, 495)]);
        let mut twice = every_five(100);
        twice.extend(200..=210);
        assert_eq!(kept(&twice).len(), 1);
    }

    #[test]
    fn a_stretch_that_is_kept_comes_as_it_stands() {
        let stretch = Stretch {
            from: 10,
            to: 20,
            latest: 0,
        };
        let mut kept = Kept(BTreeMap::from([(1, vec![stretch])]));
        let times = [9, 12, 10, 15, 14, 20, 21, 3].map(|time| kept.time(1, time));
        assert_eq!(times, [9, 12, 12, 15, 15, 20, 21, 3]);
        assert_eq!(kept.time(2, 12), 12);
    }
}
