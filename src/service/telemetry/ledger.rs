//! Ledger of faults: counts, conditions, and lines due to be logged; a pure fold over calls and their times.

use super::Fault;
use super::report::{ConditionLine, FaultLine, Phase, Report, State};
use std::collections::BTreeMap;
use std::time::{Duration, Instant};

/// Shortest time between two log lines of one kind of fault.
const LOG_EVERY: Duration = Duration::from_secs(60);

/// Time for which a past fault makes the state `degraded`.
const REMEMBERED: Duration = Duration::from_secs(15 * 60);

/// Most conditions of one kind held at once without further room: their subjects may come from outside. Of a kind each, so that many
/// of one kind keep none of another from being held.
const MOST_CONDITIONS: usize = 256;

/// Longest detail kept, in characters.
const LONGEST_DETAIL: usize = 500;

/// A lasting fault.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// Kind of the fault.
    pub fault: Fault,
    /// Subject: a sink, a folder, a file.
    pub about: String,
    /// Description in one sentence.
    pub detail: String,
    /// Begin of the condition.
    pub since: Instant,
    is_logged: bool,
}

#[derive(Debug, Default)]
pub(super) struct Ledger {
    kinds: BTreeMap<Fault, Kind>,
    conditions: BTreeMap<(Fault, String), Condition>,
    phase: Phase,
    /// Number of conditions of a kind that may be held beyond [`MOST_CONDITIONS`].
    room: usize,
}

#[derive(Debug, Default)]
struct Kind {
    count: u64,
    last: Option<Instant>,
    detail: String,
    logged: Option<Instant>,
    unlogged: u64,
}

impl Ledger {
    pub(super) fn make_room(&mut self, room: usize) {
        self.room = room;
    }

    /// Counts a fault; returns the line to log, unless one of its kind was logged less than a minute ago.
    pub(super) fn fault(&mut self, fault: Fault, detail: &str, now: Instant) -> Option<String> {
        let detail = clean(detail);
        let kind = self.kinds.entry(fault).or_default();
        kind.count += 1;
        kind.last = Some(now);
        kind.detail.clone_from(&detail);
        if !kind.is_due(now) {
            kind.unlogged += 1;
            return None;
        }
        kind.logged = Some(now);
        Some(match std::mem::take(&mut kind.unlogged) {
            0 => detail,
            more => format!("{detail} (and {more} more since the last line)"),
        })
    }

    /// Holds a condition; a new one counts as a fault.
    pub(super) fn hold(&mut self, fault: Fault, about: &str, detail: &str, now: Instant) -> Option<String> {
        let key = (fault, clean(about));
        if let Some(known) = self.conditions.get_mut(&key) {
            known.detail = clean(detail);
            return None;
        }
        let line = self.fault(fault, detail, now);
        let of_kind = self.conditions.range((fault, String::new())..);
        let count = of_kind.take_while(|((other, _), _)| *other == fault).count();
        if count < MOST_CONDITIONS + self.room {
            let condition = Condition {
                fault,
                about: key.1.clone(),
                detail: clean(detail),
                since: now,
                is_logged: line.is_some(),
            };
            self.conditions.insert(key, condition);
        }
        line
    }

    /// True if this condition holds now.
    pub(super) fn lasts(&self, fault: Fault, about: &str) -> bool {
        self.conditions.contains_key(&(fault, clean(about)))
    }

    /// Ends a condition; returns the line to log, if its begin was logged or it lasted for a while.
    pub(super) fn over(&mut self, fault: Fault, about: &str, now: Instant) -> Option<String> {
        let condition = self.conditions.remove(&(fault, clean(about)))?;
        // The condition held until now.
        let kind = self.kinds.entry(fault).or_default();
        kind.last = Some(now);
        let lasted = now.saturating_duration_since(condition.since);
        (condition.is_logged || lasted >= LOG_EVERY)
            .then(|| format!("{}: over after {} s", condition.about, lasted.as_secs()))
    }

    /// Lines for faults not logged when they happened whose minute is over.
    pub(super) fn due(&mut self, now: Instant) -> Vec<(Fault, String)> {
        let mut lines = Vec::new();
        for (fault, kind) in &mut self.kinds {
            if kind.unlogged > 0 && kind.is_due(now) {
                kind.logged = Some(now);
                let more = std::mem::take(&mut kind.unlogged);
                lines.push((
                    *fault,
                    format!("{more} more since the last line, the latest: {}", kind.detail),
                ));
            }
        }
        lines
    }

    pub(super) fn enter(&mut self, phase: Phase) {
        self.phase = phase;
    }

    pub(super) fn phase(&self) -> &Phase {
        &self.phase
    }

    pub(super) fn conditions(&self) -> Vec<Condition> {
        self.conditions.values().cloned().collect()
    }

    pub(super) fn count(&self, fault: Fault) -> u64 {
        self.kinds.get(&fault).map_or(0, |kind| kind.count)
    }

    pub(super) fn state(&self, now: Instant) -> State {
        let is_remembered = |kind: &Kind| {
            kind.last
                .is_some_and(|last| now.saturating_duration_since(last) < REMEMBERED)
        };
        if self.conditions.keys().any(|(fault, _)| fault.is_grave()) {
            State::Failing
        } else if self.phase.is_starting() {
            State::Starting
        } else if !self.conditions.is_empty() || self.kinds.values().any(is_remembered) {
            State::Degraded
        } else {
            State::Ok
        }
    }

    pub(super) fn report(&self, now: Instant) -> Report {
        let age_s = |then: Instant| now.saturating_duration_since(then).as_secs();
        let conditions = self.conditions.values().map(|condition| ConditionLine {
            fault: condition.fault.code(),
            about: condition.about.clone(),
            detail: condition.detail.clone(),
            for_s: age_s(condition.since),
        });
        let faults = self.kinds.iter().map(|(fault, kind)| FaultLine {
            fault: fault.code(),
            meaning: fault.meaning(),
            count: kind.count,
            last_s_ago: kind.last.map(age_s),
            last: kind.detail.clone(),
        });
        Report {
            state: self.state(now),
            phase: self.phase.clone(),
            conditions: conditions.collect(),
            faults: faults.collect(),
        }
    }
}

impl Kind {
    fn is_due(&self, now: Instant) -> bool {
        self.logged
            .is_none_or(|logged| now.saturating_duration_since(logged) >= LOG_EVERY)
    }
}

/// Makes a detail fit for one line of a log: no control characters, bounded length.
fn clean(detail: &str) -> String {
    let mut clean: String = detail
        .chars()
        .take(LONGEST_DETAIL)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if detail.chars().nth(LONGEST_DETAIL).is_some() {
        clean.push('…');
    }
    clean
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    fn serving() -> (Ledger, Instant) {
        let mut ledger = Ledger::default();
        ledger.enter(Phase::Serving);
        (ledger, Instant::now())
    }

    #[test]
    fn one_line_a_minute_of_each_kind_and_none_is_forgotten() {
        let (mut ledger, start) = serving();
        let at = |s: u32| start + s * SECOND;
        assert_eq!(
            ledger.fault(Fault::Client, "first", at(0)).as_deref(),
            Some("first")
        );
        for s in 1..=5 {
            assert_eq!(ledger.fault(Fault::Client, "again", at(s)), None);
        }
        assert_eq!(
            ledger.fault(Fault::Sink, "other", at(5)).as_deref(),
            Some("other"),
            "each kind has its own minute"
        );
        assert!(ledger.due(at(59)).is_empty());
        assert_eq!(
            ledger.due(at(60)),
            [(
                Fault::Client,
                "5 more since the last line, the latest: again".to_owned()
            )]
        );
        assert!(ledger.due(at(120)).is_empty(), "told once");
        assert_eq!(ledger.fault(Fault::Client, "a", at(130)).as_deref(), Some("a"));
        assert_eq!(ledger.fault(Fault::Client, "b", at(131)), None);
        assert_eq!(
            ledger.fault(Fault::Client, "c", at(190)).as_deref(),
            Some("c (and 1 more since the last line)")
        );
        assert_eq!(ledger.count(Fault::Client), 9);
    }

    #[test]
    fn a_fault_degrades_for_a_quarter_of_an_hour_and_a_condition_as_long_as_it_lasts() {
        let (mut ledger, start) = serving();
        let at = |s: u32| start + s * SECOND;
        assert_eq!(ledger.state(at(0)), State::Ok);
        ledger.fault(Fault::Rejected, "no peak", at(0));
        assert_eq!(ledger.state(at(899)), State::Degraded);
        assert_eq!(ledger.state(at(900)), State::Ok);

        ledger.hold(Fault::Sink, "mail", "refused", at(1000));
        ledger.hold(Fault::Sink, "mail", "still refused", at(2000));
        assert_eq!(ledger.count(Fault::Sink), 1, "it goes on, it is not new");
        assert_eq!(ledger.state(at(9000)), State::Degraded);
        assert_eq!(
            ledger.over(Fault::Sink, "mail", at(9000)).as_deref(),
            Some("mail: over after 8000 s")
        );
        assert_eq!(ledger.over(Fault::Sink, "mail", at(9001)), None);
        assert_eq!(
            ledger.state(at(9001)),
            State::Degraded,
            "it was true a second ago"
        );
        assert_eq!(ledger.state(at(9900)), State::Ok);
    }

    #[test]
    fn what_keeps_results_from_being_kept_is_failing() {
        let (mut ledger, now) = serving();
        ledger.hold(Fault::DiskFull, "store", "no space", now);
        assert_eq!(ledger.state(now), State::Failing);
        ledger.over(Fault::DiskFull, "store", now);
        assert_eq!(ledger.state(now), State::Degraded);
        assert_eq!(Ledger::default().state(now), State::Starting);
    }

    #[test]
    fn what_comes_from_outside_stays_one_short_line_and_bounded() {
        let (mut ledger, now) = serving();
        let line = ledger
            .fault(
                Fault::Client,
                &format!("a\nb\u{1b}[31m{}", "x".repeat(10_000)),
                now,
            )
            .unwrap();
        assert!(line.starts_with("a b [31mx") && line.chars().count() == LONGEST_DETAIL + 1);
        for i in 0..10_000 {
            ledger.hold(Fault::Recording, &format!("file {i}"), "unreadable", now);
        }
        assert_eq!(ledger.conditions().len(), MOST_CONDITIONS);
        assert_eq!(ledger.count(Fault::Recording), 10_000);
        ledger.hold(Fault::DiskFull, "store", "no space", now);
        assert_eq!(ledger.state(now), State::Failing, "many of a kind hide no other");
        let mut roomy = Ledger::default();
        roomy.make_room(44);
        for number in 0..10_000 {
            roomy.hold(Fault::Silent, &format!("site {number}"), "nothing came", now);
        }
        assert_eq!(roomy.conditions().len(), MOST_CONDITIONS + 44);
        assert!(roomy.lasts(Fault::Silent, "site 299") && !roomy.lasts(Fault::Silent, "site 300"));
    }
}
