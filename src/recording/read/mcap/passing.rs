//! Damage that is left out: holes, and the definitions that stood in them.

use super::Item;
use super::contents::Contents;
use crate::read::hole::Hole;
use crate::read::wire::Fields;
use mcap::records::op;

/// Most holes of a file; reading stops beyond.
pub(super) const MOST_HOLES: usize = 100;

impl Contents {
    /// Marks a fault as one that can be left out.
    pub fn passable(&mut self, what: String) -> String {
        self.is_passable = true;
        what
    }

    /// Goes on at a record behind a hole; `previous`: kind of the one before it.
    pub fn pass(&mut self, at: u64, previous: u8, hole: Hole) {
        self.under_way = None;
        self.holes += 1;
        self.hole.get_or_insert(hole);
        self.offset = at;
        self.previous = previous;
    }

    /// Takes the definitions of the summary, as far as they do not contradict those of the data.
    pub fn define(&mut self, definitions: &[u8], is_checked: bool, each: &mut dyn FnMut(Item<'_>)) {
        if !is_checked && !definitions.is_empty() {
            self.unverified(each);
        }
        for wanted in [op::SCHEMA, op::CHANNEL] {
            let mut records = Fields(definitions);
            while let Ok(Some((opcode, fields))) = records.record() {
                // The first one that is known stays.
                let _ = match opcode {
                    op::SCHEMA if wanted == opcode => self.schema(fields),
                    op::CHANNEL if wanted == opcode => self.channel(fields, each),
                    _ => Ok(()),
                };
            }
        }
    }

    /// Skips a damaged record of correct length; `span`: its first and last log time.
    pub fn lose(&mut self, what: String, span: Option<(u64, u64)>) -> Result<(), String> {
        if !self.passes_holes || self.holes >= MOST_HOLES {
            return Err(what);
        }
        self.holes += 1;
        let offset = self.offset;
        // An odd index behind a spoilt chunk belongs to that one's hole.
        self.hole.get_or_insert_with(|| Hole::new(offset, what, span));
        Ok(())
    }
}
