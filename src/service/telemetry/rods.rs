//! Gauges of the rods: the status of each after its latest record.

use super::metrics::{Quantity, Register, count};
use crate::analysis::findings::Doubt;
use crate::analysis::identify::Identification;
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::relative::Interval;
use crate::analysis::track::{Alarm, Kind, RodState, Verdict};
use crate::site::clock;
use crate::site::store::Standing;
use prometheus_client::encoding::EncodeLabelSet;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::registry::Unit;

/// States of [`RodState`].
const STATES: [&str; 4] = ["learning", "monitoring", "alarm", "not-monitoring"];

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct OfRod {
    rod: String,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct OfRodKind {
    rod: String,
    kind: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct OfRodState {
    rod: String,
    state: &'static str,
}

#[derive(Debug, Clone, PartialEq, Eq, Hash, EncodeLabelSet)]
struct OfRodDoubt {
    rod: String,
    doubt: &'static str,
}

#[derive(Debug)]
pub(super) struct Rods {
    alarms: Family<OfRodKind, Gauge>,
    state: Family<OfRodState, Gauge>,
    force_n: Family<OfRod, Quantity>,
    doubts: Family<OfRodDoubt, Gauge>,
    relative: Family<OfRod, Quantity>,
    last_record_s: Family<OfRod, Quantity>,
    awaited_s: Family<OfRod, Quantity>,
}

impl Rods {
    pub(super) fn new(register: &mut Register<'_>) -> Self {
        Self {
            alarms: register.put(
                "alarms_standing",
                None,
                "Alarms of a rod that stand, acknowledged or not",
            ),
            state: register.put(
                "rod_state",
                None,
                "1 for the state a rod is in (docs/states.md), else 0",
            ),
            force_n: register.put(
                "rod_force",
                Some(Unit::Other("newtons".to_owned())),
                "Axial force of a rod's latest record that counts, at the reference temperature if compensated",
            ),
            doubts: register.put(
                "rod_force_doubt",
                None,
                "1 for each reason to doubt that force (docs/measure.md, Marks), else 0; absent as the force",
            ),
            relative: register.put(
                "rod_relative_force",
                None,
                "The same force as a share of the baseline's",
            ),
            last_record_s: register.put(
                "rod_last_record_timestamp",
                Some(Unit::Seconds),
                "Start of a rod's latest record, rejected or not, since 1970; none that a wrong clock dated ahead",
            ),
            awaited_s: register.put(
                "rod_awaited_timestamp",
                Some(Unit::Seconds),
                "Since when the first record of a rod has been waited for, since 1970; gone once it has come",
            ),
        }
    }

    /// Updates the gauges after a record.
    pub(super) fn taken(&self, outcome: &Outcome, verdict: &Verdict) {
        let rod = outcome.rod();
        self.stands(rod, &verdict.state, &verdict.alarms);
        put(&self.awaited_s, rod, None);
        let ahead = clock::latest_past(clock::now());
        if let Some(start) = outcome.start().filter(|start| *start <= ahead) {
            // A late record is not the latest.
            let last = self
                .last_record_s
                .get(&OfRod { rod: rod.0.clone() })
                .map(|last| last.get());
            let last = last.unwrap_or(f64::NEG_INFINITY);
            put(&self.last_record_s, rod, Some(seconds(start).max(last)));
        }
        if !matches!(outcome, Outcome::Rejected(_)) && verdict.set_aside.is_none() {
            let at_reference = verdict.at_reference.as_ref();
            let relative = verdict.relative.as_ref();
            let force_n = at_reference.map(|at| at.force_n).or(relative.map(|r| r.force_n));
            let ratio = at_reference.map(|at| at.ratio).or(relative.map(|r| r.ratio));
            self.force(rod, force_n, ratio, &outcome.doubts());
        }
    }

    /// Sets the status of all rods, and removes any other.
    pub(super) fn all(&self, standings: &[Standing]) {
        self.alarms.clear();
        self.state.clear();
        self.force_n.clear();
        self.doubts.clear();
        self.relative.clear();
        self.last_record_s.clear();
        self.awaited_s.clear();
        let ahead = clock::latest_past(clock::now());
        for standing in standings {
            let rod = &standing.rod;
            self.stands(rod, &standing.state, &standing.alarms);
            put(&self.awaited_s, rod, standing.awaited.map(seconds));
            let latest = standing.latest_start.filter(|start| *start <= ahead);
            put(&self.last_record_s, rod, latest.map(seconds));
            // What an older segment's record says is relative to another baseline.
            if let Ok(Some(row)) = standing.latest_row()
                && row.segment == Some(standing.segment)
            {
                self.force(rod, row.force_n(), row.ratio(), &row.doubts());
            }
        }
    }

    fn force(&self, rod: &RodId, force_n: Option<Interval>, ratio: Option<Interval>, doubts: &[Doubt]) {
        for doubt in Doubt::ALL {
            let of = OfRodDoubt {
                rod: rod.0.clone(),
                doubt: doubt.code(),
            };
            match force_n {
                Some(_) => {
                    self.doubts
                        .get_or_create(&of)
                        .set(i64::from(doubts.contains(&doubt)));
                }
                None => {
                    self.doubts.remove(&of);
                }
            }
        }
        put(&self.force_n, rod, force_n.map(|force| force.mean));
        put(&self.relative, rod, ratio.map(|ratio| ratio.mean));
    }

    fn stands(&self, rod: &RodId, state: &RodState, alarms: &[Alarm]) {
        for code in STATES {
            let of = OfRodState {
                rod: rod.0.clone(),
                state: code,
            };
            self.state.get_or_create(&of).set(i64::from(state.code() == code));
        }
        for kind in Kind::ALL {
            let of = OfRodKind {
                rod: rod.0.clone(),
                kind: kind.code(),
            };
            let standing = alarms.iter().filter(|alarm| alarm.kind == kind).count();
            self.alarms.get_or_create(&of).set(count(standing));
        }
    }
}

/// Sets a value, or removes it if there is none.
fn put(gauges: &Family<OfRod, Quantity>, rod: &RodId, value: Option<f64>) {
    let of = OfRod { rod: rod.0.clone() };
    match value {
        Some(value) => {
            gauges.get_or_create(&of).set(value);
        }
        None => {
            gauges.remove(&of);
        }
    }
}

/// End of a record that gave a force \[s since 1970\].
pub(super) fn end_s(outcome: &Outcome) -> Option<f64> {
    match outcome {
        Outcome::Identified(identification) => {
            measured(identification).map(|(start, duration_s)| seconds(start) + duration_s)
        }
        Outcome::Tabulated(row) => Some(seconds(row.start) + row.duration_s),
        Outcome::Rejected(_) => None,
    }
}

fn measured(identification: &Identification) -> Option<(Timestamp, f64)> {
    let measurement = identification.measurement.as_ref()?;
    Some((measurement.start, measurement.duration_s))
}

fn seconds(time: Timestamp) -> f64 {
    time.as_nanos() as f64 * 1e-9
}
