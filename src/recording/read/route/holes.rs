//! Damage in the middle of a file: told once, and rejected for the rods that may have lost messages.

use super::super::hole::Hole;
use super::Router;
use std::collections::BTreeSet;
use tirante_analysis::signal::record::Rejection;

impl Router {
    /// Takes the clauses on damage that are not told.
    pub fn take_holes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.holes)
    }

    /// Tells these as well.
    pub fn keep_holes(&mut self, holes: Vec<String>) {
        self.holes.extend(holes);
    }

    /// Notes damage of the file, and rejects what is lost for each rod that may have had messages there.
    pub(super) fn hole(&mut self, hole: &Hole) {
        if !hole.is_loss {
            self.holes.push(hole.sentence(std::iter::empty()));
            return;
        }
        let is_lost = |id: usize| {
            hole.channels.is_empty() || u16::try_from(id).is_ok_and(|id| hole.channels.contains(&id))
        };
        let (mut topics, mut rods) = (BTreeSet::new(), BTreeSet::new());
        let channels = self.channels.iter().enumerate();
        for (_, listed) in channels.filter(|(id, listed)| listed.known && is_lost(*id)) {
            topics.insert(listed.topic);
            let routes = listed.routes.as_deref().unwrap_or_default();
            rods.extend(
                routes
                    .iter()
                    .filter(|route| !route.temperature)
                    .map(|route| route.rod),
            );
        }
        // A hole before the channels of the file are known may be anybody's.
        if topics.is_empty() {
            rods.extend(0..self.rods.len());
        }
        let names: Vec<&str> = topics
            .iter()
            .filter_map(|topic| Some(self.topics.get(*topic)?.name.as_str()))
            .collect();
        let detail = hole.sentence(names.into_iter());
        for at in rods {
            if let Some(rod) = self.rods.get_mut(at) {
                let rejection = Rejection::Damaged {
                    detail: detail.clone(),
                };
                rod.assembler
                    .tell_lost(hole.start(), hole.duration_s(), rejection);
            }
        }
        self.holes.push(detail);
        self.collect(false);
    }
}
