//! What is new in a store, as messages: each viewer has a feed of its own and asks it when the store's bell rings.

use super::{Message, Topic};
use crate::api;
use crate::record::{RodId, Timestamp};
use crate::store::{Reader, StoreError};
use crate::track::Alarm;
use std::collections::{BTreeMap, BTreeSet};

/// Most records told at once: a viewer that falls further behind misses the oldest, never the last.
const RECORDS: usize = 500;

/// Most alarms looked at, the latest.
const ALARMS: usize = 100;

/// Follows a store from a moment on.
#[derive(Debug)]
pub struct Feed {
    /// The number of the last record told.
    told: i64,
    /// When the last picture told of each rod began.
    pictured: BTreeMap<RodId, Timestamp>,
    /// The latest alarms as they were told.
    alarms: BTreeMap<String, Alarm>,
    /// SI units of the rods' samples, as far as they were asked for.
    units: BTreeMap<RodId, Option<&'static str>>,
}

impl Feed {
    /// From now on: what the store has already is not new.
    ///
    /// # Errors
    /// The store cannot be read, or a row is damaged.
    pub fn new(reader: &Reader) -> Result<Self, StoreError> {
        let mut feed = Self {
            told: reader.last_line()?,
            pictured: BTreeMap::new(),
            alarms: BTreeMap::new(),
            units: BTreeMap::new(),
        };
        feed.new_alarms(reader)?;
        Ok(feed)
    }

    /// Everything a store can be asked for.
    ///
    /// # Errors
    /// As [`Feed::new`].
    pub fn topics(reader: &Reader) -> Result<Vec<Topic>, StoreError> {
        let rods = reader.rods()?;
        Ok([Topic::Alarms]
            .into_iter()
            .chain(rods.iter().flat_map(Topic::of_rod))
            .collect())
    }

    /// What was committed since the last question, of the topics that are wanted, in the order of commits.
    ///
    /// # Errors
    /// As [`Feed::new`]; the next question then says what this one did not.
    pub fn news(&mut self, reader: &Reader, wanted: &BTreeSet<Topic>) -> Result<Vec<Message>, StoreError> {
        let last = reader.last_line()?;
        if last < self.told {
            // Another store took the place of the one that was followed.
            *self = Self::new(reader)?;
            return Ok(Vec::new());
        }
        let span = i64::try_from(RECORDS).unwrap_or(i64::MAX);
        let after = self.told.max(last.saturating_sub(span));
        let mut messages = Vec::new();
        let mut rods = BTreeSet::new();
        for line in reader.lines_after(after, RECORDS)? {
            let of_record = Message::of_record(&line).map_err(|error| StoreError::Unreadable {
                what: "a record's line".to_owned(),
                detail: error.to_string(),
            })?;
            rods.extend(
                of_record
                    .iter()
                    .filter_map(|message| message.topic.rod().cloned()),
            );
            messages.extend(of_record);
        }
        for rod in rods {
            let [_, _, waveform, spectrum] = Topic::of_rod(&rod);
            if !wanted.contains(&waveform) && !wanted.contains(&spectrum) {
                continue;
            }
            let picture = self.picture(reader, &rod)?;
            if let Some(first) = picture.first()
                && self.pictured.insert(rod, first.time) != Some(first.time)
            {
                messages.extend(picture);
            }
        }
        messages.extend(self.new_alarms(reader)?);
        self.told = last;
        messages.retain(|message| wanted.contains(&message.topic));
        Ok(messages)
    }

    /// What stands on a topic already: the rod's last record or picture, or the alarms that stand.
    ///
    /// # Errors
    /// As [`Feed::new`].
    pub fn standing(&mut self, reader: &Reader, topic: &Topic) -> Result<Vec<Message>, StoreError> {
        let mut messages = match topic {
            Topic::Alarms => {
                let alarms = reader.alarms_before(None, true, None, ALARMS)?;
                alarms.iter().rev().map(Message::of_alarm).collect()
            }
            Topic::Force(rod) | Topic::Modes(rod) => {
                let line = reader.standing(rod)?.and_then(|standing| standing.latest);
                let messages = line.as_deref().map(Message::of_record).transpose();
                messages
                    .map_err(|error| StoreError::Unreadable {
                        what: format!("the latest record of rod {rod}"),
                        detail: error.to_string(),
                    })?
                    .unwrap_or_default()
            }
            Topic::Waveform(rod) | Topic::Spectrum(rod) => {
                let picture = self.picture(reader, rod)?;
                if let Some(first) = picture.first() {
                    self.pictured.insert(rod.clone(), first.time);
                }
                picture
            }
        };
        messages.retain(|message| message.topic == *topic);
        Ok(messages)
    }

    /// The rod's last picture.
    fn picture(&mut self, reader: &Reader, rod: &RodId) -> Result<Vec<Message>, StoreError> {
        let unit = match self.units.get(rod) {
            Some(unit) => *unit,
            None => {
                let unit = api::rod::unit(reader, rod)?;
                self.units.insert(rod.clone(), unit);
                unit
            }
        };
        let picture = reader.snapshots(rod)?.latest;
        Ok(picture.map_or_else(Vec::new, |picture| Message::of_picture(rod, &picture, unit)))
    }

    /// The latest alarms that are not as they were, the oldest first.
    fn new_alarms(&mut self, reader: &Reader) -> Result<Vec<Message>, StoreError> {
        let alarms = reader.alarms_before(None, false, None, ALARMS)?;
        let changed = alarms
            .iter()
            .rev()
            .filter(|alarm| self.alarms.get(&alarm.id) != Some(alarm))
            .map(Message::of_alarm)
            .collect();
        self.alarms = alarms
            .into_iter()
            .map(|alarm| (alarm.id.clone(), alarm))
            .collect();
        Ok(changed)
    }
}
