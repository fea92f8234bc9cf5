//! The heartbeats of the work loop and of the threads before it.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::{Duration, Instant};

/// Longest time without a beat of a thread before the work loop: one step of it, however slow the disk.
pub(super) const LONGEST_STEP: Duration = Duration::from_mins(10);

/// Time at which a loop last came round: of the work loop, at which a tick last went through the whole pipeline.
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
    /// Notes that the loop is alive. For the work loop only the core calls it, for every `Job::Tick` that reaches it.
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

/// Beats of the threads without which the work loop has nothing to do: a hang there would be seen nowhere else.
#[derive(Debug, Default)]
pub struct Beats(Mutex<Vec<(&'static str, Weak<Beat>)>>);

impl Beats {
    /// Beat of the thread called `name`, which is watched for as long as it has it.
    pub fn of(&self, name: &'static str) -> Arc<Beat> {
        let beat = Arc::<Beat>::default();
        let mut beats = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        beats.retain(|(other, beat)| *other != name && beat.strong_count() > 0);
        beats.push((name, Arc::downgrade(&beat)));
        beat
    }

    /// Names of the threads, with the ages of their beats.
    pub(super) fn ages_at(&self, now: Instant) -> Vec<(&'static str, Duration)> {
        let beats = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let age = |(name, beat): &(&'static str, Weak<Beat>)| Some((*name, beat.upgrade()?.age_at(now)));
        beats.iter().filter_map(age).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thread_is_watched_while_it_has_its_beat() {
        let beats = Beats::default();
        let (one, other) = (beats.of("one"), beats.of("other"));
        let names = || {
            beats
                .ages_at(Instant::now())
                .iter()
                .map(|(name, _)| *name)
                .collect::<Vec<_>>()
        };
        assert_eq!(names(), ["one", "other"]);
        drop(one);
        assert_eq!(names(), ["other"]);
        drop(other);
        let _again = beats.of("one");
        assert_eq!(names(), ["one"]);
    }

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
