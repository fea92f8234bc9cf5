//! Events of a file's rods: collected in order, each with the times up to which all rods have been read, and ended with the file.

use super::{Ready, Router, Timed};
use crate::read::lanes::{self, Found};
use std::sync::Arc;
use tirante_analysis::signal::record::Event;
use tirante_analysis::track::ordered::Reached;

impl Router {
    /// Moves the events so far to `to`.
    pub fn events(&mut self, to: &mut Ready) {
        to.append(&mut self.ready);
    }

    /// Collects the rods' events; with `all`, none waits for another sensor any more.
    pub(super) fn collect(&mut self, all: bool) {
        let mut found = Vec::new();
        for lanes in self.rods.chunk_by_mut(|_, next| next.sensor > 0) {
            lanes::collect(lanes, all, &mut found);
        }
        self.take(found);
    }

    pub(super) fn take(&mut self, found: Vec<Found>) {
        if found.is_empty() {
            return;
        }
        let mut reached = self.reached();
        let mut timed = Vec::with_capacity(found.len());
        // Of moments that close together the later are still to come when the first does.
        for (at, event, origin) in found.into_iter().rev() {
            let before = match &event {
                Event::Moment(moment) => reached
                    .iter()
                    .map(|(rod, reached)| {
                        let own = (*rod == moment.rod).then_some(at);
                        (rod.clone(), reached.iter().copied().chain(own).min())
                    })
                    .collect(),
                _ => Arc::clone(&reached),
            };
            timed.push(Timed {
                event,
                at,
                reached: std::mem::replace(&mut reached, before),
                origin,
            });
        }
        self.ready.extend(timed.into_iter().rev());
    }

    /// Times up to which each rod has been read.
    pub fn reached(&self) -> Reached {
        let rods = self.rods.chunk_by(|_, next| next.sensor > 0);
        rods.filter(|lanes| lanes.iter().any(|lane| lane.is_followed))
            .filter_map(|lanes| {
                let first = lanes.first()?;
                let own = |sensor: usize| lanes.get(sensor)?.assembler.complete_until();
                let reached = match &first.moments {
                    None => own(0),
                    Some(moments) => moments.complete_until(|sensor| own(sensor).is_some()),
                };
                Some((first.config.rod.clone(), reached))
            })
            .collect()
    }

    /// Ends every stream; `damage` describes the part not read and gives one rejection for each rod with
    /// messages in the file.
    pub fn finish(&mut self, cut_short: bool, damage: Option<&str>, to: &mut Ready) {
        self.go_on_to_the_end();
        for (rod, count) in self.rods.iter_mut().zip(&self.counts) {
            rod.finish(*count, cut_short, damage);
        }
        self.collect(true);
        self.events(to);
    }

    /// Ends one of several files that are read side by side. Records continue in the next one if this one
    /// ended properly.
    pub fn end_file(&mut self, cut_short: bool, damage: Option<&str>) {
        self.go_on_to_the_end();
        let fed = self.rods.iter_mut().zip(&self.counts);
        for (rod, count) in fed.filter(|(_, count)| count.messages > 0) {
            if cut_short || self.ends_with_file {
                rod.assembler.finish(cut_short);
                rod.assembler.renew(true);
            }
            rod.tell_nothing(*count, damage);
        }
        self.collect(false);
    }

    /// Events of the samples left at the very end.
    pub fn ended(&mut self) -> impl Iterator<Item = Timed> + use<> {
        let mut last = Ready::default();
        self.finish(false, None, &mut last);
        last.take()
    }
}
