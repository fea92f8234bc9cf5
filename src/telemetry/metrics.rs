//! Counts and gauges for Prometheus; docs/metrics.md lists every name.
//!
//! Labels are bounded: rods and sinks come from the configuration, everything else from short lists of the program.

use super::{Beat, Fault, Health, State, process};
use crate::record::RodId;
use crate::track::RodState;
use crate::track::alarm::Kind;
use prometheus_client::collector::Collector;
use prometheus_client::encoding::text::encode;
use prometheus_client::encoding::{DescriptorEncoder, EncodeLabelSet, MetricEncoder};
use prometheus_client::metrics::MetricType;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::metrics::info::Info;
use prometheus_client::registry::{Metric, Registry, Unit};
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// A gauge of a quantity.
pub(super) type Quantity = Gauge<f64, AtomicU64>;

/// Conditions shown one by one: what they are about may come from outside.
const MOST_CONDITIONS: usize = 64;

/// What became of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RecordOutcome {
    /// It gave a force, and counts.
    Used,
    /// It gave a force, but is not followed.
    SetAside,
    /// It gave none, for a reason.
    Rejected,
    /// The store had it already.
    Known,
}

impl RecordOutcome {
    fn code(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::SetAside => "set-aside",
            Self::Rejected => "rejected",
            Self::Known => "known",
        }
    }
}

/// A bounded queue inside the daemon.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Queue {
    /// From the sockets to the journal's thread.
    Journal,
    /// From the reader to the core.
    Jobs,
}

impl Queue {
    fn code(self) -> &'static str {
        match self {
            Self::Journal => "journal",
            Self::Jobs => "jobs",
        }
    }
}

/// What came of one attempt to deliver news.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Delivery {
    /// The sink has it.
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

/// How a rod stands after a record.
#[derive(Debug, Clone, PartialEq)]
pub struct RodStanding<'a> {
    /// Its state.
    pub state: &'a RodState,
    /// The start of its latest record, in seconds since 1970.
    pub last_record_s: Option<f64>,
    /// Its force at the reference temperature, or at its own if uncompensated \[N\].
    pub force_n: Option<f64>,
    /// The same, as a share of the baseline's.
    pub relative_force: Option<f64>,
    /// Kinds of the alarms that stand.
    pub alarms: &'a [Kind],
}

macro_rules! labels {
    ($($name:ident { $($label:ident: $kind:ty),* })*) => {$(
        #[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
        struct $name { $($label: $kind),* }
    )*};
}

labels! {
    OfRod { rod: String }
    OfRodOutcome { rod: String, outcome: &'static str }
    OfRodReason { rod: String, reason: &'static str }
    OfRodKind { rod: String, kind: &'static str }
    OfRodState { rod: String, state: &'static str }
    OfQueue { queue: &'static str }
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
    queue_length: Family<OfQueue, Gauge>,
    queue_capacity: Family<OfQueue, Gauge>,
    clients: Gauge,
    received_messages: Counter,
    received_bytes: Counter,
    journal_bytes: Gauge,
    outbox_waiting: Family<OfSink, Gauge>,
    deliveries: Family<OfSinkOutcome, Counter>,
    alarms: Family<OfRodKind, Gauge>,
    rod_state: Family<OfRodState, Gauge>,
    rod_force: Family<OfRod, Quantity>,
    rod_relative: Family<OfRod, Quantity>,
    rod_last_record: Family<OfRod, Quantity>,
    disks: Disks,
}

impl Metrics {
    /// All at zero.
    pub fn new(health: Arc<Health>, beat: Arc<Beat>) -> Self {
        let mut registry = Registry::default();
        registry.register_collector(Box::new(process::Process));
        let own = registry.sub_registry_with_prefix("tirante");
        let build = vec![
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("analysis", crate::analysis::VERSION.to_string()),
        ];
        own.register("build", "The program that runs", Info::new(build));
        let disks = Disks::default();
        own.register_collector(Box::new(Standing { health, beat }));
        own.register_collector(Box::new(disks.clone()));
        let mut r = Register(own);
        Self {
            records: r.put("records", None, "Records that came to their end, by what became of them"),
            rejections: r.put("rejections", None, "Rejected records, by reason (docs/recordings.md)"),
            analysis_s: r.histogram("analysis", "Time one record's analysis took", &ANALYSIS_S),
            commit_s: r.histogram("commit", "Time one record's commit to the store took", &COMMIT_S),
            latency_s: r.histogram(
                "latency",
                "Time from the arrival of a live record's last sample to its commit",
                &LATENCY_S,
            ),
            queue_length: r.put("queue_length", None, "Items that wait in a queue"),
            queue_capacity: r.put("queue_capacity", None, "Items a queue holds before its writer waits"),
            clients: r.put("clients", None, "Clients connected to the sockets"),
            received_messages: r.put("received_messages", None, "Messages received through the sockets"),
            received_bytes: r.put("received", Some(Unit::Bytes), "Bytes received through the sockets"),
            journal_bytes: r.put("journal", Some(Unit::Bytes), "Size of all parts of the journal on disk"),
            outbox_waiting: r.put("outbox_waiting", None, "News of alarms a sink does not have yet"),
            deliveries: r.put("deliveries", None, "Attempts to deliver news of alarms, by what came of them"),
            alarms: r.put("alarms_standing", None, "Alarms of a rod that stand, acknowledged or not"),
            rod_state: r.put("rod_state", None, "1 for the state a rod is in (docs/states.md), else 0"),
            rod_force: r.put(
                "rod_force",
                Some(Unit::Other("newtons".to_owned())),
                "Axial force of a rod's latest record that counts, at the reference temperature if compensated",
            ),
            rod_relative: r.put("rod_relative_force", None, "The same force as a share of the baseline's"),
            rod_last_record: r.put(
                "rod_last_record_timestamp",
                Some(Unit::Seconds),
                "Start of a rod's latest record, rejected or not, since 1970",
            ),
            disks,
            registry,
        }
    }

    /// A record came to its end.
    pub fn record(&self, rod: &RodId, outcome: RecordOutcome) {
        self.records
            .get_or_create(&OfRodOutcome {
                rod: rod.0.clone(),
                outcome: outcome.code(),
            })
            .inc();
    }

    /// A record was rejected, for the reason of this [code](crate::record::Rejection::code).
    pub fn rejection(&self, rod: &RodId, reason: &'static str) {
        self.record(rod, RecordOutcome::Rejected);
        self.rejections
            .get_or_create(&OfRodReason {
                rod: rod.0.clone(),
                reason,
            })
            .inc();
    }

    /// One record's analysis took this long.
    pub fn analysis(&self, took: Duration) {
        self.analysis_s.observe(took.as_secs_f64());
    }

    /// One record's commit took this long.
    pub fn commit(&self, took: Duration) {
        self.commit_s.observe(took.as_secs_f64());
    }

    /// A live record was committed this long after its last sample came.
    pub fn latency(&self, took: Duration) {
        self.latency_s.observe(took.as_secs_f64());
    }

    /// A queue has this many items of so many it can hold.
    pub fn queue(&self, queue: Queue, length: usize, capacity: usize) {
        let queue = OfQueue { queue: queue.code() };
        self.queue_length.get_or_create(&queue).set(count(length));
        self.queue_capacity.get_or_create(&queue).set(count(capacity));
    }

    /// This many clients are connected.
    pub fn clients(&self, connected: usize) {
        self.clients.set(count(connected));
    }

    /// Messages came through a socket, of so many bytes together.
    pub fn received(&self, messages: u64, bytes: u64) {
        self.received_messages.inc_by(messages);
        self.received_bytes.inc_by(bytes);
    }

    /// The journal's parts on disk have this many bytes together.
    pub fn journal(&self, bytes: u64) {
        self.journal_bytes.set(i64::try_from(bytes).unwrap_or(i64::MAX));
    }

    /// This many news wait for a sink.
    pub fn outbox(&self, sink: &str, waiting: usize) {
        let sink = OfSink {
            sink: sink.to_owned(),
        };
        self.outbox_waiting.get_or_create(&sink).set(count(waiting));
    }

    /// News were delivered to a sink, or not.
    pub fn delivery(&self, sink: &str, outcome: Delivery) {
        self.deliveries
            .get_or_create(&OfSinkOutcome {
                sink: sink.to_owned(),
                outcome: outcome.code(),
            })
            .inc();
    }

    /// A rod stands so now.
    pub fn rod(&self, rod: &RodId, standing: &RodStanding<'_>) {
        let of = OfRod { rod: rod.0.clone() };
        for (gauge, value) in [
            (&self.rod_force, standing.force_n),
            (&self.rod_relative, standing.relative_force),
            (&self.rod_last_record, standing.last_record_s),
        ] {
            match value {
                Some(value) => {
                    gauge.get_or_create(&of).set(value);
                }
                None => {
                    gauge.remove(&of);
                }
            }
        }
        for state in STATES {
            let is_in = i64::from(standing.state.code() == state);
            let rod = rod.0.clone();
            self.rod_state
                .get_or_create(&OfRodState { rod, state })
                .set(is_in);
        }
        for kind in Kind::ALL {
            let standing = standing.alarms.iter().filter(|other| **other == kind).count();
            let of = OfRodKind {
                rod: rod.0.clone(),
                kind: kind.code(),
            };
            self.alarms.get_or_create(&of).set(count(standing));
        }
    }

    /// Forgets the gauges of all rods and sinks, before those of a new configuration are set.
    pub fn forget_standing(&self) {
        self.rod_force.clear();
        self.rod_relative.clear();
        self.rod_last_record.clear();
        self.rod_state.clear();
        self.alarms.clear();
        self.outbox_waiting.clear();
    }

    /// Shows the free space where `path` is, as `use_`: `store`, `journal`.
    pub fn watch_disk(&self, use_: &'static str, path: PathBuf) {
        self.disks.paths().insert(use_, path);
    }

    /// Everything as OpenMetrics text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        match encode(&mut text, &self.registry) {
            Ok(()) => text,
            // Writing to a string fails only if an encoder does.
            Err(error) => format!("# {error}\n# EOF\n"),
        }
    }
}

/// The states of [`RodState`].
const STATES: [&str; 4] = ["learning", "monitoring", "alarm", "not-monitoring"];

const ANALYSIS_S: [f64; 10] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
const COMMIT_S: [f64; 10] = [0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
const LATENCY_S: [f64; 10] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 60.0, 300.0, 1800.0, 7200.0];

fn count(items: usize) -> i64 {
    i64::try_from(items).unwrap_or(i64::MAX)
}

/// A registry that hands back what it was given.
struct Register<'r>(&'r mut Registry);

impl Register<'_> {
    fn put<M: Metric + Clone + Default>(&mut self, name: &str, unit: Option<Unit>, help: &str) -> M {
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

type NoLabels = Vec<(&'static str, String)>;

/// Writes a family of gauges or counters whose values are known only when somebody asks.
pub(super) fn family(
    encoder: &mut DescriptorEncoder<'_>,
    (name, unit, help): (&str, Option<Unit>, &str),
    kind: MetricType,
    values: impl IntoIterator<Item = (Vec<(&'static str, String)>, f64)>,
) -> fmt::Result {
    let mut values = values.into_iter().peekable();
    if values.peek().is_none() {
        return Ok(());
    }
    let mut metric = encoder.encode_descriptor(name, help, unit.as_ref(), kind)?;
    for (labels, value) in values {
        if labels.is_empty() {
            one(&mut metric, kind, value)?;
        } else {
            one(&mut metric.encode_family(&labels)?, kind, value)?;
        }
    }
    Ok(())
}

fn one(encoder: &mut MetricEncoder<'_>, kind: MetricType, value: f64) -> fmt::Result {
    match kind {
        MetricType::Counter => encoder.encode_counter::<NoLabels, f64, f64>(&value, None),
        _ => encoder.encode_gauge(&value),
    }
}

/// The state of health, at the moment somebody asks.
#[derive(Debug)]
struct Standing {
    health: Arc<Health>,
    beat: Arc<Beat>,
}

impl Collector for Standing {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let encoder = &mut encoder;
        let flag = |is: bool| f64::from(u8::from(is));
        let state = self.health.state();
        family(
            encoder,
            ("state", None, "1 for the daemon's state of health, else 0"),
            MetricType::Gauge,
            State::ALL.map(|other| (vec![("state", other.code().to_owned())], flag(other == state))),
        )?;
        let is_ready = self.health.phase().not_ready().is_none();
        family(
            encoder,
            (
                "ready",
                None,
                "1 while the store is open and the sources are live, else 0",
            ),
            MetricType::Gauge,
            [(Vec::new(), flag(is_ready))],
        )?;
        family(
            encoder,
            (
                "beat_age",
                Some(Unit::Seconds),
                "Time since something last went through the whole pipeline",
            ),
            MetricType::Gauge,
            [(Vec::new(), self.beat.age().as_secs_f64())],
        )?;
        let of_kind = |fault: Fault| vec![("kind", fault.code().to_owned())];
        family(
            encoder,
            (
                "faults",
                None,
                "Faults that happened, by kind (docs/operations.md)",
            ),
            MetricType::Counter,
            Fault::ALL.map(|fault| (of_kind(fault), self.health.count(fault) as f64)),
        )?;
        let conditions = self.health.conditions();
        let mut counts: BTreeMap<Fault, u32> = Fault::ALL.map(|fault| (fault, 0)).into();
        for condition in &conditions {
            *counts.entry(condition.fault).or_default() += 1;
        }
        family(
            encoder,
            ("conditions", None, "Faults that last, by kind"),
            MetricType::Gauge,
            counts
                .into_iter()
                .map(|(fault, count)| (of_kind(fault), f64::from(count))),
        )?;
        family(
            encoder,
            (
                "condition",
                None,
                "1 for each fault that lasts, with what it is about; the first 64",
            ),
            MetricType::Gauge,
            conditions.into_iter().take(MOST_CONDITIONS).map(|condition| {
                let labels = vec![
                    ("kind", condition.fault.code().to_owned()),
                    ("about", condition.about),
                ];
                (labels, 1.0)
            }),
        )
    }
}

/// Free space of the disks that are written to.
#[derive(Debug, Clone, Default)]
struct Disks(Arc<Mutex<BTreeMap<&'static str, PathBuf>>>);

impl Disks {
    fn paths(&self) -> std::sync::MutexGuard<'_, BTreeMap<&'static str, PathBuf>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Collector for Disks {
    fn encode(&self, mut encoder: DescriptorEncoder<'_>) -> fmt::Result {
        let paths = self.paths().clone();
        let free = paths.into_iter().filter_map(|(use_, path)| {
            let disk = rustix::fs::statvfs(path).ok()?;
            let free = disk.f_bavail as f64 * disk.f_frsize as f64;
            Some((vec![("use", use_.to_owned())], free))
        });
        family(
            &mut encoder,
            (
                "disk_free",
                Some(Unit::Bytes),
                "Free space on the disk of the store, of the journal",
            ),
            MetricType::Gauge,
            free,
        )
    }
}
