//! Finds recordings that are new or changed, and lets those begin that grow.

use super::awaiting::News;
use super::lane::{Lane, Stamp, has_end, stamp};
use super::listing::{Entry, Listing, label, name_of};
use super::{Ended, Folder, RETRY};
use crate::recording::read::folder::{first_time, span_by_summary};
use crate::service::telemetry::{Beat, Fault};
use rustix::fs::{Mode, OFlags};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::fs::{File, Metadata};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

/// Shortest time between two scans.
const SCAN_EVERY: Duration = Duration::from_secs(1);
/// Scans take at most one part in this many of the time.
const SCAN_SHARE: u32 = 20;
/// Most links named at once.
const MOST_NAMED: usize = 20;
/// Most growing recordings read at once.
const MOST_GROWING: usize = 64;
/// Subject of the condition that there are more.
const GROWING: &str = "growing recordings";

/// True if another file system is mounted at a folder.
fn is_mount(folder: &Path) -> bool {
    let device = |path: &Path| path.metadata().ok().map(|data| data.dev());
    device(folder).is_some_and(|own| device(&folder.join("..")).is_some_and(|above| above != own))
}

impl Folder {
    /// Scans the folder if it is time to.
    pub(super) fn scan_if_due(&mut self, stop: &AtomicBool, beat: &Beat) {
        let began = Instant::now();
        if began < self.next_scan {
            return;
        }
        self.scan(stop, beat);
        self.end_late();
        self.next_scan = Instant::now() + SCAN_EVERY.max(SCAN_SHARE * began.elapsed());
    }

    /// Looks for files that are new or changed. Under a mount that is gone lies another folder, and what was in it may come back.
    fn scan(&mut self, stop: &AtomicBool, beat: &Beat) {
        let about = format!("mount {}", self.path.display());
        if !is_mount(&self.path) && self.was_mount {
            let detail = format!(
                "{}: nothing is mounted there any more, and nothing is read: mount it again, or restart the daemon if it is to be \
                 a folder of this disk",
                self.path.display()
            );
            return self.health.hold(Fault::Folder, &about, detail);
        }
        self.was_mount |= is_mount(&self.path);
        self.health.over(Fault::Folder, &about);
        let mut there = BTreeSet::new();
        self.crowded = 0;
        let mut links = BTreeSet::new();
        let mut unreadable = BTreeMap::new();
        for entry in Listing::of(Arc::clone(&self.path), self.has_subfolders) {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            beat.pass();
            match entry {
                Entry::Recording(name, data) => {
                    self.found(&name, stamp(&data), &data);
                    there.insert(name);
                }
                Entry::Link(name) => {
                    links.insert(name);
                }
                Entry::Unreadable(folder, fault) => {
                    unreadable.insert(folder, fault);
                }
            }
        }
        match self.crowded {
            0 => self.health.over(Fault::Folder, GROWING),
            more => {
                let detail = format!(
                    "{more} recordings more than {MOST_GROWING} grow at once: they are read when others have ended; put the topics of \
                     several sensors into one recording"
                );
                self.health.hold(Fault::Folder, GROWING, detail);
            }
        }
        let new: Vec<&OsString> = links.difference(&self.links).collect();
        let sentence = not_followed(&self.path, &new);
        // Each counts.
        for _ in &new {
            self.health.fault(Fault::Folder, &sentence);
        }
        self.links = links;
        for folder in &self.unreadable {
            if !unreadable.contains_key(folder) {
                self.health
                    .over(Fault::Folder, &self.path.join(folder).display().to_string());
            }
        }
        for (folder, fault) in &unreadable {
            let path = self.path.join(folder).display().to_string();
            let detail = format!("{path}: the watched folder cannot be read: {fault}");
            self.health.hold(Fault::Folder, &path, detail);
        }
        self.unreadable = unreadable.into_keys().collect();
        // What lies in a folder that cannot be read now is not gone.
        let unreadable = &self.unreadable;
        let is_there = |name: &OsString| {
            there.contains(name)
                || unreadable
                    .iter()
                    .any(|folder| Path::new(name).starts_with(folder))
        };
        let growing = self.growing.iter().filter_map(|lane| lane.begins).max();
        let of_now = (self.waits.readings, growing);
        let (due, news) = self.awaiting.due(&self.channels, is_there, of_now);
        for News { file, topics } in news {
            let (label, hours) = (label(&file), self.waits.readings.as_secs_f64() / 3600.0);
            tracing::info!(
                "{label} waits for readings of {}, {hours:.2} h at most",
                topics.join(", ")
            );
        }
        // A name that is gone may come back as another file.
        self.failed.retain(|name, _| is_there(name));
        self.postponed.retain(is_there);
        self.finishing.retain(is_there);
        self.done.retain(|name, _| is_there(name));
        let health = &self.health;
        self.set_aside.retain(|name| {
            let stays = is_there(name);
            if !stays {
                health.over(Fault::Quarantined, &label(name));
            }
            stays
        });
        let kept = self
            .joins
            .begun
            .forget_if(|label, _| !name_of(label).is_some_and(|name| is_there(&name)));
        for (name, file) in due {
            self.enqueue(name, file.begins, file.stamp);
        }
        self.tell(
            Ended {
                kept,
                ..Ended::default()
            },
            Vec::new(),
        );
    }

    /// Queues a finished file whose first message was logged at `begins` \[ns\].
    fn enqueue(&mut self, name: OsString, begins: u64, stamp: Stamp) {
        self.queue.insert((begins, name.clone()));
        self.queued.insert(name, stamp);
    }

    fn found(&mut self, name: &OsStr, stamp: Stamp, data: &Metadata) {
        if let Some(lane) = self.growing.iter_mut().find(|lane| lane.name == name) {
            let same = |open: Metadata| (open.dev(), open.ino()) == (data.dev(), data.ino());
            lane.is_replaced = !lane.file.metadata().is_ok_and(same);
            return;
        }
        let is_waiting = self.failed.get(name).is_some_and(|until| Instant::now() < *until);
        if self.done.get(name) == Some(&stamp) {
            self.awaiting.remove(name);
            self.finishing.remove(name);
            return;
        }
        if self.queued.contains_key(name)
            || self.awaiting.has(name, &stamp)
            || is_waiting
            || self.finished.as_ref().is_some_and(|group| group.has(name))
        {
            return;
        }
        let file = match self.open(name) {
            Ok(file) => file,
            Err(fault) => return self.cannot_open(name, &fault),
        };
        let age = data
            .modified()
            .ok()
            .and_then(|modified| SystemTime::now().duration_since(modified).ok());
        // One that was not written to for long does not grow any more. An empty one may be about to be written anew: some file systems keep
        // the time of change when a file is emptied.
        let has_rested = stamp.0 > 0 && age.is_some_and(|age| age >= self.waits.settle);
        if has_end(&file) || has_rested {
            let time = first_time(&file).unwrap_or(u64::MAX);
            if self.finishing.contains(name) || self.channels.iter().all(|rod| rod.temperature.is_none()) {
                return self.enqueue(name.to_owned(), time, stamp);
            }
            // At the start a file has waited since it was written.
            let waited = age.filter(|_| self.catches_up).unwrap_or_default();
            self.awaiting
                .add(name, (time, stamp), span_by_summary(&file), waited);
            return;
        }
        self.awaiting.remove(name);
        self.finishing.remove(name);
        if self.postponed.contains(name) {
            // Until it is finished.
        } else if self.growing.len() >= MOST_GROWING {
            self.crowded += 1;
        } else {
            match Lane::begin(&self.path, name, file, true, &self.channels, &self.settings) {
                Ok(mut lane) => {
                    self.joins.join(&mut lane);
                    self.growing.push_back(lane);
                }
                Err(error) => self.health.fault(Fault::Folder, error),
            }
        }
    }

    pub(super) fn cannot_open(&mut self, name: &OsStr, fault: &io::Error) {
        let path = self.path.join(name);
        let detail = format!(
            "{}: cannot be opened: {fault}; it is tried again every minute",
            path.display()
        );
        self.health.fault(Fault::Folder, detail);
        self.finishing.remove(name);
        self.failed.insert(name.to_owned(), Instant::now() + RETRY);
    }

    /// Opens a regular file: it may have changed since it was listed, and opening a pipe would block.
    pub(super) fn open(&self, name: &OsStr) -> io::Result<File> {
        let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = File::from(rustix::fs::open(self.path.join(name), flags, Mode::empty())?);
        if file.metadata()?.is_file() {
            Ok(file)
        } else {
            Err(io::Error::other("not a regular file"))
        }
    }
}

/// Sentence about links that are new; one line of the log names them all, because there is one a minute.
fn not_followed(folder: &Path, links: &[&OsString]) -> String {
    if let [link] = links {
        return format!("{}: a link, which is not followed", folder.join(link).display());
    }
    let named = links.iter().take(MOST_NAMED).map(|link| label(link));
    let mut names: Vec<String> = named.collect();
    if links.len() > MOST_NAMED {
        names.push(format!("{} more", links.len() - MOST_NAMED));
    }
    format!(
        "{}: links, which are not followed: {}",
        folder.display(),
        names.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_all_named_up_to_a_number() {
        let links: Vec<OsString> = (0..25).map(|number| format!("l{number}.mcap").into()).collect();
        let links: Vec<&OsString> = links.iter().collect();
        let folder = Path::new("/in");
        assert_eq!(
            not_followed(folder, &links[..1]),
            "/in/l0.mcap: a link, which is not followed"
        );
        assert_eq!(
            not_followed(folder, &links[..2]),
            "/in: links, which are not followed: l0.mcap, l1.mcap"
        );
        assert!(not_followed(folder, &links).ends_with("l19.mcap, 5 more"));
    }
}
