//! All rods of a site at a glance.

use super::days::{DAY_NS, Days};
use super::monitoring::Monitoring;
use super::standing::{RodStatus, Terms};
use crate::analysis::signal::record::Timestamp;
use crate::site::clock;
use crate::site::store::{Reader, StoreError};
use serde::Serialize;

/// Number of days counted as recent.
const RECENT_DAYS: u32 = 30;

/// Most points of a trend.
const TREND_POINTS: usize = 90;

/// A site and its rods.
#[derive(Debug, Serialize)]
pub struct SiteAnswer {
    /// Name of the site.
    pub site: String,
    /// Version of the program that answers.
    pub version: &'static str,
    /// Silence that raises an alarm \[s\]; older data are stale.
    pub silence_s: Option<f64>,
    /// State of the monitoring; `null` if no daemon ever worked on the store.
    pub monitoring: Option<Monitoring>,
    /// Its rods, in alphabetical order.
    pub rods: Vec<RodGlance>,
}

/// One rod at a glance.
#[derive(Debug, Serialize)]
pub struct RodGlance {
    /// Status of the rod.
    #[serde(flatten)]
    pub status: RodStatus,
    /// Counts of its last days.
    pub recent: Recent,
    /// Daily means of its last days.
    pub trend: Trend,
}

/// Counts of the days up to a rod's latest record.
#[derive(Debug, Serialize)]
pub struct Recent {
    /// Number of days.
    pub days: u32,
    /// Number of records in them.
    pub records: u64,
    /// Number of rejected records in them.
    pub rejected: u64,
}

/// Daily means of N_t / N_0, at the reference temperature if it is compensated.
#[derive(Debug, Serialize)]
pub struct Trend {
    /// Begin of each day.
    pub time: Vec<Timestamp>,
    /// Mean of each day.
    pub mean: Vec<Option<f64>>,
}

impl SiteAnswer {
    /// Rods of a store.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(reader: &Reader, days: &Days) -> Result<Self, StoreError> {
        let terms = Terms::of(reader)?;
        let mut rods = Vec::new();
        for standing in reader.standings()? {
            let counts = days.counts(&standing.rod);
            let status = RodStatus::of(standing, counts, terms)?;
            rods.push(RodGlance {
                recent: Recent::of(days, &status),
                trend: Trend::of(days, &status),
                status,
            });
        }
        let config = reader.latest_config()?;
        Ok(Self {
            site: config.map_or_else(|| "Site".to_owned(), |[_, site, _]| site),
            version: env!("CARGO_PKG_VERSION"),
            silence_s: terms.map(|terms| terms.silence_s),
            monitoring: Monitoring::of(reader, None, None, clock::now())?,
            rods,
        })
    }
}

/// The last `count` days of a rod up to its latest record.
fn last_days(days: &Days, status: &RodStatus, count: u32) -> Option<(Timestamp, Timestamp)> {
    let (_, end) = days.believed_span(&status.rod, status.latest_record)?;
    let begin = end.as_nanos().saturating_sub(i64::from(count) * DAY_NS);
    Some((Timestamp::from_nanos(begin), end))
}

impl Recent {
    fn of(days: &Days, status: &RodStatus) -> Self {
        let mut recent = Self {
            days: RECENT_DAYS,
            records: 0,
            rejected: 0,
        };
        if let Some((from, to)) = last_days(days, status, RECENT_DAYS) {
            for (_, day) in days.between(&status.rod, from, to) {
                recent.records += day.records;
                recent.rejected += day.rejected;
            }
        }
        recent
    }
}

impl Trend {
    fn of(days: &Days, status: &RodStatus) -> Self {
        let (mut time, mut mean) = (Vec::new(), Vec::new());
        if let Some((from, to)) = last_days(days, status, 365) {
            let there: Vec<_> = days.between(&status.rod, from, to).collect();
            // Every so many days one, the last among them.
            let step = there.len().div_ceil(TREND_POINTS).max(1);
            for (start, day) in there.iter().rev().step_by(step).rev() {
                let quantity = if status.compensated {
                    &day.relative_force_at_reference
                } else {
                    &day.relative_force
                };
                time.push(*start);
                mean.push(quantity.get().map(|[mean, ..]| mean));
            }
        }
        Self { time, mean }
    }
}
