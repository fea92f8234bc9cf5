//! Growing files: each is followed, and begins when the files that began before it are read as far as they are.

use super::group::Group;
use super::lane::Lane;
use super::{Folder, FolderStep};
use crate::recording::read::Step;
use crate::recording::read::folder::first_time;
use crate::service::daemon::supervision::Watch;
use crate::service::telemetry::Fault;
use std::ffi::{OsStr, OsString};
use std::time::Instant;

/// Bytes that growing recordings may hold together; beyond, the largest is read when it is finished.
const MOST_BYTES: usize = 32 << 20;

/// Most bytes of finished files that a growing one waits for: an archive does not keep live data waiting.
const MOST_AHEAD: u64 = 256 << 20;

impl Folder {
    /// Takes a step of the next growing file with data.
    pub(super) fn step_growing(&mut self, watch: &mut dyn Watch) -> Option<FolderStep> {
        for _ in 0..self.growing.len() {
            let mut lane = self.growing.pop_front()?;
            if !self.is_next(&mut lane) {
                self.growing.push_back(lane);
                continue;
            }
            lane.recording.bound(self.room());
            let step = lane.step(watch, self.waits.settle, &self.health);
            match step {
                None => {
                    self.joins.give_back(lane.taken().iter());
                    self.finishing.insert(lane.name);
                    self.next_scan = Instant::now();
                }
                Some(Step::End) => return Some(self.end_growing(lane, watch)),
                Some(Step::Wait) => self.growing.push_back(lane),
                Some(Step::More) => {
                    self.growing.push_back(lane);
                    self.make_room();
                    return Some(Step::More);
                }
                Some(Step::Event(event, place)) => {
                    // Events already read are returned before the next file's turn.
                    self.growing.push_front(lane);
                    return Some(Step::Event(event, place));
                }
            }
        }
        None
    }

    /// True if a file may be read: one without a message so far waits for those that began before it, since it may go on with what they
    /// leave open.
    fn is_next(&mut self, lane: &mut Lane) -> bool {
        if lane.elders.is_none() {
            self.line_up(lane);
        }
        let Some(elders) = &mut lane.elders else {
            return true;
        };
        elders.retain(|name| {
            let elder = self.growing.iter().find(|other| other.name == *name);
            let is_behind = elder
                .is_some_and(|elder| elder.is_behind && (elder.begins, name) < (lane.begins, &lane.name));
            let group = self.finished.as_ref();
            let is_finished = self.queued.contains_key(name) || group.is_some_and(|group| group.has(name));
            is_behind || is_finished || self.finishing.contains(name)
        });
        elders.is_empty()
    }

    /// Finds the files that began before one, if that has a message.
    fn line_up(&mut self, lane: &mut Lane) {
        let first = |name: &OsStr| self.open(name).ok().and_then(|file| first_time(&file));
        let is_known = lane.begins.is_some();
        lane.begins = lane.begins.or_else(|| first(&lane.name));
        let Some(begins) = lane.begins else {
            return;
        };
        if !is_known && lane.recording.is_unread() {
            self.joins.join(lane);
        }
        let firsts: Vec<_> = self
            .growing
            .iter()
            .map(|other| other.begins.or_else(|| first(&other.name)))
            .collect();
        let is_elder = |first: Option<u64>, name: &OsString| {
            first.is_some_and(|first| (first, name) < (begins, &lane.name))
        };
        let finishing = self.finishing.iter().filter(|name| is_elder(first(name), name));
        let mut elders: Vec<OsString> = finishing.cloned().collect();
        elders.extend(self.finished_before(begins, &lane.name));
        for (other, first) in self.growing.iter_mut().zip(firsts) {
            other.begins = first;
            if is_elder(first, &other.name) {
                other.is_behind = true;
                elders.push(other.name.clone());
            }
        }
        lane.elders = Some(elders);
    }

    /// Finished files that are still to be read and began before one, if they are not too long.
    fn finished_before(&self, begins: u64, name: &OsString) -> Vec<OsString> {
        let queued = self
            .queue
            .iter()
            .take_while(|(first, other)| (*first, other) < (begins, name));
        let group = self.finished.as_ref().filter(|group| group.began() < begins);
        let sizes = queued.clone().filter_map(|(_, name)| self.queued.get(name));
        let bytes = sizes
            .map(|(bytes, _)| *bytes)
            .chain(group.map(Group::bytes))
            .sum::<u64>();
        let names = queued.map(|(_, name)| name).chain(group.and_then(Group::first));
        names.filter(|_| bytes <= MOST_AHEAD).cloned().collect()
    }

    /// Puts off the largest growing files while all together hold too much: they are begun again when
    /// finished.
    fn make_room(&mut self) {
        while self.growing.len() > 1
            && self.growing.iter().map(|lane| lane.held).sum::<usize>() > MOST_BYTES
            && let Some(at) = (0..self.growing.len()).max_by_key(|at| self.growing[*at].held)
            && let Some(lane) = self.growing.remove(at)
        {
            let detail = format!(
                "{}: growing files together hold more than {} MiB; it is read when it is finished",
                lane.label,
                MOST_BYTES >> 20
            );
            self.health.fault(Fault::Folder, detail);
            self.joins.give_back(lane.taken().iter());
            self.postponed.insert(lane.name);
        }
    }

    /// Ends a growing file.
    fn end_growing(&mut self, mut lane: Lane, watch: &dyn Watch) -> FolderStep {
        let read = self.read(&mut lane, watch);
        let left = lane.take_left();
        let ended = self.joins.left(left, lane.taken(), |rod| self.is_in_use(rod));
        self.done_with(ended, vec![read])
    }
}
