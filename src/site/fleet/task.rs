//! One task of a fleet: a site, its files, its configuration, and the name that its result therefore has.

use super::identity;
use super::part::Part;
use crate::analysis::identify::VERSION;
use crate::analysis::signal::record::Timestamp;
use crate::config::Config;
use crate::site::hex::hex;
use crate::site::store::{FileMark, FileState};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

/// Format of a plan's lines.
pub const FORMAT: u32 = 1;
/// Format of lines of parts, which an older program would take for the whole site.
pub const PART_FORMAT: u32 = 2;

/// Longest line of a plan \[bytes\]: a site of a hundred thousand files.
const LONGEST: usize = 64 << 20;

/// Input of a task.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Input {
    /// Recordings, replayed.
    #[default]
    Recordings,
    /// One store, analysed again without recordings.
    Store,
}

/// One file of a task's manifest.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Item {
    /// Path below the archive.
    pub path: String,
    /// Size \[bytes\].
    pub bytes: u64,
    /// Identity of the content: [`identity`].
    pub identity: String,
    /// Times of the first and last message, if the file's end says them.
    pub from: Option<Timestamp>,
    /// Time of the last message.
    pub to: Option<Timestamp>,
}

/// One line of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Task {
    /// [`FORMAT`] or [`PART_FORMAT`].
    pub format: u32,
    /// Array index, from 0.
    pub index: usize,
    /// Name of the site's folder and configuration.
    pub site: String,
    /// Input of the task.
    pub input: Input,
    /// Folder of all sites' recordings.
    pub archive: PathBuf,
    /// Folder of all sites' configurations.
    pub configs: PathBuf,
    /// Hash of everything in the configuration that a result depends on.
    pub config_hash: String,
    /// Version of the analysis.
    pub analysis_version: u32,
    /// Files, by name.
    pub files: Vec<Item>,
    /// Summed size of the files \[bytes\].
    pub bytes: u64,
    /// Expected processor time \[s\]: for the order of the tasks, not a promise.
    pub cost_s: f64,
    /// Name of the result: hash of configuration, manifest and analysis version.
    pub result: String,
    /// Share of the site's search, if the task is no more than that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<Part>,
}

/// Reason why a task cannot run.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// The plan or what it names changed: another attempt ends the same way.
    #[error("{0}")]
    Outdated(String),
    /// A file is missing or cannot be read now: another attempt may find it.
    #[error("{0}")]
    Unreachable(String),
}

/// Name of the result of some files by a configuration with this program.
pub fn result_name(site: &str, input: Input, config_hash: &str, files: &[Item]) -> String {
    let mut hash = Sha256::new();
    let mut add = |text: &str| {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text.as_bytes());
    };
    add(site);
    add(match input {
        Input::Recordings => "recordings",
        Input::Store => "store",
    });
    add(config_hash);
    add(&VERSION.to_string());
    for file in files {
        add(&file.path);
        add(&file.identity);
        add(&file.bytes.to_string());
    }
    hex(&hash.finalize()[..8])
}

/// Hash of everything in a configuration that a result depends on.
pub fn hash_of(config: &Config) -> String {
    hex(&config.hash())
}

impl Task {
    /// Path of the configuration.
    pub fn config_path(&self) -> PathBuf {
        self.configs.join(format!("{}.toml", self.site))
    }

    /// Paths of the files.
    pub fn paths(&self) -> Vec<PathBuf> {
        self.files
            .iter()
            .map(|file| self.archive.join(&file.path))
            .collect()
    }

    /// Path of the site's result below a folder of results.
    pub fn result_in(&self, folder: &Path) -> PathBuf {
        folder.join(&self.site).join(format!("{}.db", self.result))
    }

    /// Times of the first and last message of its files, as far as they say them.
    pub fn span(&self) -> Option<(Timestamp, Timestamp)> {
        let from = self.files.iter().filter_map(|file| file.from).min()?;
        Some((from, self.files.iter().filter_map(|file| file.to).max()?))
    }

    /// Outcome of each file, from those of which something is lost: their names as paths, and what is lost. Depends on
    /// nothing but content and names, as the result must: times of change are not kept.
    pub fn marks(&self, damaged: &[(String, String)]) -> Vec<FileMark> {
        let mark = |name: &str, size, state| FileMark {
            name: name.to_owned(),
            size,
            modified_ns: 0,
            state,
        };
        let mut lost: BTreeMap<&str, &str> = damaged
            .iter()
            .map(|(name, what)| (name.as_str(), what.as_str()))
            .collect();
        let mut marks = Vec::new();
        for (item, path) in self.files.iter().zip(self.paths()) {
            let state = match lost.remove(&*path.display().to_string()) {
                Some(what) => FileState::Incomplete(what.to_owned()),
                None => FileState::Done,
            };
            marks.push(mark(&item.path, item.bytes, state));
        }
        // A part of a journal has a name of its own.
        let others = lost.into_iter();
        marks.extend(others.map(|(name, what)| mark(name, 0, FileState::Incomplete(what.to_owned()))));
        marks
    }

    /// Reads and checks the configuration.
    ///
    /// # Errors
    /// It cannot be read or is not the planned one, or this program is another version.
    pub fn config(&self) -> Result<Config, TaskError> {
        let (site, path) = (&self.site, self.config_path());
        let config =
            Config::load(&path).map_err(|error| TaskError::Outdated(format!("site {site}: {error}")))?;
        if hash_of(&config) != self.config_hash {
            return Err(TaskError::Outdated(format!(
                "site {site}: {} changed since the plan was made: plan again",
                path.display()
            )));
        }
        if self.analysis_version != VERSION {
            return Err(TaskError::Outdated(format!(
                "site {site}: planned for analysis version {}, this program has {VERSION}: plan again with this program",
                self.analysis_version
            )));
        }
        Ok(config)
    }

    /// Checks that every file is there and the planned one.
    ///
    /// # Errors
    /// The first that is missing, or another.
    pub fn check_files(&self) -> Result<(), TaskError> {
        for (item, path) in self.files.iter().zip(self.paths()) {
            let name = path.display();
            let (bytes, identity) = identity::again(&path, &item.identity).map_err(|error| {
                TaskError::Unreachable(format!(
                    "site {}: {name}: {error}; if the archive is elsewhere on this machine, say --archive DIR",
                    self.site
                ))
            })?;
            if self.input == Input::Store && identity::has_open_log(&path) {
                return Err(TaskError::Outdated(format!(
                    "site {}: {name}: commits wait in its write-ahead log, which was not so when the plan was made: take a copy by \
                     `tirante backup`, and plan again",
                    self.site
                )));
            }
            if bytes != item.bytes || identity != item.identity {
                return Err(TaskError::Outdated(format!(
                    "site {}: {name} changed since the plan was made ({} bytes then, {bytes} now): plan again",
                    self.site, item.bytes
                )));
            }
        }
        Ok(())
    }
}

/// Reads the tasks of a plan: all, or the one with an index.
///
/// # Errors
/// The file cannot be read, a line is no task, or no task has the index.
pub fn read(path: &Path, index: Option<usize>) -> Result<Vec<Task>, TaskError> {
    let name = path.display();
    let file = File::open(path).map_err(|error| TaskError::Unreachable(format!("{name}: {error}")))?;
    let mut lines = BufReader::new(file);
    let (mut tasks, mut count) = (Vec::new(), 0);
    let mut line = Vec::new();
    loop {
        line.clear();
        let mut limited = std::io::Read::take(&mut lines, LONGEST as u64);
        let length = limited
            .read_until(b'\n', &mut line)
            .map_err(|error| TaskError::Unreachable(format!("{name}: {error}")))?;
        if length == 0 {
            break;
        }
        let number = count;
        count += 1;
        if index.is_some_and(|index| index != number) {
            continue;
        }
        let wrong = |what: String| TaskError::Outdated(format!("{name}: line {}: {what}", number + 1));
        if line.last() != Some(&b'\n') {
            return Err(wrong(
                "the line is cut short: the plan was not written to its end, plan again".to_owned(),
            ));
        }
        let task: Task =
            serde_json::from_slice(&line).map_err(|error| wrong(format!("no task ({error}): plan again")))?;
        let format = task.part.map_or(FORMAT, |_| PART_FORMAT);
        if task.format != format || task.index != number {
            return Err(wrong(format!(
                "format {} and index {} where format {format} and index {number} are expected: plan again",
                task.format, task.index
            )));
        }
        tasks.push(task);
    }
    match index {
        Some(index) if tasks.is_empty() => Err(TaskError::Outdated(format!(
            "{name} has {count} tasks, 0 to {}: there is no index {index}",
            count.saturating_sub(1)
        ))),
        _ if tasks.is_empty() => Err(TaskError::Outdated(format!("{name} has no tasks"))),
        _ => Ok(tasks),
    }
}
