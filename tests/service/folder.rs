//! The watched folder and the reader: every case of a file in it, restarts at any point, reloads.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::common::{FS, START, motion, recording, spec};
use std::collections::{BTreeSet, HashSet};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::Write;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::{Event, Record};
use tirante::config::Config;
use tirante::config::settings::journal::JournalSettings;
use tirante::recording::read::Step;
use tirante::recording::read::folder::recordings;
use tirante::recording::read::recordings::Recordings;
use tirante::recording::write::{Encoding, Layout, RecordingWriter, WriterOptions};
use tirante::service::daemon::places::Place;
use tirante::service::daemon::reader::{JOURNAL, JournalSource, Reader, Remembered, Sources, Surroundings};
use tirante::service::daemon::steps::Aside;
use tirante::service::daemon::supervision::{Unwatched, Watch};
use tirante::service::daemon::trial::Input;
use tirante::service::journal::{Around, Batch, Bell, End, Entry, Journal};
use tirante::service::telemetry::{Fault, Health};
use tirante::site::driver::{Job, Loads};
use tirante::site::prepared::Generation;
use tirante::site::store::{Carry, FileState};

const LAYOUT: Layout = Layout::Batch(50);
const PATIENCE: Duration = Duration::from_secs(30);
/// Longer than the interval of scans.
const QUIET: Duration = Duration::from_millis(2500);

pub fn generation(window_s: f64) -> Arc<Generation> {
    let text = format!(
        r#"
[site]
name = "Folder"
seed = 1
[record]
cut = "window"
window_s = {window_s}
min_duration_s = {window_s}
[[rod]]
id = "laser"
length_m = 10
section = "round"
[rod.priors]
axial_force_n = {{ mean = 1e5, cv = 0.2 }}
youngs_modulus_pa = 2e11
density_kg_m3 = 7800
diameter_m = 0.05
spring_left_n_m = 0
spring_right_n_m = 0
[rod.channel]
topic = "/laser"
field = "values"
unit = "mm"
fs_hz = 200
"#
    );
    let config = Config::parse(&text, "test.toml").unwrap();
    Arc::new(Generation::prepare(config, |_| |_, _| ()).unwrap())
}

/// A recording of `seconds` that begins `after` seconds late.
pub fn measured(after: f64, seconds: f64) -> Vec<u8> {
    let mut writer =
        RecordingWriter::new(std::io::Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
    let id = writer
        .add_channel(spec("/laser", Encoding::Json, LAYOUT))
        .unwrap();
    let samples = motion((seconds * FS) as usize);
    writer
        .write_samples(id, START.plus_seconds(after), FS, &samples)
        .unwrap();
    writer.finish().unwrap().into_inner()
}

/// A reader with its output so far, as a store would keep it.
pub struct Run {
    pub reader: Reader,
    pub jobs: Receiver<Job>,
    pub health: Arc<Health>,
    caught_up: Arc<AtomicBool>,
    pub remembered: Remembered,
    pub records: Vec<(String, Record)>,
    reloads: usize,
    damaged: usize,
}

/// Notes the steps, and says what of `bad.mcap` must not be read.
struct Told {
    steps: Arc<Mutex<Vec<String>>>,
    bad: Aside,
}

impl Watch for Told {
    fn working_on(&mut self, step: &str) -> bool {
        self.steps.lock().unwrap().push(step.to_owned());
        true
    }

    fn aside(&mut self, name: &str, _: &Input) -> Aside {
        match name {
            "bad.mcap" => self.bad.clone(),
            _ => Aside::Nothing,
        }
    }
}

impl Run {
    fn folder(folder: &Path, settle_s: f64) -> Self {
        Self::with(folder, settle_s, Remembered::default(), Box::new(Unwatched))
    }

    fn with(folder: &Path, settle_s: f64, remembered: Remembered, watch: Box<dyn Watch>) -> Self {
        let sources = Sources {
            folder: Some(folder.to_owned()),
            subfolders: false,
            settle_s,
            join_s: 1.0,
            journal: None,
        };
        Self::of(sources, remembered, Arc::default(), watch)
    }

    pub fn of(sources: Sources, remembered: Remembered, bell: Arc<Bell>, watch: Box<dyn Watch>) -> Self {
        let (sender, jobs) = sync_channel(8);
        let health = Arc::<Health>::default();
        let caught_up = Arc::<AtomicBool>::default();
        let reader = Reader::start(
            sources,
            remembered.clone(),
            generation(10.0),
            Surroundings {
                jobs: sender,
                health: Arc::clone(&health),
                bell,
                caught_up: Arc::clone(&caught_up),
                loads: Loads::default(),
                beat: Arc::default(),
                watch,
            },
        )
        .unwrap();
        Self {
            reader,
            jobs,
            health,
            caught_up,
            remembered,
            records: Vec::new(),
            reloads: 0,
            damaged: 0,
        }
    }

    pub fn take(&mut self, job: Job) {
        match job {
            Job::Event {
                event: Event::Record(record),
                place,
                ..
            } => self.records.push((place.origin.to_string(), record)),
            Job::Files { marks, carry, .. } => {
                for mark in marks {
                    self.remembered.files.insert(mark.name.clone(), mark);
                }
                self.keep(carry);
            }
            Job::Event {
                event: Event::Rejected { rejection, .. },
                ..
            } if rejection.code() == "damaged" => self.damaged += 1,
            Job::Reload(_) => self.reloads += 1,
            _ => {}
        }
    }

    fn keep(&mut self, carries: Vec<Carry>) {
        for carry in carries {
            if carry.journal == JOURNAL {
                self.remembered.carry = Some(carry);
                continue;
            }
            self.remembered.open.retain(|kept| kept.journal != carry.journal);
            if !carry.body.is_empty() {
                self.remembered.open.push(carry);
            }
        }
    }

    /// Takes jobs until a condition holds.
    pub fn until(&mut self, what: &str, is_wanted: impl Fn(&Self) -> bool) {
        let end = Instant::now() + PATIENCE;
        while !is_wanted(self) {
            match self.jobs.recv_timeout(Duration::from_millis(20)) {
                Ok(job) => self.take(job),
                Err(RecvTimeoutError::Timeout) => assert!(Instant::now() < end, "waited for {what} in vain"),
                Err(RecvTimeoutError::Disconnected) => panic!("the reader ended; waited for {what}"),
            }
        }
    }

    /// Takes jobs until none comes for a while.
    pub fn until_quiet(&mut self) {
        while let Ok(job) = self.jobs.recv_timeout(QUIET) {
            self.take(job);
        }
    }

    pub fn done(&self, name: &str) -> bool {
        self.remembered.files.contains_key(name)
    }

    pub fn starts(&self, file: &str) -> Vec<f64> {
        let of_file = self.records.iter().filter(|(name, _)| name == file);
        of_file
            .map(|(_, record)| record.start.seconds_since(START))
            .collect()
    }
}

#[test]
fn only_regular_recordings_under_the_folder_are_read_whatever_their_name() {
    let outside = tempfile::tempdir().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(outside.path().join("out.mcap"), measured(900.0, 20.0)).unwrap();
    symlink(outside.path().join("out.mcap"), at("link.mcap")).unwrap();
    symlink(outside.path(), at("folder-link.mcap")).unwrap();
    fs::create_dir(at("folder.mcap")).unwrap();
    fs::write(at("folder.mcap/below.mcap"), measured(800.0, 20.0)).unwrap();
    rustix::fs::mknodat(
        rustix::fs::CWD,
        at("pipe.mcap"),
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
        0,
    )
    .unwrap();
    for ignored in [".hidden.mcap", "a.mcap.part", "a.mcap.tmp", "a.txt"] {
        fs::write(at(ignored), measured(700.0, 20.0)).unwrap();
    }
    let odd = folder.path().join(OsStr::from_bytes(b"odd \xff\n\\name.mcap"));
    fs::write(&odd, measured(100.0, 20.0)).unwrap();
    fs::write(at("z-first.MCAP"), measured(0.0, 20.0)).unwrap();
    fs::write(at("garbage.mcap"), b"no recording at all").unwrap();
    fs::write(at("empty.mcap"), b"").unwrap();

    let mut run = Run::folder(folder.path(), 0.1);
    let odd_label = "odd \\xff\n\\\\name.mcap";
    run.until("all four files", |run| run.remembered.files.len() == 4);
    run.until_quiet();
    // In the order of their data.
    let starts: Vec<f64> = run
        .records
        .iter()
        .map(|(_, record)| record.start.seconds_since(START))
        .collect();
    assert_eq!(starts, [0.0, 10.0, 100.0, 110.0]);
    assert_eq!(run.starts(odd_label), [100.0, 110.0]);
    let mut names: Vec<&str> = run.remembered.files.keys().map(String::as_str).collect();
    names.sort_unstable();
    assert_eq!(names, ["empty.mcap", "garbage.mcap", odd_label, "z-first.MCAP"]);

    // A restart reads nothing again, a changed file once.
    let remembered = run.remembered.clone();
    run.reader.stop();
    let mut run = Run::with(folder.path(), 0.1, remembered, Box::new(Unwatched));
    run.until_quiet();
    assert_eq!(run.records.len(), 0);
    fs::write(&odd, measured(200.0, 20.0)).unwrap();
    run.until("the changed file", |run| run.records.len() == 2);
    run.until_quiet();
    assert_eq!(run.starts(odd_label), [200.0, 210.0]);
}

#[test]
fn folders_below_are_read_on_request_and_links_are_named() {
    let outside = tempfile::tempdir().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("2026/11")).unwrap();
    fs::create_dir_all(at("journal")).unwrap();
    fs::create_dir_all(at(".hidden")).unwrap();
    fs::write(at("2026/11/b.mcap"), measured(200.0, 20.0)).unwrap();
    fs::write(at("2026/a.mcap"), measured(100.0, 20.0)).unwrap();
    fs::write(at("top.mcap"), measured(0.0, 20.0)).unwrap();
    // No part of the daemon's own journal, though it is called so.
    fs::write(at("journal/journal.000001.mcap"), measured(300.0, 20.0)).unwrap();
    fs::write(at(".hidden/h.mcap"), measured(400.0, 20.0)).unwrap();
    fs::write(outside.path().join("out.mcap"), measured(500.0, 20.0)).unwrap();
    symlink(outside.path(), at("2026/elsewhere")).unwrap();
    symlink(outside.path().join("out.mcap"), at("2026/link.mcap")).unwrap();
    let watched = || Sources {
        folder: Some(folder.path().to_owned()),
        subfolders: true,
        settle_s: 0.1,
        join_s: 1.0,
        journal: None,
    };
    let mut run = Run::of(
        watched(),
        Remembered::default(),
        Arc::default(),
        Box::new(Unwatched),
    );
    run.until("all four files", |run| run.remembered.files.len() == 4);
    run.until_quiet();
    let names: Vec<&str> = run.remembered.files.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "./2026/11/b.mcap",
            "./2026/a.mcap",
            "./journal/journal.000001.mcap",
            "top.mcap"
        ]
    );
    let starts: Vec<f64> = run
        .records
        .iter()
        .map(|(_, record)| record.start.seconds_since(START))
        .collect();
    assert_eq!(starts, [0.0, 10.0, 100.0, 110.0, 200.0, 210.0, 300.0, 310.0]);
    // Each of the two links once, however often the folder is looked at.
    assert_eq!(run.health.count(Fault::Folder), 2);

    // A restart reads nothing again; a file that comes into a new folder is read.
    let remembered = run.remembered.clone();
    run.reader.stop();
    let mut run = Run::of(watched(), remembered, Arc::default(), Box::new(Unwatched));
    run.until_quiet();
    assert_eq!(run.records.len(), 0);
    fs::create_dir(at("2026/12")).unwrap();
    fs::write(at("2026/12/c.mcap"), measured(600.0, 20.0)).unwrap();
    run.until("the new file", |run| run.done("./2026/12/c.mcap"));
    run.until_quiet();
    assert_eq!(run.starts("./2026/12/c.mcap"), [600.0, 610.0]);
}

#[test]
fn a_growing_file_is_followed_ended_when_it_settles_and_read_again_when_it_grows() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grows.mcap");
    let options = WriterOptions {
        chunk_bytes: Some(20_000),
        ..WriterOptions::default()
    };
    let bytes = recording(Encoding::Json, LAYOUT, options, 12_000);
    let (first, second) = (bytes.len() * 6 / 10, bytes.len() * 8 / 10);
    let mut run = Run::folder(folder.path(), 5.0);
    fs::write(&path, &bytes[..first]).unwrap();
    run.until("the first record", |run| !run.records.is_empty());
    assert!(!run.done("grows.mcap"), "it may still grow");
    run.until("its settling", |run| run.done("grows.mcap"));
    assert!(run.records.iter().all(|(_, record)| record.duration_s() >= 9.9));
    let before = run.records.len();
    let mut file = File::options().append(true).open(&path).unwrap();
    file.write_all(&bytes[first..second]).unwrap();
    let size = second as u64;
    run.until("a second reading", |run| {
        run.remembered.files["grows.mcap"].size == size
    });
    let identities: BTreeSet<[u8; 32]> = run.records.iter().map(|(_, record)| record.identity()).collect();
    assert!(identities.len() > before, "there are new ones");
    assert_eq!(
        run.records.len(),
        before + identities.len(),
        "known ones come again, as the same"
    );
    assert_eq!(run.damaged, 0);
}

#[test]
fn a_writer_that_goes_back_and_fills_in_lengths_is_no_damage() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("grows.mcap");
    let mut run = Run::folder(folder.path(), 600.0);
    let mut writer = RecordingWriter::new(File::create(&path).unwrap(), WriterOptions::default()).unwrap();
    let id = writer
        .add_channel(spec("/laser", Encoding::Json, LAYOUT))
        .unwrap();
    for (at, samples) in motion(10_000).chunks(500).enumerate() {
        let start = START.plus_seconds(at as f64 * 500.0 / FS);
        writer.write_samples(id, start, FS, samples).unwrap();
        std::thread::sleep(Duration::from_millis(100));
    }
    writer.finish().unwrap();
    run.until("its end", |run| run.done("grows.mcap"));
    run.until_quiet();
    let identities: BTreeSet<[u8; 32]> = run.records.iter().map(|(_, record)| record.identity()).collect();
    assert_eq!((identities.len(), run.damaged), (5, 0));
}

#[test]
fn a_file_that_is_replaced_while_it_is_read_is_read_and_so_is_the_new_one() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(&path, measured(0.0, 1200.0)).unwrap();
    let mut run = Run::folder(folder.path(), 600.0);
    // The queue is full now, and the reader in the middle.
    run.until("its first records", |run| run.records.len() > 2);
    let next = folder.path().join("next.tmp");
    fs::write(&next, measured(5000.0, 20.0)).unwrap();
    fs::rename(&next, &path).unwrap();
    run.until("both", |run| run.records.len() == 122);
    run.until_quiet();
    assert_eq!(run.records.len(), 122);
    assert_eq!(run.starts("a.mcap")[120..], [5000.0, 5010.0]);

    // Cut off in the middle while it is read: the data before the cut are used.
    fs::write(&path, measured(10_000.0, 1200.0)).unwrap();
    run.until("its first records", |run| run.records.len() > 124);
    File::options()
        .write(true)
        .open(&path)
        .unwrap()
        .set_len(2000)
        .unwrap();
    run.until_quiet();
    assert!(run.records.len() >= 125);
    // The file that then takes its name is read as well, long before the settling time is over.
    fs::write(&next, measured(50_000.0, 20.0)).unwrap();
    fs::rename(&next, &path).unwrap();
    run.until("the file after it", |run| {
        run.starts("a.mcap").ends_with(&[50_000.0, 50_010.0])
    });
}

#[test]
fn a_folder_that_vanishes_is_a_condition_until_it_is_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("watched");
    let mut run = Run::folder(&path, 600.0);
    run.until("the fault", |run| {
        run.health
            .conditions()
            .iter()
            .any(|held| held.fault == Fault::Folder)
    });
    fs::create_dir(&path).unwrap();
    fs::write(path.join("a.mcap"), measured(0.0, 20.0)).unwrap();
    run.until("the file", |run| run.done("a.mcap"));
    assert!(run.health.conditions().is_empty());
    assert_eq!(run.health.count(Fault::Folder), 1);
}

#[test]
fn a_file_without_permission_is_named_and_does_not_stop_the_others() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let locked = folder.path().join("locked.mcap");
    fs::write(&locked, measured(0.0, 20.0)).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o0)).unwrap();
    if File::open(&locked).is_ok() {
        return eprintln!("skipped: this user may read everything");
    }
    fs::write(folder.path().join("open.mcap"), measured(100.0, 20.0)).unwrap();
    let mut run = Run::folder(folder.path(), 600.0);
    run.until("the other", |run| run.done("open.mcap"));
    run.until_quiet();
    assert_eq!((run.records.len(), run.health.count(Fault::Folder)), (2, 1));
}

#[test]
fn no_two_steps_of_a_file_have_one_name_and_they_are_the_same_the_next_time() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.mcap"), measured(0.0, 120.0)).unwrap();
    let steps = || {
        let steps = Arc::<Mutex<Vec<String>>>::default();
        let noted = Arc::clone(&steps);
        let watch = Box::new(Told {
            steps: noted,
            bad: Aside::Nothing,
        });
        let mut run = Run::with(folder.path(), 600.0, Remembered::default(), watch);
        run.until("it", |run| run.done("a.mcap"));
        drop(run);
        let mut steps = steps.lock().unwrap().clone();
        // The last look, which finds the end, may come again.
        steps.pop();
        steps
    };
    let first = steps();
    let names: HashSet<_> = first.iter().collect();
    assert!(first.len() > 10 && names.len() == first.len(), "{first:?}");
    assert_eq!(first, steps());
}

#[test]
fn what_ends_the_program_is_set_aside_and_the_rest_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("bad.mcap"), measured(0.0, 20.0)).unwrap();
    fs::write(folder.path().join("good.mcap"), measured(100.0, 20.0)).unwrap();
    let watch = Box::new(Told {
        steps: Arc::default(),
        bad: Aside::From {
            place: Place { offset: 0, taken: 0 },
            why: "ended the program 4 times".to_owned(),
        },
    });
    let mut run = Run::with(folder.path(), 600.0, Remembered::default(), watch);
    run.until("both", |run| run.done("bad.mcap") && run.done("good.mcap"));
    run.until_quiet();
    assert!(
        matches!(&run.remembered.files["bad.mcap"].state, FileState::Quarantined(why) if why.contains("4 times"))
    );
    assert_eq!(run.remembered.files["good.mcap"].state, FileState::Done);
    assert_eq!((run.records.len(), run.health.count(Fault::Quarantined)), (2, 1));
}

#[test]
fn what_a_file_lost_is_kept_with_its_mark() {
    let folder = tempfile::tempdir().unwrap();
    let whole = measured(0.0, 20.0);
    fs::write(folder.path().join("whole.mcap"), &whole).unwrap();
    fs::write(folder.path().join("cut.mcap"), &whole[..whole.len() / 2]).unwrap();
    let mut run = Run::folder(folder.path(), 1.0);
    run.until("both", |run| run.done("whole.mcap") && run.done("cut.mcap"));
    assert_eq!(run.remembered.files["whole.mcap"].state, FileState::Done);
    assert!(
        matches!(&run.remembered.files["cut.mcap"].state, FileState::Incomplete(why) if why.contains("ends in the middle"))
    );
}

#[test]
fn growing_files_without_a_place_are_a_condition_until_they_have_one() {
    let folder = tempfile::tempdir().unwrap();
    let growing = measured(0.0, 1.0);
    let path = |number: usize| folder.path().join(format!("{number}.mcap"));
    for number in 0..66 {
        fs::write(path(number), &growing[..growing.len() - 8]).unwrap();
    }
    let mut run = Run::folder(folder.path(), 600.0);
    run.until("it is told", |run| {
        let conditions = run.health.conditions();
        conditions
            .iter()
            .any(|one| one.detail.contains("2 recordings more than 64"))
    });
    (0..2).for_each(|number| fs::write(path(number), &growing).unwrap());
    run.until("all have a place", |run| run.health.conditions().is_empty());
}

#[test]
fn a_file_whose_beginning_is_deadly_too_is_set_aside_as_a_whole() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("bad.mcap"), measured(0.0, 20.0)).unwrap();
    fs::write(folder.path().join("good.mcap"), measured(100.0, 20.0)).unwrap();
    let steps = Arc::<Mutex<Vec<String>>>::default();
    let watch = Box::new(Told {
        steps: Arc::clone(&steps),
        bad: Aside::Whole("bad.mcap: the whole file is set aside".to_owned()),
    });
    let mut run = Run::with(folder.path(), 600.0, Remembered::default(), watch);
    run.until("both", |run| run.done("bad.mcap") && run.done("good.mcap"));
    let is_bad = |step: &String| step.starts_with("bad.mcap");
    assert!(!steps.lock().unwrap().iter().any(is_bad));
    assert!(
        matches!(&run.remembered.files["bad.mcap"].state, FileState::Quarantined(why) if why.contains("whole file"))
    );
    assert!(run.records.iter().all(|(file, _)| file == "good.mcap") && !run.records.is_empty());
    let conditions = run.health.conditions();
    assert!(
        conditions.iter().any(|one| one.fault == Fault::Quarantined),
        "{conditions:?}"
    );
    // Gone, it is no condition any more.
    fs::remove_file(folder.path().join("bad.mcap")).unwrap();
    run.until("the condition is over", |run| run.health.conditions().is_empty());
}

#[test]
fn stops_at_once_with_a_full_queue_and_finishes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.mcap"), measured(0.0, 1200.0)).unwrap();
    let mut run = Run::folder(folder.path(), 600.0);
    run.until("a record", |run| !run.records.is_empty());
    // Nothing is taken now.
    std::thread::sleep(Duration::from_millis(200));
    let began = Instant::now();
    run.reader.stop();
    assert!(
        began.elapsed() < Duration::from_millis(1000),
        "{:?}",
        began.elapsed()
    );
    let rest = run
        .jobs
        .iter()
        .filter(|job| matches!(job, Job::Files { .. }))
        .count();
    assert_eq!(rest, 0);
}

/// A journal of several parts, and a way to read it.
struct Live {
    folder: PathBuf,
    journal: Journal,
}

fn sources(live: &Live, folder: Option<&Path>) -> Sources {
    Sources {
        folder: folder.map(Path::to_owned),
        subfolders: false,
        settle_s: 600.0,
        join_s: 1.0,
        journal: Some(JournalSource {
            folder: live.folder.clone(),
            handle: live.journal.handle(),
            results_kept: live.journal.results_kept(),
            signals: Arc::default(),
        }),
    }
}

fn journal(folder: &Path) -> Live {
    let failed = |error| panic!("the journal failed: {error}");
    let settings = JournalSettings::default();
    // Nothing is old or large enough here to be asked for.
    let around = Around {
        beat: Arc::default(),
        copied: None,
        health: Arc::default(),
        halted: Arc::default(),
        vouch: Box::new(|_| Vec::new()),
    };
    Live {
        folder: folder.to_owned(),
        journal: Journal::start(folder, &settings, 3600.0, around, failed).unwrap(),
    }
}

/// Sends a recording, in parts of the journal if wanted; leaves the stream open without `end`.
fn send(live: &Live, bytes: &[u8], rotate_every: usize, end: bool) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .unwrap();
    runtime.block_on(async {
        let mut line = live.journal.handle().connect(Some("laser")).await.unwrap();
        let mut through = 0;
        for message in mcap::MessageStream::new(bytes).unwrap() {
            let message = message.unwrap();
            let schema = message.channel.schema.as_ref();
            through += 1;
            let channel = Entry::Channel {
                id: message.channel.id,
                topic: message.channel.topic.clone(),
                encoding: message.channel.message_encoding.clone(),
                schema: schema.map(|s| Arc::new((s.name.clone(), s.encoding.clone(), s.data.to_vec()))),
            };
            let content = Entry::Message {
                channel: message.channel.id,
                log_time: message.log_time,
                publish_time: message.publish_time,
                data: message.data.to_vec(),
            };
            let entries = if through == 1 {
                vec![channel, content]
            } else {
                vec![content]
            };
            line.append(Batch { entries, through }).await.unwrap();
            if (through as usize).is_multiple_of(rotate_every) {
                live.journal.handle().rotate();
            }
        }
        if end {
            line.end(End::Complete).await.unwrap();
        } else {
            line.durable().wait_for(|count| *count == through).await.unwrap();
        }
    });
}

#[test]
fn journal_and_folder_are_read_side_by_side_by_daemon_and_replay() {
    let (folder, journals) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let live = journal(journals.path());
    // Streams of 20 s with a recording between them in time, and one behind them: windows of 10 s.
    send(&live, &measured(0.0, 20.0), 25, true);
    send(&live, &measured(1000.0, 20.0), 25, true);
    fs::write(folder.path().join("between.mcap"), measured(500.0, 20.0)).unwrap();
    fs::write(folder.path().join("behind.mcap"), measured(1500.0, 20.0)).unwrap();
    // The last record of a file stays open until the next of its series: it may continue there.
    let expected = [0.0, 10.0, 500.0, 1000.0, 1010.0, 510.0, 1500.0, 1510.0];
    let seconds = |record: &Record| record.start.seconds_since(START).round();

    let mut run = Run::of(
        sources(&live, Some(folder.path())),
        Remembered::default(),
        live.journal.bell(),
        Box::new(Unwatched),
    );
    run.until("all records", |run| run.records.len() == expected.len());
    let starts: Vec<f64> = run.records.iter().map(|(_, record)| seconds(record)).collect();
    assert_eq!(starts, expected);
    run.reader.stop();
    live.journal.stop();

    let files = recordings(&[folder.path().to_owned(), journals.path().to_owned()]);
    let generation = generation(10.0);
    let channels = generation.config.rods.iter().map(|rod| rod.channels.clone());
    let read = Recordings::new(
        files,
        channels.collect(),
        generation.config.record,
        false,
        Arc::default(),
    );
    let records = read.filter_map(|step| match step {
        Step::Event(Event::Record(record), _) => Some(seconds(&record)),
        _ => None,
    });
    let records: Vec<f64> = records.collect();
    assert_eq!(records, expected);
}

#[test]
fn a_restart_at_any_job_gives_the_same_records() {
    let folder = tempfile::tempdir().unwrap();
    let live = journal(folder.path());
    // Windows of 10 s, parts of 6.25 s: every part but the first begins in the middle of a record.
    send(&live, &measured(0.0, 65.0), 25, true);
    let run = Run::of(
        sources(&live, None),
        Remembered::default(),
        live.journal.bell(),
        Box::new(Unwatched),
    );
    let mut jobs = Vec::new();
    while let Ok(job) = run.jobs.recv_timeout(QUIET) {
        jobs.push(job);
    }
    run.reader.stop();
    let identities = |records: &[(String, Record)]| -> Vec<[u8; 32]> {
        records.iter().map(|(_, record)| record.identity()).collect()
    };
    let count = jobs.len();
    let mut whole = Run::of(
        sources(&live, None),
        Remembered::default(),
        live.journal.bell(),
        Box::new(Unwatched),
    );
    whole.until_quiet();
    assert_eq!(whole.records.len(), 6);
    assert!(
        whole.remembered.files.len() >= 10,
        "{:?}",
        whole.remembered.files.keys()
    );
    let expected = identities(&whole.records);
    whole.reader.stop();
    let mut resumed = 0;
    for killed_after in 0..=count {
        let mut first = Run::of(
            sources(&live, None),
            Remembered::default(),
            live.journal.bell(),
            Box::new(Unwatched),
        );
        for _ in 0..killed_after {
            let Ok(job) = first.jobs.recv_timeout(PATIENCE) else {
                // Fewer jobs came than before; all is read all the same.
                assert_eq!(first.remembered.files.len(), whole.remembered.files.len());
                break;
            };
            first.take(job);
        }
        let (mut found, remembered) = (identities(&first.records), first.remembered.clone());
        first.reader.stop();
        let parts = remembered.files.len();
        let mut second = Run::of(
            sources(&live, None),
            remembered,
            live.journal.bell(),
            Box::new(Unwatched),
        );
        let missing = count - killed_after;
        second.until("the rest", |second| {
            second.remembered.files.len() >= whole.remembered.files.len()
        });
        resumed += usize::from(parts > 0 && missing > 0);
        for identity in identities(&second.records) {
            if !found.contains(&identity) {
                found.push(identity);
            }
        }
        // The last part has no end yet: its records come whenever they come.
        second.until("the last record", |second| {
            let mut all = found.clone();
            all.extend(identities(&second.records));
            expected.iter().all(|identity| all.contains(identity))
        });
        for identity in identities(&second.records) {
            if !found.contains(&identity) {
                found.push(identity);
            }
        }
        assert_eq!(found, expected, "killed after job {killed_after}");
        assert_eq!(second.health.count(Fault::Recording), 0);
        second.reader.stop();
    }
    assert!(resumed > 5);
    live.journal.stop();
}

#[test]
fn live_data_come_within_a_second_beside_a_large_file() {
    let folder = tempfile::tempdir().unwrap();
    let watched = folder.path().join("watched");
    fs::create_dir(&watched).unwrap();
    let live = journal(&folder.path().join("journal"));
    let mut run = Run::of(
        sources(&live, Some(&watched)),
        Remembered::default(),
        live.journal.bell(),
        Box::new(Unwatched),
    );
    run.until_quiet();
    assert!(run.caught_up.load(Ordering::Relaxed));
    // It appears when the reader is live already.
    let large = recording(Encoding::Json, LAYOUT, WriterOptions::default(), 1_000_000);
    fs::write(watched.join("large.tmp"), large).unwrap();
    fs::rename(watched.join("large.tmp"), watched.join("large.mcap")).unwrap();
    run.until("the large file", |run| !run.starts("large.mcap").is_empty());
    assert!(!run.caught_up.load(Ordering::Relaxed));
    send(&live, &measured(100_000.0, 29.0), 100_000, false);
    run.until("the live records", |run| {
        run.records
            .iter()
            .filter(|(name, _)| name.starts_with("journal/"))
            .count()
            == 2
    });
    assert!(!run.done("large.mcap"), "the large file is not through yet");
    run.reader.stop();
    live.journal.stop();
}

#[test]
fn a_reload_cuts_anew_at_a_part_and_nothing_is_cut_without_need() {
    let folder = tempfile::tempdir().unwrap();
    let live = journal(folder.path());
    let mut run = Run::of(
        sources(&live, None),
        Remembered::default(),
        live.journal.bell(),
        Box::new(Unwatched),
    );
    send(&live, &measured(0.0, 39.0), 100_000, false);
    run.until("three records", |run| run.records.len() == 3);
    run.reader.reload(generation(10.0));
    run.until("an equal configuration", |run| run.reloads == 1);
    assert_eq!(run.records.len(), 3);
    assert!(run.remembered.files.is_empty(), "nothing was cut");
    // Other windows: from the next part on.
    run.reader.reload(generation(5.0));
    run.until("another one", |run| run.reloads == 2);
    assert_eq!(run.remembered.files.len(), 1);
    send(&live, &measured(1000.0, 21.0), 100_000, true);
    run.until("shorter records", |run| run.records.len() >= 7);
    assert!(
        run.records[3..]
            .iter()
            .all(|(_, record)| (record.duration_s() - 5.0).abs() < 0.1)
    );
    run.reader.stop();
    live.journal.stop();
}

/// A folder with very many files costs little.
#[test]
#[ignore = "a campaign: cargo test --release --test service folder:: -- --ignored --nocapture"]
fn a_hundred_thousand_files() {
    let folder = tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap();
    let small = measured(0.0, 0.5);
    for number in 0..100_000 {
        fs::write(folder.path().join(format!("{number}.mcap")), &small).unwrap();
    }
    let began = Instant::now();
    let mut run = Run::folder(folder.path(), 600.0);
    while run.remembered.files.len() < 100_000 {
        let job = run.jobs.recv_timeout(Duration::from_secs(120)).unwrap();
        run.take(job);
    }
    println!("100 000 files read in {:?}", began.elapsed());
    let before = cpu_s();
    std::thread::sleep(Duration::from_secs(30));
    let share = (cpu_s() - before) / 30.0;
    println!("watching them takes {:.1} % of a core", share * 100.0);
    assert!(share < 0.08);
    fs::write(folder.path().join("new.mcap"), measured(50.0, 20.0)).unwrap();
    run.until("a new one among them", |run| run.records.len() == 2);
}

/// Processor time of this process \[s\].
fn cpu_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    let ticks: f64 = fields[11].parse::<f64>().unwrap() + fields[12].parse::<f64>().unwrap();
    ticks / 100.0
}
