//! The heartbeat of the work loop.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Time at which a tick last went through the whole pipeline, from the reader to the core.
#[derive(Debug)]
pub struct Beat {
    begun: Instant,
    latest_ms: AtomicU64,
}

impl Default for Beat {
    fn default() -> Self {
        Self {
            begun: Instant::now(),
            latest_ms: AtomicU64::new(0),
        }
    }
}

impl Beat {
    /// Notes that the work loop is alive; called only by the core, for every `Job::Tick` that reaches
    /// it.
    pub fn pass(&self) {
        let ms = u64::try_from(self.begun.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.latest_ms.fetch_max(ms, Ordering::Relaxed);
    }

    /// Time since the last beat; since the start of the program if there was none.
    pub fn age(&self) -> Duration {
        self.age_at(Instant::now())
    }

    fn age_at(&self, now: Instant) -> Duration {
        let latest = self.begun + Duration::from_millis(self.latest_ms.load(Ordering::Relaxed));
        now.saturating_duration_since(latest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_age_grows_until_the_next_pass() {
        let beat = Beat::default();
        let later = beat.begun + Duration::from_secs(40);
        assert_eq!(beat.age_at(later), Duration::from_secs(40));
        beat.latest_ms.store(39_000, Ordering::Relaxed);
        assert_eq!(beat.age_at(later), Duration::from_secs(1));
        beat.pass();
        assert_eq!(beat.age_at(later), Duration::from_secs(1), "it never goes back");
    }
}
