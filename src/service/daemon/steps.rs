//! Marks of the reader's steps, so that a crash of the process can be attributed to a step of an input.

use super::places::{Place, Steps};
use super::quarantine::{last_step, place_step};
use super::supervision::Watch;
use super::trial::Input;
use crate::recording::read::{Source, Step};
use crate::service::telemetry::{Fault, Health};
use crate::site::ordered_map::message_of;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;

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
        watch: &mut dyn Watch,
        health: &Health,
    ) -> Step<S::File> {
        let position = source.position();
        if let Some((name, offset)) = &position
            && self.quarantined.as_ref().is_none_or(|(aside, _)| aside != name)
        {
            if self.file.as_ref().is_none_or(|(file, _)| file != name) {
                let aside = watch.aside(name, input);
                if aside == Aside::Stopped {
                    return Step::Wait;
                }
                (self.file, self.steps) = (Some((Arc::clone(name), aside)), Steps::default());
            }
            if !self.begin(source, (name, *offset), watch, health) {
                return Step::Wait;
            }
        }
        let polled = catch_unwind(AssertUnwindSafe(|| source.poll()));
        watch.idle();
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

    /// Begins the next step of a file, or ends the file if it must not be taken; returns false if the daemon stops before.
    fn begin<S: Source>(
        &mut self,
        source: &mut S,
        (name, offset): (&Arc<str>, u64),
        watch: &mut dyn Watch,
        health: &Health,
    ) -> bool {
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
                if !watch.working_on(&last_step(name, offset)) {
                    return false;
                }
                source.abandon(&why);
                why
            }
            _ => return watch.working_on(&place_step(name, place)),
        };
        self.set_aside(Arc::clone(name), why, health);
        true
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
