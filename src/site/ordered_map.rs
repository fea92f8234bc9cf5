//! Work on all cores, results in the order of the input, memory bounded: the bridge between reading
//! (which waits) and analysis (which computes).

use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Most items in flight per worker, however light.
const ITEMS_PER_WORKER: usize = 8;

/// Limits of the work in flight.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Number of threads that work.
    pub workers: usize,
    /// Summed weight of the items taken from the input and not yet delivered; an item heavier than
    /// this is processed alone.
    pub weight: usize,
}

/// Applies `work` to every item of `input` on several threads and hands the results to `deliver` on
/// the calling thread, in input order: all that are ready, at least one, so that the cost per delivery falls
/// when there is much to do. The input is pulled on a thread of its own, ahead of delivery by at most one
/// item more than `limits` allow, each weighing `weigh(item)`.
///
/// A panic in `work` is delivered as `Err` with its message; the other items go on. A panic in
/// `input` itself is resumed on the calling thread. `deliver` may break off the whole run.
pub fn map_in_order<T: Send, R: Send>(
    input: impl Iterator<Item = T> + Send,
    limits: Limits,
    weigh: impl Fn(&T) -> usize + Send,
    work: impl Fn(T) -> R + Sync,
    mut deliver: impl FnMut(Vec<Result<R, String>>) -> ControlFlow<()>,
) {
    let workers = limits.workers.max(1);
    let items = workers * ITEMS_PER_WORKER;
    let tickets = Tickets::new(items, limits.weight);
    let (job_sender, job_receiver) = sync_channel::<Job<T>>(items);
    let job_receiver = Mutex::new(job_receiver);
    let (result_sender, result_receiver) = sync_channel(items);

    thread::scope(|scope| {
        let (tickets, job_receiver, work) = (&tickets, &job_receiver, &work);
        scope.spawn(move || feed(input, weigh, tickets, &job_sender));
        for _ in 0..workers {
            let results = result_sender.clone();
            scope.spawn(move || serve(job_receiver, work, &results));
        }
        drop(result_sender);

        let mut waiting = BTreeMap::new();
        let mut next = 0;
        while let Ok(job) = result_receiver.recv() {
            waiting.insert(job.index, job);
            for job in result_receiver.try_iter() {
                waiting.insert(job.index, job);
            }
            let (mut results, mut weights) = (Vec::new(), Vec::new());
            while let Some(job) = waiting.remove(&next) {
                next += 1;
                results.push(job.content);
                weights.push(job.weight);
            }
            if !results.is_empty() && deliver(results).is_break() {
                break;
            }
            tickets.give_back(&weights);
        }
        // Whatever still runs finds its channel closed and stops.
        tickets.close();
        drop(result_receiver);
    });
}

/// An item, or its result, with its index in the input.
struct Job<T> {
    index: usize,
    weight: usize,
    content: T,
}

fn feed<T>(
    input: impl Iterator<Item = T>,
    weigh: impl Fn(&T) -> usize,
    tickets: &Tickets,
    jobs: &SyncSender<Job<T>>,
) {
    for (index, content) in input.enumerate() {
        let weight = weigh(&content);
        if !tickets.take(weight)
            || jobs
                .send(Job {
                    index,
                    weight,
                    content,
                })
                .is_err()
        {
            return;
        }
    }
}

fn serve<T, R>(
    jobs: &Mutex<Receiver<Job<T>>>,
    work: &impl Fn(T) -> R,
    results: &SyncSender<Job<Result<R, String>>>,
) {
    loop {
        let job = lock(jobs).recv();
        let Ok(Job {
            index,
            weight,
            content,
        }) = job
        else {
            return;
        };
        // The item is consumed and nothing shared is left half-changed: `work` only borrows.
        let result = catch_unwind(AssertUnwindSafe(|| work(content))).map_err(|panic| message_of(&*panic));
        if results
            .send(Job {
                index,
                weight,
                content: result,
            })
            .is_err()
        {
            return;
        }
    }
}

/// Message of a caught panic.
pub fn message_of(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A semaphore that counts items and their weight, and can be closed.
struct Tickets {
    items: usize,
    weight: usize,
    taken: Mutex<Taken>,
    changed: Condvar,
}

#[derive(Default)]
struct Taken {
    items: usize,
    weight: usize,
    closed: bool,
}

impl Tickets {
    fn new(items: usize, weight: usize) -> Self {
        Self {
            items,
            weight,
            taken: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    /// Waits until there is room, or nothing else is in flight; returns false once closed.
    fn take(&self, weight: usize) -> bool {
        let full = |taken: &mut Taken| {
            let room = taken.items < self.items && taken.weight.saturating_add(weight) <= self.weight;
            !taken.closed && taken.items > 0 && !room
        };
        let waited = self.changed.wait_while(lock(&self.taken), full);
        let mut taken = waited.unwrap_or_else(PoisonError::into_inner);
        taken.items += 1;
        taken.weight += weight;
        !taken.closed
    }

    fn give_back(&self, weights: &[usize]) {
        let mut taken = lock(&self.taken);
        taken.items -= weights.len();
        taken.weight -= weights.iter().sum::<usize>();
        self.changed.notify_one();
    }

    fn close(&self) {
        lock(&self.taken).closed = true;
        self.changed.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::time::Duration;

    fn limits(workers: usize) -> Limits {
        Limits {
            workers,
            weight: 1000,
        }
    }

    #[test]
    fn heavy_items_go_alone() {
        let at_once = AtomicUsize::new(0);
        let work = |_| {
            let others = at_once.fetch_add(1, Ordering::SeqCst);
            thread::sleep(Duration::from_millis(1));
            at_once.fetch_sub(1, Ordering::SeqCst);
            others
        };
        let mut delivered = 0;
        map_in_order(
            0..20,
            limits(4),
            |_| 5000,
            work,
            |others| {
                assert!(others.iter().all(|others| *others == Ok(0)));
                delivered += others.len();
                ControlFlow::Continue(())
            },
        );
        assert_eq!(delivered, 20);
    }

    #[test]
    fn results_come_in_input_order_whatever_finishes_first() {
        for workers in [1, 2, 7] {
            let mut seen = Vec::new();
            map_in_order(
                0..200u64,
                limits(workers),
                |_| 1,
                |i| {
                    thread::sleep(Duration::from_micros((i * 37) % 300));
                    i * i
                },
                |results| {
                    seen.extend(results.into_iter().map(Result::unwrap));
                    ControlFlow::Continue(())
                },
            );
            assert_eq!(seen, (0..200u64).map(|i| i * i).collect::<Vec<_>>());
        }
    }

    #[test]
    fn what_waits_is_delivered_together() {
        let (mut seen, mut deliveries) = (0, 0);
        map_in_order(
            0..200,
            limits(2),
            |_| 1,
            |i| i,
            |results| {
                // Delivery is slow: the other items are finished meanwhile.
                thread::sleep(Duration::from_millis(5));
                assert!(results.len() <= 2 * ITEMS_PER_WORKER);
                seen += results.len();
                deliveries += 1;
                ControlFlow::Continue(())
            },
        );
        assert_eq!(seen, 200);
        assert!(deliveries < 100, "{deliveries}");
    }

    #[test]
    fn a_panic_is_delivered_in_its_place_and_the_rest_goes_on() {
        let mut seen = Vec::new();
        map_in_order(
            0..10,
            limits(2),
            |_| 1,
            |i| if i == 4 { panic!("item {i} is bad") } else { i },
            |results| {
                seen.extend(results);
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
            limits(2),
            |_| 1,
            |i| {
                if i == 0 {
                    thread::sleep(Duration::from_millis(50));
                }
            },
            |results| {
                delivered.fetch_add(results.len(), Ordering::SeqCst);
                ControlFlow::Continue(())
            },
        );
        assert_eq!(delivered.load(Ordering::SeqCst), 500);
        // One more than the tickets: the feeder pulls an item before it waits for its ticket.
        assert!(most.load(Ordering::SeqCst) <= 2 * ITEMS_PER_WORKER + 1);
    }

    #[test]
    fn breaking_off_stops_an_endless_input() {
        let mut count = 0;
        map_in_order(
            0..,
            limits(2),
            |_| 1,
            |i: u64| i,
            |results| {
                count += results.len();
                if count >= 5 {
                    ControlFlow::Break(())
                } else {
                    ControlFlow::Continue(())
                }
            },
        );
        assert!((5..5 + 2 * ITEMS_PER_WORKER).contains(&count), "{count}");
    }
}
