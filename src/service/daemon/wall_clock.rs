//! Compares the machine's clock with a monotonic one: detects steps, and doubts time in which no daemon
//! worked.

use crate::analysis::signal::record::Timestamp;
use crate::site::store::Stretch;
use std::time::Instant;

/// Least step of the clock that is reported \[s\].
const STEP_S: f64 = 60.0;
/// Time between two daemons that is not reported \[s\].
const RESTART_S: f64 = 900.0;
/// Longest credible outage; beyond, the clock itself is in doubt \[s\].
const DOUBTED_S: f64 = 7.0 * 86_400.0;

/// State of the clock at the start of the daemon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Began {
    /// No fault.
    Even,
    /// No daemon worked for so long \[s\].
    Outage(f64),
    /// The clock gives a doubtful time since the last daemon's work \[s\]: too long, or negative.
    Doubted(f64),
}

/// The machine's clock while a daemon runs.
#[derive(Debug)]
pub struct WallClock {
    stretch: Stretch,
    begun: Instant,
}

impl WallClock {
    /// Begins at `wall` by the machine's clock; `last`: latest stretch of a daemon's work.
    pub fn begin(last: Option<Stretch>, wall: Timestamp, now: Instant) -> (Self, Began) {
        let clock = Self {
            stretch: Stretch { from: wall, to: wall },
            begun: now,
        };
        let away_s = last.map_or(0.0, |last| wall.seconds_since(last.to));
        let began = if !(-STEP_S..=DOUBTED_S).contains(&away_s) {
            Began::Doubted(away_s)
        } else if away_s > RESTART_S {
            Began::Outage(away_s)
        } else {
            Began::Even
        };
        (clock, began)
    }

    /// Takes the clock's time `wall`; returns its step since the last call, if any \[s\]. A step begins a new
    /// stretch.
    pub fn look(&mut self, wall: Timestamp, now: Instant) -> Option<f64> {
        let lived_s = now.saturating_duration_since(self.begun).as_secs_f64();
        let step_s = wall.seconds_since(self.stretch.from.plus_seconds(lived_s));
        if step_s.abs() <= STEP_S {
            self.stretch.to = wall.max(self.stretch.from);
            return None;
        }
        self.stretch = Stretch { from: wall, to: wall };
        self.begun = now;
        Some(step_s)
    }

    /// Stretch of time since the begin or the last step.
    pub fn stretch(&self) -> Stretch {
        self.stretch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const DAY_S: f64 = 86_400.0;

    fn at(s: f64) -> Timestamp {
        Timestamp::from_nanos(1_800_000_000_000_000_000).plus_seconds(s)
    }

    #[test]
    fn a_start_after_a_month_is_doubted_and_one_after_a_night_is_an_outage() {
        let last = Stretch {
            from: at(0.0),
            to: at(DAY_S),
        };
        let began = |wall_s: f64| WallClock::begin(Some(last), at(wall_s), Instant::now()).1;
        assert_eq!(began(DAY_S + 60.0), Began::Even);
        assert_eq!(began(1.5 * DAY_S), Began::Outage(0.5 * DAY_S));
        assert_eq!(began(32.0 * DAY_S), Began::Doubted(31.0 * DAY_S));
        assert_eq!(began(0.0), Began::Doubted(-DAY_S));
        assert_eq!(WallClock::begin(None, at(0.0), Instant::now()).1, Began::Even);
    }

    #[test]
    fn a_step_of_the_clock_begins_a_new_stretch() {
        let now = Instant::now();
        let (mut clock, _) = WallClock::begin(None, at(0.0), now);
        let later = |s: u64| now + Duration::from_secs(s);
        assert_eq!(clock.look(at(100.0), later(100)), None);
        // Slewed by a second: no step.
        assert_eq!(clock.look(at(201.0), later(200)), None);
        assert_eq!(clock.stretch().to, at(201.0));
        let step_s = clock.look(at(300.0 + 31.0 * DAY_S), later(300)).unwrap();
        assert!((step_s - 31.0 * DAY_S).abs() < 1e-3);
        assert_eq!(clock.look(at(400.0 + 31.0 * DAY_S), later(400)), None);
        let back_s = clock.look(at(500.0), later(500)).unwrap();
        assert!((back_s + 31.0 * DAY_S).abs() < 1e-3);
        assert_eq!(clock.stretch().from, at(500.0));
    }
}
