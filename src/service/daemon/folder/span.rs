//! Spans of finished files: one without a summary is read for it, a step at a time.

use super::Folder;
use super::lane::{Stamp, stamp};
use super::listing::label;
use crate::recording::read::folder::{Span, SpanReader, span_by_summary};
use crate::service::daemon::places::Steps;
use crate::service::daemon::quarantine::place_step;
use crate::service::daemon::supervision::Watch;
use std::ffi::{OsStr, OsString};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Span of a finished file that may be read beside others.
pub(super) struct Spanned {
    name: OsString,
    stamp: Option<Stamp>,
    label: String,
    steps: Steps,
    /// Reads it for its span; `None` when that is known.
    reader: Option<SpanReader>,
    span: Option<Span>,
}

impl Spanned {
    fn step(&mut self, watch: &mut dyn Watch) {
        let Some(reader) = &mut self.reader else {
            return;
        };
        if !watch.working_on(&place_step(&self.label, self.steps.next(reader.offset()))) {
            return;
        }
        // What breaks the program here breaks it once more when the file is read, and is told then.
        let has_more = catch_unwind(AssertUnwindSafe(|| reader.step()));
        watch.idle();
        self.steps.brought_something();
        match has_more {
            Ok(true) => {}
            Ok(false) => self.span = self.reader.take().and_then(SpanReader::into_span),
            Err(_) => self.reader = None,
        }
    }
}

impl Folder {
    /// True if the span of a finished file is known; otherwise it is read for it from then on.
    pub(super) fn knows_span(&mut self, name: &OsStr, watch: &dyn Watch) -> bool {
        let known = self.spanned.as_ref().filter(|known| known.name == *name);
        if known.is_some_and(|known| known.reader.is_some()) {
            return false;
        }
        let label = label(name);
        // One at which the program ended is read alone.
        let file = self.open(name).ok().filter(|_| !watch.is_suspect(&label));
        let now = file.as_ref().and_then(|file| file.metadata().ok());
        let now = now.map(|data| stamp(&data));
        if known.is_some_and(|known| known.stamp == now) {
            return true;
        }
        let span = file.as_ref().and_then(span_by_summary);
        let reader = file.filter(|_| span.is_none()).and_then(SpanReader::begin);
        let is_known = reader.is_none();
        self.spanned = Some(Spanned {
            name: name.to_owned(),
            stamp: now,
            label,
            steps: Steps::default(),
            reader,
            span,
        });
        is_known
    }

    /// Span of a finished file, once it is known; `None` if it is read alone.
    pub(super) fn span_of(&self, name: &OsStr) -> Option<Span> {
        let known = self.spanned.as_ref().filter(|known| known.name == *name);
        known.and_then(|known| known.span.clone())
    }

    /// True if a file is read for its span.
    pub(super) fn is_spanning(&self) -> bool {
        self.spanned.as_ref().is_some_and(|known| known.reader.is_some())
    }

    /// Takes a step of the file that is read for its span.
    pub(super) fn step_span(&mut self, watch: &mut dyn Watch) {
        if let Some(reading) = &mut self.spanned {
            reading.step(watch);
        }
    }
}
