//! Changes in a store, as messages: each viewer has its own feed and queries it when the store's bell rings.

use super::{Message, Topic};
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::service::api::{self, listing::AlarmAnswer};
use crate::site::store::{FileId, Reader, StoreError};
use std::collections::{BTreeMap, BTreeSet};

/// Most records sent at once, and most alarm events: beyond, the oldest are left out and counted.
const MOST: usize = 500;

/// Most active alarms sent, the latest.
const STANDING: usize = 100;

/// Follows a store from a moment on. Call every method within one snapshot of the store
/// ([`Reader::together`]).
#[derive(Debug)]
pub struct Feed {
    file: FileId,
    /// Number of the last record sent.
    record: i64,
    /// Number of the last alarm event sent.
    news: i64,
    /// Start of each rod's last view at the last call, of a refused record and of others.
    pictured: BTreeMap<(RodId, bool), Timestamp>,
}

/// Changes committed since the last call.
#[derive(Debug, Default)]
pub struct News {
    /// Messages of the wanted topics: of records in the order of commits, of views, of alarms.
    pub messages: Vec<Message>,
    /// Number of records and alarm events left out.
    pub left_out: usize,
    /// True if another store took the place of the one followed.
    pub is_other_store: bool,
}

impl Feed {
    /// A feed from now on: the present content of the store is not new.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn new(reader: &Reader) -> Result<Self, StoreError> {
        Ok(Self {
            file: reader.file(),
            record: reader.last_record()?,
            news: reader.latest_news()?,
            pictured: BTreeMap::new(),
        })
    }

    /// All topics of a store.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn topics(reader: &Reader) -> Result<Vec<Topic>, StoreError> {
        let rods = reader.rods()?;
        Ok([Topic::Alarms]
            .into_iter()
            .chain(rods.iter().flat_map(Topic::of_rod))
            .collect())
    }

    /// Notes present messages that were sent: the same view is not sent again as new.
    pub fn told(&mut self, standing: &[Message]) {
        for message in standing {
            if let Topic::Waveform(rod) | Topic::Spectrum(rod) = &message.topic {
                self.pictured.insert((rod.clone(), false), message.time);
            }
        }
    }

    /// Changes since the last call, of the wanted topics.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged; the next call then returns the missed changes.
    pub fn news(&mut self, reader: &Reader, wanted: &BTreeSet<Topic>) -> Result<News, StoreError> {
        let is_other_store = reader.file() != self.file;
        if is_other_store {
            // All of it is new.
            *self = Self {
                file: reader.file(),
                record: 0,
                news: 0,
                pictured: BTreeMap::new(),
            };
        }
        let (record, news) = (reader.last_record()?, reader.latest_news()?);
        let span = i64::try_from(MOST).unwrap_or(i64::MAX);
        let after = |told: i64, last: i64| told.max(last.saturating_sub(span));
        let (after_record, after_news) = (after(self.record, record), after(self.news, news));
        let left_out = (after_record - self.record) + (after_news - self.news);

        let mut messages = Vec::new();
        for row in reader.rows_after(after_record, MOST)? {
            messages.extend(Message::of_record(&row));
        }
        let mut pictured = self.pictured.clone();
        let rods: BTreeSet<RodId> = messages
            .iter()
            .filter_map(|message| message.topic.rod().cloned())
            .collect();
        for rod in rods {
            let [_, _, waveform, spectrum] = Topic::of_rod(&rod);
            if !wanted.contains(&waveform) && !wanted.contains(&spectrum) {
                continue;
            }
            let kept = reader.snapshots(&rod)?;
            // A refused record's snapshot is sent only with its record, because it stays in the store for years.
            let is_told = |picture: &Snapshot| {
                let mut of_rod = messages
                    .iter()
                    .filter(|message| message.topic.rod() == Some(&rod));
                of_rod.any(|message| message.time == picture.start)
            };
            let refused = kept.refused.filter(is_told);
            for (picture, is_refused) in [(refused, true), (kept.latest, false)] {
                let Some(picture) = picture else { continue };
                let key = (rod.clone(), is_refused);
                if pictured.insert(key, picture.start) != Some(picture.start) {
                    messages.extend(of_picture(reader, &rod, &picture)?);
                }
            }
        }
        for news in reader.news_after(after_news, MOST)? {
            messages.push(Message::of_event(&news.event, news.words.as_deref()));
        }
        messages.retain(|message| wanted.contains(&message.topic));
        (self.record, self.news, self.pictured) = (record, news, pictured);
        Ok(News {
            messages,
            left_out: usize::try_from(left_out).unwrap_or_default(),
            is_other_store,
        })
    }
}

/// Present state of a topic: the rod's last record or view, or the active alarms, the oldest first.
///
/// # Errors
/// The store cannot be read, or a row is damaged.
pub fn standing(reader: &Reader, topic: &Topic) -> Result<Vec<Message>, StoreError> {
    let mut messages = match topic {
        Topic::Alarms => {
            let mut messages = Vec::new();
            for alarm in reader
                .alarms_before(None, true, None, STANDING)?
                .into_iter()
                .rev()
            {
                let answer = AlarmAnswer::of(reader, alarm)?;
                messages.push(Message::of_alarm(
                    &answer.alarm,
                    answer.acknowledged_words.as_deref(),
                ));
            }
            messages
        }
        Topic::Force(rod) | Topic::Modes(rod) => {
            let standing = reader.standing(rod)?;
            let row = standing
                .map(|standing| standing.latest_row())
                .transpose()?
                .flatten();
            row.as_ref().map(Message::of_record).unwrap_or_default()
        }
        Topic::Waveform(rod) | Topic::Spectrum(rod) => picture(reader, rod)?,
        // Samples are not in the store.
        Topic::Signal(_) => Vec::new(),
    };
    messages.retain(|message| message.topic == *topic);
    Ok(messages)
}

/// View of the rod's last record that counts, or of a refused one if there is no other.
fn picture(reader: &Reader, rod: &RodId) -> Result<Vec<Message>, StoreError> {
    let kept = reader.snapshots(rod)?;
    match kept.latest.or(kept.refused) {
        Some(picture) => of_picture(reader, rod, &picture),
        None => Ok(Vec::new()),
    }
}

fn of_picture(reader: &Reader, rod: &RodId, picture: &Snapshot) -> Result<Vec<Message>, StoreError> {
    let unit = api::rod::unit(reader, rod, picture.start)?;
    Ok(Message::of_picture(rod, picture, unit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::track::alarm::What;
    use crate::analysis::track::{Alarm, AlarmEvent, Kind};
    use crate::site::store::Store;

    fn all(reader: &Reader) -> BTreeSet<Topic> {
        Feed::topics(reader).unwrap().into_iter().collect()
    }

    #[test]
    fn an_empty_store_has_nothing_to_tell() {
        let store = Store::in_memory().unwrap();
        let mut feed = Feed::new(&store).unwrap();
        assert_eq!(Feed::topics(&store).unwrap(), [Topic::Alarms]);
        let news = feed.news(&store, &all(&store)).unwrap();
        assert!(news.messages.is_empty() && news.left_out == 0 && !news.is_other_store);
        assert!(standing(&store, &Topic::Alarms).unwrap().is_empty());
    }

    #[test]
    fn events_are_told_at_their_own_time() {
        let rod = RodId("north".to_owned());
        let raised = Timestamp::from_nanos(1_000);
        let alarm = Alarm::new(&rod, Kind::Drift, 1, raised, "less".to_owned());
        let event = AlarmEvent {
            what: What::Raised,
            time: Timestamp::from_nanos(2_000),
            alarm,
        };
        let message = Message::of_event(&event, None);
        assert_eq!((message.topic, message.time), (Topic::Alarms, event.time));
        assert_eq!(message.body["timestamp"]["nsec"], 1_000);
    }
}
