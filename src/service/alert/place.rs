//! Position of a sink in the events and notices of the store, and the marks under which the store keeps it.

use crate::config::settings::alert::SinkSettings;
use crate::site::store::{Reader, StoreError};

/// Name under which the copy to a centre once kept its position.
const OLD_COPY: &str = "forward";

/// Position of a sink.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    /// Number of the latest event delivered.
    pub(super) through: i64,
    /// Number of the latest notice of the daemon's conditions that the sink has.
    pub(super) notices: i64,
    /// True if it got the alarms active when it was added.
    pub(super) knows_standing: bool,
}

impl Place {
    /// Position of a sink as the store keeps it; `None` for a new sink.
    pub(super) fn of(sink: &str, reader: &Reader) -> Result<Option<Self>, StoreError> {
        let latest = reader.latest_news()?;
        let notices = reader.delivered(&notices_mark(sink))?;
        // Up to store format 6 the copy to a centre noted the number of its last commit as `forward`: such a mark is none of a
        // sink of that name, nor is one past all events.
        let is_of_copy = |through: &i64| *through > latest || (sink == OLD_COPY && notices.is_none());
        let Some(through) = reader.delivered(sink)?.filter(|through| !is_of_copy(through)) else {
            return Ok(None);
        };
        Ok(Some(Self {
            through,
            notices: notices.unwrap_or(0),
            knows_standing: reader.delivered(&standing_mark(sink))?.is_some(),
        }))
    }

    /// Position of a new sink: after the present events.
    pub(super) fn new(reader: &Reader) -> Result<Self, StoreError> {
        Ok(Self {
            through: reader.latest_news()?,
            notices: reader.latest_notice()?,
            knows_standing: false,
        })
    }

    /// Marks that keep the position of a new sink. Its own is the last: without it the sink is still new after a kill
    /// between the two.
    pub(super) fn marks(self, sink: &str) -> [(String, i64); 2] {
        [
            (notices_mark(sink), self.notices),
            (sink.to_owned(), self.through),
        ]
    }
}

/// Marks of those of `sinks` that are new to the store. Stored before the next event, they make that event and all later ones
/// reach the sink as they happen, however late its courier starts.
///
/// # Errors
/// The store cannot be read.
pub fn marks_of_new(sinks: &[SinkSettings], reader: &Reader) -> Result<Vec<(String, i64)>, StoreError> {
    let mut marks = Vec::new();
    for settings in sinks {
        if Place::of(&settings.id, reader)?.is_none() {
            marks.extend(Place::new(reader)?.marks(&settings.id));
        }
    }
    Ok(marks)
}

/// Name under which the store keeps the number of the last notice that a sink has. No id has a slash.
pub(super) fn notices_mark(sink: &str) -> String {
    format!("{sink}/conditions")
}

/// Name under which the store records that a sink got the alarms active when it was added. No sink id has a
/// slash.
pub(super) fn standing_mark(sink: &str) -> String {
    format!("{sink}/standing")
}
