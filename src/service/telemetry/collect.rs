//! Metrics evaluated at each scrape: the state of health, free space.

use super::{Beat, Fault, Health, State, Via};
use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, MetricEncoder};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Unit;
use std::collections::BTreeMap;
use std::fmt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most conditions shown one by one: their subjects may come from outside.
const MOST_CONDITIONS: usize = 64;

type NoLabels = Vec<(&'static str, String)>;

/// Writes a family of gauges or counters evaluated at the scrape.
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

/// State of health at the time of the scrape.
#[derive(Debug)]
pub(super) struct HealthNow {
    pub(super) health: Arc<Health>,
    pub(super) beat: Arc<Beat>,
}

impl Collector for HealthNow {
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
        )?;
        let credentials = self.health.credentials();
        family(
            encoder,
            (
                "denied",
                None,
                "Attempts without valid credentials, or beyond what they allow, at the sockets and over HTTP",
            ),
            MetricType::Counter,
            [("socket", Via::Socket), ("http", Via::Http)]
                .map(|(at, entry)| (vec![("at", at.to_owned())], credentials.denials(entry) as f64)),
        )?;
        let ends = credentials.all_ends().into_iter();
        family(
            encoder,
            (
                "certificate_end_timestamp",
                Some(Unit::Seconds),
                "Time after which a certificate is not valid, by the key of `[ingest.tls]` that names its file",
            ),
            MetricType::Gauge,
            ends.map(|(key, end_s)| (vec![("key", key.to_owned())], end_s as f64)),
        )
    }
}

/// Free space of the disks in use.
#[derive(Debug, Clone, Default)]
pub(super) struct Disks(Arc<Mutex<BTreeMap<&'static str, PathBuf>>>);

impl Disks {
    pub(super) fn paths(&self) -> MutexGuard<'_, BTreeMap<&'static str, PathBuf>> {
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
