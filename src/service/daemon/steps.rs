//! Marks of the reader's steps, so that a crash of the process can be attributed to a step of an input.

use super::suspects::{CONDEMNED, FILE_CONDEMNED, file_step, last_step};

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
pub(super) struct Blame {
    /// Reason in one sentence.
    pub why: String,
    /// True if nothing of it may be used, not even its beginning.
    pub is_whole: bool,
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
    pub(super) fn begin(&mut self, name: &str, offset: u64, steps: &mut Steps) -> Option<Blame> {
        if steps.is_first() {
            let deaths = (self.deaths)(&file_step(name));
            if deaths >= FILE_CONDEMNED {
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
        if deaths >= CONDEMNED {
            // What came before a place that is set aside may be what the program dies of: that is a step too.
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

    pub(super) fn end(&mut self) {
        (self.working_on)(None);
    }
}

/// Names the steps of one input: a chunk is read in many, all at one offset. With one name for all, a step
/// that went well would clear a later one that crashes, and the input would never be set aside. The names are
/// the same whenever the input is read: steps without data do not count.
#[derive(Debug, Default)]
pub(super) struct Steps {
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

    pub fn brought_something(&mut self) {
        self.taken += 1;
    }
}
