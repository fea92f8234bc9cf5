//! One rod: segments, effect of temperature, charts, and views of its records.

use super::days::Days;
use super::standing::{RodStatus, Terms};
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::DriftWatch;
use crate::config::Config;
use crate::site::store::{Reader, StoreError};
use serde::Serialize;
use serde_json::value::RawValue;

/// Answer about one rod.
#[derive(Debug, Serialize)]
pub struct RodAnswer {
    /// Status of the rod.
    #[serde(flatten)]
    pub status: RodStatus,
    /// Begin of its first day and end of that of its latest record, those left out that a wrong clock dated.
    pub span: Option<[Timestamp; 2]>,
    /// Stretches of history with one baseline each, ascending.
    pub segments: Vec<SegmentAnswer>,
    /// Effect of temperature, as learned.
    pub thermal: Option<Thermal>,
    /// Relative loss of force that raises an alarm \[-\].
    pub limit_loss: Option<f64>,
    /// Silence that raises an alarm \[s\]; older data are stale.
    pub silence_s: Option<f64>,
}

/// A stretch of history with one baseline.
#[derive(Debug, Serialize)]
pub struct SegmentAnswer {
    /// Number of the segment, from 1.
    pub number: u32,
    /// Reason for opening it: `first`, `requested`, `changed`, `clock`.
    pub reason: String,
    /// Reason that a person gave when asking for it.
    pub asked_words: Option<String>,
    /// First and last record of the baseline, once learned.
    pub baseline: Option<[Timestamp; 2]>,
    /// Number of records of the baseline.
    pub baseline_records: usize,
    /// Reference temperature \[degC\].
    pub reference_c: Option<f64>,
    /// Error of the last attempt at a baseline.
    pub fault: Option<String>,
}

/// Effect of temperature on the relative force.
#[derive(Debug, Serialize)]
pub struct Thermal {
    /// Slope \[1/K\].
    pub slope_per_k: f64,
    /// Standard deviation of the slope \[1/K\].
    pub slope_sd_per_k: f64,
}

impl RodAnswer {
    /// Rod as in the store; `None` if it is not there.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(reader: &Reader, days: &Days, rod: &RodId) -> Result<Option<Self>, StoreError> {
        let Some(standing) = reader.standing(rod)? else {
            return Ok(None);
        };
        let mut asked = reader.rebaselines(rod)?;
        let mut segments = reader.segments(rod)?;
        // Each request that was applied opened one segment; the latest segment was opened by the latest request.
        segments.reverse();
        let segments = segments.into_iter().map(|segment| {
            let is_asked = segment.reason.code() == "requested";
            let baseline = segment.baseline.as_ref();
            SegmentAnswer {
                number: segment.number,
                reason: segment.reason.code().to_owned(),
                asked_words: is_asked.then(|| asked.pop()).flatten().flatten(),
                baseline: baseline.map(|baseline| [baseline.first, baseline.last]),
                baseline_records: baseline.map_or(0, |baseline| baseline.records),
                reference_c: segment.reference_c,
                fault: segment.fault,
            }
        });
        let mut segments: Vec<_> = segments.collect();
        segments.reverse();
        let slope = reader.watch(rod)?.get().and_then(DriftWatch::slope);
        let thermal = slope.map(|(slope_per_k, slope_sd_per_k)| Thermal {
            slope_per_k,
            slope_sd_per_k,
        });
        let terms = Terms::of(reader)?;
        let span = days.believed_span(rod, standing.latest_start);
        Ok(Some(Self {
            limit_loss: terms.map(|terms| terms.limit_loss),
            silence_s: terms.map(|terms| terms.silence_s),
            span: span.map(|(first, last)| [first, last]),
            segments,
            thermal,
            status: RodStatus::of(standing, days.counts(rod), terms)?,
        }))
    }
}

/// Views of single records of a rod.
#[derive(Debug, Serialize)]
pub struct Looks {
    /// Id of the rod.
    pub rod: RodId,
    /// SI unit of the waveform.
    pub unit: Option<&'static str>,
    /// The latest identified record.
    pub latest: Option<Snapshot>,
    /// The first record of the present baseline.
    pub baseline: Option<Snapshot>,
    /// The latest refused record, with the reason.
    pub refused: Option<Snapshot>,
    /// The latest record's line, as `history --format json` prints it.
    pub record: Option<Box<RawValue>>,
}

/// SI unit of the samples of a rod's record that began at `start`, by the configuration it was taken with.
///
/// # Errors
/// The store cannot be read, or a row is damaged.
pub fn unit(reader: &Reader, rod: &RodId, start: Timestamp) -> Result<Option<&'static str>, StoreError> {
    let config = reader.config_at(rod, start)?;
    let config = config.and_then(|[_, _, text]| Config::parse(&text, "the store").ok());
    Ok(config.and_then(|config| {
        let rod = config.rod(&rod.0)?;
        Some(rod.channels.displacement.unit.si())
    }))
}

impl Looks {
    /// Reads the views from a store.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(reader: &Reader, rod: &RodId) -> Result<Self, StoreError> {
        let snapshots = reader.snapshots(rod)?;
        let line = reader.standing(rod)?.and_then(|standing| standing.latest);
        Ok(Self {
            rod: rod.clone(),
            unit: match snapshots.latest.as_ref().or(snapshots.refused.as_ref()) {
                Some(latest) => unit(reader, rod, latest.start)?,
                None => None,
            },
            latest: snapshots.latest,
            baseline: snapshots.first,
            refused: snapshots.refused,
            record: line
                .map(RawValue::from_string)
                .transpose()
                .map_err(|error| StoreError::Unreadable {
                    what: format!("the latest record of rod {rod}"),
                    detail: error.to_string(),
                })?,
        })
    }
}

/// The drift watch of a rod's present segment, in columns, ascending in time: one point per closed period.
#[derive(Debug, Default, Serialize)]
pub struct Chart {
    /// Number of the segment.
    pub segment: u32,
    /// Begin of each period.
    pub time: Vec<Timestamp>,
    /// Number of records in each.
    pub records: Vec<usize>,
    /// Standard normal residual without a change.
    pub residual: Vec<Option<f64>>,
    /// N_t / N_0 - 1 at the reference temperature.
    pub at_reference: Vec<Option<f64>>,
    /// Evidence of a change relative to the alarm limit, with temperature and the other rods: alarm above
    /// one \[-\].
    pub evidence: Vec<Option<f64>>,
    /// The same with the other rods only \[-\].
    pub evidence_peers: Vec<Option<f64>>,
    /// The same with the rod's own data only \[-\].
    pub evidence_blind: Vec<Option<f64>>,
}

impl Chart {
    /// The last `most` periods of a rod's current segment.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(reader: &Reader, rod: &RodId, most: usize) -> Result<Self, StoreError> {
        let Some(standing) = reader.standing(rod)? else {
            return Ok(Self::default());
        };
        let mut chart = Self {
            segment: standing.segment,
            ..Self::default()
        };
        for period in reader.last_periods(rod, standing.segment, most)? {
            let charted = period.charted.as_ref();
            let evidence = charted.map(|charted| charted.evidence).unwrap_or_default();
            chart.time.push(period.start);
            chart.records.push(period.records);
            chart.residual.push(charted.map(|charted| charted.residual));
            chart
                .at_reference
                .push(charted.and_then(|charted| charted.at_reference));
            chart.evidence.push(evidence.compensated);
            chart.evidence_peers.push(evidence.peers);
            chart.evidence_blind.push(evidence.blind);
        }
        Ok(chart)
    }
}
