//! `identify` of a rod with several sensors: their records by moments, each moment identified jointly.

use super::foreign;
use crate::analysis::identify::{ArrayResult, Plan, Sensed};
use crate::analysis::inference::joint::Datum;
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::array;
use crate::analysis::signal::record::{Event, Record, RodChannels, RodId};
use crate::config::{Config, RodConfig};
use crate::recording::import::{self, Whose};
use crate::recording::read::{Options, Recording};
use crate::site::analyse::refused;
use crate::site::records::Others;
use std::path::Path;

/// Outcomes of a recording's moments, with the losses on the way.
pub struct Joint {
    /// One per moment, in time order.
    pub outcomes: Vec<Outcome>,
    /// True if data were lost, or a sensor was left out.
    pub has_losses: bool,
}

/// Identifies the records of all sensors of `rod` in a recording or another program's file.
///
/// # Errors
/// The file cannot be read, or has nothing of any sensor.
pub fn identify(
    path: &Path,
    config: &Config,
    rod: &RodConfig,
    plan: &Plan,
    others: &Others,
    data: &[Datum],
) -> anyhow::Result<Joint> {
    let id = &rod.analysis.rod;
    let lanes: Vec<RodChannels> = rod
        .sensors
        .iter()
        .enumerate()
        .map(|(number, sensor)| sensor.as_rod(id, number + 1))
        .collect();
    let whose = Whose {
        rods: &lanes,
        is_meant: others.is_meant,
        any_start: others.any_start,
    };
    let mut recording = import::open(
        path,
        &others.how,
        whose,
        &config.record,
        Options::default(),
        &foreign::watch,
    )?;
    let name = |sensor: usize| {
        let sensor = &rod.sensors[sensor];
        format!("{id}: sensor {} at {} l", sensor.channel.topic, sensor.at)
    };
    let mut has_losses = false;
    let mut records: Vec<Vec<Record>> = vec![Vec::new(); lanes.len()];
    for event in recording.by_ref() {
        let of = |rod: &RodId| lanes.iter().position(|lane| lane.rod == *rod);
        match event {
            Event::Record(record) => {
                if let Some(sensor) = of(&record.rod) {
                    let rod = id.clone();
                    records[sensor].push(Record { rod, ..record });
                }
            }
            Event::Rejected { rod, rejection, .. } => {
                if let Some(sensor) = of(&rod) {
                    tell!("{}: {rejection}", name(sensor));
                    has_losses = true;
                }
            }
            Event::Readings { .. } => {}
        }
    }
    let summary = Recording::summary(&recording);
    for fault in summary.faults() {
        tell!("{fault}");
        has_losses = true;
    }
    anyhow::ensure!(
        !summary.has_nothing(),
        "{}",
        summary.absence().unwrap_or_default()
    );
    for (sensor, _) in records.iter().enumerate().filter(|(_, own)| own.is_empty()) {
        tell!("{}: no record in {}", name(sensor), path.display());
        has_losses = true;
    }
    let mut outcomes = Vec::new();
    for moment in array::moments(records) {
        let sensed: Vec<Sensed<'_>> = moment
            .iter()
            .map(|(sensor, record)| {
                let own = &rod.sensors[*sensor];
                Sensed {
                    at: own.at,
                    at_sd_m: own.at_sd_m,
                    unit: own.channel.unit,
                    gain_sd: own.gain_sd,
                    record,
                }
            })
            .collect();
        let ArrayResult { outcome, left_out } = plan.run_array(&sensed, data);
        for (index, why) in left_out {
            tell!("{}: left out: {why}", name(moment[index].0));
            has_losses = true;
        }
        outcomes.push(match outcome {
            Ok(identification) => Outcome::Identified(Box::new(identification)),
            Err(refusal) => {
                // There is a first: a moment is made of records.
                let Some((_, first)) = moment.into_iter().next() else {
                    continue;
                };
                let identity = first.identity();
                refused(first, identity, refusal)
            }
        });
    }
    Ok(Joint { outcomes, has_losses })
}
