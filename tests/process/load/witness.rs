//! Watches the store while the daemon writes it, and notes when each record's result became visible.

use super::plant::Plant;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, SystemTime};

/// Interval between checks.
const LOOK: Duration = Duration::from_millis(5);

/// A record as it was seen.
#[derive(Debug, Clone)]
pub struct Seen {
    pub rod: String,
    /// End of the record \[s since 1970\].
    pub end_s: f64,
    /// From the time of its last sample to when it was seen \[s\].
    pub latency_s: f64,
}

pub struct Witness {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Vec<Seen>>>,
}

impl Witness {
    /// Begins to watch; records already present are ignored.
    pub fn start(plant: &Plant) -> Self {
        let store = plant.store();
        let stop = Arc::<AtomicBool>::default();
        let is_over = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let mut seen = Vec::new();
            let mut last: i64 = store
                .query_row("SELECT coalesce(max(id), 0) FROM record", (), |row| row.get(0))
                .unwrap();
            let mut statement = store
                .prepare("SELECT id, rod, start_ns, duration_s FROM record WHERE id > ? AND start_ns IS NOT NULL ORDER BY id")
                .unwrap();
            loop {
                let is_last = is_over.load(Ordering::Relaxed);
                let mut rows = statement.query([last]).unwrap();
                while let Some(row) = rows.next().unwrap() {
                    let now = SystemTime::UNIX_EPOCH.elapsed().unwrap().as_secs_f64();
                    last = row.get(0).unwrap();
                    let end_s = row.get::<_, i64>(2).unwrap() as f64 * 1e-9 + row.get::<_, f64>(3).unwrap();
                    seen.push(Seen {
                        rod: row.get(1).unwrap(),
                        end_s,
                        latency_s: now - end_s,
                    });
                }
                drop(rows);
                if is_last {
                    return seen;
                }
                thread::sleep(LOOK);
            }
        });
        Self {
            stop,
            thread: Some(thread),
        }
    }

    pub fn finish(mut self) -> Vec<Seen> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Least, median, 95 % and largest latency \[s\].
pub fn spread(seen: &[Seen]) -> [f64; 4] {
    let mut latencies: Vec<f64> = seen.iter().map(|seen| seen.latency_s).collect();
    latencies.sort_by(f64::total_cmp);
    let last = latencies.len() - 1;
    [
        latencies[0],
        latencies[last / 2],
        latencies[last * 95 / 100],
        latencies[last],
    ]
}
