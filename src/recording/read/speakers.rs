//! Detects several channels on one topic, so that no rod gets another sensor's samples.
//!
//! A writer that starts again may give a topic another channel: the old one is silent from then on. Two sensors on
//! one topic are active in turn, or at the same times.

/// Active channels of one topic.
#[derive(Debug, Default)]
pub(super) struct Speakers {
    now: Option<Speaker>,
    /// Channels that were active before.
    before: Vec<Speaker>,
    /// True if several are active at once, and that was reported.
    shared: Shared,
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
        let speaks_again = self.before.iter().any(|known| known.channel == channel);
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
        self.before.retain(|known| known.channel != channel);
        self.before.extend(self.now.replace(speaker));
        self.shared == Shared::No
    }

    /// True if several active channels were found just now.
    pub fn is_news(&self) -> bool {
        self.shared == Shared::News
    }

    /// Names of the channels, for people.
    pub fn names(&self) -> String {
        let speakers = self.before.iter().chain(&self.now);
        let mut channels: Vec<u16> = speakers.map(|speaker| speaker.channel).collect();
        channels.sort_unstable();
        let channels: Vec<String> = channels.iter().map(u16::to_string).collect();
        channels.join(", ")
    }

    /// Ends a stream of a journal: the remaining channel may be used.
    pub fn end_of(&mut self, stream: usize) {
        let spoke = self.before.iter().chain(&self.now);
        if spoke.into_iter().any(|speaker| speaker.stream == Some(stream)) {
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
}
