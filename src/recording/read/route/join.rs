//! Rods that go on where an earlier file ended, and leave their open samples to the next.

use super::{Ready, Rod, Route, Router, held};
use crate::read::tail::{Tail, Tails};
use std::sync::Arc;
use tirante_analysis::signal::record::RodId;

/// Most bytes of samples that a rod leaves open; a longer record ends with its file.
const MOST_OPEN: usize = 8 << 20;

impl Router {
    /// Lets the rods go on with the open samples of earlier files, and leave theirs; `is_whole`: it neither grows nor was cut short.
    pub fn join(&mut self, tails: Tails, file: Arc<str>, is_whole: bool) {
        self.tails = Some(tails).filter(|_| !self.ends_with_file);
        self.takes_warmth = is_whole && self.before.is_none();
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
        let routes = listed.routes.clone();
        self.note_thermometer(routes.as_deref().unwrap_or_default());
        let (routes, Some(tails)) = (routes, &self.tails) else {
            return;
        };
        for route in routes
            .iter()
            .flat_map(|routes| routes.iter())
            .filter(|route| !route.temperature || self.takes_warmth)
        {
            let Some(first) = self.rods.get(route.rod).map(|rod| route.rod - rod.sensor) else {
                continue;
            };
            let lanes = self.rods[first..].chunk_by_mut(|_, next| next.sensor > 0).next();
            let Some(lanes) = lanes else { continue };
            if route.temperature {
                lanes[0].is_warmed = true;
                // Its samples here began without them.
                if lanes[0].is_begun {
                    continue;
                }
            } else if std::mem::replace(&mut lanes[0].is_begun, true) {
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
            if lanes[0].is_continued {
                continue;
            }
            let Some(tail) = tails.take(&lanes[0].config.rod, log_time) else {
                continue;
            };
            lanes[0].is_continued = true;
            if route.temperature {
                lanes[0].is_together = !tail.is_apart();
            }
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

    /// Notes whether samples and readings of the rods of a channel come in one file, at its first message.
    fn note_thermometer(&mut self, routes: &[Route]) {
        for route in routes {
            let of = |route: &Route| self.rods.get(route.rod).map(|rod| route.rod - rod.sensor);
            let rod = of(route);
            let begun = self.channels.iter().filter(|listed| listed.is_begun);
            let mut others = begun.flat_map(|listed| listed.routes.iter().flat_map(|routes| routes.iter()));
            let is_together = others.any(|other| other.temperature != route.temperature && of(other) == rod);
            // Readings alone may be those of a rod whose samples come in other files.
            if let Some(rod) = rod.filter(|_| is_together || !route.temperature) {
                self.rods[rod].is_together = is_together;
            }
        }
    }

    /// Ends the file: rods with samples or temperatures in it leave what is open, the others end.
    pub fn leave(&mut self, to: &mut Ready) {
        self.go_on_to_the_end();
        let mut counts = self.counts.iter();
        for lanes in self.rods.chunk_by_mut(|_, next| next.sensor > 0) {
            let leaves = lanes[0].is_open() && held(lanes) <= MOST_OPEN;
            lanes[0].is_begun &= leaves;
            lanes[0].is_warmed &= leaves;
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

    /// Open samples of the rods with samples or temperatures in the file, whose events were taken.
    pub fn left(&self, place: &(Arc<str>, u64, u64)) -> Vec<Tail> {
        let Some(tails) = &self.tails else {
            return Vec::new();
        };
        let lanes = self.rods.chunk_by(|_, next| next.sensor > 0);
        lanes
            .filter(|lanes| lanes.iter().any(Rod::is_open))
            .filter_map(|lanes| {
                // With temperatures alone the samples are still those of a file before.
                let before = lanes[0].files.latest().filter(|_| !lanes[0].is_begun);
                let (file, bytes, records) = place.clone();
                let place = (before.unwrap_or(file), bytes, records);
                Tail::of(lanes, tails.settings(), &place)
            })
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
            .any(|lane| (lane.is_begun || lane.is_continued) && lane.config.rod == *rod)
    }
}
