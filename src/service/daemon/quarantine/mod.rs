//! Quarantine for inputs that crash the process: each step is recorded before it runs and cleared after.
//!
//! Before a risky step its name is written into a slot of `STORE.working`, and erased after it. The file survives any end
//! of the process. A step found in it at the next start is suspect: it is taken again while nothing else is at work
//! ([`super::supervision`]), so that no other step is blamed. If the process ends at it once more, the step is tried in a process of
//! its own ([`super::trial`]) before it is taken again, and set aside if that dies: an end from outside blames no step. A step
//! at which, or at whose trial, the daemon ends again and again is set aside as well ([`Ends::is_too_many`]), so that nothing
//! keeps the daemon down for good.

mod names;
mod slots;
mod suspects;

pub use names::{file_step, last_step, place_step, record_step};
pub use suspects::{Ends, LAST};

use super::places::Place;
use slots::{Left, Slots};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use suspects::Suspects;

/// Quarantine of one store.
#[derive(Debug)]
pub struct Quarantine {
    slots: Slots,
    list: PathBuf,
    /// Locked while the list is written: what is written last is the latest.
    suspects: Mutex<Suspects>,
    number_of_slots: Mutex<usize>,
    is_over: AtomicBool,
}

/// Slot in which one thread marks its step.
#[derive(Debug)]
pub struct Slot {
    quarantine: Arc<Quarantine>,
    number: usize,
    step: Option<String>,
}

impl Quarantine {
    /// Reads the steps at which the last process of this store ended, and starts with empty slots.
    ///
    /// # Errors
    /// The files beside the store cannot be read or written.
    pub fn open(store: &Path) -> io::Result<Self> {
        let list = beside(store, ".suspects");
        let mut suspects = Suspects::read(&list)?;
        let path = beside(store, ".working");
        let left = Left::read(&path)?;
        for (step, is_alone) in &left.steps {
            suspects.suspect(step, *is_alone, left.went_with_the_machine());
        }
        suspects.shorten();
        if !left.steps.is_empty() {
            suspects.write(&list);
        }
        Ok(Self {
            slots: Slots::begin(&path)?,
            list,
            suspects: Mutex::new(suspects),
            // The first names the boot.
            number_of_slots: Mutex::new(1),
            is_over: AtomicBool::new(false),
        })
    }

    /// True if no step is suspect.
    pub fn is_empty(&self) -> bool {
        self.suspects().is_empty()
    }

    /// Ends of the program at a step, if it is suspect.
    pub fn ends(&self, step: &str) -> Option<Ends> {
        self.suspects().get(step)
    }

    /// Places of a file at which the program ended with no other step at work.
    pub fn places(&self, file: &str) -> Vec<(Place, Ends)> {
        self.suspects().places(file)
    }

    /// Keeps that a step, of which so many processes of its own died, is never taken again.
    pub fn condemn(&self, step: &str, deaths: u32) {
        let mut suspects = self.suspects();
        suspects.condemn(step, deaths);
        suspects.write(&self.list);
    }

    /// Clears a file that was read to its end.
    pub fn is_read(&self, file: &str) {
        self.clear(&file_step(file));
    }

    fn clear(&self, step: &str) {
        let mut suspects = self.suspects();
        if suspects.clear(step) {
            suspects.write(&self.list);
        }
    }

    /// A slot for one thread.
    pub fn slot(self: &Arc<Self>) -> Slot {
        let mut slots = self
            .number_of_slots
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let number = *slots;
        *slots += 1;
        Slot {
            quarantine: Arc::clone(self),
            number,
            step: None,
        }
    }

    /// Prepares an orderly end of the process: steps still at work are not suspect.
    pub fn stand_down(&self) {
        let _suspects = self.suspects();
        self.is_over.store(true, Ordering::Relaxed);
        self.slots.clear();
    }

    /// True when the process ends in order.
    pub fn is_over(&self) -> bool {
        self.is_over.load(Ordering::Relaxed)
    }

    fn mark(&self, slot: usize, step: Option<&str>) {
        // The lock keeps a mark from following the orderly end.
        let suspects = self.suspects();
        if !self.is_over() {
            // A suspect is taken while nothing else is at work.
            let step = step.map(|step| (step, suspects.get(step).is_some()));
            self.slots.mark(slot, step);
        }
    }

    fn suspects(&self) -> MutexGuard<'_, Suspects> {
        self.suspects.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Slot {
    /// Begins a step of this thread. For a suspect its caller has seen to it that nothing else is at work.
    pub fn working_on(&mut self, step: &str) {
        self.idle();
        self.quarantine.mark(self.number, Some(step));
        self.step = Some(step.to_owned());
    }

    /// Ends the step, which is then no suspect.
    pub fn idle(&mut self) {
        if let Some(step) = self.leave() {
            self.quarantine.clear(&step);
        }
    }

    /// Ends the step without clearing it; returns its name.
    pub fn leave(&mut self) -> Option<String> {
        let step = self.step.take()?;
        self.quarantine.mark(self.number, None);
        Some(step)
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        self.idle();
    }
}

fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use std::fs;
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

    /// Simulates a machine that goes down at a step.
    fn goes_down_at(store: &Path, step: &str) {
        dies_at(store, &[step]);
        slots::boot_anew(&beside(store, ".working"));
    }

    fn alone(store: &Path, step: &str) -> u32 {
        Quarantine::open(store)
            .unwrap()
            .ends(step)
            .unwrap_or_default()
            .alone
    }

    #[test]
    fn the_ends_at_a_step_alone_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        dies_at(&store, &["good", "bad"]);
        for ends in 0..3 {
            assert_eq!(alone(&store, "bad"), ends);
            // Nothing was lost by looking.
            dies_at(&store, &["bad"]);
        }
        let quarantine = Quarantine::open(&store).unwrap();
        assert_eq!(quarantine.ends("bad").unwrap().alone, 3);
        assert_eq!(quarantine.ends("good").unwrap().alone, 0);
    }

    #[test]
    fn steps_that_end_at_once_are_all_cleared() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        let quarantine = Quarantine::open(&store).unwrap();
        for round in 0..100 {
            for step in ["one", "other"] {
                quarantine.suspects().suspect(step, true, false);
            }
            thread::scope(|scope| {
                for step in ["one", "other"] {
                    let quarantine = &quarantine;
                    scope.spawn(move || quarantine.clear(step));
                }
            });
            let list = fs::read(beside(&store, ".suspects")).unwrap();
            let left: BTreeMap<String, Ends> = serde_json::from_slice(&list).unwrap();
            assert_eq!(left, BTreeMap::new(), "round {round}");
        }
    }

    #[test]
    fn a_file_whose_beginning_is_deadly_too_is_quarantined_as_a_whole_until_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        let of_file = || {
            let quarantine = Quarantine::open(&store).unwrap();
            quarantine.ends(&file_step("a@b.mcap")).unwrap_or_default()
        };
        // A step that was running at a kill from outside is not to blame.
        for place in 0..10 {
            dies_at(&store, &[&format!("a@b.mcap@{place}+0")]);
        }
        assert_eq!(of_file(), Ends::default());
        for _ in 0..=LAST {
            dies_at(&store, &["a@b.mcap@77+0"]);
        }
        assert!(of_file().is_too_many() && !of_file().is_too_many_for_a_file());
        dies_at(&store, &[&last_step("a@b.mcap", 77)]);
        assert!(of_file().is_too_many_for_a_file());
        let quarantine = Quarantine::open(&store).unwrap();
        let place = Place { offset: 77, taken: 0 };
        let places = quarantine.places("a@b.mcap");
        assert!(
            places.len() == 1 && places[0].0 == place && places[0].1.is_too_many(),
            "{places:?}"
        );
        assert_eq!(quarantine.places("a"), []);
        quarantine.is_read("a@b.mcap");
        assert_eq!(of_file(), Ends::default());
    }

    #[test]
    fn success_clears_and_an_end_in_order_blames_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        dies_at(&store, &["step"]);
        dies_at(&store, &["step"]);
        let quarantine = Arc::new(Quarantine::open(&store).unwrap());
        assert_eq!(quarantine.ends("step").unwrap().alone, 1);
        let mut slot = quarantine.slot();
        slot.working_on("step");
        slot.idle();
        assert_eq!(quarantine.ends("step"), None);
        slot.working_on("another");
        quarantine.stand_down();
        // What comes later marks nothing any more.
        slot.working_on("a third");
        std::mem::forget(slot);
        let quarantine = Quarantine::open(&store).unwrap();
        assert!(quarantine.is_empty(), "{quarantine:?}");
    }

    #[test]
    fn a_step_that_takes_the_machine_down_is_set_aside_in_the_end() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        // The first end blames nobody.
        for ends in 0..=2 * LAST {
            let quarantine = Quarantine::open(&store).unwrap();
            assert!(
                !quarantine.ends("step").is_some_and(|ends| ends.is_too_many()),
                "{ends}"
            );
            goes_down_at(&store, "step");
        }
        let ends = Quarantine::open(&store).unwrap().ends("step").unwrap();
        assert!(ends.is_too_many(), "{ends:?}");
    }

    #[test]
    fn power_cuts_blame_no_step_while_steps_go_through() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        for day in 0..6 * LAST {
            // Every second time at a suspect, alone, which goes through at the next start.
            let step = format!("step {}", day / 2);
            let quarantine = Arc::new(Quarantine::open(&store).unwrap());
            if day % 2 == 0 && day > 0 {
                let mut slot = quarantine.slot();
                slot.working_on(&format!("step {}", day / 2 - 1));
            }
            drop(quarantine);
            goes_down_at(&store, &step);
        }
        let quarantine = Quarantine::open(&store).unwrap();
        let suspects = quarantine.suspects();
        let counted = (0..40).filter_map(|day| suspects.get(&format!("step {day}")));
        assert!(counted.map(|ends| ends.alone).sum::<u32>() <= 1, "{suspects:?}");
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
        assert_eq!(quarantine.ends("step"), Some(Ends::default()));
    }

    #[test]
    fn broken_memory_is_begun_anew() {
        let folder = tempfile::tempdir().unwrap();
        let store = folder.path().join("site.db");
        fs::write(beside(&store, ".suspects"), b"{").unwrap();
        fs::write(beside(&store, ".working"), [0xff; 3000]).unwrap();
        let quarantine = Quarantine::open(&store).unwrap();
        assert_eq!(quarantine.ends("anything"), None);
    }
}
