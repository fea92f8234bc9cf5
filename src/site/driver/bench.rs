//! Room for records under analysis: an analysis takes up to a hundred bytes a sample.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Most samples under analysis at once; a larger record is analysed alone.
const SAMPLES: usize = 1 << 20;

/// Number of samples under analysis.
#[derive(Debug, Default)]
pub(super) struct Bench {
    samples: Mutex<usize>,
    freed: Condvar,
}

/// A record's share of the room, until dropped.
#[derive(Debug)]
pub(super) struct Share<'a> {
    bench: &'a Bench,
    samples: usize,
}

impl Bench {
    /// Waits for room for a record. Records come in their order, so none waits longer than those before it take.
    pub fn take(&self, samples: usize) -> Share<'_> {
        let is_full = |held: &mut usize| *held > 0 && *held + samples > SAMPLES;
        let waited = self.freed.wait_while(self.lock(), is_full);
        *waited.unwrap_or_else(PoisonError::into_inner) += samples;
        Share { bench: self, samples }
    }

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.samples.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        *self.bench.lock() -= self.samples;
        self.bench.freed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::thread;

    #[test]
    fn light_records_go_together_and_heavy_ones_alone() {
        let (bench, now, most) = (Bench::default(), AtomicUsize::new(0), AtomicUsize::new(0));
        thread::scope(|scope| {
            for number in 0..8 {
                let (bench, now, most) = (&bench, &now, &most);
                scope.spawn(move || {
                    for round in 0..200 {
                        let samples = if (number + round) % 5 == 0 {
                            3 * SAMPLES
                        } else {
                            SAMPLES / 3
                        };
                        let _share = bench.take(samples);
                        let all = now.fetch_add(samples, Ordering::SeqCst) + samples;
                        assert!(all == samples || all <= SAMPLES, "{all}");
                        most.fetch_max(all, Ordering::SeqCst);
                        thread::yield_now();
                        now.fetch_sub(samples, Ordering::SeqCst);
                    }
                });
            }
        });
        assert_eq!((*bench.lock(), most.into_inner()), (0, 3 * SAMPLES));
    }
}
