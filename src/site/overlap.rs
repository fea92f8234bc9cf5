//! Records of one rod that overlap in time: two sensors, or two sites, under one topic. Each file by itself is in order, and the
//! baseline would hold both.

use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{RodId, Timestamp};
use std::collections::{HashMap, VecDeque};

/// Latest records of a rod that the next one is compared with.
const KEPT: usize = 8;
/// Share of the shorter one from which on an overlap counts: what is cut anew after a restart may share an edge.
const SHARE: f64 = 0.25;
/// Overlapping records among the latest from which on the rod's topic has two sources.
const MANY: usize = 3;

/// Beginning of the subjects of conditions: no topic begins like this.
const ABOUT: &str = "records of rod ";

/// Latest records of each rod with a single sensor.
#[derive(Debug, Default)]
pub struct Overlaps(HashMap<RodId, Rod>);

#[derive(Debug, Default)]
struct Rod {
    latest: VecDeque<Span>,
    is_told: bool,
}

#[derive(Debug)]
struct Span {
    start: Timestamp,
    duration_s: f64,
    file: String,
    overlaps: bool,
}

/// Subject of the condition of a rod.
pub fn about(rod: &RodId) -> String {
    format!("{ABOUT}{rod}")
}

/// True for the subject of such a condition.
pub fn is_about(text: &str) -> bool {
    text.starts_with(ABOUT)
}

/// Change of a rod.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Change {
    /// Its records overlap, in one sentence.
    Begins(String),
    /// They do no longer.
    Ends,
}

impl Overlaps {
    /// Takes the outcome of a new record, which came from `file`.
    pub fn take(&mut self, outcome: &Outcome, file: &str) -> Option<Change> {
        let Outcome::Identified(found) = outcome else {
            return None;
        };
        let measurement = found.measurement.as_ref().filter(|_| found.joint.is_none())?;
        let (start, duration_s) = (measurement.start, measurement.duration_s);
        let rod = self.0.entry(found.rod.clone()).or_default();
        let overlaps = |other: &&Span| {
            let later = start.seconds_since(other.start);
            let shared = (other.duration_s - later)
                .min(duration_s + later)
                .min(duration_s.min(other.duration_s));
            shared > SHARE * duration_s.min(other.duration_s)
        };
        let other = rod
            .latest
            .iter()
            .rev()
            .find(overlaps)
            .map(|other| other.file.clone());
        rod.latest.push_back(Span {
            start,
            duration_s,
            file: file.to_owned(),
            overlaps: other.is_some(),
        });
        if rod.latest.len() > KEPT {
            rod.latest.pop_front();
        }
        let count = rod.latest.iter().filter(|span| span.overlaps).count();
        match other {
            Some(other) if count >= MANY && !rod.is_told => {
                rod.is_told = true;
                let files = match other == file {
                    true => file.to_owned(),
                    false => format!("{other} and {file}"),
                };
                Some(Change::Begins(format!(
                    "rod {}: records overlap in time, the latest at {start}, of {files}: two sensors, or two sites, have its topic, or one \
                     recording is there in two versions; its baseline and its alarms are of both: give each sensor a topic of its own, \
                     begin the rod's baseline anew (`tirante rebaseline`)",
                    found.rod
                )))
            }
            None if count == 0 && rod.is_told && rod.latest.len() >= KEPT => {
                rod.is_told = false;
                Some(Change::Ends)
            }
            _ => None,
        }
    }

    /// Goes on with a rod whose records overlapped before a restart: it takes as many that do not to end it as without one.
    pub fn resume(&mut self, rod: &RodId) {
        self.0.entry(rod.clone()).or_default().is_told = true;
    }

    /// Forgets the rods that are not `kept`; returns those whose records overlapped.
    pub fn retain(&mut self, is_kept: impl Fn(&RodId) -> bool) -> Vec<RodId> {
        let gone = self.0.extract_if(|rod, _| !is_kept(rod));
        gone.filter(|(_, rod)| rod.is_told).map(|(rod, _)| rod).collect()
    }
}
