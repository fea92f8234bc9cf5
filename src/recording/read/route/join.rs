//! Rods that go on where an earlier file ended, and leave their open samples to the next.

use super::{Ready, Router, held};
use crate::analysis::signal::record::RodId;
use crate::recording::read::tail::{Tail, Tails};
use std::sync::Arc;

/// Most bytes of samples that a rod leaves open; a longer record ends with its file.
const MOST_OPEN: usize = 8 << 20;

impl Router {
    /// Lets the rods go on with the open samples of earlier files, and leave theirs.
    pub fn join(&mut self, tails: Tails, file: Arc<str>) {
        self.tails = Some(tails).filter(|_| !self.ends_with_file);
        self.file = Some(file);
    }

    /// True if its rods leave open samples at the end.
    pub fn leaves_open(&self) -> bool {
        self.tails.is_some()
    }

    /// Lets the rods of a channel go on with their open samples, at its first message in the file.
    pub(super) fn go_on_with_tails(&mut self, channel: u16, log_time: u64) {
        let Some(listed) = self.channels.get_mut(usize::from(channel)) else {
            return;
        };
        if std::mem::replace(&mut listed.is_begun, true) {
            return;
        }
        let (routes, Some(tails)) = (listed.routes.clone(), &self.tails) else {
            return;
        };
        // Temperatures alone may stand in a file of their own.
        for route in routes
            .iter()
            .flat_map(|routes| routes.iter())
            .filter(|route| !route.temperature)
        {
            let Some(first) = self.rods.get(route.rod).map(|rod| route.rod - rod.sensor) else {
                continue;
            };
            let lanes = self.rods[first..].chunk_by_mut(|_, next| next.sensor > 0).next();
            let Some(lanes) = lanes else { continue };
            if std::mem::replace(&mut lanes[0].is_begun, true) {
                let counts = self.counts.iter().skip(first).take(lanes.len());
                let is_first = counts.map(|count| count.messages).sum::<u64>() == 0;
                if let Some(before) = self
                    .before
                    .as_mut()
                    .filter(|_| is_first && held(lanes) <= MOST_OPEN)
                {
                    let file = lanes[0].files.latest().or_else(|| self.file.clone());
                    before.extend(file.and_then(|file| Tail::of(lanes, tails.settings(), &(file, 0, 0))));
                }
                continue;
            }
            let Some(tail) = tails.take(&lanes[0].config.rod, log_time) else {
                continue;
            };
            if !tail.restore(lanes, tails.settings()) {
                let lost = format!(
                    "rod {}: the samples that {} left open cannot be read; they are left out",
                    tail.rod, tail.file
                );
                self.holes.push(lost);
            }
            self.taken.push(tail);
        }
    }

    /// Ends the file: rods with samples in it leave what is open, the others end.
    pub fn leave(&mut self, to: &mut Ready) {
        self.go_on_to_the_end();
        let mut counts = self.counts.iter();
        for lanes in self.rods.chunk_by_mut(|_, next| next.sensor > 0) {
            lanes[0].is_begun &= held(lanes) <= MOST_OPEN;
            let leaves = lanes[0].is_begun;
            for (rod, count) in lanes.iter_mut().zip(&mut counts) {
                match leaves {
                    true => rod.tell_nothing(*count, None),
                    false => rod.finish(*count, false, None),
                }
            }
        }
        self.collect(false);
        self.events(to);
    }

    /// Open samples of the rods with samples in the file, whose events were taken.
    pub fn left(&self, place: &(Arc<str>, u64, u64)) -> Vec<Tail> {
        let Some(tails) = &self.tails else {
            return Vec::new();
        };
        let lanes = self.rods.chunk_by(|_, next| next.sensor > 0);
        lanes
            .filter(|lanes| lanes.iter().any(|lane| lane.is_begun))
            .filter_map(|lanes| Tail::of(lanes, tails.settings(), place))
            .collect()
    }

    /// Notes with which open samples of other files of its stream it goes on.
    pub fn note_start(&mut self) {
        self.before = Some(Vec::new());
    }

    /// Those noted.
    pub fn before(&self) -> &[Tail] {
        self.before.as_deref().unwrap_or_default()
    }

    /// Open samples of earlier files that the rods went on with.
    pub fn taken(&self) -> &[Tail] {
        &self.taken
    }

    /// The same, taken out.
    pub fn take_taken(&mut self) -> Vec<Tail> {
        std::mem::take(&mut self.taken)
    }

    /// Remembers what others went on with.
    pub fn keep_taken(&mut self, taken: Vec<Tail>) {
        self.taken = taken;
    }

    /// True if a rod had samples in the file.
    pub fn has_begun(&self, rod: &RodId) -> bool {
        self.rods
            .iter()
            .any(|lane| lane.is_begun && lane.config.rod == *rod)
    }
}
