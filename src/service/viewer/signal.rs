//! Samples as the daemon reads them, for the viewers that subscribe to a rod's signal.
//!
//! Each viewer has a queue with a limit: the reader never waits for a viewer, and a viewer that is too slow
//! misses the oldest samples and is told how many. Nothing is made for a rod that nobody listens to.

use super::{Message, Topic};
use crate::analysis::signal::record::{RodChannels, RodId, Timestamp};
use crate::recording::read::Listener;
use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Most samples that wait for one viewer, each block counted as [`BLOCK`] more: half a megabyte.
const WAITING: usize = 1 << 16;
/// Cost of a block beside its samples \[samples\].
const BLOCK: usize = 16;
/// Most samples of one block; a longer message is split.
const LONGEST: usize = 1 << 12;
/// Most samples handed over at once, so that a viewer is also served records and alarms.
const AT_ONCE: usize = 1 << 10;

/// Live signals of a daemon's rods.
#[derive(Default)]
pub struct Signals {
    rods: Mutex<Vec<(RodId, &'static str)>>,
    queues: Mutex<Vec<Arc<Queue>>>,
    /// True if any viewer wants any rod.
    is_heard: AtomicBool,
}

/// Samples that wait for one viewer.
#[derive(Default)]
struct Queue {
    waiting: Mutex<Waiting>,
    bell: Notify,
}

#[derive(Default)]
struct Waiting {
    wanted: BTreeSet<RodId>,
    blocks: VecDeque<Arc<Block>>,
    /// Cost of all blocks \[samples\].
    cost: usize,
    /// Number of samples that were left out since the last call.
    left_out: usize,
}

/// Consecutive samples of one message.
struct Block {
    rod: RodId,
    unit: &'static str,
    /// Time of the first sample.
    time: Timestamp,
    /// Interval of the samples \[s\].
    step_s: f64,
    /// Samples in SI units.
    samples: Vec<f64>,
}

/// Samples for one viewer.
#[derive(Debug, Default)]
pub struct Heard {
    /// One message per sample, in the order in which they were read.
    pub messages: Vec<Message>,
    /// Number of samples left out before them.
    pub left_out: usize,
}

/// One viewer's place among the listeners.
pub struct Ear {
    signals: Arc<Signals>,
    queue: Arc<Queue>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Signals {
    /// Sets the rods whose signals are offered.
    pub fn follow(&self, rods: &[RodChannels]) {
        *lock(&self.rods) = rods
            .iter()
            .map(|rod| (rod.rod.clone(), rod.displacement.unit.si()))
            .collect();
    }

    /// Topics of the signals offered.
    pub fn topics(&self) -> Vec<Topic> {
        let rods = lock(&self.rods);
        rods.iter().map(|(rod, _)| Topic::Signal(rod.clone())).collect()
    }

    /// A listener that passes samples on to the viewers.
    pub fn listener(self: &Arc<Self>) -> Listener {
        let signals = Arc::clone(self);
        Arc::new(move |rod, time, samples, fs_hz| signals.take(rod, time, samples, fs_hz))
    }

    /// A place for one more viewer, who wants nothing yet.
    pub fn listen(self: &Arc<Self>) -> Ear {
        let queue = Arc::<Queue>::default();
        lock(&self.queues).push(Arc::clone(&queue));
        Ear {
            signals: Arc::clone(self),
            queue,
        }
    }

    /// Passes on samples of a rod, the first of them at `time`.
    fn take(&self, rod: &RodId, time: Timestamp, samples: &[f64], fs_hz: Option<f64>) {
        if !self.is_heard.load(Ordering::Relaxed) {
            return;
        }
        let rods = lock(&self.rods);
        let Some((_, unit)) = rods.iter().find(|(known, _)| known == rod) else {
            return;
        };
        // Several samples in one message have a rate.
        let step_s = fs_hz.map_or(0.0, f64::recip);
        for (number, part) in samples.chunks(LONGEST).enumerate() {
            let mut block = None;
            for queue in lock(&self.queues).iter() {
                let mut waiting = lock(&queue.waiting);
                if !waiting.wanted.contains(rod) {
                    continue;
                }
                let block = block.get_or_insert_with(|| {
                    Arc::new(Block {
                        rod: rod.clone(),
                        unit,
                        time: time.plus_seconds((number * LONGEST) as f64 * step_s),
                        step_s,
                        samples: part.to_vec(),
                    })
                });
                waiting.push(Arc::clone(block));
                queue.bell.notify_one();
            }
        }
    }

    /// Notes if any viewer wants any rod.
    fn look(&self) {
        let queues = lock(&self.queues);
        let is_heard = queues.iter().any(|queue| !lock(&queue.waiting).wanted.is_empty());
        self.is_heard.store(is_heard, Ordering::Relaxed);
    }
}

impl Waiting {
    /// Adds a block; the oldest give way.
    fn push(&mut self, block: Arc<Block>) {
        self.cost += BLOCK + block.samples.len();
        self.blocks.push_back(block);
        while self.cost > WAITING
            && let Some(oldest) = self.blocks.pop_front()
        {
            self.cost -= BLOCK + oldest.samples.len();
            self.left_out += oldest.samples.len();
        }
    }

    /// Removes the next blocks, with [`AT_ONCE`] samples and those of one block more at most.
    fn pull(&mut self) -> Option<Heard> {
        let mut heard = Heard::default();
        while heard.messages.len() < AT_ONCE
            && let Some(block) = self.blocks.pop_front()
        {
            self.cost -= BLOCK + block.samples.len();
            heard
                .messages
                .extend(block.samples.iter().enumerate().map(|(at, value)| {
                    let time = block.time.plus_seconds(at as f64 * block.step_s);
                    Message::of_sample(&block.rod, time, *value, block.unit)
                }));
        }
        heard.left_out = std::mem::take(&mut self.left_out);
        (!heard.messages.is_empty()).then_some(heard)
    }
}

impl Ear {
    /// Topics of the signals offered.
    pub fn topics(&self) -> Vec<Topic> {
        self.signals.topics()
    }

    /// Changes the rods whose samples the viewer wants.
    pub fn want(&self, rods: BTreeSet<RodId>) {
        lock(&self.queue.waiting).wanted = rods;
        self.signals.look();
    }

    /// Waits for the next samples. Nothing is lost if the wait is given up.
    pub async fn next(&self) -> Heard {
        loop {
            let heard = lock(&self.queue.waiting).pull();
            if let Some(heard) = heard {
                return heard;
            }
            self.queue.bell.notified().await;
        }
    }
}

impl Drop for Ear {
    fn drop(&mut self) {
        lock(&self.signals.queues).retain(|queue| !Arc::ptr_eq(queue, &self.queue));
        self.signals.look();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;

    fn signals() -> (Arc<Signals>, RodId) {
        let signals = Arc::<Signals>::default();
        let config = Config::built_in();
        let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
        signals.follow(&channels);
        (signals, channels[0].rod.clone())
    }

    #[test]
    fn a_viewer_hears_the_rods_it_wants_sample_by_sample() {
        let (signals, rod) = signals();
        let (ear, other) = (signals.listen(), signals.listen());
        let listener = signals.listener();
        let time = Timestamp::from_nanos(1_000_000_000);
        listener(&rod, time, &[9.0], None);
        ear.want(BTreeSet::from([rod.clone()]));
        other.want(BTreeSet::from([RodId("another".to_owned())]));
        listener(&rod, time, &[1.0, 2.0, 3.0], Some(4.0));
        listener(&RodId("unknown".to_owned()), time, &[1.0], None);
        let heard = lock(&ear.queue.waiting).pull().unwrap();
        let values: Vec<f64> = heard
            .messages
            .iter()
            .map(|message| message.body["value"].as_f64().unwrap())
            .collect();
        assert_eq!((values, heard.left_out), (vec![1.0, 2.0, 3.0], 0));
        assert_eq!(heard.messages[2].time.as_nanos(), 1_500_000_000);
        assert_eq!(heard.messages[2].body["unit"], "m");
        assert!(lock(&ear.queue.waiting).pull().is_none());
        assert!(lock(&other.queue.waiting).pull().is_none());
        // Nothing is made when the last one has gone.
        drop((ear, other));
        assert!(!signals.is_heard.load(Ordering::Relaxed) && lock(&signals.queues).is_empty());
    }

    #[test]
    fn a_viewer_that_takes_nothing_misses_the_oldest_and_is_told() {
        let (signals, rod) = signals();
        let ear = signals.listen();
        ear.want(BTreeSet::from([rod.clone()]));
        let listener = signals.listener();
        let count = 3 * WAITING;
        let samples: Vec<f64> = (0..count).map(|i| i as f64).collect();
        listener(&rod, Timestamp::from_nanos(0), &samples, Some(1000.0));
        assert!(lock(&ear.queue.waiting).cost <= WAITING);
        let (mut values, mut left_out) = (Vec::new(), 0);
        while let Some(heard) = { lock(&ear.queue.waiting).pull() } {
            assert!(heard.messages.len() < AT_ONCE + LONGEST);
            left_out += heard.left_out;
            values.extend(heard.messages.iter().map(|message| {
                // The stamp belongs to the sample: number i is taken i ms after the first.
                let value = message.body["value"].as_f64().unwrap();
                assert_eq!(message.time.as_nanos(), (value as i64) * 1_000_000);
                value
            }));
        }
        assert_eq!(left_out + values.len(), count);
        assert_eq!(values, samples[left_out..]);
        assert_eq!(lock(&ear.queue.waiting).cost, 0);
    }
}
