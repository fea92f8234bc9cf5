//! Waits before a failed sink is tried again.

use crate::analysis::numerics::random;
use rand::RngExt;
use rand::rngs::ChaCha8Rng;
use std::time::Duration;

/// Shortest and longest time between two tries, and the time one may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// The wait after the first failure.
    pub first: Duration,
    /// Longest wait, even if the other side asks for more.
    pub longest: Duration,
    /// Longest time of one send.
    pub deadline: Duration,
}

impl Default for Pace {
    fn default() -> Self {
        Self {
            first: Duration::from_secs(1),
            longest: Duration::from_secs(300),
            deadline: Duration::from_secs(10),
        }
    }
}

/// Waits that double with each failure, varied randomly by a fifth so that sinks that failed together do not
/// retry together.
#[derive(Debug)]
pub struct Backoff {
    pace: Pace,
    failures: u32,
    chance: ChaCha8Rng,
}

impl Backoff {
    /// Waits of this pace; equal seeds give equal waits.
    pub fn new(pace: Pace, seed: u64) -> Self {
        Self {
            pace,
            failures: 0,
            chance: random::stream(seed, 0),
        }
    }

    /// Wait after one more failure: at least as long as the other side `asked` for, up to the longest.
    pub fn after_failure(&mut self, asked: Option<Duration>) -> Duration {
        let doubled = self
            .pace
            .first
            .saturating_mul(2u32.saturating_pow(self.failures.min(31)));
        self.failures = self.failures.saturating_add(1);
        let own = doubled
            .min(self.pace.longest)
            .mul_f64(self.chance.random_range(0.8..1.2));
        own.max(asked.unwrap_or_default().min(self.pace.longest))
    }

    /// Resets after a success: the next failure counts as the first.
    pub fn reset(&mut self) {
        self.failures = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_longest_with_a_fifth_of_chance() {
        let mut backoff = Backoff::new(Pace::default(), 7);
        for nominal_s in [1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0, 256.0, 300.0, 300.0] {
            let wait_s = backoff.after_failure(None).as_secs_f64();
            assert!(
                (0.8 * nominal_s..1.2 * nominal_s).contains(&wait_s),
                "{wait_s} {nominal_s}"
            );
        }
        for _ in 0..100 {
            assert!(backoff.after_failure(None).as_secs_f64() < 360.0);
        }
        backoff.reset();
        assert!(backoff.after_failure(None).as_secs_f64() < 1.2);
    }

    #[test]
    fn chance_repeats_with_the_seed_and_spreads() {
        let waits = |seed| {
            let mut backoff = Backoff::new(Pace::default(), seed);
            (0..8).map(|_| backoff.after_failure(None)).collect::<Vec<_>>()
        };
        assert_eq!(waits(1), waits(1));
        assert_ne!(waits(1), waits(2));
    }

    #[test]
    fn what_the_other_side_asks_for_is_honoured_up_to_the_longest() {
        let mut backoff = Backoff::new(Pace::default(), 7);
        assert_eq!(
            backoff.after_failure(Some(Duration::from_secs(30))),
            Duration::from_secs(30)
        );
        assert_eq!(
            backoff.after_failure(Some(Duration::from_secs(86_400))),
            Duration::from_secs(300)
        );
        assert!(backoff.after_failure(Some(Duration::ZERO)).as_secs_f64() > 3.0);
    }
}
