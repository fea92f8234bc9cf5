//! Detects several channels on one topic, so that no rod gets another sensor's samples.
//!
//! A writer that starts again may give a topic another channel: the old one is silent from then on. Two sensors on
//! one topic are active in turn, or at the same times.

use std::collections::BTreeMap;

/// Most channels named in a sentence.
const NAMED: usize = 8;

/// Active channels of one topic.
#[derive(Debug, Default)]
pub(super) struct Speakers {
    now: Option<Speaker>,
    /// Channels that were active before, with their streams.
    before: BTreeMap<u16, Option<usize>>,
    /// True if several are active at once, and that was reported.
    shared: Shared,
    /// Names of those, found once: every message of theirs is refused by them.
    names: String,
}

#[derive(Debug, Clone, Copy)]
struct Speaker {
    channel: u16,
    /// Index of its stream, in a journal.
    stream: Option<usize>,
    /// Latest log time \[ns\].
    latest: u64,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
enum Shared {
    #[default]
    No,
    News,
    Told,
}

impl Speakers {
    /// Notes a message; returns true if it may be used.
    #[inline]
    pub fn may_speak(&mut self, channel: u16, stream: Option<usize>, log_time: u64) -> bool {
        if let (Some(now), Shared::No) = (&mut self.now, self.shared)
            && now.channel == channel
        {
            now.latest = now.latest.max(log_time);
            return true;
        }
        self.another(channel, stream, log_time)
    }

    fn another(&mut self, channel: u16, stream: Option<usize>, log_time: u64) -> bool {
        if self.shared != Shared::No {
            self.shared = Shared::Told;
            return false;
        }
        let speaks_again = self.before.contains_key(&channel);
        // A sender that connects anew may begin again where it began.
        let is_back = |now: &Speaker| now.stream == stream && log_time < now.latest;
        if speaks_again || self.now.as_ref().is_some_and(is_back) {
            self.shared = Shared::News;
        }
        let speaker = Speaker {
            channel,
            stream,
            latest: log_time,
        };
        self.before.remove(&channel);
        let silent = self.now.replace(speaker);
        self.before
            .extend(silent.map(|silent| (silent.channel, silent.stream)));
        if self.shared == Shared::No {
            return true;
        }
        self.names = self.named();
        false
    }

    /// True if several active channels were found just now.
    pub fn is_news(&self) -> bool {
        self.shared == Shared::News
    }

    /// Names of the channels that are active at once, for people.
    pub fn names(&self) -> &str {
        &self.names
    }

    fn named(&self) -> String {
        let mut channels: Vec<u16> = self.before.keys().copied().collect();
        channels.extend(self.now.map(|speaker| speaker.channel));
        channels.sort_unstable();
        let mut named: Vec<String> = channels.iter().take(NAMED).map(u16::to_string).collect();
        match channels.len().saturating_sub(NAMED) {
            0 => {}
            more => named.push(format!("and {more} more")),
        }
        named.join(", ")
    }

    /// Ends a stream of a journal: the remaining channel may be used.
    pub fn end_of(&mut self, stream: usize) {
        let now = self.now.as_ref().map(|now| &now.stream);
        if self.before.values().chain(now).any(|of| *of == Some(stream)) {
            *self = Self::default();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Messages that may be used, given channels with log times.
    fn used(messages: &[(u16, u64)]) -> Vec<bool> {
        let mut speakers = Speakers::default();
        let mut may = |&(channel, time): &(u16, u64)| speakers.may_speak(channel, None, time);
        messages.iter().map(&mut may).collect()
    }

    #[test]
    fn one_after_another_is_one_sensor_and_in_turn_are_two() {
        assert_eq!(used(&[(1, 10), (1, 20), (4, 30), (4, 40)]), [true; 4]);
        assert_eq!(
            used(&[(1, 10), (4, 11), (1, 20), (4, 21)]),
            [true, true, false, false]
        );
        assert_eq!(
            used(&[(1, 10), (4, 10), (1, 20), (1, 30)]),
            [true, true, false, false]
        );
        // One whole after the other in the file, at the same times.
        assert_eq!(
            used(&[(1, 10), (1, 20), (4, 10), (4, 20)]),
            [true, true, false, false]
        );
    }

    #[test]
    fn it_is_news_once_and_over_with_a_stream() {
        let mut speakers = Speakers::default();
        for (channel, stream, may) in [(1, 0, true), (2, 1, true), (1, 0, false)] {
            assert_eq!(speakers.may_speak(channel, Some(stream), 5), may);
        }
        assert!(speakers.is_news());
        assert_eq!(speakers.names(), "1, 2");
        assert!(!speakers.may_speak(2, Some(1), 6) && !speakers.is_news());
        speakers.end_of(7);
        assert!(!speakers.may_speak(2, Some(1), 7));
        speakers.end_of(0);
        assert!(speakers.may_speak(2, Some(1), 8));
        // Sent again from the beginning over another connection.
        assert!(speakers.may_speak(3, Some(2), 1));
    }

    #[test]
    fn of_many_channels_a_few_are_named_and_none_is_looked_for_among_the_others() {
        let begun = std::time::Instant::now();
        let mut speakers = Speakers::default();
        let all = 1..=u16::MAX;
        assert!(all.clone().all(|channel| speakers.may_speak(channel, None, 5)));
        assert!(!speakers.may_speak(1, None, 6) && speakers.is_news());
        assert_eq!(speakers.names(), "1, 2, 3, 4, 5, 6, 7, 8, and 65527 more");
        for _ in 0..20 {
            let refused = all.clone().filter(|channel| {
                let may = speakers.may_speak(*channel, None, 7);
                !may && !speakers.names().is_empty()
            });
            assert_eq!(refused.count(), usize::from(u16::MAX));
        }
        // A fraction of a second; looking through all of them for each takes minutes.
        assert!(begun.elapsed().as_secs() < 20, "{:?}", begun.elapsed());
    }
}
