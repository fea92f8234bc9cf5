//! Counts and gauges for Prometheus; docs/metrics.md lists every name.
//!
//! Labels are bounded: rods and sinks come from the configuration, everything else from short lists of the program.

use super::collect::{Disks, HealthNow};
use super::process::Process;
use super::rods::{self, Rods};
use super::{Beat, Health};
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::RodId;
use crate::analysis::track::Verdict;
use crate::site::store::Standing;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::encoding::text::encode;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry, Unit};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::{Duration, SystemTime};

/// A gauge of a quantity.
pub(super) type Quantity = Gauge<f64, AtomicU64>;

/// Result of one attempt to deliver an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// Delivered to the sink.
    Delivered,
    /// It is tried again later.
    Failed,
}

impl Delivery {
    fn code(self) -> &'static str {
        match self {
            Self::Delivered => "delivered",
            Self::Failed => "failed",
        }
    }
}

macro_rules! labels {
    ($($name:ident { $($label:ident: $kind:ty),* })*) => {$(
        #[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
        struct $name { $($label: $kind),* }
    )*};
}

labels! {
    OfRodOutcome { rod: String, outcome: &'static str }
    OfRodReason { rod: String, reason: &'static str }
    OfSink { sink: String }
    OfSinkOutcome { sink: String, outcome: &'static str }
}

/// The daemon's counts and gauges; shared by all its threads.
#[derive(Debug)]
pub struct Metrics {
    registry: Registry,
    records: Family<OfRodOutcome, Counter>,
    rejections: Family<OfRodReason, Counter>,
    analysis_s: Histogram,
    commit_s: Histogram,
    latency_s: Histogram,
    clients: Gauge,
    received_messages: Counter,
    received_bytes: Counter,
    journal_bytes: Gauge,
    outbox_waiting: Family<OfSink, Gauge>,
    deliveries: Family<OfSinkOutcome, Counter>,
    rods: Rods,
    disks: Disks,
}

impl Metrics {
    /// All metrics, at zero.
    pub fn new(health: Arc<Health>, beat: Arc<Beat>) -> Self {
        let mut registry = Registry::default();
        registry.register_collector(Box::new(Process));
        let own = registry.sub_registry_with_prefix("tirante");
        let build = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("analysis", crate::analysis::identify::VERSION.to_string()),
        ];
        own.register("build", "The program that runs", Info::new(build));
        let disks = Disks::default();
        own.register_collector(Box::new(HealthNow { health, beat }));
        own.register_collector(Box::new(disks.clone()));
        let mut r = Register(own);
        Self {
            records: r.put("records", None, "Records that came to their end, by what became of them"),
            rejections: r.put("rejections", None, "Rejected records, by reason (docs/recordings.md)"),
            analysis_s: r.histogram("analysis", "Time one record's analysis took", &ANALYSIS_S),
            commit_s: r.histogram("commit", "Time a record's commit to the store took, with those committed together", &COMMIT_S),
            latency_s: r.histogram(
                "latency",
                "Time from the end of a live record, by its own clock, to its commit; records that end more than an hour ago \
                 are not live",
                &LATENCY_S,
            ),
            clients: r.put("clients", None, "Clients connected to the sockets"),
            received_messages: r.put("received_messages", None, "Messages received through the sockets"),
            received_bytes: r.put("received", Some(Unit::Bytes), "Bytes received through the sockets"),
            journal_bytes: r.put("journal", Some(Unit::Bytes), "Size of all parts of the journal on disk"),
            outbox_waiting: r.put("outbox_waiting", None, "News of alarms and conditions a sink does not have yet"),
            deliveries: r.put("deliveries", None, "Attempts to deliver news of alarms, by what came of them"),
            rods: Rods::new(&mut r),
            disks,
            registry,
        }
    }

    /// Counts a record taken and durable, with the time of its commit.
    pub fn taken(&self, outcome: &Outcome, verdict: &Verdict, took: Duration) {
        let rod = outcome.rod();
        self.commit_s.observe(took.as_secs_f64());
        match outcome {
            Outcome::Rejected(rejected) => {
                self.record(rod, "rejected");
                let of = OfRodReason {
                    rod: rod.0.clone(),
                    reason: rejected.rejection.code(),
                };
                self.rejections.get_or_create(&of).inc();
            }
            _ if verdict.set_aside.is_some() => self.record(rod, "set-aside"),
            _ => self.record(rod, "used"),
        }
        if let (Some(end_s), Ok(now)) = (rods::end_s(outcome), SystemTime::UNIX_EPOCH.elapsed()) {
            let latency_s = now.as_secs_f64() - end_s;
            if (0.0..LIVE_S).contains(&latency_s) {
                self.latency_s.observe(latency_s);
            }
        }
        self.rods.taken(outcome, verdict);
    }

    /// Counts a record that is in the store already.
    pub fn known(&self, rod: &RodId) {
        self.record(rod, "known");
    }

    fn record(&self, rod: &RodId, outcome: &'static str) {
        let of = OfRodOutcome {
            rod: rod.0.clone(),
            outcome,
        };
        self.records.get_or_create(&of).inc();
    }

    /// Sets the status of all rods of the store: at the start, and for another configuration.
    pub fn standings(&self, standings: &[Standing]) {
        self.rods.all(standings);
    }

    /// Adds the time of one record's analysis.
    pub fn analysis(&self, took: Duration) {
        self.analysis_s.observe(took.as_secs_f64());
    }

    /// Sets the number of clients connected.
    pub fn clients(&self, connected: usize) {
        self.clients.set(count(connected));
    }

    /// Counts messages from a socket, and their bytes.
    pub fn received(&self, messages: u64, bytes: u64) {
        self.received_messages.inc_by(messages);
        self.received_bytes.inc_by(bytes);
    }

    /// Sets the total size of the journal's parts on disk \[bytes\].
    pub fn journal(&self, bytes: u64) {
        self.journal_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
    }

    /// Sets the number of events that wait for a sink.
    pub fn outbox(&self, sink: &str, waiting: usize) {
        let sink = OfSink {
            sink: sink.to_owned(),
        };
        self.outbox_waiting.get_or_create(&sink).set(count(waiting));
    }

    /// Counts a delivery to a sink, or a failure.
    pub fn delivery(&self, sink: &str, outcome: Delivery) {
        self.deliveries
            .get_or_create(&OfSinkOutcome {
                sink: sink.to_owned(),
                outcome: outcome.code(),
            })
            .inc();
    }

    /// Removes a sink that is no longer configured.
    pub fn forget_sink(&self, sink: &str) {
        let sink = OfSink {
            sink: sink.to_owned(),
        };
        self.outbox_waiting.remove(&sink);
    }

    /// Shows the free space where `path` is, as `use_`: `store`, `journal`.
    pub fn watch_disk(&self, use_: &'static str, path: PathBuf) {
        self.disks.paths().insert(use_, path);
    }

    /// All metrics as OpenMetrics text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        match encode(&mut text, &self.registry) {
            Ok(()) => text,
            // Writing to a string fails only if an encoder does.
            Err(error) => format!("# {error}\n# EOF\n"),
        }
    }
}

/// Largest age of a live record's end when it comes \[s\].
const LIVE_S: f64 = 3600.0;

const ANALYSIS_S: [f64; 10] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
const COMMIT_S: [f64; 10] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
const LATENCY_S: [f64; 10] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 60.0, 300.0, 900.0, 3600.0];

pub(super) fn count(items: usize) -> i64 {
    i64::try_from(items).unwrap_or(i64::MAX)
}

/// A registry that returns the metric registered.
pub(super) struct Register<'r>(&'r mut Registry);

impl Register<'_> {
    pub(super) fn put<M: Metric + Clone + Default>(
        &mut self,
        name: &str,
        unit: Option<Unit>,
        help: &str,
    ) -> M {
        self.keep(name, unit, help, M::default())
    }

    fn histogram(&mut self, name: &str, help: &str, buckets: &[f64]) -> Histogram {
        let histogram = Histogram::new(buckets.iter().copied());
        self.keep(name, Some(Unit::Seconds), help, histogram)
    }

    fn keep<M: Metric + Clone>(&mut self, name: &str, unit: Option<Unit>, help: &str, metric: M) -> M {
        match unit {
            Some(unit) => self.0.register_with_unit(name, help, unit, metric.clone()),
            None => self.0.register(name, help, metric.clone()),
        }
        metric
    }
}
