//! Work on all cores, results in the order of the input, memory bounded: the bridge between reading
//! (which waits) and analysis (which computes).

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Items taken from the input and not yet delivered, per worker; bounds memory when one item is slow.
const IN_FLIGHT_PER_WORKER: usize = 3;

/// Applies `work` to every item of `input` on `workers` threads and hands the results to `deliver`
/// on the calling thread, in input order. The input is pulled on a thread of its own, at most
/// [`IN_FLIGHT_PER_WORKER`] items per worker ahead of delivery.
///
/// A panic in `work` is delivered as `Err` with its message; the other items go on. A panic in
/// `input` itself is resumed on the calling thread. `deliver` may break off the whole run.
pub fn map_in_order<T: Send, R: Send>(
    input: impl Iterator<Item = T> + Send,
    workers: usize,
    work: impl Fn(T) -> R + Sync,
    mut deliver: impl FnMut(Result<R, String>) -> ControlFlow<()>,
) {
    let workers = workers.max(1);
    let tickets = Tickets::new(workers * IN_FLIGHT_PER_WORKER);
    let (job_sender, job_receiver) = sync_channel::<(usize, T)>(workers * IN_FLIGHT_PER_WORKER);
    let job_receiver = Mutex::new(job_receiver);
    let (result_sender, result_receiver) = sync_channel(workers * IN_FLIGHT_PER_WORKER);

    thread::scope(|scope| {
        let (tickets, job_receiver, work) = (&tickets, &job_receiver, &work);
        scope.spawn(move || feed(input, tickets, &job_sender));
        for _ in 0..workers {
            let results = result_sender.clone();
            scope.spawn(move || serve(job_receiver, work, &results));
        }
        drop(result_sender);

        let mut waiting = BTreeMap::new();
        let mut next = 0;
        'run: for (index, result) in &result_receiver {
            waiting.insert(index, result);
            while let Some(result) = waiting.remove(&next) {
                next += 1;
                if deliver(result).is_break() {
                    break 'run;
                }
                tickets.give_back();
            }
        }
        // Whatever still runs finds its channel closed and stops.
        tickets.close();
        drop(result_receiver);
    });
}

fn feed<T>(input: impl Iterator<Item = T>, tickets: &Tickets, jobs: &SyncSender<(usize, T)>) {
    for job in input.enumerate() {
        if !tickets.take() || jobs.send(job).is_err() {
            return;
        }
    }
}

fn serve<T, R>(
    jobs: &Mutex<Receiver<(usize, T)>>,
    work: &impl Fn(T) -> R,
    results: &SyncSender<(usize, Result<R, String>)>,
) {
    loop {
        let job = lock(jobs).recv();
        let Ok((index, item)) = job else { return };
        // The item is consumed and nothing shared is left half-changed: `work` only borrows.
        let result = catch_unwind(AssertUnwindSafe(|| work(item))).map_err(|panic| message_of(&*panic));
        if results.send((index, result)).is_err() {
            return;
        }
    }
}

fn message_of(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A counting semaphore that can be closed.
struct Tickets {
    left: Mutex<Option<usize>>,
    changed: Condvar,
}

impl Tickets {
    fn new(count: usize) -> Self {
        Self {
            left: Mutex::new(Some(count)),
            changed: Condvar::new(),
        }
    }

    /// Waits for a ticket; false once closed.
    fn take(&self) -> bool {
        let mut left = lock(&self.left);
        loop {
            match left.as_mut() {
                None => return false,
                Some(0) => left = self.changed.wait(left).unwrap_or_else(PoisonError::into_inner),
                Some(count) => {
                    *count -= 1;
                    return true;
                }
            }
        }
    }

    fn give_back(&self) {
        if let Some(count) = lock(&self.left).as_mut() {
            *count += 1;
        }
        self.changed.notify_one();
    }

    fn close(&self) {
        *lock(&self.left) = None;
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    #[test]
    fn results_come_in_input_order_whatever_finishes_first() {
        for workers in [1, 2, 7] {
            let mut seen = Vec::new();
            map_in_order(
                0..200u64,
                workers,
                |i| {
                    thread::sleep(Duration::from_micros((i * 37) % 300));
                    i * i
                },
                |result| {
                    seen.push(result.unwrap());
                    ControlFlow::Continue(())
                },
            );
            assert_eq!(seen, (0..200u64).map(|i| i * i).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_panic_is_delivered_in_its_place_and_the_rest_goes_on() {
        let mut seen = Vec::new();
        map_in_order(
            0..10,
            2,
            |i| if i == 4 { panic!("item {i} is bad") } else { i },
            |result| {
                seen.push(result);
                ControlFlow::Continue(())
            },
        );
        assert_eq!(seen.len(), 10);
        assert_eq!(seen[4], Err("item 4 is bad".to_owned()));
        assert_eq!(seen[9], Ok(9));
    }

    #[test]
    fn a_slow_first_item_does_not_pull_in_the_whole_input() {
        let pulled = AtomicUsize::new(0);
        let most = AtomicUsize::new(0);
        let delivered = AtomicUsize::new(0);
        let input = (0..500).inspect(|_| {
            let ahead = pulled.fetch_add(1, Ordering::SeqCst) + 1 - delivered.load(Ordering::SeqCst);
            most.fetch_max(ahead, Ordering::SeqCst);
        });
        map_in_order(
            input,
            2,
            |i| {
                if i == 0 {
                    thread::sleep(Duration::from_millis(50));
                }
            },
            |_| {
                delivered.fetch_add(1, Ordering::SeqCst);
                ControlFlow::Continue(())
            },
        );
        assert_eq!(delivered.load(Ordering::SeqCst), 500);
        // One more than the tickets: the feeder pulls an item before it waits for its ticket.
        assert!(most.load(Ordering::SeqCst) <= 2 * IN_FLIGHT_PER_WORKER + 1);
    }

    #[test]
    fn breaking_off_stops_an_endless_input() {
        let mut count = 0;
        map_in_order(
            0..,
            2,
            |i: u64| i,
            |_| {
                count += 1;
                if count == 5 {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            },
        );
        assert_eq!(count, 5);
    }
}
