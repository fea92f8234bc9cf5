//! Content of a report, as plain data: the page is the same whether a store or a test fills it.

use crate::analysis::findings::Doubt;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::{Alarm, Interval, Period, RodState};
use std::collections::BTreeMap;

/// A site and its rods.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SiteReport {
    /// Name of the site.
    pub site: String,
    /// Its rods, in the order shown.
    pub rods: Vec<RodReport>,
    /// Provenance of the numbers, as name and value: program, configuration, analysis version, seed.
    pub provenance: Vec<(String, String)>,
}

/// Content of a report for one rod.
#[derive(Debug, Clone, PartialEq)]
pub struct RodReport {
    /// Id of the rod.
    pub rod: String,
    /// State after its last record; `None` if it is not tracked.
    pub state: Option<RodState>,
    /// Number of its current segment, if known: not always the highest one, as earlier settings may have come back.
    pub segment: Option<u32>,
    /// Number of used records that are not among `records`, as their lines were removed.
    pub older_used: usize,
    /// Unit of its samples as written, if known: `m`, `m/s`.
    pub motion_unit: Option<String>,
    /// Facts of its configuration, as name and value: length, section, material, supports.
    pub facts: Vec<(String, String)>,
    /// Number of records that a baseline takes, if known.
    pub baseline_takes: Option<usize>,
    /// Identified records, ascending in time.
    pub records: Vec<RecordPoint>,
    /// Refused records by reason, the most frequent first.
    pub rejections: Vec<RejectionCount>,
    /// Stretches of history with one baseline each, ascending.
    pub segments: Vec<SegmentReport>,
    /// Closed periods with their segment's number, ascending.
    pub periods: Vec<(u32, Period)>,
    /// Effect of temperature, as learned.
    pub thermal: Option<ThermalLine>,
    /// Every alarm, in the order raised.
    pub alarms: Vec<Alarm>,
    /// Words of the people who acknowledged them, by the alarm's id.
    pub words: BTreeMap<String, String>,
    /// The first record of the present baseline.
    pub baseline: Option<Snapshot>,
    /// The latest identified record.
    pub latest: Option<Snapshot>,
    /// The latest refused record with samples.
    pub refused: Option<Snapshot>,
    /// File of the latest record, if known.
    pub file: Option<String>,
}

impl RodReport {
    /// A rod without any data.
    pub fn new(rod: &str) -> Self {
        Self {
            rod: rod.to_owned(),
            state: None,
            segment: None,
            older_used: 0,
            motion_unit: None,
            facts: Vec::new(),
            baseline_takes: None,
            records: Vec::new(),
            rejections: Vec::new(),
            segments: Vec::new(),
            periods: Vec::new(),
            thermal: None,
            alarms: Vec::new(),
            words: BTreeMap::new(),
            baseline: None,
            latest: None,
            refused: None,
            file: None,
        }
    }

    /// The latest identified record as kept: of its own, or as the first of its baseline.
    pub fn shown(&self) -> Option<&Snapshot> {
        self.latest.as_ref().or(self.baseline.as_ref())
    }

    /// Active alarms.
    pub fn standing(&self) -> impl Iterator<Item = &Alarm> {
        self.alarms.iter().filter(|alarm| !alarm.is_over())
    }

    /// The record of a rod measured only once, without another to compare it with or an alarm to tell.
    pub fn only_record(&self) -> Option<&RecordPoint> {
        match &self.records[..] {
            [only] if only.ratio.is_none() && self.older_used == 0 && self.standing().next().is_none() => {
                Some(only)
            }
            _ => None,
        }
    }

    /// True for a rod that fits one sheet: one record came, used or refused.
    pub fn is_sheet(&self) -> bool {
        self.only_record().is_some() || self.is_refused_once()
    }

    /// True for a rod of which one record came, which was refused.
    pub fn is_refused_once(&self) -> bool {
        let refused: usize = self.rejections.iter().map(|rejection| rejection.count).sum();
        self.records.is_empty()
            && self.older_used == 0
            && refused == 1
            && self.alarms.is_empty()
            && self.refused.is_some()
    }

    /// The current segment.
    pub fn segment(&self) -> Option<&SegmentReport> {
        match self.segment {
            Some(current) => self.segments.iter().find(|segment| segment.number == current),
            None => self.segments.last(),
        }
    }

    /// The latest record that counts.
    pub fn last_used(&self) -> Option<&RecordPoint> {
        self.records
            .iter()
            .rev()
            .find(|record| record.set_aside.is_none())
    }

    /// Number of records that count.
    pub fn used(&self) -> usize {
        let here = self.records.iter().filter(|record| record.set_aside.is_none());
        self.older_used + here.count()
    }
}

/// One record without a rod.
#[derive(Debug, Clone, PartialEq)]
pub struct SpectrumReport {
    /// File of the record.
    pub file: String,
    /// Channel or rod of the record.
    pub channel: String,
    /// Unit of its samples as written, if known.
    pub unit: Option<String>,
    /// Band searched for peaks \[Hz\].
    pub band_hz: Option<(f64, f64)>,
    /// Faults noticed by the quality checks.
    pub flags: Vec<String>,
    /// Force in words with its mark, if a rod is configured.
    pub force: Option<String>,
    /// Reasons to doubt it.
    pub doubts: Vec<Doubt>,
    /// View of the record, if it has samples.
    pub record: Option<Snapshot>,
    /// Reason why it was refused, if it was.
    pub fault: Option<String>,
}

/// One identified record.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordPoint {
    /// Time of the first sample.
    pub start: Timestamp,
    /// Number of its segment.
    pub segment: Option<u32>,
    /// Absolute force from this record alone \[N\].
    pub force_n: Interval,
    /// Force given the baseline, at the measured temperature \[N\].
    pub tracked_force_n: Option<Interval>,
    /// Force given the baseline, at the reference temperature \[N\].
    pub force_at_reference_n: Option<Interval>,
    /// N_t / N_0 at the measured temperature.
    pub ratio: Option<Interval>,
    /// N_t / N_0 at the reference temperature.
    pub ratio_at_reference: Option<Interval>,
    /// Temperature \[degC\].
    pub temperature_c: Option<f64>,
    /// Reference temperature \[degC\].
    pub reference_c: Option<f64>,
    /// Natural frequencies: order, frequency \[Hz\], standard error \[Hz\].
    pub modes: Vec<(usize, f64, f64)>,
    /// Reasons to doubt its forces.
    pub doubts: Vec<Doubt>,
    /// Reason why it does not count on the charts, if it does not.
    pub set_aside: Option<String>,
}

/// Records refused for one reason.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectionCount {
    /// Code of the reason.
    pub code: String,
    /// Number of records.
    pub count: usize,
    /// Start of the latest one.
    pub last: Option<Timestamp>,
    /// Message of the latest one.
    pub message: String,
}

/// A stretch of history with one baseline.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentReport {
    /// Number of the segment, from 1.
    pub number: u32,
    /// Reason for opening it.
    pub reason: String,
    /// First and last record of the baseline, once learned.
    pub baseline: Option<(Timestamp, Timestamp)>,
    /// Number of records of the baseline.
    pub records: usize,
    /// Scatter of the frequencies over their standard errors, as a factor.
    pub overdispersion: Option<f64>,
    /// Reference temperature \[degC\].
    pub reference_c: Option<f64>,
    /// Error of the last attempt at a baseline.
    pub fault: Option<String>,
}

/// Effect of temperature on the relative force, as learned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThermalLine {
    /// Slope \[1/K\].
    pub slope_per_k: f64,
    /// Standard deviation of the slope \[1/K\].
    pub slope_sd_per_k: f64,
}

/// Time in Unix seconds, for drawing.
pub(super) fn unix_s(time: Timestamp) -> f64 {
    time.as_nanos() as f64 * 1e-9
}
