//! Messages that wait for those of other files, where several are read side by side.

use super::Router;
use crate::recording::read::mcap::Message;
use std::collections::VecDeque;

/// Messages ahead of those of other files, where several are read side by side.
#[derive(Default)]
pub(super) struct Ahead {
    /// Log time up to which messages are passed on \[ns\]; `None`: all are.
    pub(super) limit: Option<u64>,
    /// Latest log time so far \[ns\].
    pub(super) front: Option<u64>,
    /// Waiting messages, with the latest log time up to each.
    pub(super) waiting: VecDeque<(u64, Owned)>,
}

/// A message that waits.
pub(super) struct Owned {
    pub(super) channel: u16,
    pub(super) log_time: u64,
    publish_time: u64,
    pub(super) data: Vec<u8>,
}

impl Router {
    /// Passes a message on if it is its turn.
    #[inline]
    pub(super) fn in_turn(&mut self, message: Message<'_>) {
        let ahead = &mut self.ahead;
        if let Some(limit) = ahead.limit {
            let front = ahead
                .front
                .map_or(message.log_time, |front| front.max(message.log_time));
            ahead.front = Some(front);
            if front > limit || !ahead.waiting.is_empty() {
                let owned = Owned {
                    channel: message.channel,
                    log_time: message.log_time,
                    publish_time: message.publish_time,
                    data: message.data.to_vec(),
                };
                ahead.waiting.push_back((front, owned));
                return;
            }
        }
        self.message(message);
    }

    /// Sets the log time up to which messages are passed on from now on \[ns\].
    pub fn limit(&mut self, limit: u64) {
        self.ahead.limit = Some(limit);
    }

    /// Notes that nothing comes before a log time \[ns\].
    pub fn waits_until(&mut self, time: u64) {
        self.ahead.front = self.ahead.front.max(Some(time));
    }

    /// True if messages wait for their turn.
    pub fn waits(&self) -> bool {
        !self.ahead.waiting.is_empty()
    }

    /// Log time of the next message, or of the latest one \[ns\].
    pub fn front(&self) -> Option<u64> {
        let next = self.ahead.waiting.front().map(|(front, _)| *front);
        next.or(self.ahead.front)
    }

    /// Passes on the waiting messages up to a log time \[ns\].
    pub fn go_on(&mut self, limit: u64) {
        while let Some((front, owned)) = self.ahead.waiting.pop_front() {
            if front > limit {
                self.ahead.waiting.push_front((front, owned));
                return;
            }
            self.message(Message {
                channel: owned.channel,
                log_time: owned.log_time,
                publish_time: owned.publish_time,
                data: &owned.data,
            });
        }
    }
}
