//! Conditions of the daemon for the sinks: each begin and end is reported once, after it has lasted. One that comes and goes again
//! and again is reported ever more rarely.

use crate::analysis::signal::record::Timestamp;
use crate::service::telemetry::{Condition, Fault};
use crate::site::store::ConditionEvent;
use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

/// Time after which an end is forgotten.
const FORGOTTEN: Duration = Duration::from_secs(86_400);
/// Longest absence that is asked for before an end is reported, but for longer settling times.
const LONGEST: Duration = Duration::from_secs(6 * 3600);

/// Conditions that were reported or are about to be.
#[derive(Debug)]
pub struct Conditions {
    /// Time for which a condition must last, or be absent, before it is reported. Each end within the last day doubles the time
    /// for which one must be absent that leaves monitoring at work: one that comes and goes all day makes at most some twenty messages, and then stands.
    settle: Duration,
    open: BTreeMap<(String, String), Open>,
    /// Number of ends reported within a day of each other, with the time of the latest.
    ends: BTreeMap<(String, String), (u32, Instant)>,
}

/// One condition.
#[derive(Debug)]
struct Open {
    begun: ConditionEvent,
    is_told: bool,
    /// Time since which it is absent.
    absent: Option<Instant>,
}

impl Conditions {
    /// Continues with the active conditions in the store.
    pub fn new(settle: Duration, standing: Vec<ConditionEvent>) -> Self {
        let open = standing.into_iter().map(|begun| {
            let key = (begun.fault.clone(), begun.about.clone());
            let open = Open {
                begun,
                is_told: true,
                absent: None,
            };
            (key, open)
        });
        Self {
            settle,
            open: open.collect(),
            ends: BTreeMap::new(),
        }
    }

    /// Sets another settling time.
    pub fn set_settle(&mut self, settle: Duration) {
        self.settle = settle;
    }

    /// Takes the present conditions and returns the notices to send. `wall` is the time by the machine's
    /// clock.
    pub fn look(&mut self, lasting: &[Condition], now: Instant, wall: Timestamp) -> Vec<ConditionEvent> {
        let mut told = Vec::new();
        self.ends
            .retain(|_, (_, latest)| now.saturating_duration_since(*latest) < FORGOTTEN);
        for condition in lasting {
            let key = (condition.fault.code().to_owned(), condition.about.clone());
            let lasted = now.saturating_duration_since(condition.since);
            let ends = self.ends.get(&key).map_or(0, |(count, _)| *count);
            let open = self.open.entry(key).or_insert_with_key(|(fault, about)| Open {
                begun: ConditionEvent::raised(
                    fault,
                    about,
                    wall.plus_seconds(-lasted.as_secs_f64()),
                    &condition.detail,
                ),
                is_told: false,
                absent: None,
            });
            open.absent = None;
            if !open.is_told && lasted >= self.settle {
                open.is_told = true;
                open.begun.detail.clone_from(&condition.detail);
                if ends > 0 {
                    let times = ends + 1;
                    open.begun
                        .detail
                        .push_str(&format!(" (number {times} within a day)"));
                }
                told.push(open.begun.clone());
            }
        }
        let (settle, ends) = (self.settle, &mut self.ends);
        let lasting: BTreeSet<(&str, &str)> = lasting
            .iter()
            .map(|condition| (condition.fault.code(), condition.about.as_str()))
            .collect();
        self.open.retain(|key, open| {
            let (fault, about) = key;
            if lasting.contains(&(fault.as_str(), about.as_str())) {
                return true;
            }
            if !open.is_told {
                return false;
            }
            let absent = *open.absent.get_or_insert(now);
            let absent_for = now.saturating_duration_since(absent);
            let count = ends.get(key).map_or(0, |(count, _)| *count);
            // That monitoring goes on again is told at once, however often it stopped.
            let doublings = if is_grave(fault) { 0 } else { count.min(20) };
            let is_over = absent_for >= settle.max(settle.saturating_mul(1 << doublings).min(LONGEST));
            if is_over {
                ends.insert(key.clone(), (count + 1, now));
                told.push(open.begun.cleared(wall.plus_seconds(-absent_for.as_secs_f64())));
            }
            !is_over
        });
        told
    }
}

/// True if results are not kept, or not made, while a condition of this code lasts.
fn is_grave(code: &str) -> bool {
    Fault::ALL
        .iter()
        .any(|fault| fault.is_grave() && fault.code() == code)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::telemetry::Health;

    const SETTLE: Duration = Duration::from_secs(60);

    fn at(s: u64) -> Timestamp {
        Timestamp::from_nanos(1_800_000_000_000_000_000).plus_seconds(s as f64)
    }

    /// Notices at each second of a condition that is present in some of them.
    fn told(conditions: &mut Conditions, there: &[(u64, u64)], until: u64) -> Vec<(u64, bool, String)> {
        let (health, begun) = (Health::default(), Instant::now());
        let mut told = Vec::new();
        let mut since = None;
        for s in 0..until {
            let is_there = there.iter().any(|(from, to)| (*from..*to).contains(&s));
            since = is_there.then(|| since.unwrap_or(s));
            health.over(Fault::Sink, "mail");
            if is_there {
                health.hold(Fault::Sink, "mail", "refused");
            }
            let mut lasting = health.conditions();
            for condition in &mut lasting {
                condition.since = begun + Duration::from_secs(since.unwrap_or(s));
            }
            for notice in conditions.look(&lasting, begun + Duration::from_secs(s), at(s)) {
                told.push((s, notice.is_raised, notice.condition));
            }
        }
        told
    }

    #[test]
    fn what_lasts_is_told_once_and_what_flaps_is_not() {
        let mut conditions = Conditions::new(SETTLE, Vec::new());
        // Short ones are passed over; a short absence does not end one that lasts.
        let told = told(&mut conditions, &[(0, 30), (100, 200), (230, 400)], 600);
        let said: Vec<(u64, bool)> = told.iter().map(|(s, raised, _)| (*s, *raised)).collect();
        assert_eq!(said, [(160, true), (460, false)]);
        assert_eq!(told[0].2, told[1].2, "one id");
    }

    #[test]
    fn what_comes_and_goes_all_day_is_told_a_few_times_and_ends_when_it_is_quiet() {
        // Five minutes there, five minutes gone, for ten hours; then gone.
        let flaps: Vec<(u64, u64)> = (0..60).map(|n| (600 * n, 600 * n + 300)).collect();
        let mut conditions = Conditions::new(SETTLE, Vec::new());
        let told = told(&mut conditions, &flaps, 60_000);
        let said: Vec<(u64, bool)> = told.iter().map(|(s, raised, _)| (*s, *raised)).collect();
        // Absences of 60, 120 and 240 s are ends; 480 s never passes until the flapping is over, at 35 700 s.
        let quiet = 35_700 + 480;
        assert_eq!(
            said,
            [
                (60, true),
                (360, false),
                (660, true),
                (1020, false),
                (1260, true),
                (1740, false),
                (1860, true),
                (quiet, false)
            ]
        );
        assert!(conditions.open.is_empty());
    }

    #[test]
    fn what_stood_before_the_start_is_not_told_again_and_ends_if_it_is_gone() {
        let begun = ConditionEvent::raised("sink", "mail", at(0), "refused");
        let mut conditions = Conditions::new(SETTLE, vec![begun.clone()]);
        assert!(told(&mut conditions, &[(0, 300)], 300).is_empty());
        let mut conditions = Conditions::new(SETTLE, vec![begun.clone()]);
        assert_eq!(told(&mut conditions, &[], 300), [(60, false, begun.condition)]);
    }
}
