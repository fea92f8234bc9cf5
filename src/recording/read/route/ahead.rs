//! Messages that wait: for those of other files, where several are read side by side, for the rest of a large one, or until the
//! records before them are taken.

use super::{MOST_READY, Router};
use crate::read::decode::PIECE;
use crate::read::mcap::Message;
use std::collections::VecDeque;
use std::sync::Arc;

/// Messages that wait for their turn.
#[derive(Default)]
pub(super) struct Ahead {
    /// Log time up to which messages are passed on \[ns\]; `None`: all are.
    pub(super) limit: Option<u64>,
    /// Latest log time so far \[ns\].
    pub(super) front: Option<u64>,
    /// Waiting messages, with the latest log time up to each.
    waiting: VecDeque<(u64, Owned)>,
    /// Bytes of them.
    bytes: usize,
}

impl Ahead {
    fn push_back(&mut self, front: u64, message: Owned) {
        self.bytes += message.data.len();
        self.waiting.push_back((front, message));
    }

    fn push_front(&mut self, front: u64, message: Owned) {
        self.bytes += message.data.len();
        self.waiting.push_front((front, message));
    }

    fn pop(&mut self) -> Option<(u64, Owned)> {
        let first = self.waiting.pop_front()?;
        self.bytes -= first.1.data.len();
        Some(first)
    }
}

/// A message that waits.
struct Owned {
    channel: u16,
    log_time: u64,
    publish_time: u64,
    data: Arc<[u8]>,
    /// Number of its first sample that was not passed on.
    from: usize,
}

impl Owned {
    fn of(message: &Message<'_>, from: usize) -> Self {
        Self {
            channel: message.channel,
            log_time: message.log_time,
            publish_time: message.publish_time,
            data: Arc::from(message.data),
            from,
        }
    }
}

impl Router {
    /// Bytes of the messages that wait.
    pub fn ahead_bytes(&self) -> usize {
        self.ahead.bytes
    }

    /// Passes a message on if it is its turn.
    #[inline]
    pub(super) fn in_turn(&mut self, message: Message<'_>) {
        let is_full = self.ready.bytes() > MOST_READY;
        let ahead = &mut self.ahead;
        if ahead.limit.is_none() && ahead.waiting.is_empty() && !is_full {
            return self.pass(message);
        }
        let front = ahead
            .front
            .map_or(message.log_time, |front| front.max(message.log_time));
        if ahead.limit.is_some() {
            ahead.front = Some(front);
        }
        if ahead.limit.is_some_and(|limit| front > limit) || !ahead.waiting.is_empty() || is_full {
            ahead.push_back(front, Owned::of(&message, 0));
        } else {
            self.pass(message);
        }
    }

    /// Passes on a message, of a large array the first piece: the rest waits, so that its records are taken one by one.
    #[inline]
    fn pass(&mut self, message: Message<'_>) {
        if self.message(message, 0) {
            let front = self.ahead.front.unwrap_or_default();
            self.ahead.push_front(front, Owned::of(&message, PIECE));
        }
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

    /// Passes on everything that waits: the file ends here.
    pub(super) fn go_on_to_the_end(&mut self) {
        while self.waits() {
            self.go_on(u64::MAX);
        }
    }

    /// Passes on the waiting messages up to a log time \[ns\], and of a large one a piece; fewer if these give records of more than
    /// [`MOST_READY`] bytes, which are taken first.
    pub fn go_on(&mut self, limit: u64) {
        while let Some((front, owned)) = self.ahead.pop() {
            if front > limit {
                self.ahead.push_front(front, owned);
                return;
            }
            let message = Message {
                channel: owned.channel,
                log_time: owned.log_time,
                publish_time: owned.publish_time,
                data: &owned.data,
            };
            if self.message(message, owned.from) {
                let from = owned.from + PIECE;
                self.ahead.push_front(front, Owned { from, ..owned });
                return;
            }
            if self.ready.bytes() > MOST_READY {
                return;
            }
        }
    }
}
