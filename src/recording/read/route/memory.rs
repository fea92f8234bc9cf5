//! Bound on the samples of all rods that are in no record yet.

use super::{Rod, Router};
use crate::read::lanes;
use std::cmp::Reverse;

/// Growth of the rods' samples after which their memory is checked again \[bytes\].
pub(super) const WEIGHED_EVERY: usize = 1 << 20;

/// Bytes of rods' samples that are not yet in a record or a moment.
pub(in crate::read) fn held(rods: &[Rod]) -> usize {
    rods.iter().map(|rod| rod.assembler.held() + rod.waiting()).sum()
}

impl Router {
    /// Bytes of samples of all rods that are not yet in a record or a moment.
    pub fn held(&self) -> usize {
        held(&self.rods)
    }

    /// Sets the bytes of samples beyond which the longest stretch becomes a record.
    pub fn bound(&mut self, most: usize) {
        self.most = most;
    }

    /// Ends the longest stretches, or moments, while all rods together hold too much.
    pub(super) fn weigh(&mut self) {
        self.grown = 0;
        let mut held = self.held();
        while held > self.most {
            if let Some(at) = (0..self.rods.len()).max_by_key(|at| self.rods[*at].waiting())
                && self.rods[at].waiting()
                    > self
                        .rods
                        .iter()
                        .map(|rod| rod.assembler.held())
                        .max()
                        .unwrap_or(0)
            {
                let Some(found) = lanes::release(&mut self.rods[at..]) else {
                    return;
                };
                *self.released.entry(at).or_insert(0) += 1;
                self.take(vec![found]);
                held = self.held();
                continue;
            }
            let rods = self.rods.iter().map(|rod| rod.assembler.held());
            // Of equal ones the first.
            let Some((_, Reverse(at))) = rods.enumerate().map(|(at, held)| (held, Reverse(at))).max() else {
                return;
            };
            let Some(rod) = self.rods.get_mut(at) else { return };
            let before = rod.assembler.held();
            rod.assembler.cut_off();
            *self.cuts.entry(at).or_insert(0) += 1;
            self.collect(false);
            let now = self.rods.get(at).map_or(0, |rod| rod.assembler.held());
            held = self.held();
            if now >= before {
                return;
            }
        }
    }
}
