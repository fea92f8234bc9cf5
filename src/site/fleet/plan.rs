//! From an archive's folders and a folder of configurations to tasks.
//!
//! `ARCHIVE/SITE/**/*.mcap` belongs to `CONFIGS/SITE.toml`, and every folder and every configuration needs the other.

use super::identity::{self, Thoroughness};
use super::part::Part;
use super::task::{FORMAT, Input, Item, PART_FORMAT, Task, hash_of, result_name};
use crate::analysis::identify::VERSION;
use crate::analysis::signal::record::Timestamp;
use crate::config::Config;
use crate::recording::read::folder::times_by_summary;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// Processor time of a site besides its records \[s\]: start of the program, and a rod's table of draws.
const START_S: f64 = 0.1;
const ROD_S: f64 = 0.05;
/// Processor time per byte of recordings and of a store \[s\]: 4 ms for the 8 kB of a record of 60 s at 40 Hz, and
/// 1 ms for the 6 kB that a store keeps of it.
const RECORDING_S: f64 = 4e-3 / 8e3;
const STORE_S: f64 = 1e-3 / 6e3;

/// Share of a recording's time that is reading, which every part of a site does.
const READING: f64 = 0.1;
/// Most parts of a site, all of which its own task has open.
const MOST_PARTS: usize = 200;
/// Most files in the lines of all parts of a site.
const MOST_ITEMS: usize = 1_000_000;

/// Archive, configurations, and what is wanted of them.
#[derive(Debug, Clone)]
pub struct Wanted<'a> {
    /// Folder with a folder of recordings, or of one store, for each site.
    pub archive: &'a Path,
    /// Folder with `SITE.toml` for each site.
    pub configs: &'a Path,
    /// Only these sites; empty: all.
    pub sites: &'a [String],
    /// Kind of files in the sites' folders.
    pub input: Input,
    /// Way to tell files apart.
    pub thoroughness: Thoroughness,
}

/// Tasks of a fleet, the costliest first, so that none of them is waited for at the end; or all reasons why there is no
/// plan.
///
/// # Errors
/// Folders without a configuration, configurations without a folder, files that cannot be read, faults of
/// configurations.
pub fn plan(wanted: &Wanted<'_>) -> Result<Vec<Task>, Vec<String>> {
    let mut faults = Vec::new();
    let (sites, configs) = (sites(wanted, &mut faults), configs(wanted, &mut faults));
    let chosen: BTreeSet<String> = match wanted.sites {
        [] => sites.union(&configs).cloned().collect(),
        named => named.iter().cloned().collect(),
    };
    let (archive, folder) = (wanted.archive.display(), wanted.configs.display());
    let mut tasks = Vec::new();
    for site in chosen {
        match (sites.contains(&site), configs.contains(&site)) {
            (true, true) => match task(wanted, &site) {
                Ok(task) => tasks.push(task),
                Err(more) => faults.extend(more),
            },
            (true, false) => faults.push(format!(
                "site {site}: {archive}/{site} has no configuration {folder}/{site}.toml: write it (`tirante init` makes one), or \
                 plan others with --site"
            )),
            (false, true) => faults.push(format!(
                "site {site}: {folder}/{site}.toml has no folder {archive}/{site}: rename one of them, or take the configuration \
                 away"
            )),
            (false, false) => faults.push(format!(
                "site {site}: there is neither {archive}/{site} nor {folder}/{site}.toml"
            )),
        }
    }
    if faults.is_empty() && tasks.is_empty() {
        faults.push(format!(
            "{archive}: no folders: each site's recordings lie in a folder with its name"
        ));
    }
    if !faults.is_empty() {
        return Err(faults);
    }
    tasks.sort_by(|a, b| b.cost_s.total_cmp(&a.cost_s).then_with(|| a.site.cmp(&b.site)));
    for (index, task) in tasks.iter_mut().enumerate() {
        task.index = index;
    }
    Ok(tasks)
}

/// Tasks for parts of the search of every site that is expected to cost more than a time \[s\], the costliest first: as many as bring each
/// below it, as far as reading all files of the site leaves time.
pub fn parts(tasks: &[Task], longest_s: f64) -> Vec<Task> {
    let mut parts: Vec<Task> = tasks
        .iter()
        .filter(|task| task.cost_s > longest_s)
        .flat_map(|task| {
            let search_s = (1.0 - READING) * RECORDING_S * task.bytes as f64;
            let fixed_s = task.cost_s - search_s;
            let wanted = (search_s / (longest_s - fixed_s).max(0.0)).ceil().max(2.0);
            let most = MOST_PARTS.min(MOST_ITEMS / task.files.len().max(1)).max(2);
            let of = most.min(wanted as usize);
            let cost_s = ((fixed_s + search_s / of as f64) * 1e3).round() / 1e3;
            (0..of).map(move |number| Task {
                format: PART_FORMAT,
                part: Some(Part { number, of }),
                cost_s,
                ..task.clone()
            })
        })
        .collect();
    parts.sort_by(|a, b| b.cost_s.total_cmp(&a.cost_s).then_with(|| a.site.cmp(&b.site)));
    for (index, part) in parts.iter_mut().enumerate() {
        part.index = index;
    }
    parts
}

/// Folders of the archive, by name; a recording beside them is a fault.
fn sites(wanted: &Wanted<'_>, faults: &mut Vec<String>) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for (name, path) in entries(wanted.archive, faults) {
        if path.is_dir() {
            found.insert(name);
        } else if is_input(wanted.input, &path) && wanted.sites.is_empty() {
            faults.push(format!(
                "{}: lies beside the sites' folders: move it into the folder of its site",
                path.display()
            ));
        }
    }
    found
}

/// Names of the configurations.
fn configs(wanted: &Wanted<'_>, faults: &mut Vec<String>) -> BTreeSet<String> {
    entries(wanted.configs, faults)
        .into_iter()
        .filter_map(|(name, path)| {
            let name = name.strip_suffix(".toml")?;
            path.is_file().then(|| name.to_owned())
        })
        .collect()
}

/// Entries of a folder that are not hidden.
fn entries(folder: &Path, faults: &mut Vec<String>) -> Vec<(String, PathBuf)> {
    let mut found = Vec::new();
    let listed = match fs::read_dir(folder) {
        Ok(listed) => listed,
        Err(error) => {
            faults.push(format!("{}: {error}", folder.display()));
            return found;
        }
    };
    for entry in listed {
        match entry.map(|entry| (entry.file_name().into_string(), entry.path())) {
            Ok((Ok(name), _)) if name.starts_with('.') => {}
            Ok((Ok(name), path)) => found.push((name, path)),
            Ok((Err(_), path)) => {
                faults.push(format!("{}: the name is not UTF-8: rename it", path.display()))
            }
            Err(error) => faults.push(format!("{}: {error}", folder.display())),
        }
    }
    found.sort();
    found
}

fn is_input(input: Input, path: &Path) -> bool {
    let ending = match input {
        Input::Recordings => "mcap",
        Input::Store => "db",
    };
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case(ending))
}

/// Files of a site's folder and of the folders in it, links not followed.
fn gather(folder: &Path, input: Input, files: &mut Vec<PathBuf>, faults: &mut Vec<String>) {
    for (_, path) in entries(folder, faults) {
        match fs::symlink_metadata(&path) {
            Ok(kind) if kind.is_dir() => gather(&path, input, files, faults),
            Ok(kind) if kind.is_file() && is_input(input, &path) => files.push(path),
            Ok(kind) if kind.is_symlink() && (is_input(input, &path) || path.is_dir()) => {
                faults.push(format!(
                    "{}: is a link, which is not followed: put what it leads to there",
                    path.display()
                ))
            }
            Ok(_) => {}
            Err(error) => faults.push(format!("{}: {error}", path.display())),
        }
    }
}

fn task(wanted: &Wanted<'_>, site: &str) -> Result<Task, Vec<String>> {
    let of_site = |fault: String| format!("site {site}: {fault}");
    let config = Config::load(&wanted.configs.join(format!("{site}.toml")))
        .map_err(|error| vec![of_site(error.to_string())])?;
    let (mut paths, mut faults) = (Vec::new(), Vec::new());
    let folder = wanted.archive.join(site);
    gather(&folder, wanted.input, &mut paths, &mut faults);
    let mut files = Vec::new();
    for path in paths {
        match item(wanted, &path) {
            Ok(item) => files.push(item),
            Err(fault) => faults.push(fault),
        }
    }
    match (wanted.input, files.len()) {
        (_, 0) if faults.is_empty() => faults.push(format!(
            "{}: no {} in it: put the site's there, or take folder and configuration away",
            folder.display(),
            match wanted.input {
                Input::Recordings => "recordings (*.mcap)",
                Input::Store => "store (*.db)",
            }
        )),
        (Input::Store, count) if count > 1 => faults.push(format!(
            "{}: {count} stores, and one is analysed again: leave the one that is meant",
            folder.display()
        )),
        _ => {}
    }
    if !faults.is_empty() {
        return Err(faults.into_iter().map(of_site).collect());
    }
    files.sort_by(|a, b| a.path.cmp(&b.path));
    let config_hash = hash_of(&config);
    let bytes: u64 = files.iter().map(|file| file.bytes).sum();
    let per_byte_s = match wanted.input {
        Input::Recordings => RECORDING_S,
        Input::Store => STORE_S,
    };
    let cost_s = START_S + ROD_S * config.rods.len() as f64 + per_byte_s * bytes as f64;
    Ok(Task {
        format: FORMAT,
        index: 0,
        site: site.to_owned(),
        input: wanted.input,
        archive: absolute(wanted.archive),
        configs: absolute(wanted.configs),
        result: result_name(site, wanted.input, &config_hash, &files),
        config_hash,
        analysis_version: VERSION,
        files,
        bytes,
        // Milliseconds are more than it can promise.
        cost_s: (cost_s * 1e3).round() / 1e3,
        part: None,
    })
}

fn item(wanted: &Wanted<'_>, path: &Path) -> Result<Item, String> {
    let thoroughness = match wanted.input {
        Input::Recordings => wanted.thoroughness,
        // A page in the middle of a database changes without a trace at its ends, and what is not in it yet has no identity.
        Input::Store => Thoroughness::Whole,
    };
    if wanted.input == Input::Store && identity::has_open_log(path) {
        return Err(format!(
            "{}: commits wait in its write-ahead log: take a copy by `tirante backup`",
            path.display()
        ));
    }
    let (bytes, identity) =
        identity::of(path, thoroughness).map_err(|error| format!("{}: {error}", path.display()))?;
    let below = path.strip_prefix(wanted.archive).unwrap_or(path);
    let times = match wanted.input {
        Input::Recordings => times_by_summary(path),
        Input::Store => None,
    };
    let time = |nanos: u64| i64::try_from(nanos).ok().map(Timestamp::from_nanos);
    Ok(Item {
        path: below
            .to_str()
            .ok_or_else(|| format!("{}: the name is not UTF-8: rename it", path.display()))?
            .to_owned(),
        bytes,
        identity,
        from: times.and_then(|(from, _)| time(from)),
        to: times.and_then(|(_, to)| time(to)),
    })
}

fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}
