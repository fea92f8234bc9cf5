//! The search of a site's samples in parts: each part finds the resonances of its share of the records, and the site's own task takes
//! them from there instead of searching again.
//!
//! A record is a pure function of the samples before its end, so every part reads all files and searches only the records of its share:
//! temperatures and cuts are those of a replay, and so is the site's result, whichever parts are there.

use crate::analysis::identify::{Identification, Plan, Refusal};
use crate::analysis::signal::modes::{Motion, Resonance};
use crate::analysis::signal::record::{Event, Record, RodId};
use crate::config::Config;
use crate::recording::atomic::AtomicFile;
use crate::site::ordered_map::{Limits, map_in_order};
use crate::site::prepared::Plans;
use crate::site::records::{Others, Records};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, BufReader, Read, Write};
use std::ops::ControlFlow;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// First bytes of a part's file.
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

/// Result of the search of one record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Searched {
    resonances: Vec<Resonance>,
    motion: Motion,
}

impl Part {
    /// True if a record belongs to it: days of each rod go round the parts, and another rod's day to the next part.
    fn has(self, place: usize, record: &Record) -> bool {
        let day = record.start.as_nanos().div_euclid(1_000_000_000 * STRETCH_S);
        (day + place as i64).rem_euclid(self.of.max(1) as i64) == self.number as i64
    }

    /// Name of its file for a result of a name.
    pub fn name(self, result: &str) -> String {
        format!("{result}.part-{}-of-{}", self.number, self.of)
    }
}

/// Searches the records of a part in some files on `workers` threads and writes what is found; `tell` hears the number of records.
/// Returns that number. Records that only the site's own task can analyse (of several sensors, refused before a search, or that break
/// the program) are left to it.
///
/// # Errors
/// The file cannot be written.
pub fn search(
    part: Part,
    paths: &[PathBuf],
    config: &Config,
    plans: &Plans,
    workers: usize,
    into: &Path,
    mut tell: impl FnMut(u64),
) -> io::Result<u64> {
    let places: HashMap<&RodId, usize> = config.rods.iter().map(|rod| &rod.analysis.rod).zip(0..).collect();
    let others = Others {
        is_meant: true,
        needs_all: true,
        ..Others::default()
    };
    let records = Records::open(paths, config, others).filter_map(|event| match event {
        Event::Record(record) => {
            let place = *places.get(&record.rod)?;
            part.has(place, &record).then_some(record)
        }
        _ => None,
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
            let evidence = plans.get(&record.rod)?.search(&record).ok()?;
            let searched = Searched {
                resonances: evidence.resonances,
                motion: evidence.motion,
            };
            Some((record.identity(), postcard::to_stdvec(&searched).ok()?))
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
    match failure {
        Some(error) => Err(error),
        None => file.commit().map(|()| count),
    }
}

/// A part's file under way, which ends in the hash of what is before it.
struct HashingFile {
    file: AtomicFile,
    hash: Sha256,
}

impl HashingFile {
    fn create(path: &Path) -> io::Result<Self> {
        Ok(Self {
            file: AtomicFile::create(path)?,
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

    fn commit(mut self) -> io::Result<()> {
        let hash = self.hash.finalize();
        self.file.write_all(&hash)?;
        self.file.commit()
    }
}

/// Results of all parts of a site that are there: the place of each record's body in its file.
#[derive(Debug, Default)]
pub struct Parts {
    files: Vec<(PathBuf, File)>,
    places: HashMap<[u8; 32], (usize, u64, u32)>,
    used: AtomicU64,
}

impl Parts {
    /// Opens the parts of a result in a folder. `damaged` hears of a file that is passed over: its records are searched as if it were not
    /// there.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn open(folder: &Path, result: &str, mut damaged: impl FnMut(&Path, &str)) -> io::Result<Self> {
        let mut parts = Self::default();
        let begins = format!("{result}.part-");
        let mut paths = Vec::new();
        for entry in fs::read_dir(folder)? {
            let entry = entry?;
            if entry.file_name().to_string_lossy().starts_with(&begins) {
                paths.push(entry.path());
            }
        }
        paths.sort();
        for path in paths {
            match entries(&path) {
                Ok((file, found)) => {
                    let number = parts.files.len();
                    let found = found
                        .into_iter()
                        .map(|(identity, at, length)| (identity, (number, at, length)));
                    parts.places.extend(found);
                    parts.files.push((path, file));
                }
                Err(error) => damaged(&path, &error.to_string()),
            }
        }
        Ok(parts)
    }

    /// Number of records that were searched in a part.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// True if no part is there.
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
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
        match self.searched(&record.identity()) {
            Some(Searched { resonances, motion }) => {
                self.used.fetch_add(1, Ordering::Relaxed);
                plan.run_searched(record, resonances, motion)
            }
            None => plan.run(record),
        }
    }

    fn searched(&self, identity: &[u8; 32]) -> Option<Searched> {
        let &(number, at, length) = self.places.get(identity)?;
        let (_, file) = self.files.get(number)?;
        let mut body = vec![0; length as usize];
        file.read_exact_at(&mut body, at).ok()?;
        postcard::from_bytes(&body).ok()
    }

    /// Removes the files; what cannot be removed only takes room.
    pub fn remove(self) {
        for (path, _) in self.files {
            let _ = fs::remove_file(path);
        }
    }
}

/// Records of a part's file, with place and length of each body, after a look at every byte.
type Entries = Vec<([u8; 32], u64, u32)>;

fn entries(path: &Path) -> io::Result<(File, Entries)> {
    let file = File::open(path)?;
    let damaged = || io::Error::new(io::ErrorKind::InvalidData, "it is damaged");
    let body = file.metadata()?.len().checked_sub(32).ok_or_else(damaged)?;
    let mut reader = BufReader::new(&file).take(body);
    let mut hash = Sha256::new();
    let mut take = |bytes: &mut [u8]| {
        reader.read_exact(bytes)?;
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
