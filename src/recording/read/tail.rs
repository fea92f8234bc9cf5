//! Open samples at the end of a file, from which the file that goes on there begins.

use super::carry::cut_by;
use super::route::{Files, Rod, Router};
use super::stream::SEAM_NS;
use super::{Event, Place};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;
use tirante_analysis::signal::record::{Assembler, RecordSettings, RodChannels, RodId, Timestamp};

/// Version of the encoding, raised whenever the content of an assembler changes its meaning.
const VERSION: u32 = 2;
/// The version before, without [`Thermometer`].
const BEFORE: u32 = 1;

/// Samples of a rod that its latest file left open.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Tail {
    /// The rod.
    pub rod: RodId,
    /// Log time of its latest message with samples \[ns since 1970\].
    pub to: u64,
    /// Name of the file.
    pub file: String,
    /// Bytes read of the file.
    bytes: u64,
    /// Number of records returned of it.
    records: u64,
    lanes: Vec<Lane>,
    moments: Option<Vec<u8>>,
    /// Encoded behind the rest.
    #[serde(skip)]
    thermometer: Thermometer,
}

/// End of open samples and readings with which no file goes on.
#[derive(Default)]
pub struct TailEnd {
    /// Their events.
    pub events: Vec<(Event, Place)>,
    /// Readings that stay for samples still to come.
    pub remembered: Option<Tail>,
}

/// State of the readings of the rod's thermometer.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Thermometer {
    /// False if its readings came in a file with samples.
    is_apart: bool,
    /// True if there is nothing else, and they are in events already.
    is_told: bool,
}

/// One sensor of the rod.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Lane {
    /// Channels and settings with which its samples were cut.
    cut_by: String,
    is_followed: bool,
    assembler: Vec<u8>,
}

impl Tail {
    /// Saves the lanes of a rod, whose events were taken, at the end of a file.
    pub(super) fn of(lanes: &[Rod], settings: &RecordSettings, place: &(Arc<str>, u64, u64)) -> Option<Self> {
        let first = lanes.first()?;
        let saved = lanes.iter().map(|lane| {
            Ok(Lane {
                cut_by: cut_by(&lane.config, settings),
                is_followed: lane.is_followed,
                assembler: lane.assembler.save()?,
            })
        });
        let (file, bytes, records) = place;
        Some(Self {
            rod: first.config.rod.clone(),
            to: lanes.iter().map(|lane| lane.to).max()?,
            file: file.to_string(),
            bytes: *bytes,
            records: *records,
            // No input brings about that samples cannot be encoded.
            lanes: saved.collect::<Result<_, postcard::Error>>().ok()?,
            moments: first.moments.as_ref().and_then(|moments| moments.save().ok()),
            thermometer: Thermometer {
                is_apart: !first.is_together,
                is_told: false,
            },
        })
    }

    /// Encodes it for the store.
    pub fn encode(&self) -> Vec<u8> {
        let room = Vec::with_capacity(self.held() + 4096);
        postcard::to_extend(&(VERSION, self, self.thermometer), room).unwrap_or_default()
    }

    /// Reads an encoded one; `None` if it comes from another version of the program.
    pub fn decode(body: &[u8]) -> Option<Self> {
        // The version comes first: another one need not be readable beyond it.
        let (version, rest) = postcard::take_from_bytes::<u32>(body).ok()?;
        let (tail, rest) = match version {
            VERSION | BEFORE => postcard::take_from_bytes::<Self>(rest).ok()?,
            _ => return None,
        };
        let thermometer = match version {
            VERSION => postcard::from_bytes(rest).ok()?,
            _ => Thermometer::default(),
        };
        Some(Self { thermometer, ..tail })
    }

    /// True if the readings of its rod's thermometer do not come in the files with its samples.
    pub(super) fn is_apart(&self) -> bool {
        self.thermometer.is_apart
    }

    /// True if it only remembers readings, which were told already, for samples still to come.
    pub fn is_memory(&self) -> bool {
        self.thermometer.is_told
    }

    /// Bytes that it takes.
    pub fn held(&self) -> usize {
        let lanes: usize = self.lanes.iter().map(|lane| lane.assembler.len()).sum();
        lanes + self.moments.as_ref().map_or(0, Vec::len)
    }

    /// True if its rod is cut now as its samples were.
    pub fn fits(&self, channels: &[RodChannels], settings: &RecordSettings) -> bool {
        let rod = channels.iter().find(|channels| channels.rod == self.rod);
        rod.is_some_and(|rod| {
            let now = rod.lanes().map(|lane| cut_by(&lane, settings));
            now.eq(self.lanes.iter().map(|lane| lane.cut_by.clone()))
        })
    }

    /// Puts its samples into the lanes of its rod, in front of the temperatures that these have already; false if it cannot be read.
    pub(super) fn restore(&self, lanes: &mut [Rod], settings: &RecordSettings) -> bool {
        let resumed = self
            .lanes
            .iter()
            .map(|lane| Assembler::resume(&lane.assembler, *settings));
        let Ok(assemblers) = resumed.collect::<Result<Vec<_>, _>>() else {
            return false;
        };
        if assemblers.len() != lanes.len() {
            return false;
        }
        let file: Arc<str> = Arc::from(self.file.as_str());
        for ((lane, saved), mut assembler) in lanes.iter_mut().zip(&self.lanes).zip(assemblers) {
            assembler.append_temperatures(&mut lane.assembler);
            lane.assembler = assembler;
            lane.is_followed = saved.is_followed;
            lane.to = lane.to.max(self.to);
            lane.files = Files::default();
            lane.files.note(Some(&file), Timestamp::from_nanos(i64::MIN));
        }
        match (
            lanes.first_mut().and_then(|lane| lane.moments.as_mut()),
            &self.moments,
        ) {
            (Some(moments), Some(saved)) => moments.resume(saved).is_ok(),
            (None, None) => true,
            _ => false,
        }
    }

    /// Its end if no file goes on with it; `None` if it cannot be read.
    pub fn ended(&self, channels: &[RodChannels], settings: &RecordSettings) -> Option<TailEnd> {
        let rod = channels.iter().find(|channels| channels.rod == self.rod)?;
        let mut router = Router::new(std::slice::from_ref(rod), settings);
        if !self.restore(&mut router.rods, settings) {
            return None;
        }
        let file: Arc<str> = Arc::from(self.file.as_str());
        let mut records = self.records;
        let events = router.ended().map(|timed| {
            records += timed.records();
            timed.at_place(Arc::clone(&file), self.bytes, records)
        });
        let events = events.collect();
        let remembered = self.is_apart().then(|| {
            for lane in &mut router.rods {
                lane.assembler.remember();
                lane.to = 0;
            }
            let has_readings = router.rods.iter().any(|lane| lane.assembler.has_readings());
            let mut stays =
                Self::of(&router.rods, settings, &(file, self.bytes, records)).filter(|_| has_readings)?;
            stays.thermometer.is_told = true;
            Some(stays)
        });
        Some(TailEnd {
            events,
            remembered: remembered.flatten(),
        })
    }
}

/// Open samples of the files read so far, one rod each, for the files that go on with them.
#[derive(Debug, Clone)]
pub struct Tails {
    pool: Arc<Mutex<Pool>>,
    settings: RecordSettings,
}

#[derive(Debug, Default)]
struct Pool {
    /// Those that wait, each since a time.
    waiting: BTreeMap<RodId, (Tail, Instant)>,
    /// Time since which a rod's samples up to a log time \[ns\] wait: a file with temperatures alone takes them and puts them back.
    since: BTreeMap<RodId, (u64, Instant)>,
}

impl Tails {
    /// None yet, of rods cut with `settings`.
    pub fn new(settings: RecordSettings) -> Self {
        Self {
            pool: Arc::default(),
            settings,
        }
    }

    /// Settings with which the rods are cut.
    pub fn settings(&self) -> &RecordSettings {
        &self.settings
    }

    fn pool<T>(&self, work: impl FnOnce(&mut Pool) -> T) -> T {
        work(&mut self.pool.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn all<T>(&self, work: impl FnOnce(&mut BTreeMap<RodId, (Tail, Instant)>) -> T) -> T {
        self.pool(|pool| work(&mut pool.waiting))
    }

    /// Takes the samples with which a rod's message of this log time \[ns\] goes on: earlier messages than theirs go on with nothing.
    pub(super) fn take(&self, rod: &RodId, time: u64) -> Option<Tail> {
        self.all(|waiting| {
            let (tail, _) = waiting.get(rod)?;
            (time.saturating_add(SEAM_NS) >= tail.to)
                .then(|| waiting.remove(rod))
                .flatten()
                .map(|(tail, _)| tail)
        })
    }

    /// Adds a rod's; returns the one before, which cannot wait any more.
    ///
    /// # Errors
    /// The rod has a later one: the tail itself.
    #[allow(clippy::result_large_err, reason = "it is no failure, and moved on at once")]
    pub fn put(&self, tail: Tail) -> Result<Option<Tail>, Tail> {
        self.pool(|Pool { waiting, since }| {
            if waiting
                .get(&tail.rod)
                .is_some_and(|(other, _)| other.to > tail.to)
            {
                return Err(tail);
            }
            let (to, rod) = (tail.to, tail.rod.clone());
            let known = since.get(&rod).filter(|(known, _)| *known == to && to > 0);
            let at = known.map_or_else(Instant::now, |(_, at)| *at);
            since.insert(rod.clone(), (to, at));
            let before = waiting.insert(rod.clone(), (tail, at));
            // The same samples again, of a copy or of a file that was touched, replace themselves.
            let is_same = |before: &Tail| {
                let now = waiting.get(&rod).map(|(tail, _)| (&tail.lanes, &tail.moments));
                before.to == to && now == Some((&before.lanes, &before.moments))
            };
            Ok(before.map(|(tail, _)| tail).filter(|before| !is_same(before)))
        })
    }

    /// Takes those for which `is_wanted` is true, with the time since which each waits.
    pub fn remove_if(&self, is_wanted: impl Fn(&Tail, Instant) -> bool) -> Vec<Tail> {
        self.all(|waiting| {
            let wanted = waiting.extract_if(.., |_, (tail, since)| is_wanted(tail, *since));
            wanted.map(|(_, (tail, _))| tail).collect()
        })
    }

    /// Log time of the latest message with samples of a rod's, if it waits \[ns since 1970\].
    pub(super) fn to(&self, rod: &RodId) -> Option<u64> {
        self.all(|waiting| Some(waiting.get(rod)?.0.to))
    }

    /// True if a rod's waits.
    pub fn has(&self, rod: &RodId) -> bool {
        self.all(|waiting| waiting.contains_key(rod))
    }

    /// Rods of which readings are remembered.
    pub fn remembering(&self) -> BTreeSet<RodId> {
        self.all(|waiting| {
            let remembering = waiting.iter().filter(|(_, (tail, _))| tail.is_memory());
            remembering.map(|(rod, _)| rod.clone()).collect()
        })
    }

    /// Bytes that all of them take.
    pub fn held(&self) -> usize {
        self.all(|waiting| waiting.values().map(|(tail, _)| tail.held()).sum())
    }
}
