//! Effect of a configuration on the baselines of a store: half a year of learning is not dropped without a
//! request.

use crate::analysis::signal::record::{RodId, Timestamp};
use crate::analysis::track::{Segment, State};
use crate::config::Config;
use crate::site::prepared::key;
use crate::site::store::{Reader, Shelved, StoreError};
use std::fmt::Write;

/// True if a rod's segment was measured with settings that have the key `wanted` by the rules of this program: an earlier one of the
/// same analysis hashed other settings.
///
/// # Errors
/// The store cannot be read.
pub fn has_same_settings(reader: &Reader, state: &State, wanted: &str) -> Result<bool, StoreError> {
    if state.segment.key == wanted {
        return Ok(true);
    }
    if version(&state.segment.key) != version(wanted) {
        return Ok(false);
    }
    let learned = state.segment.baseline.as_ref().map(|baseline| baseline.last);
    let learned = learned
        .map(|last| reader.config_at(&state.rod, last))
        .transpose()?;
    Ok(has_key(learned.flatten(), &state.rod, wanted)
        || is_measured_with(reader, &state.rod, state.segment.number, wanted)?)
}

/// True if the latest record of a segment was measured with settings of the key `wanted`. This program gives other settings another
/// segment; an earlier one, which hashed less, may have let them into the same.
fn is_measured_with(reader: &Reader, rod: &RodId, segment: u32, wanted: &str) -> Result<bool, StoreError> {
    Ok(has_key(reader.config_in(rod, segment)?, rod, wanted))
}

fn has_key(config: Option<[String; 3]>, rod: &RodId, wanted: &str) -> bool {
    let config = config.and_then(|[_, _, text]| Config::parse(&text, "the store").ok());
    config.is_some_and(|config| key(&config, rod) == wanted)
}

/// The latest shelved segment of a rod with the settings of the key `wanted`.
///
/// # Errors
/// The store cannot be read.
pub fn shelved(reader: &Reader, rod: &RodId, wanted: &str) -> Result<Option<Shelved>, StoreError> {
    for shelved in reader.shelved(rod)?.into_iter().rev() {
        let is_of_this_analysis = version(&shelved.key) == version(wanted);
        if shelved.key == wanted
            || is_of_this_analysis && is_measured_with(reader, rod, shelved.segment, wanted)?
        {
            return Ok(Some(shelved));
        }
    }
    Ok(None)
}

/// Effect on a rod's baseline.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Fate {
    /// There is no baseline yet.
    None,
    /// The baseline is kept.
    Kept,
    /// Earlier settings are back: the segment of this number continues.
    FoundAgain(u32),
    /// Earlier settings are back, whose baseline was being learned: its segment continues.
    LearnedOn(Learning),
    /// The settings change the meaning of the numbers while a baseline is being learned: it rests, and another begins. Holds
    /// these settings, as far as known.
    Rests(Learning, Vec<String>),
    /// Another version of the program measures differently: the baseline must be learned again.
    Outdated,
    /// The settings change the meaning of the numbers: the baseline would be lost. Holds these settings, as
    /// far as known.
    Lost(Vec<String>),
    /// The configuration has no such rod, but a new one on its topic: most likely renamed.
    Renamed(RodId),
    /// The configuration has no such rod: its baseline rests.
    Unfollowed,
}

impl Fate {
    /// True if months of learning end with it.
    pub fn is_loss(&self) -> bool {
        matches!(self, Self::Lost(_) | Self::Renamed(_))
    }

    /// First reason of a loss.
    fn first_reason(&self) -> String {
        match self {
            Self::Renamed(name) => format!("its topic belongs to the new rod {name}"),
            Self::Lost(changes) if !changes.is_empty() => changes[0].clone(),
            _ => "its settings changed".to_owned(),
        }
    }
}

/// A baseline that is being learned.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Learning {
    /// Its segment.
    pub segment: u32,
    /// Number of its records so far.
    pub records: usize,
    /// Number of records that it takes.
    pub of: usize,
}

/// One rod and its baseline.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Prospect {
    /// The rod.
    pub rod: RodId,
    /// Present segment.
    pub segment: u32,
    /// Number of records of its baseline, and start of the first.
    pub learned: Option<(usize, Timestamp)>,
    /// Effect on the baseline.
    pub fate: Fate,
}

/// Settings that would drop baselines not given up.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{text}")]
pub struct Refused {
    text: String,
    /// Rods that would lose theirs, each with the first reason.
    lost: Vec<(RodId, String)>,
}

/// Most rods named in a short message.
const NAMED: usize = 5;

impl Refused {
    /// The rods with the first setting that changed, for a message: `rod north (rod.priors.…: … -> …)`.
    pub fn brief(&self) -> String {
        let named = self.lost.iter().take(NAMED);
        let mut named: Vec<String> = named.map(|(rod, why)| format!("rod {rod} ({why})")).collect();
        let more = self.lost.len().saturating_sub(NAMED);
        if more > 0 {
            named.push(format!("{more} more"));
        }
        named.join(", ")
    }
}

/// Reason why a configuration was refused, or could not be checked.
#[derive(Debug, thiserror::Error)]
pub enum BaselineError {
    /// It would drop a baseline.
    #[error(transparent)]
    Refused(#[from] Refused),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// Effect of this configuration on the baselines of a store's rods.
///
/// # Errors
/// The store cannot be read.
pub fn prospects(reader: &Reader, config: &Config) -> Result<Vec<Prospect>, StoreError> {
    let states = reader.states()?;
    let mut prospects = Vec::new();
    for rod in config.rods.iter().map(|rod| &rod.analysis.rod) {
        let Some(state) = states.get(rod) else {
            continue;
        };
        let segment = &state.segment;
        let learned = segment.baseline.as_ref();
        let wanted = key(config, rod);
        let found = shelved(reader, rod, &wanted)?;
        let fate = match (learned, found) {
            _ if has_same_settings(reader, state, &wanted)? => learned.map_or(Fate::None, |_| Fate::Kept),
            (_, Some(found)) if found.has_baseline => Fate::FoundAgain(found.segment),
            (None, Some(found)) => Fate::LearnedOn(Learning {
                segment: found.segment,
                records: found.learning,
                of: config.track.baseline_records,
            }),
            (None, None) if state.learned() == 0 => Fate::None,
            (None, None) => rests(reader, config, state)?,
            (Some(_), _) if version(&segment.key) != version(&wanted) => Fate::Outdated,
            // One that is being learned is none for a baseline.
            (Some(_), _) => Fate::Lost(changes(reader, config, rod, segment)?),
        };
        prospects.push(Prospect {
            rod: rod.clone(),
            segment: segment.number,
            learned: learned.map(|baseline| (baseline.records, baseline.first)),
            fate,
        });
    }
    let is_configured = |rod: &RodId| config.rods.iter().any(|known| known.analysis.rod == *rod);
    for (rod, state) in states.iter().filter(|(rod, _)| !is_configured(rod)) {
        let Some(baseline) = &state.segment.baseline else {
            continue;
        };
        let topic = |config: &Config| {
            let known = config.rods.iter().find(|known| known.analysis.rod == *rod);
            known.map(|known| known.channels.displacement.topic.clone())
        };
        let before = config_of(reader, rod, baseline.last)?.as_ref().and_then(topic);
        // A rod with records of its own is no new name.
        let mut fresh = config
            .rods
            .iter()
            .filter(|known| !states.contains_key(&known.analysis.rod));
        let renamed = fresh.find(|known| Some(&known.channels.displacement.topic) == before.as_ref());
        prospects.push(Prospect {
            rod: rod.clone(),
            segment: state.segment.number,
            learned: Some((baseline.records, baseline.first)),
            fate: renamed.map_or(Fate::Unfollowed, |known| {
                Fate::Renamed(known.analysis.rod.clone())
            }),
        });
    }
    Ok(prospects)
}

/// Configuration of a rod's record that began at `start`, if this program can read it.
fn config_of(reader: &Reader, rod: &RodId, start: Timestamp) -> Result<Option<Config>, StoreError> {
    let before = reader.config_at(rod, start)?;
    Ok(before.and_then(|[_, _, text]| Config::parse(&text, "the store").ok()))
}

/// Fate of a baseline that is being learned, under other settings.
fn rests(reader: &Reader, config: &Config, state: &State) -> Result<Fate, StoreError> {
    let (rod, segment) = (&state.rod, state.segment.number);
    let before = reader.config_in(rod, segment)?;
    let before = before.and_then(|[_, _, text]| Config::parse(&text, "the store").ok());
    let learning = Learning {
        segment,
        records: state.learned(),
        of: before.as_ref().unwrap_or(config).track.baseline_records,
    };
    let changes = before.map_or_else(Vec::new, |before| config.changes_of(&before, rod));
    Ok(Fate::Rests(learning, changes))
}

/// Version of the analysis in a key.
fn version(key: &str) -> Option<&str> {
    key.split_once('-').map(|(version, _)| version)
}

/// Settings that give a rod's numbers another meaning than in its segment.
fn changes(
    reader: &Reader,
    config: &Config,
    rod: &RodId,
    segment: &Segment,
) -> Result<Vec<String>, StoreError> {
    let last = segment.baseline.as_ref().map(|baseline| baseline.last);
    let before = match last {
        Some(last) => config_of(reader, rod, last)?,
        None => None,
    };
    Ok(before.map_or_else(Vec::new, |before| config.changes_of(&before, rod)))
}

/// Refuses a configuration that would drop a baseline of a rod that is not among those `given_up`.
///
/// # Errors
/// The configuration would drop one, or the store cannot be read.
pub fn guard(reader: &Reader, config: &Config, given_up: &[String]) -> Result<(), BaselineError> {
    let (mut refusal, mut lost) = (String::new(), Vec::new());
    for prospect in prospects(reader, config)? {
        if prospect.fate.is_loss() && !given_up.contains(&prospect.rod.0) {
            // Writing to a string cannot fail.
            let _ = writeln!(refusal, "{prospect}");
            lost.push((prospect.rod, prospect.fate.first_reason()));
        }
    }
    if refusal.is_empty() {
        return Ok(());
    }
    refusal += "say --accept-new-baseline ROD for each of them, or ask for it while the old configuration holds: tirante rebaseline ROD";
    Err(Refused { text: refusal, lost }.into())
}

impl std::fmt::Display for Prospect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { rod, segment, .. } = self;
        let learned = self.learned.map_or_else(String::new, |(records, first)| {
            format!(" (segment {segment}, {records} records from {first} on)")
        });
        match &self.fate {
            Fate::None => write!(f, "rod {rod}: there is no baseline yet"),
            Fate::Kept => write!(f, "rod {rod}: the baseline stays{learned}"),
            Fate::FoundAgain(before) => write!(
                f,
                "rod {rod}: these are settings of before: the baseline of segment {before} goes on"
            ),
            Fate::LearnedOn(Learning { segment, records, of }) => write!(
                f,
                "rod {rod}: these are settings of before: the baseline that segment {segment} was learning goes on ({records} of {of} \
                 records)"
            ),
            Fate::Rests(Learning { segment, records, of }, changes) => {
                write!(
                    f,
                    "rod {rod}: the baseline that is being learned rests ({records} of {of} records, segment {segment}) and begins anew \
                     with these settings; it comes back with the old ones"
                )?;
                match &changes[..] {
                    [] => Ok(()),
                    changes => write!(f, ": {}", changes.join("; ")),
                }
            }
            Fate::Outdated => write!(
                f,
                "rod {rod}: the analysis changed with the program: a new baseline is learned{learned}"
            ),
            Fate::Lost(changes) if changes.is_empty() => {
                write!(
                    f,
                    "rod {rod}: the baseline would be lost{learned}: its settings changed"
                )
            }
            Fate::Renamed(name) => write!(
                f,
                "rod {rod}: the baseline would be lost{learned}: the configuration has no such rod, and its topic belongs to the new \
                 rod {name}: give it the id {rod} again"
            ),
            Fate::Unfollowed => write!(
                f,
                "rod {rod}: the configuration has no such rod: no record of it is taken, its baseline rests{learned}"
            ),
            Fate::Lost(changes) => {
                let changes = changes.join("; ");
                write!(f, "rod {rod}: the baseline would be lost{learned}: {changes}")
            }
        }
    }
}
