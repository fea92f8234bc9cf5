//! The search of a site's samples in parts: each part finds the resonances of its share of the records, and the site's own task takes
//! them from there instead of searching again.
//!
//! A record is a pure function of the samples before its end, so every part reads all files and searches only the records of its share:
//! temperatures and cuts are those of a replay, and so is the site's result, whichever parts are there.

use crate::analysis::identify::{Identification, Plan, Refusal};
use crate::analysis::signal::modes::{Motion, Resonance};
use crate::analysis::signal::record::{Event, Excitation, Record, RodChannels, RodId};
use crate::config::Config;
use crate::recording::import::How;
use crate::recording::read::{self, Recordings, SourceError, Step};
use crate::site::ordered_map::{Limits, map_in_order};
use crate::site::prepared::Plans;
use crate::site::records::in_order;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::ops::ControlFlow;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// First bytes of a part's file; another layout of the bodies gets another number.
const MAGIC: &[u8; 8] = b"TIRPART1";
/// Bytes of an entry before its body: the record's identity and the body's length.
const HEAD: usize = 32 + 4;
/// Longest body \[bytes\]: far beyond what a spectrum holds.
const LONGEST: u32 = 1 << 20;
/// Time that one part has together \[s\].
const STRETCH_S: i64 = 86_400;
/// Most samples of records in memory between reading and search (8 bytes each).
const SAMPLES_IN_FLIGHT: usize = 2 << 20;

/// Share of a site's records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Part {
    /// Number of the part, from 0.
    pub number: usize,
    /// Number of parts of the site.
    pub of: usize,
}

/// Result of the search of one record, with what the search depends on besides the samples that identify the record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Searched {
    clock_sd: f64,
    excitation: Option<Excitation>,
    resonances: Vec<Resonance>,
    motion: Motion,
}

impl Searched {
    /// `None` for a record that cannot be searched.
    fn of(plan: &Plan, record: &Record) -> Option<Self> {
        let evidence = plan.search(record).ok()?;
        Some(Self {
            clock_sd: record.clock_sd,
            excitation: record.excitation,
            resonances: evidence.resonances,
            motion: evidence.motion,
        })
    }

    /// True if it is what a search of this record gives.
    fn is_of(&self, record: &Record) -> bool {
        self.clock_sd.to_bits() == record.clock_sd.to_bits() && self.excitation == record.excitation
    }
}

impl Part {
    /// True if a record of a rod, by its place among `rods`, belongs to it: the days of all rods go round the parts.
    fn has(self, rod: usize, rods: usize, record: &Record) -> bool {
        let day = record.start.as_nanos().div_euclid(1_000_000_000 * STRETCH_S);
        (day * rods as i64 + rod as i64).rem_euclid(self.of.max(1) as i64) == self.number as i64
    }

    /// Name of its file for a result of a name.
    pub fn name(self, result: &str) -> String {
        format!("{result}.part-{}-of-{}", self.number, self.of)
    }
}

/// Reason why a part has no file.
#[derive(Debug, thiserror::Error)]
pub enum PartError {
    /// A recording that the file system refuses: its records would be missing.
    #[error(transparent)]
    Recording(#[from] SourceError),
    /// The part's file cannot be written.
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// Searches the records of a part in some files on `workers` threads and writes what is found to `into`; `tell` hears the number of
/// records. Returns that number. Records that only the site's own task can analyse (of several sensors, refused before a search, or that
/// break the program) are left to it, and so is what there is to say of damaged recordings.
///
/// # Errors
/// A recording cannot be read, or the file not be written.
pub fn search(
    part: Part,
    paths: &[PathBuf],
    config: &Config,
    plans: &Plans,
    workers: usize,
    into: &Path,
    mut tell: impl FnMut(u64),
) -> Result<u64, PartError> {
    let rods: HashMap<&RodId, usize> = config.rods.iter().map(|rod| &rod.analysis.rod).zip(0..).collect();
    let channels: Vec<RodChannels> = config.rods.iter().map(|rod| rod.channels.clone()).collect();
    let files = in_order(read::recordings(paths), &How::default());
    let mut recordings = Recordings::new(files, channels, config.record, false, Arc::default());
    let refused = Mutex::new(None);
    // A record is filtered as it is cut, before the next one: in memory are those that are searched.
    let records = std::iter::from_fn(|| {
        loop {
            match recordings.next()? {
                Step::Event(Event::Record(record), _)
                    if rods
                        .get(&record.rod)
                        .is_some_and(|&rod| part.has(rod, rods.len(), &record)) =>
                {
                    return Some(record);
                }
                Step::File(Err(error @ SourceError::Io { .. })) => {
                    *refused.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                    return None;
                }
                Step::File(_) | Step::Event(..) | Step::More | Step::Wait | Step::End => {}
            }
        }
    });
    let limits = Limits {
        workers,
        weight: SAMPLES_IN_FLIGHT,
    };
    let mut file = HashingFile::create(into)?;
    file.write(MAGIC)?;
    let (mut count, mut failure) = (0, None);
    map_in_order(
        records,
        limits,
        |record| record.samples.len(),
        |record| {
            let searched = Searched::of(plans.get(&record.rod)?, &record)?;
            let body = postcard::to_stdvec(&searched).ok()?;
            (body.len() <= LONGEST as usize).then(|| (record.identity(), body))
        },
        |results| {
            for (identity, body) in results.into_iter().flatten().flatten() {
                if let Err(error) = file.entry(&identity, &body) {
                    failure = Some(error);
                    return ControlFlow::Break(());
                }
                count += 1;
                tell(count);
            }
            ControlFlow::Continue(())
        },
    );
    if let Some(error) = refused.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error.into());
    }
    if let Some(error) = failure {
        return Err(error.into());
    }
    file.finish()?;
    Ok(count)
}

/// A part's file under way, which ends in the hash of what is before it.
struct HashingFile {
    file: BufWriter<File>,
    hash: Sha256,
}

impl HashingFile {
    fn create(path: &Path) -> io::Result<Self> {
        Ok(Self {
            file: BufWriter::new(File::create(path)?),
            hash: Sha256::new(),
        })
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.hash.update(bytes);
        self.file.write_all(bytes)
    }

    fn entry(&mut self, identity: &[u8; 32], body: &[u8]) -> io::Result<()> {
        let length = u32::try_from(body.len()).map_err(io::Error::other)?;
        self.write(identity)?;
        self.write(&length.to_le_bytes())?;
        self.write(body)
    }

    fn finish(mut self) -> io::Result<()> {
        let hash = self.hash.finalize();
        self.file.write_all(&hash)?;
        self.file.flush()
    }
}

/// Removes the parts of a result from a folder, whole ones and those under way: with the result in its place nobody needs them. What
/// cannot be removed only takes room.
pub fn remove(folder: &Path, result: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if is_of(name.strip_prefix('.').unwrap_or(&name), result) {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// True if a file of a name is a part of a result.
fn is_of(name: &str, result: &str) -> bool {
    name.strip_prefix(result)
        .is_some_and(|rest| rest.starts_with(".part-"))
}

/// Results of all parts of a site that are there: the place of each record's body in its file.
#[derive(Debug, Default)]
pub struct Parts {
    files: Vec<File>,
    places: HashMap<[u8; 32], (usize, u64, u32)>,
    used: AtomicU64,
}

impl Parts {
    /// Opens the parts of a result in a folder. `passed_over` hears of files that cannot be used: their records are searched again.
    ///
    /// # Errors
    /// The folder cannot be listed.
    pub fn open(
        folder: &Path,
        result: &str,
        mut passed_over: impl FnMut(&Path, &io::Error),
    ) -> io::Result<Self> {
        let mut parts = Self::default();
        let mut paths: Vec<PathBuf> = fs::read_dir(folder)?
            .flatten()
            .filter(|entry| is_of(&entry.file_name().to_string_lossy(), result))
            .map(|entry| entry.path())
            .collect();
        paths.sort();
        for path in paths {
            match entries(&path) {
                Ok((file, found)) => {
                    let number = parts.files.len();
                    for (identity, at, length) in found {
                        parts.places.entry(identity).or_insert((number, at, length));
                    }
                    parts.files.push(file);
                }
                Err(error) => passed_over(&path, &error),
            }
        }
        Ok(parts)
    }

    /// Number of records that were searched in a part.
    pub fn searched(&self) -> usize {
        self.places.len()
    }

    /// Number of records that were taken from a part.
    pub fn used(&self) -> u64 {
        self.used.load(Ordering::Relaxed)
    }

    /// Runs a record through its plan, without a search if a part has it.
    ///
    /// # Errors
    /// The reason why the record gives no force.
    pub fn run(&self, plan: &Plan, record: &Record) -> Result<Identification, Refusal> {
        if self.places.is_empty() {
            return plan.run(record);
        }
        match self.of(record) {
            Some(Searched {
                resonances, motion, ..
            }) => {
                self.used.fetch_add(1, Ordering::Relaxed);
                plan.run_searched(record, resonances, motion)
            }
            None => plan.run(record),
        }
    }

    fn of(&self, record: &Record) -> Option<Searched> {
        let &(number, at, length) = self.places.get(&record.identity())?;
        let mut body = vec![0; length as usize];
        self.files.get(number)?.read_exact_at(&mut body, at).ok()?;
        let searched: Searched = postcard::from_bytes(&body).ok()?;
        searched.is_of(record).then_some(searched)
    }
}

/// Identity of each record of a part's file, with place and length of its body.
type Entries = Vec<([u8; 32], u64, u32)>;

/// Entries of a part's file, after a look at every byte.
fn entries(path: &Path) -> io::Result<(File, Entries)> {
    let file = File::open(path)?;
    let damaged = || io::Error::new(io::ErrorKind::InvalidData, "it is damaged");
    let cut_short = |error: io::Error| match error.kind() {
        io::ErrorKind::UnexpectedEof => damaged(),
        _ => error,
    };
    let body = file.metadata()?.len().checked_sub(32).ok_or_else(damaged)?;
    let mut reader = BufReader::new(&file).take(body);
    let mut hash = Sha256::new();
    let mut take = |bytes: &mut [u8]| {
        reader.read_exact(bytes).map_err(cut_short)?;
        hash.update(&*bytes);
        Ok::<_, io::Error>(())
    };
    let mut magic = [0; MAGIC.len()];
    take(&mut magic)?;
    if magic != *MAGIC {
        return Err(damaged());
    }
    let (mut at, mut found) = (MAGIC.len() as u64, Vec::new());
    while at < body {
        let mut head = [0; HEAD];
        take(&mut head)?;
        let (identity, length) = head.split_at(32);
        let identity: [u8; 32] = identity.try_into().map_err(|_| damaged())?;
        let length = u32::from_le_bytes(length.try_into().map_err(|_| damaged())?);
        if length > LONGEST {
            return Err(damaged());
        }
        take(&mut vec![0; length as usize])?;
        at += HEAD as u64;
        found.push((identity, at, length));
        at += u64::from(length);
    }
    let mut said = [0; 32];
    file.read_exact_at(&mut said, body)?;
    if said[..] != hash.finalize()[..] {
        return Err(damaged());
    }
    Ok((file, found))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::modes::MotionKind;

    /// Bytes of an entry as parts on disk have them: where these change, [`MAGIC`] must.
    #[test]
    fn the_layout_of_a_body_has_its_number() {
        let resonance = Resonance {
            frequency_hz: 1.0,
            frequency_sd_hz: 2.0,
            damping: 3.0,
            damping_log_sd: 4.0,
            peak_to_noise: 5.0,
            evidence: 6.0,
            line: true,
            misfit: 7.0,
            foreign_log_odds: 8.0,
        };
        let searched = Searched {
            clock_sd: 0.5,
            excitation: Some(Excitation::FreeDecay),
            resonances: vec![resonance],
            motion: Motion {
                kind: MotionKind::FreeDecays,
                onsets_s: vec![9.0],
            },
        };
        let body = postcard::to_stdvec(&searched).unwrap();
        let hash: [u8; 32] = Sha256::digest(&body).into();
        assert_eq!(
            (&MAGIC[..], body.len(), &hash[..4]),
            (&b"TIRPART1"[..], 86, &[0xda, 0xc7, 0x2a, 0x6f][..])
        );
        assert_eq!(postcard::from_bytes::<Searched>(&body).unwrap(), searched);
    }
}
