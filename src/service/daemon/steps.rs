//! Marks of the reader's steps, so that a crash of the process can be attributed to a step of an input.

use super::places::{Place, Steps};
use super::quarantine::{CONDEMNED, FILE_LAST, LAST, Quarantine, Slot, file_step, last_step};
use super::trial::{Input, Trials, Verdict};
use crate::recording::read::{Source, Step};
use crate::service::telemetry::{Fault, Health};
use crate::site::ordered_map::message_of;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

/// Callback with the present step of work; `None` when it went well.
pub type TakeNote = Box<dyn FnMut(Option<&str>) + Send>;

/// Callback that tells the part of a file that must not be read.
pub type AskAside = Box<dyn FnMut(&str, &Input) -> Aside + Send>;

/// Callbacks for the reader's steps.
pub struct Watch {
    /// Notes the present step; `None` when it went well.
    pub working_on: TakeNote,
    /// Tells the part of a file that must not be read, before its first step.
    pub aside: AskAside,
    /// Notes that a file was read to its end, which clears all its steps.
    pub is_read: Box<dyn Fn(&str) + Send>,
}

/// Part of a file that must not be read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Aside {
    /// Nothing.
    Nothing,
    /// Everything from a place on.
    From {
        /// The place.
        place: Place,
        /// Event there, as the end of a sentence.
        why: String,
    },
    /// Anything, not even its beginning, for this reason.
    Whole(String),
    /// The daemon stops before that is known.
    Stopped,
}

/// Takes a source's steps under watch: a file whose reading crashes the program is quarantined.
#[derive(Debug, Default)]
pub(super) struct Guard {
    /// File of the steps, once it is known what of it must not be read.
    file: Option<(Arc<str>, Aside)>,
    steps: Steps,
    /// Quarantined file, and the reason.
    quarantined: Option<(Arc<str>, String)>,
}

impl Guard {
    /// Takes the next step of a source.
    pub fn poll<S: Source>(
        &mut self,
        source: &mut S,
        input: &Input,
        watch: &mut Watch,
        health: &Health,
    ) -> Step<S::File> {
        let position = source.position();
        if let Some((name, offset)) = &position
            && self.quarantined.as_ref().is_none_or(|(aside, _)| aside != name)
        {
            if self.file.as_ref().is_none_or(|(file, _)| file != name) {
                let aside = (watch.aside)(name, input);
                if aside == Aside::Stopped {
                    return Step::Wait;
                }
                (self.file, self.steps) = (Some((Arc::clone(name), aside)), Steps::default());
            }
            self.begin(source, (name, *offset), watch, health);
        }
        let polled = catch_unwind(AssertUnwindSafe(|| source.poll()));
        (watch.working_on)(None);
        let step = match (polled, position) {
            (Ok(step), _) => step,
            // What a broken source holds is not believed, and the other files go on.
            (Err(panic), Some((name, offset)))
                if self.quarantined.as_ref().is_none_or(|(aside, _)| *aside != name) =>
            {
                let why = format!(
                    "{name}: reading it at byte {offset} broke the program, please report it: {}; what was not yet a record is \
                     set aside",
                    message_of(&*panic)
                );
                source.discard(&why);
                self.set_aside(name, why, health);
                Step::More
            }
            (Err(panic), _) => resume_unwind(panic),
        };
        if matches!(step, Step::More | Step::Event(..)) {
            self.steps.brought_something();
        }
        step
    }

    /// Begins the next step of a file, or ends the file if it must not be taken.
    fn begin<S: Source>(
        &mut self,
        source: &mut S,
        (name, offset): (&Arc<str>, u64),
        watch: &mut Watch,
        health: &Health,
    ) {
        let place = self.steps.next(offset);
        let why = match self.file.as_ref().map(|(_, aside)| aside) {
            Some(Aside::Whole(why)) => {
                let why = why.clone();
                source.discard(&why);
                why
            }
            Some(Aside::From { place: from, why }) if *from == place => {
                let why = format!("{name}: reading it at byte {offset} {why}; it is set aside");
                // The data before a quarantined place may cause the crash, so completing them is a step as well.
                (watch.working_on)(Some(&last_step(name, offset)));
                source.abandon(&why);
                why
            }
            _ => return (watch.working_on)(Some(&format!("{name}@{place}"))),
        };
        self.set_aside(Arc::clone(name), why, health);
    }

    fn set_aside(&mut self, name: Arc<str>, why: String, health: &Health) {
        health.hold(Fault::Quarantined, &name, &why);
        self.quarantined = Some((name, why));
    }

    /// Returns the reason why a file that ended was quarantined, if it was.
    pub fn end(&mut self, name: &str) -> Option<String> {
        let aside = self.quarantined.take_if(|(aside, _)| **aside == *name);
        aside.map(|(_, why)| why)
    }
}

impl Watch {
    /// Callbacks that do nothing.
    pub fn none() -> Self {
        Self {
            working_on: Box::new(|_| {}),
            aside: Box::new(|_, _| Aside::Nothing),
            is_read: Box::new(|_| {}),
        }
    }

    /// Callbacks that record the steps in a quarantine, and try suspect ones in a process of their own.
    pub(super) fn of(quarantine: &Arc<Quarantine>, trials: &Arc<Trials>) -> Self {
        let mut slot = quarantine.slot();
        let mut apart = quarantine.slot();
        let (looked_up, reads) = (Arc::clone(quarantine), Arc::clone(quarantine));
        let trials = Arc::clone(trials);
        Self {
            working_on: Box::new(move |step| match step {
                Some(step) => slot.working_on(step),
                None => slot.idle(),
            }),
            aside: Box::new(move |name, input| aside(&looked_up, &mut apart, &trials, name, input)),
            is_read: Box::new(move |file| reads.is_read(file)),
        }
    }
}

/// Finds the part of a file that must not be read, after the ends of earlier processes. A trial is a step of its own, so that an end of the daemon at it
/// counts as one at that place.
fn aside(quarantine: &Quarantine, slot: &mut Slot, trials: &Trials, name: &str, input: &Input) -> Aside {
    let whole = || {
        Aside::Whole(format!(
            "{name}: reading it ended the program, and so did what came before that place: the whole file is set aside"
        ))
    };
    if quarantine.deaths(&file_step(name)) >= FILE_LAST {
        return whole();
    }
    let suspects = quarantine.places(name);
    if let Some((place, deaths)) = suspects.iter().find(|(_, deaths)| *deaths >= LAST) {
        return Aside::From {
            place: *place,
            why: match *deaths {
                CONDEMNED => "ended the program and a process of its own".to_owned(),
                deaths => format!("ended the program {deaths} times"),
            },
        };
    }
    let places: Vec<Place> = suspects.into_iter().map(|(place, _)| place).collect();
    let Some(last) = places.last() else {
        return Aside::Nothing;
    };
    let step = format!("{name}@{last}");
    let mut read_apart = |places: &[Place], ends_there: bool| {
        slot.working_on(&step);
        let verdict = trials.of_reading(name, input, places, ends_there);
        slot.leave();
        verdict
    };
    let (how, place) = match read_apart(&places, false) {
        Verdict::Cleared => return Aside::Nothing,
        Verdict::Stopped => return Aside::Stopped,
        Verdict::Died { how, at: Some(place) } => (how, place),
        // An earlier part of the journal, of which this one can tell nothing.
        Verdict::Died { at: None, .. } if matches!(input, Input::Journal { .. }) => return Aside::Nothing,
        Verdict::Died { at: None, .. } => {
            quarantine.condemn(&file_step(name));
            return whole();
        }
    };
    match read_apart(&[place], true) {
        Verdict::Cleared => {
            // A file that grows is begun again and again.
            quarantine.condemn(&format!("{name}@{place}"));
            Aside::From {
                place,
                why: format!("ended the program, and a process of its own {how}"),
            }
        }
        Verdict::Stopped => Aside::Stopped,
        Verdict::Died { .. } => {
            quarantine.condemn(&file_step(name));
            whole()
        }
    }
}
