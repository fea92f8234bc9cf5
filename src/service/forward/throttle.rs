//! The rate of a site with a backlog: its messages wait as long as the centre asks, so that what is new elsewhere does not wait
//! behind them.

use crate::analysis::numerics::random;
use async_nats::Subscriber;
use futures_util::{FutureExt, StreamExt};
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::time::{Duration, Instant};

/// Subject of what the centre asks of all sites.
pub const SUBJECT: &str = "tirante.v1.pause";

/// Most commits that are no backlog: they are sent at once.
const LIVE: i64 = 50;
/// Most commits in a message.
const MOST: usize = 200;
/// The same of the first message of a backlog, doubled with each: many sites that come back together have not heard yet that the
/// centre is busy.
const FIRST: usize = 10;
/// The same while the centre asks for pauses: small messages follow one another evenly.
const PAUSED: usize = 25;
/// Wait between the first messages of a backlog, and between those of full size: what a site alone has sent before the centre can
/// ask for a pause is folded within seconds.
const SLOW: Duration = Duration::from_secs(1);
const QUICK: Duration = Duration::from_millis(200);
/// Time after which what the centre asked for is forgotten. It asks once a second, unless its database takes longer.
const VALID: Duration = Duration::from_secs(30);
/// Longest pause a centre can ask for \[s\].
pub const LONGEST_S: f64 = 3600.0;

/// Request of the centre to the sites that have a backlog.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pause {
    /// Time between two messages of a backlog \[s\].
    pub pause_s: f64,
    /// Time until the centre has read what the stream holds \[s\].
    pub wait_s: f64,
}

/// Waits between the messages of a backlog.
#[derive(Debug)]
pub struct Throttle {
    asked: Option<(Instant, Duration)>,
    sent: Option<Instant>,
    most: usize,
    /// Share of the pause that is waited this time: sites do not send in step.
    share: f64,
    chance: ChaCha8Rng,
}

impl Throttle {
    /// A throttle; equal seeds give equal waits.
    pub fn new(seed: u64) -> Self {
        Self {
            asked: None,
            sent: None,
            most: FIRST,
            share: 1.0,
            chance: random::stream(seed, 1),
        }
    }

    /// Takes what the centre asked for meanwhile.
    pub fn hear(&mut self, subscriber: &mut Subscriber) {
        while let Some(Some(message)) = subscriber.next().now_or_never() {
            self.take(&message.payload, Instant::now());
        }
    }

    /// Takes one message of the centre.
    pub(crate) fn take(&mut self, payload: &[u8], now: Instant) {
        // What cannot be read asks for nothing.
        if let Ok(Pause { pause_s, .. }) = serde_json::from_slice(payload)
            && (0.0..=LONGEST_S).contains(&pause_s)
        {
            self.asked = Some((now, Duration::from_secs_f64(pause_s)));
        }
    }

    fn asked(&self, now: Instant) -> Option<Duration> {
        let (at, pause) = self.asked?;
        (now.saturating_duration_since(at) < VALID).then_some(pause)
    }

    /// Time until the next message may be sent, with so many commits waiting; `None`: now.
    pub fn wait(&self, waiting: i64, now: Instant) -> Option<Duration> {
        let sent = self.sent.filter(|_| waiting > LIVE)?;
        let own = if self.most < MOST { SLOW } else { QUICK };
        let pause = self.asked(now).unwrap_or(own).mul_f64(self.share);
        let wait = (sent + pause).saturating_duration_since(now);
        (!wait.is_zero()).then_some(wait)
    }

    /// Most commits of the next message, with so many waiting.
    pub fn most(&self, waiting: i64, now: Instant) -> usize {
        if waiting <= LIVE {
            MOST
        } else if self.asked(now).is_some() {
            PAUSED
        } else {
            self.most
        }
    }

    /// Notes that a message was sent, with so many commits waiting before it.
    pub fn sent(&mut self, waiting: i64, now: Instant) {
        self.sent = Some(now);
        self.share = self.chance.random_range(0.5..1.5);
        if waiting <= LIVE {
            self.most = FIRST;
        } else if self.asked(now).is_none() {
            self.most = (2 * self.most).min(MOST);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn ask(throttle: &mut Throttle, pause_s: f64, now: Instant) {
        let asked = Pause { pause_s, wait_s: 7.0 };
        throttle.take(&serde_json::to_vec(&asked).unwrap(), now);
    }

    #[test]
    fn a_backlog_begins_slowly_and_what_is_new_goes_at_once() {
        let (mut throttle, mut now) = (Throttle::new(1), Instant::now());
        let mut sizes = Vec::new();
        for _ in 0..7 {
            assert_eq!(throttle.wait(1000, now), None);
            sizes.push(throttle.most(1000, now));
            throttle.sent(1000, now);
            // The pauses of the beginning are from 0.5 s to 1.5 s, those of full messages a fifth of that.
            let wait = throttle.wait(1000, now).unwrap();
            let nominal = if sizes.len() < 5 { SECOND } else { SECOND / 5 };
            assert!(wait >= nominal / 2 && wait < 3 * nominal / 2, "{wait:?}");
            now += wait;
        }
        assert_eq!(sizes, [10, 20, 40, 80, 160, 200, 200]);
        throttle.sent(LIVE, now);
        assert_eq!((throttle.wait(LIVE, now), throttle.most(LIVE, now)), (None, MOST));
        // The next backlog begins slowly again.
        assert_eq!(throttle.most(LIVE + 1, now), FIRST);
    }

    #[test]
    fn the_centre_is_obeyed_as_long_as_it_asks() {
        let (mut throttle, now) = (Throttle::new(1), Instant::now());
        for _ in 0..6 {
            throttle.sent(1000, now);
        }
        assert!(throttle.wait(1000, now).unwrap() < SECOND / 2);
        assert_eq!(throttle.most(1000, now), MOST);
        ask(&mut throttle, 100.0, now);
        let wait = throttle.wait(1000, now).unwrap();
        assert!(wait >= 50 * SECOND && wait < 150 * SECOND, "{wait:?}");
        assert_eq!(throttle.most(1000, now), PAUSED);
        assert_eq!(throttle.wait(LIVE, now), None);
        // A shorter pause ends the longer one that is under way.
        ask(&mut throttle, 10.0, now);
        assert!(throttle.wait(1000, now).unwrap() < 15 * SECOND);
        assert_eq!(throttle.wait(1000, now + VALID), None);
        // What is no pause changes nothing.
        for nonsense in [
            &b"{\"pause_s\":-1.0,\"wait_s\":0}"[..],
            b"{\"pause_s\":1e9,\"wait_s\":0}",
            b"",
            b"[]",
        ] {
            throttle.take(nonsense, now + 2 * VALID);
        }
        assert_eq!(throttle.wait(1000, now + 2 * VALID), None);
        assert_eq!(throttle.most(1000, now + 2 * VALID), MOST);
    }
}
