//! Records and alarms, page by page, the latest first.

use super::days::Days;
use crate::analysis::signal::record::time::DAY_S;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::Alarm;
use crate::site::store::{Line, Lines, Mark, Reader, StoreError};
use serde::Serialize;
use serde_json::value::RawValue;

/// A page of a rod's records.
#[derive(Debug, Serialize)]
pub struct Records {
    /// Records' JSON, as `history --format json` prints it, with the `file` each came from.
    pub records: Vec<Box<RawValue>>,
    /// Cursor of the next page; `None` after the last.
    pub next: Option<String>,
    /// True if the list ends here because the lines of older records were removed (`[store] keep_lines_d`);
    /// `history --format csv` has their numbers.
    pub older_lines_removed: bool,
}

impl Records {
    /// At most `most` records of a rod before the cursor `next` of another page, only rejected ones or all.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(
        reader: &Reader,
        days: &Days,
        rod: &RodId,
        before: Option<Mark>,
        only_rejected: bool,
        most: usize,
    ) -> Result<Self, StoreError> {
        // One more than requested shows if there is another page.
        let wanted = most + 1;
        let mut lines = Lines::default();
        if only_rejected {
            // Day by day, those with a rejection alone: the last hundred may lie years apart.
            let end = before.map_or(Timestamp::MAX, |mark| {
                Timestamp::from_nanos(mark.start_ns.saturating_add(1))
            });
            let all = days.between(rod, Timestamp::from_nanos(i64::MIN), end);
            for (day, _) in all.rev().filter(|(_, bucket)| bucket.rejected > 0) {
                let within = (day, day.plus_seconds(DAY_S));
                let of_day = reader.lines_before(rod, within, before, true, wanted - lines.found.len())?;
                lines.found.extend(of_day.found);
                lines.are_older_removed = of_day.are_older_removed;
                if lines.found.len() >= wanted || lines.are_older_removed {
                    break;
                }
            }
        } else {
            let always = (Timestamp::from_nanos(i64::MIN), Timestamp::MAX);
            lines = reader.lines_before(rod, always, before, false, wanted)?;
        }
        let Lines {
            mut found,
            are_older_removed,
        } = lines;
        let is_more = found.len() > most;
        found.truncate(most);
        let next = found
            .last()
            .filter(|_| is_more)
            .map(|Line { mark, .. }| format!("{}.{}", mark.start_ns, mark.id));
        let lines = found.into_iter().map(|line| {
            with_file(line).map_err(|error| StoreError::Unreadable {
                what: format!("a record of rod {rod}"),
                detail: error.to_string(),
            })
        });
        Ok(Self {
            records: lines.collect::<Result<_, _>>()?,
            older_lines_removed: are_older_removed && next.is_none(),
            next,
        })
    }
}

/// A record's line with its file as the last field. The line itself is not parsed again, so that its numbers
/// keep every digit.
fn with_file(Line { mut json, file, .. }: Line) -> serde_json::Result<Box<RawValue>> {
    if json.ends_with('}') {
        json.pop();
        json += &format!(",\"file\":{}}}", serde_json::to_string(&file)?);
    }
    RawValue::from_string(json)
}

/// Parses a page's cursor `next`.
pub fn mark(next: &str) -> Option<Mark> {
    let (start_ns, id) = next.split_once('.')?;
    Some(Mark {
        start_ns: start_ns.parse().ok()?,
        id: id.parse().ok()?,
    })
}

/// An alarm, as `history --what alarms --format json` prints it.
#[derive(Debug, Clone, Serialize)]
pub struct AlarmAnswer {
    /// The alarm, in its present state.
    #[serde(flatten)]
    pub alarm: Alarm,
    /// True if it is active.
    pub stands: bool,
    /// Words of the acknowledgement: `NAME: TEXT`.
    pub acknowledged_words: Option<String>,
}

impl AlarmAnswer {
    /// Reads one alarm's entry from the store.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn of(reader: &Reader, alarm: Alarm) -> Result<Self, StoreError> {
        let words = reader.acknowledged_words(&alarm)?;
        Ok(Self::with(alarm, words))
    }

    /// An alarm with the words of its acknowledgement.
    pub fn with(alarm: Alarm, acknowledged_words: Option<String>) -> Self {
        Self {
            stands: !alarm.is_over(),
            acknowledged_words,
            alarm,
        }
    }
}

/// A page of alarms.
#[derive(Debug, Serialize)]
pub struct Alarms {
    /// The alarms, in their present state.
    pub alarms: Vec<AlarmAnswer>,
    /// Cursor of the next page; `None` after the last.
    pub next: Option<String>,
}

impl Alarms {
    /// At most `most` alarms before the one with id `before`; `None` if there is no such alarm.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn of(
        reader: &Reader,
        rod: Option<&RodId>,
        only_standing: bool,
        before: Option<&str>,
        most: usize,
    ) -> Result<Option<Self>, StoreError> {
        let before = match before.map(|id| reader.alarm(id)).transpose()? {
            Some(None) => return Ok(None),
            found => found.flatten(),
        };
        let mut alarms = reader.alarms_before(rod, only_standing, before.as_ref(), most + 1)?;
        let is_more = alarms.len() > most;
        alarms.truncate(most);
        let next = alarms.last().filter(|_| is_more).map(|alarm| alarm.id.clone());
        let alarms = alarms.into_iter().map(|alarm| AlarmAnswer::of(reader, alarm));
        Ok(Some(Self {
            alarms: alarms.collect::<Result<_, _>>()?,
            next,
        }))
    }
}
