//! Marks of the reader's steps, so that a crash of the process can be attributed to a step of an input.

use super::quarantine::{DEATHS, FILE_DEATHS, file_step, last_step};
use crate::recording::read::{Source, Step};
use crate::service::telemetry::{Fault, Health};
use std::sync::Arc;

/// Callback with the present step of work; `None` when it went well.
pub type TakeNote = Box<dyn FnMut(Option<&str>) + Send>;

/// Callbacks for the reader's steps.
pub struct Watch {
    /// Notes the present step; `None` when it went well.
    pub working_on: TakeNote,
    /// Number of crashes of the process at a step.
    pub deaths: Box<dyn Fn(&str) -> u32 + Send>,
    /// Notes that a file was read to its end, which clears all its steps.
    pub is_read: Box<dyn Fn(&str) + Send>,
}

/// Reason why an input is not read any further.
struct Blame {
    /// Reason in one sentence.
    why: String,
    /// True if nothing of it may be used, not even its beginning.
    is_whole: bool,
}

/// Takes a source's steps under watch: a file whose reading crashes the program is quarantined.
#[derive(Debug, Default)]
pub(super) struct Guard {
    /// File of the steps.
    file: Option<Arc<str>>,
    steps: Steps,
    /// Quarantined file, and the reason.
    quarantined: Option<(Arc<str>, String)>,
}

impl Guard {
    /// Takes the next step of a source.
    pub fn poll<S: Source>(&mut self, source: &mut S, watch: &mut Watch, health: &Health) -> Step<S::File> {
        let position = source.position();
        if let Some((name, _)) = &position
            && self.file.as_ref() != Some(name)
        {
            (self.file, self.steps) = (Some(Arc::clone(name)), Steps::default());
        }
        if let Some((name, offset)) = position
            && self.quarantined.as_ref().is_none_or(|(aside, _)| *aside != name)
            && let Some(Blame { why, is_whole }) = watch.begin(&name, offset, &mut self.steps)
        {
            health.hold(Fault::Quarantined, &name, &why);
            if is_whole {
                source.discard(&why);
            } else {
                source.abandon(&why);
            }
            self.quarantined = Some((name, why));
        }
        let step = source.poll();
        watch.end();
        if matches!(step, Step::More | Step::Event(..)) {
            self.steps.brought_something();
        }
        step
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
            deaths: Box::new(|_| 0),
            is_read: Box::new(|_| {}),
        }
    }

    /// Begins the next step of the input `name`; returns the reason if it must not.
    fn begin(&mut self, name: &str, offset: u64, steps: &mut Steps) -> Option<Blame> {
        if steps.is_first() {
            let deaths = (self.deaths)(&file_step(name));
            if deaths >= FILE_DEATHS {
                return Some(Blame {
                    why: format!(
                        "{name}: reading it ended the program, and so did what came before that place: the whole file is set \
                         aside"
                    ),
                    is_whole: true,
                });
            }
        }
        let step = steps.next(name, offset);
        let deaths = (self.deaths)(&step);
        if deaths >= DEATHS {
            // The data before a quarantined place may cause the crash, so completing them is a step as well.
            (self.working_on)(Some(&last_step(name, offset)));
            return Some(Blame {
                why: format!(
                    "{name}: reading it at byte {offset} ended the program {deaths} times; it is set aside"
                ),
                is_whole: false,
            });
        }
        (self.working_on)(Some(&step));
        None
    }

    fn end(&mut self) {
        (self.working_on)(None);
    }
}

/// Names the steps of one input: a chunk is read in many, all at one offset. With one name for all, a step
/// that went well would clear a later one that crashes, and the input would never be set aside. The names are
/// the same whenever the input is read: steps without data do not count.
#[derive(Debug, Default)]
struct Steps {
    offset: u64,
    /// Number of steps at this offset with data.
    taken: u64,
    has_begun: bool,
}

impl Steps {
    /// True if no step was taken yet.
    fn is_first(&mut self) -> bool {
        !std::mem::replace(&mut self.has_begun, true)
    }

    fn next(&mut self, name: &str, offset: u64) -> String {
        if offset != self.offset {
            (self.offset, self.taken) = (offset, 0);
        }
        format!("{name}@{offset}+{}", self.taken)
    }

    fn brought_something(&mut self) {
        self.taken += 1;
    }
}
