//! Watch over what the reader reads and passes on: suspect steps are taken with nothing else at work, after a trial.
//!
//! The reader begins everything that is risky, its own steps and the analyses. So nothing else is at work once it has waited
//! until the pipeline is empty, and the work loop ticks on meanwhile: silence, files, requests, retention, the watchdog's beat.

use super::places::Place;
use super::quarantine::{Quarantine, Slot, file_step, place_step, record_step};
use super::steps::Aside;
use super::trial::{DEATHS, Input, Trials, Verdict};
use crate::analysis::signal::record::Event;
use crate::service::telemetry::Beat;
use crate::site::analyse::{Known, known_by};
use crate::site::driver::Loads;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Pause before a step is tried after an end alone, times its ends.
const PAUSE: Duration = Duration::from_millis(if cfg!(test) { 10 } else { 1000 });
/// Most such pauses for one step.
const MOST_PAUSES: u32 = 4;
/// Interval between looks at the pipeline.
const LOOK: Duration = Duration::from_millis(2);

/// Watch over the reader's steps and events; by itself it does nothing.
pub trait Watch: Send {
    /// Notes the step that begins, which for a suspect waits until nothing else is at work; returns false if the daemon stops
    /// before.
    fn working_on(&mut self, _step: &str) -> bool {
        true
    }

    /// Notes that the step went well.
    fn idle(&mut self) {}

    /// Notes that a file was read to its end, which clears all its steps.
    fn is_read(&self, _file: &str) {}

    /// True if the program ended while it read a file: its steps are those of a trial only if it is read alone.
    fn is_suspect(&self, _file: &str) -> bool {
        false
    }

    /// Tells the part of a file that must not be read, before its first step.
    fn aside(&mut self, _name: &str, _input: &Input) -> Aside {
        Aside::Nothing
    }

    /// Tells the standing of an event before it is passed on to be analysed; a suspect one is tried.
    fn event(&mut self, _event: &Event) -> Standing {
        Standing::Usual
    }
}

/// The watch that does nothing.
#[derive(Debug, Clone, Copy)]
pub struct Unwatched;

impl Watch for Unwatched {}

/// Watch of a daemon: marks every step in the quarantine, and tries suspect ones.
#[derive(Debug)]
pub(super) struct Watched {
    pub(super) quarantine: Arc<Quarantine>,
    pub(super) trials: Arc<Trials>,
    /// Records that need no analysis.
    pub(super) known: Arc<Known>,
    /// Share of the reader's events in the pipeline.
    pub(super) loads: Loads,
    /// False while a suspect is waited for: there is more to read.
    pub(super) caught_up: Arc<AtomicBool>,
    /// Beat of the reader.
    pub(super) beat: Arc<Beat>,
    pub(super) slot: Slot,
}

/// Standing of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// It is passed on like any other.
    Usual,
    /// Its analysis is suspect: nothing else is at work, and nothing may be until it is over.
    Suspect,
    /// The daemon stops.
    Stopped,
}

impl Watch for Watched {
    fn working_on(&mut self, step: &str) -> bool {
        let may_begin = self.wait_for(step, Duration::ZERO);
        if may_begin {
            self.slot.working_on(step);
        }
        may_begin
    }

    fn idle(&mut self) {
        self.slot.idle();
    }

    fn is_read(&self, file: &str) {
        self.quarantine.is_read(file);
    }

    fn is_suspect(&self, file: &str) -> bool {
        self.quarantine.ends(&file_step(file)).is_some() || !self.quarantine.places(file).is_empty()
    }

    fn event(&mut self, event: &Event) -> Standing {
        if self.quarantine.is_empty() {
            return Standing::Usual;
        }
        let Some(record) = event.record().filter(|_| known_by(event, &self.known).is_none()) else {
            return Standing::Usual;
        };
        let step = record_step(record);
        let ends = match self.quarantine.ends(&step) {
            // The worker sets it aside.
            Some(ends) if !ends.is_too_many() => ends,
            _ => return Standing::Usual,
        };
        if ends.alone == 0 {
            return match self.wait_for(&step, Duration::ZERO) {
                true => Standing::Suspect,
                false => Standing::Stopped,
            };
        }
        match self.try_apart(&step, |trials| trials.of_analysis(&step, event)) {
            Verdict::Cleared => {}
            Verdict::Stopped => return Standing::Stopped,
            Verdict::Died { .. } => self.quarantine.condemn(&step, DEATHS),
        }
        Standing::Suspect
    }

    fn aside(&mut self, name: &str, input: &Input) -> Aside {
        let whole = || {
            Aside::Whole(format!(
                "{name}: reading it ended the program, and so did what came before that place: the whole file is set aside"
            ))
        };
        let of_file = self.quarantine.ends(&file_step(name));
        if of_file.is_some_and(|ends| ends.is_too_many_for_a_file()) {
            return whole();
        }
        let suspects = self.quarantine.places(name);
        if let Some((place, ends)) = suspects.iter().find(|(_, ends)| ends.is_too_many()) {
            return Aside::From {
                place: *place,
                why: ends.reason(),
            };
        }
        let places: Vec<Place> = suspects.into_iter().map(|(place, _)| place).collect();
        let Some(last) = places.last() else {
            return Aside::Nothing;
        };
        let step = place_step(name, *last);
        let mut read_apart = |places: &[Place], ends_there: bool| {
            self.try_apart(&step, |trials| trials.of_reading(name, input, places, ends_there))
        };
        let (how, place) = match read_apart(&places, false) {
            Verdict::Cleared => return Aside::Nothing,
            Verdict::Stopped => return Aside::Stopped,
            Verdict::Died { how, at } => (how, at),
        };
        match read_apart(&[place], true) {
            Verdict::Cleared => {
                // A file that grows is begun again and again.
                self.quarantine.condemn(&place_step(name, place), DEATHS);
                Aside::From {
                    place,
                    why: format!("ended the program, and a process of its own {how}"),
                }
            }
            Verdict::Stopped => Aside::Stopped,
            Verdict::Died { .. } => {
                self.quarantine.condemn(&file_step(name), DEATHS);
                whole()
            }
        }
    }
}

impl Watched {
    /// Waits before a suspect step until nothing else is at work, at least for `pause`; returns false if the daemon stops.
    fn wait_for(&self, step: &str, pause: Duration) -> bool {
        if self.quarantine.ends(step).is_none() {
            return true;
        }
        self.caught_up.store(false, Ordering::Relaxed);
        let until = Instant::now() + pause;
        while !self.loads.are_none() || Instant::now() < until {
            if self.quarantine.is_over() {
                return false;
            }
            self.beat.pass();
            thread::sleep(LOOK);
        }
        true
    }

    /// Tries a step in a process of its own. An end of the daemon meanwhile counts as one at that step.
    fn try_apart(&mut self, step: &str, trial: impl FnOnce(&Trials) -> Verdict) -> Verdict {
        let ends = self.quarantine.ends(step).unwrap_or_default();
        if !self.wait_for(step, PAUSE * ends.alone.min(MOST_PAUSES)) {
            return Verdict::Stopped;
        }
        self.slot.working_on(step);
        let verdict = trial(&self.trials);
        self.slot.leave();
        verdict
    }
}
