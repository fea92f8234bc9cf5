//! Quarantine for inputs that crash the process: each step is recorded before it runs and cleared after.
//!
//! Before a risky step its name is written into a slot of `STORE.working`, and erased after it. The file survives any end
//! of the process. A step found in it at the next start is suspect: it is tried again while nothing else runs, so that no
//! other step is blamed. If the process ends at it once more, the step is tried in a process of its own
//! ([`super::trial`]) before it is taken again, and set aside if that dies: an end from outside blames no step. A step at
//! which the daemon ends [`LAST`] times alone, though it was cleared each time, is set aside as well, so that nothing keeps
//! the daemon down for good; ends across a boot of the machine are not counted beyond the first.

use super::places::Place;
use crate::recording::atomic::AtomicFile;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Number of crashes of a step alone after which it is not taken again, whatever a process of its own showed. With the
/// first crash, which blames no step, these are five: systemd must not give up before (docs/daemon.md).
pub const LAST: u32 = 4;

/// Number of crashes of a file after which nothing of it is used: those alone at one place, and one more
/// while its data before that place was completed.
pub const FILE_LAST: u32 = LAST + 1;

/// Number of crashes that stands for a trial in which the step was condemned.
pub const CONDEMNED: u32 = 1000;

/// Name of a file's step that completes the data before a quarantined place.
const END: &str = "end";

/// Size of a slot \[bytes\].
const SLOT: usize = 1024;
/// Most slots: more than any machine has workers. The first names the boot of the machine.
const MOST_SLOTS: usize = 1100;
/// Kind of the first slot.
const BOOT: &str = "boot";
/// Most suspects remembered, besides the quarantined ones.
const MOST: usize = 256;
/// Longest wait of a suspect for the other steps to end.
const PATIENCE: Duration = Duration::from_secs(10);
/// Pause before a step is tried again after a crash alone, times its crashes.
const PAUSE: Duration = Duration::from_millis(if cfg!(test) { 10 } else { 1000 });

/// Quarantine of one store: steps that crashed the program, with the number of crashes.
#[derive(Debug)]
pub struct Quarantine {
    working: File,
    /// Locked before the deaths: what is written last is the latest.
    memory: Mutex<PathBuf>,
    inner: Mutex<Inner>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct Inner {
    /// Number of crashes alone of every suspect.
    deaths: BTreeMap<String, u32>,
    slots: usize,
    busy: usize,
    is_alone: bool,
    is_over: bool,
}

/// Slot in which one thread marks its step.
#[derive(Debug)]
pub struct Slot {
    quarantine: Arc<Quarantine>,
    number: usize,
    step: Option<Step>,
}

#[derive(Debug)]
struct Step {
    name: String,
    is_alone: bool,
}

impl Quarantine {
    /// Reads the steps at which the last process of this store ended, and starts with empty slots.
    ///
    /// # Errors
    /// The files beside the store cannot be read or written.
    pub fn open(store: &Path) -> io::Result<Self> {
        let memory = beside(store, ".suspects");
        let mut deaths = match fs::read(&memory) {
            Ok(bytes) => serde_json::from_slice(&bytes).unwrap_or_else(|error| {
                tracing::warn!("{}: not understood ({error}), begun anew", memory.display());
                BTreeMap::new()
            }),
            Err(error) if error.kind() == io::ErrorKind::NotFound => BTreeMap::new(),
            Err(error) => return Err(error),
        };
        let path = beside(store, ".working");
        let left = match fs::read(&path) {
            Ok(bytes) => Left::of(&bytes),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Left::default(),
            Err(error) => return Err(error),
        };
        let boot = boot();
        let same_boot = left.boot.is_none() || boot.is_none() || left.boot == boot;
        let had_any = !left.steps.is_empty();
        let mut blame = |name: String, is_counted: bool| {
            let deaths = deaths.entry(name).or_insert(0);
            // Whatever ended the machine ended the daemon; the step is tried apart, and no more.
            let most = if same_boot { u32::MAX } else { 1.max(*deaths) };
            *deaths = (*deaths + u32::from(is_counted)).min(most);
        };
        for (name, is_alone) in left.steps {
            if let Some((file, step)) = file_of(&name) {
                blame(file_step(file), is_alone || step == END);
            }
            blame(name, is_alone);
        }
        if deaths.len() > MOST {
            deaths.retain(|_, deaths| *deaths > 0);
        }
        if had_any && let Err(error) = remember(&memory, &deaths) {
            tracing::warn!("{}: cannot be written: {error}", memory.display());
        }
        let working = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(true)
            .open(path)?;
        if let Some(boot) = boot {
            let _ = working.write_all_at(&slot_of(BOOT, &boot), 0);
        }
        Ok(Self {
            working,
            memory: Mutex::new(memory),
            inner: Mutex::new(Inner {
                deaths,
                slots: 1,
                ..Inner::default()
            }),
            changed: Condvar::new(),
        })
    }

    /// Number of crashes of this step with no other step at work.
    pub fn deaths(&self, step: &str) -> u32 {
        self.lock().deaths.get(step).copied().unwrap_or(0)
    }

    /// Places of a file at which the program crashed with no other step at work, with the number of crashes.
    pub fn places(&self, file: &str) -> Vec<(Place, u32)> {
        let inner = self.lock();
        let begin = format!("{file}@");
        let steps = inner.deaths.range(begin.clone()..);
        steps
            .take_while(|(name, _)| name.starts_with(&begin))
            .filter(|(_, deaths)| **deaths > 0)
            .filter_map(|(name, deaths)| Some((Place::parse(&name[begin.len()..])?, *deaths)))
            .collect()
    }

    /// Keeps that a step is never taken again.
    pub fn condemn(&self, step: &str) {
        self.lock().deaths.insert(step.to_owned(), CONDEMNED);
        self.keep();
    }

    /// Clears a file that was read to its end.
    pub fn is_read(&self, file: &str) {
        self.forget(&file_step(file));
    }

    fn forget(&self, step: &str) {
        if self.lock().deaths.remove(step).is_some() {
            self.keep();
        }
    }

    /// Writes the list of suspects, best effort.
    fn keep(&self) {
        let memory = self.memory.lock().unwrap_or_else(PoisonError::into_inner);
        let deaths = self.lock().deaths.clone();
        if let Err(error) = remember(&memory, &deaths) {
            tracing::warn!("{}: cannot be written: {error}", memory.display());
        }
    }

    /// A slot for one thread.
    pub fn slot(self: &Arc<Self>) -> Slot {
        let mut inner = self.lock();
        let number = inner.slots;
        inner.slots += 1;
        Slot {
            quarantine: Arc::clone(self),
            number,
            step: None,
        }
    }

    /// Prepares an orderly end of the process: steps still at work are not suspect, and none waits any more.
    pub fn stand_down(&self) {
        self.lock().is_over = true;
        self.changed.notify_all();
        // Nothing can be done about a failure: at worst a step is tried alone.
        let _ = self.working.set_len(0);
    }

    /// Waits until a step may begin; returns true if it is alone.
    fn begin(&self, step: &str) -> bool {
        let deaths = self.lock().deaths.get(step).copied();
        let pause = PAUSE * deaths.unwrap_or(0);
        drop(
            self.changed
                .wait_timeout_while(self.lock(), pause, |inner| !inner.is_over)
                .unwrap_or_else(PoisonError::into_inner),
        );
        self.enter(deaths.is_some())
    }

    /// Waits for work that is alone, or for all other work; returns true if it is alone now.
    fn enter(&self, wants_alone: bool) -> bool {
        let (mut inner, _) = self
            .changed
            .wait_timeout_while(self.lock(), PATIENCE, |inner| {
                !inner.is_over && (inner.is_alone || (wants_alone && inner.busy > 0))
            })
            .unwrap_or_else(PoisonError::into_inner);
        let is_alone = wants_alone && inner.busy == 0;
        inner.busy += 1;
        inner.is_alone |= is_alone;
        is_alone
    }

    fn leave(&self, was_alone: bool) {
        let mut inner = self.lock();
        inner.busy -= 1;
        inner.is_alone &= !was_alone;
        drop(inner);
        self.changed.notify_all();
    }

    /// Writes a mark, best effort: without it a crash is not counted.
    fn mark(&self, slot: usize, content: &[u8; SLOT]) {
        let inner = self.lock();
        if !inner.is_over && slot < MOST_SLOTS {
            let _ = self.working.write_all_at(content, (slot * SLOT) as u64);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Slot {
    /// Begins a step of this thread; it may have to wait for others, and others for it. The thread must not
    /// wait for anything else before [`Slot::idle`].
    pub fn working_on(&mut self, step: &str) {
        self.idle();
        let is_alone = self.quarantine.begin(step);
        let kind = if is_alone { "alone" } else { "beside" };
        self.quarantine.mark(self.number, &slot_of(kind, step));
        self.step = Some(Step {
            name: step.to_owned(),
            is_alone,
        });
    }

    /// Ends the step, which is then no suspect.
    pub fn idle(&mut self) {
        if let Some(name) = self.leave() {
            self.quarantine.forget(&name);
        }
    }

    /// Ends the step without clearing it; returns its name.
    pub fn leave(&mut self) -> Option<String> {
        let step = self.step.take()?;
        self.quarantine.mark(self.number, &[0; SLOT]);
        self.quarantine.leave(step.is_alone);
        Some(step.name)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.idle();
    }
}

/// Name of all steps of a file together.
pub fn file_step(file: &str) -> String {
    format!("file {file}")
}

/// Name of the step that completes the data before a place of a file.
pub fn last_step(file: &str, offset: u64) -> String {
    format!("{file}@{offset}+{END}")
}

/// File and step of a step name `NAME@PLACE+STEP`.
fn file_of(name: &str) -> Option<(&str, &str)> {
    let (file, place) = name.rsplit_once('@')?;
    place.split_once('+').map(|(_, step)| (file, step))
}

/// Content of a file of slots.
#[derive(Debug, Default)]
struct Left {
    boot: Option<String>,
    /// Steps, each with true if it was alone.
    steps: Vec<(String, bool)>,
}

impl Left {
    fn of(bytes: &[u8]) -> Self {
        let mut left = Self::default();
        for slot in bytes.chunks(SLOT).take(MOST_SLOTS) {
            let end = slot.iter().position(|byte| *byte == 0).unwrap_or(slot.len());
            let text = String::from_utf8_lossy(&slot[..end]);
            match text.split_once('\t') {
                None => {}
                Some((BOOT, boot)) => left.boot = Some(boot.to_owned()),
                Some((kind, name)) => left.steps.push((name.to_owned(), kind == "alone")),
            }
        }
        left
    }
}

/// Content of a slot. The excess is cut off: the name alone distinguishes steps.
fn slot_of(kind: &str, name: &str) -> [u8; SLOT] {
    let mut content = [0; SLOT];
    let mut rest = &mut content[..];
    let _ = write!(rest, "{kind}\t{name}");
    content
}

/// Identity of the machine's present boot: the unit names it, since its sandbox hides the file.
fn boot() -> Option<String> {
    let named = std::env::var("TIRANTE_BOOT_ID").ok().filter(|id| !id.is_empty());
    let id = named.or_else(|| fs::read_to_string("/proc/sys/kernel/random/boot_id").ok())?;
    let id: String = id.chars().filter(char::is_ascii_hexdigit).collect();
    Some(id).filter(|id| !id.is_empty())
}

fn remember(path: &Path, deaths: &BTreeMap<String, u32>) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    serde_json::to_writer_pretty(&mut file, deaths)?;
    file.write_all(b"\n")?;
    file.commit()
}

fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    /// Simulates a process that crashes at these steps.
    fn dies_at(store: &Path, steps: &[&str]) {
        let quarantine = Arc::new(Quarantine::open(store).unwrap());
        for step in steps {
            let mut slot = quarantine.slot();
            slot.working_on(step);
            std::mem::forget(slot);
        }
    }

    #[test]
    fn the_crashes_of_a_step_alone_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        dies_at(&store, &["good", "bad"]);
        for death in 0..3 {
            let quarantine = Quarantine::open(&store).unwrap();
            assert_eq!(quarantine.deaths("bad"), death);
            drop(quarantine);
            // Nothing was lost by looking.
            dies_at(&store, &["bad"]);
        }
        let quarantine = Arc::new(Quarantine::open(&store).unwrap());
        assert_eq!(quarantine.deaths("bad"), 3);
        assert_eq!(quarantine.deaths("good"), 0);
    }

    #[test]
    fn steps_that_end_at_once_are_all_cleared() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        let quarantine = Quarantine::open(&store).unwrap();
        for round in 0..100 {
            for step in ["one", "other"] {
                quarantine.lock().deaths.insert(step.to_owned(), 1);
            }
            thread::scope(|scope| {
                for step in ["one", "other"] {
                    let quarantine = &quarantine;
                    scope.spawn(move || quarantine.forget(step));
                }
            });
            let memory = fs::read(beside(&store, ".suspects")).unwrap();
            let left: BTreeMap<String, u32> = serde_json::from_slice(&memory).unwrap();
            assert_eq!(left, BTreeMap::new(), "round {round}");
        }
    }

    #[test]
    fn a_file_whose_beginning_is_deadly_too_is_quarantined_as_a_whole_until_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        let deaths = || Quarantine::open(&store).unwrap().deaths(&file_step("a@b.mcap"));
        // A step that was running at a kill from outside is not to blame.
        for place in 0..10 {
            dies_at(&store, &[&format!("a@b.mcap@{place}+0")]);
        }
        assert_eq!(deaths(), 0);
        for _ in 0..=LAST {
            dies_at(&store, &["a@b.mcap@77+0"]);
        }
        assert_eq!(deaths(), LAST);
        dies_at(&store, &[&last_step("a@b.mcap", 77)]);
        assert_eq!(deaths(), FILE_LAST);
        let quarantine = Quarantine::open(&store).unwrap();
        let place = Place { offset: 77, taken: 0 };
        assert_eq!(quarantine.places("a@b.mcap"), [(place, LAST)]);
        assert_eq!(quarantine.places("a"), []);
        quarantine.is_read("a@b.mcap");
        assert_eq!(deaths(), 0);
    }

    #[test]
    fn success_clears_and_an_end_in_order_blames_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        dies_at(&store, &["step"]);
        dies_at(&store, &["step"]);
        let quarantine = Arc::new(Quarantine::open(&store).unwrap());
        assert_eq!(quarantine.deaths("step"), 1);
        let mut slot = quarantine.slot();
        slot.working_on("step");
        slot.idle();
        assert_eq!(quarantine.deaths("step"), 0);
        slot.working_on("another");
        quarantine.stand_down();
        std::mem::forget(slot);
        let quarantine = Quarantine::open(&store).unwrap();
        assert!(quarantine.lock().deaths.is_empty(), "{quarantine:?}");
    }

    #[test]
    fn a_boot_of_the_machine_accuses_a_step_and_never_condemns_it() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        for _ in 0..5 {
            dies_at(&store, &["step"]);
            let slots = beside(&store, ".working");
            let mut bytes = fs::read(&slots).unwrap();
            bytes[..SLOT].copy_from_slice(&slot_of(BOOT, "another"));
            fs::write(&slots, bytes).unwrap();
        }
        assert_eq!(Quarantine::open(&store).unwrap().deaths("step"), 1);
        dies_at(&store, &["step"]);
        dies_at(&store, &["step"]);
        assert_eq!(Quarantine::open(&store).unwrap().deaths("step"), 3);
    }

    #[test]
    fn a_step_that_is_left_is_neither_cleared_nor_counted() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        dies_at(&store, &["step"]);
        let mut slot = Arc::new(Quarantine::open(&store).unwrap()).slot();
        slot.working_on("step");
        slot.leave();
        drop(slot);
        let quarantine = Quarantine::open(&store).unwrap();
        assert_eq!(quarantine.lock().deaths.get("step"), Some(&0));
    }

    #[test]
    fn a_suspect_is_tried_with_nothing_else_at_work() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        dies_at(&store, &["suspect"]);
        let quarantine = Arc::new(Quarantine::open(&store).unwrap());
        let mut one = quarantine.slot();
        one.working_on("good");
        let mut other = quarantine.slot();
        let waiting = thread::spawn(move || {
            other.working_on("suspect");
            assert_eq!(other.quarantine.lock().busy, 1);
            let third = Arc::clone(&other.quarantine);
            let later = thread::spawn(move || third.slot().working_on("third"));
            thread::sleep(Duration::from_millis(20));
            assert!(!later.is_finished());
            drop(other);
            later.join().unwrap();
        });
        thread::sleep(Duration::from_millis(20));
        assert!(!waiting.is_finished());
        one.idle();
        waiting.join().unwrap();
    }

    #[test]
    fn broken_memory_is_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        fs::write(beside(&store, ".suspects"), b"{").unwrap();
        fs::write(beside(&store, ".working"), [0xff; 3000]).unwrap();
        let quarantine = Quarantine::open(&store).unwrap();
        assert_eq!(quarantine.deaths("anything"), 0);
    }
}
