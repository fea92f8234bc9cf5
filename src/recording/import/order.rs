//! The messages of a plan in order of time, as a recorder would write them.

use super::plan::{Plan, Planned};
use crate::read::Block;
use crate::write::Layout;
use std::ops::Range;
use std::sync::Arc;
use tirante_analysis::signal::record::Timestamp;

/// Iterator over the messages of a plan.
pub(super) struct Order(Vec<Cursor>);

/// A channel's position: stretch, next sample, and its time.
struct Cursor {
    stretch: usize,
    at: usize,
    time: Option<Timestamp>,
}

impl Order {
    pub(super) fn new(plan: &Plan) -> Self {
        let start = |channel: &Planned| {
            let mut cursor = Cursor {
                stretch: 0,
                at: 0,
                time: None,
            };
            cursor.settle(channel);
            cursor
        };
        Self(plan.channels.iter().map(start).collect())
    }

    /// Channel, time and samples of the next message; the first of several at one time.
    pub(super) fn next(&mut self, plan: &Plan) -> Option<(usize, Timestamp, Range<usize>)> {
        let waiting = self.0.iter().enumerate();
        let (index, time) = waiting
            .filter_map(|(index, cursor)| Some((index, cursor.time?)))
            .min_by_key(|(_, time)| *time)?;
        let (cursor, channel) = (self.0.get_mut(index)?, plan.channels.get(index)?);
        let (_, samples) = channel.stretches.get(cursor.stretch)?;
        let length = match channel.layout {
            Layout::Sample => 1,
            Layout::Batch(length) => length.max(1),
        };
        let taken = cursor.at..samples.end.min(cursor.at + length);
        cursor.at = taken.end;
        cursor.settle(channel);
        Some((index, time, taken))
    }
}

impl Cursor {
    /// Moves to the first stretch with samples left and notes the time of the next one.
    fn settle(&mut self, channel: &Planned) {
        self.time = None;
        while let Some((start, samples)) = channel.stretches.get(self.stretch) {
            self.at = self.at.max(samples.start);
            if self.at < samples.end {
                let seconds = (self.at - samples.start) as f64 / channel.fs_hz;
                self.time = Some(start.plus_seconds(seconds));
                return;
            }
            self.stretch += 1;
        }
    }
}

/// Samples of a plan, message by message.
pub(super) struct Blocks {
    plan: Plan,
    order: Order,
    topics: Vec<Arc<str>>,
}

impl Blocks {
    pub(super) fn new(plan: Plan) -> Self {
        Self {
            order: Order::new(&plan),
            topics: plan
                .channels
                .iter()
                .map(|channel| channel.topic.as_str().into())
                .collect(),
            plan,
        }
    }
}

impl Iterator for Blocks {
    type Item = Block;

    fn next(&mut self) -> Option<Block> {
        let (index, time, samples) = self.order.next(&self.plan)?;
        let channel = self.plan.channels.get(index)?;
        Some(Block {
            topic: Arc::clone(self.topics.get(index)?),
            time,
            fs_hz: channel.fs_hz,
            samples: channel.values.get(samples)?.to_vec(),
        })
    }
}
