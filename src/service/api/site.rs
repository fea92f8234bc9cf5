//! All rods of a site at a glance.

use super::days::{DAY_NS, Days};
use super::monitoring::Monitoring;
use super::standing::{Goals, RodStatus};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::site::clock;
use crate::site::store::{Reader, StoreError};
use serde::Serialize;

/// Days counted as recent.
const RECENT_DAYS: u32 = 30;

/// Most points of a trend.
const TREND_POINTS: usize = 90;

/// A site and its rods.
#[derive(Debug, Serialize)]
pub struct SiteAnswer {
    /// The site's name.
    pub site: String,
    /// Version of the program that answers.
    pub version: &'static str,
    /// Whether it is monitored; `null` if no daemon ever worked on the store.
    pub monitoring: Option<Monitoring>,
    /// Its rods, in alphabetical order.
    pub rods: Vec<RodGlance>,
}

/// One rod at a glance.
#[derive(Debug, Serialize)]
pub struct RodGlance {
    /// How it stands.
    #[serde(flatten)]
    pub status: RodStatus,
    /// Its last days.
    pub recent: Recent,
    /// Its last days as a line.
    pub trend: Trend,
}

/// The days before and with a rod's latest record.
#[derive(Debug, Serialize)]
pub struct Recent {
    /// How many days.
    pub days: u32,
    /// Records in them.
    pub records: u64,
    /// Those that were rejected.
    pub rejected: u64,
}

/// Daily means of N_t / N_0, at the reference temperature if it is compensated.
#[derive(Debug, Serialize)]
pub struct Trend {
    /// The beginning of each day.
    pub time: Vec<Timestamp>,
    /// Its mean.
    pub mean: Vec<Option<f64>>,
}

impl SiteAnswer {
    /// What a store knows of its rods.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(reader: &Reader, days: &Days) -> Result<Self, StoreError> {
        let goals = Goals::of(reader)?;
        let mut rods = Vec::new();
        for standing in reader.standings()? {
            let counts = days.counts(&standing.rod);
            let status = RodStatus::of(standing, counts, goals)?;
            rods.push(RodGlance {
                recent: Recent::of(days, &status.rod),
                trend: Trend::of(days, &status),
                status,
            });
        }
        let config = reader.latest_config()?;
        Ok(Self {
            site: config.map_or_else(|| "Site".to_owned(), |[_, site, _]| site),
            version: env!("CARGO_PKG_VERSION"),
            monitoring: Monitoring::of(reader, None, clock::now())?,
            rods,
        })
    }
}

/// The last `count` days of a rod.
fn last_days(days: &Days, rod: &RodId, count: u32) -> Option<(Timestamp, Timestamp)> {
    let (_, end) = days.span(rod)?;
    let begin = end.as_nanos().saturating_sub(i64::from(count) * DAY_NS);
    Some((Timestamp::from_nanos(begin), end))
}

impl Recent {
    fn of(days: &Days, rod: &RodId) -> Self {
        let mut recent = Self {
            days: RECENT_DAYS,
            records: 0,
            rejected: 0,
        };
        if let Some((from, to)) = last_days(days, rod, RECENT_DAYS) {
            for (_, day) in days.between(rod, from, to) {
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
        if let Some((from, to)) = last_days(days, &status.rod, 365) {
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
