//! Times that a record cannot have: far ahead of the last one, or older than what is closed, until enough records agree on them.

use super::channels::Peer;
use super::{COMPARED_S, Plausibility, REMEMBERED};
use crate::signal::record::Timestamp;

/// Silence after which a record's time is doubted until others agree \[s\].
pub const JUMP_S: f64 = 90.0 * 86_400.0;

/// Longest silence that a site may have had \[s\]: it ends a baseline with the records before it, and other rods confirm its end. Behind a
/// longer one the clock was wrong, most likely.
pub(crate) const LONGEST_SILENCE_S: f64 = 3.0 * 365.25 * 86_400.0;

/// Time over which records must have gone on behind a silence until it counts as one for good \[s\]: what was recorded in it and comes later
/// is late, and takes back nothing.
const SETTLED_S: f64 = 30.0 * 86_400.0;

impl Plausibility {
    /// True while a time far ahead is doubted: until another rod's records are believed as far, or more than `patience` records in a row
    /// agree on it, of the site's rods together if half of `patience` are its own.
    pub(super) fn is_ahead(
        &mut self,
        start: Timestamp,
        latest: Timestamp,
        patience: usize,
        peers: &[Peer],
    ) -> bool {
        if start.seconds_since(latest) <= JUMP_S {
            self.ahead = None;
            return false;
        }
        let is_near = |time: Timestamp| start.seconds_since(time).abs() <= COMPARED_S;
        let count = match self.ahead {
            Some((last, count)) if start == last => count,
            Some((last, count)) if (0.0..=JUMP_S).contains(&start.seconds_since(last)) => count + 1,
            _ => 1,
        };
        let may_be_silence = start.seconds_since(latest) <= LONGEST_SILENCE_S;
        let peers = if may_be_silence { peers } else { &[] };
        // A rod that has just begun believes every clock.
        let is_known = |peer: &&Peer| peer.shown.len() == REMEMBERED;
        let is_there = (peers.iter().filter(is_known))
            .filter_map(|peer| peer.shown.back())
            .any(|last| is_near(last.time));
        // Channels of one recorder have one clock: each confirms no more than the rod's own records do.
        let theirs = peers
            .iter()
            .filter_map(|peer| peer.ahead)
            .filter(|(last, _)| is_near(*last));
        let others: usize = theirs.map(|(_, theirs)| theirs.min(count)).sum();
        let agreeing = if count > 1 && 2 * count > patience {
            count + others
        } else {
            count
        };
        let doubted = !is_there && agreeing <= patience;
        self.ahead = doubted.then_some((start, count));
        if !doubted {
            self.skipped = Some((latest, start));
        }
        doubted
    }

    /// True if the last record was one of this time, which was doubted.
    pub(crate) fn is_doubted_at(&self, start: Timestamp) -> bool {
        self.ahead.is_some_and(|(last, _)| last == start)
    }

    /// Notes a record older than periods already closed. Returns true if the clock was right before it jumped
    /// ahead, and is right again: more than `patience` records in a row lie in the time that the jump left out.
    pub fn is_back(&mut self, start: Timestamp, patience: usize) -> bool {
        self.behind += 1;
        let is_in_it = |(before, behind): (Timestamp, Timestamp)| before < start && start < behind;
        self.in_skipped = if self.skipped.is_some_and(is_in_it) {
            self.in_skipped + 1
        } else {
            0
        };
        self.in_skipped > patience
    }

    /// Notes the time of an accepted record: behind a jump that may have been a silence, records that go on make it one.
    pub(super) fn forget_silence(&mut self, start: Timestamp) {
        self.skipped = self.skipped.filter(|(before, behind)| {
            behind.seconds_since(*before) > LONGEST_SILENCE_S || start.seconds_since(*behind) <= SETTLED_S
        });
    }

    /// True if at least this many records in a row were older than periods already closed.
    pub fn is_behind(&self, patience: usize) -> bool {
        self.behind >= patience
    }
}

#[cfg(test)]
mod tests {
    use super::super::Doubt;
    use super::super::tests::{OWN, at, learned};
    use super::*;
    use crate::signal::record::RodId;
    use crate::track::observation::Observation;

    #[test]
    fn a_jump_of_the_clock_is_believed_only_when_it_lasts() {
        let (mut plausibility, last) = learned();
        let (rod, latest) = (RodId("a".into()), Some(last.start));
        let far = |day: f64| at(27_000.0 + day, OWN, 1e-4);
        assert_eq!(
            plausibility.doubt(&far(0.0), &rod, latest, &[], 3),
            Some(Doubt::Clock)
        );
        assert_eq!(
            plausibility.doubt(&at(10.0, OWN, 1e-4), &rod, latest, &[], 3),
            None
        );
        for day in 1..=3 {
            assert_eq!(
                plausibility.doubt(&far(f64::from(day)), &rod, latest, &[], 3),
                Some(Doubt::Clock)
            );
        }
        assert_eq!(plausibility.doubt(&far(4.0), &rod, latest, &[], 3), None);
        // Weeks of silence are no jump.
        assert_eq!(
            plausibility.doubt(&at(60.0, OWN, 1e-4), &rod, latest, &[], 3),
            None
        );
    }

    #[test]
    fn a_jump_is_taken_back_by_records_in_the_time_it_skipped_alone() {
        let (rod, patience) = (RodId("a".into()), 5);
        let day = |day: f64| at(day, OWN, 1e-4);
        // Records go on for some days behind a jump over some.
        let behind = |over: f64, goes_on: f64| {
            let (mut plausibility, last) = learned();
            let (mut latest, first) = (last.start, last.start.days() + over);
            for place in 0..=patience + goes_on as usize {
                let record = day(first + place as f64);
                if plausibility
                    .doubt(&record, &rod, Some(latest), &[], patience)
                    .is_none()
                {
                    plausibility.believe(&record);
                    latest = record.start;
                }
            }
            (plausibility, last.start.days())
        };
        let is_back = |of: &Plausibility, times: [f64; 6]| {
            let mut of = of.clone();
            times.map(|time| of.is_back(day(time).start, patience))[5]
        };
        let six = |from: f64| std::array::from_fn(|place| from + place as f64);
        let (winter, last) = behind(120.0, 10.0);
        assert!(is_back(&winter, six(last + 20.0)));
        // A clock set back by a week, and recordings that were missed since.
        assert!(!is_back(&winter, six(last + 127.0)));
        let mut mixed = six(last + 20.0);
        mixed[2] = last + 130.0;
        assert!(!is_back(&winter, mixed), "not in a row");
        // The site has been there again for weeks: it was a silence. Decades are none.
        assert!(!is_back(&behind(120.0, 60.0).0, six(last + 20.0)));
        assert!(is_back(&behind(27_000.0, 60.0).0, six(last + 20.0)));
    }

    #[test]
    fn a_jump_that_other_rods_made_is_believed_sooner() {
        let far = |day: f64| at(200.0 + day, OWN, 1e-4);
        let doubt = |mine: &mut Plausibility, last: &Observation, day: f64, peers: &[Peer]| {
            mine.doubt(&far(day), &RodId("a".into()), Some(last.start), peers, 5)
        };
        let peer = |of: &Plausibility| of.as_peer(&RodId("b".into()));
        // Another rod's clock has been believed there.
        let (mut mine, last) = learned();
        let mut there = Plausibility::default();
        for day in [-4.0, -3.0, -2.0, -1.0] {
            // It has just begun.
            let peers = [peer(&there)];
            assert_eq!(doubt(&mut mine.clone(), &last, 0.0, &peers), Some(Doubt::Clock));
            assert_eq!(there.doubt(&far(day), &RodId("b".into()), None, &[], 5), None);
        }
        assert_eq!(doubt(&mut mine, &last, 0.0, &[peer(&there)]), None);
        // Another rod that comes back at the same time: six records of both, three at least of each.
        let (mut mine, last) = learned();
        let (mut other, _) = learned();
        for day in [0.0, 1.0, 2.0] {
            let peers = [peer(&other)];
            assert_eq!(doubt(&mut mine, &last, day, &peers), Some(Doubt::Clock), "{day}");
            let peers = [peer(&mine)];
            let believed = (day < 2.0).then_some(Doubt::Clock);
            assert_eq!(doubt(&mut other, &last, day, &peers), believed, "{day}");
        }
        // No site is silent for decades.
        let (mut mine, last) = learned();
        let mut there = Plausibility::default();
        let rod = RodId("b".into());
        for day in 0..4 {
            let decades = at(27_000.0 + f64::from(day), OWN, 1e-4);
            assert_eq!(there.doubt(&decades, &rod, None, &[], 5), None);
        }
        let decades = at(27_004.0, OWN, 1e-4);
        let peers = [peer(&there)];
        assert_eq!(
            mine.doubt(&decades, &RodId("a".into()), Some(last.start), &peers, 5),
            Some(Doubt::Clock)
        );
        // A file of many channels with a wrong date.
        let (mut mine, last) = learned();
        let others = std::array::from_fn::<_, 10, _>(|_| {
            let (mut other, last) = learned();
            assert_eq!(doubt(&mut other, &last, 0.0, &[]), Some(Doubt::Clock));
            peer(&other)
        });
        assert_eq!(doubt(&mut mine, &last, 0.0, &others), Some(Doubt::Clock));
    }
}
