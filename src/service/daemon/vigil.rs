//! The watch over the daemon itself: its conditions, its clock, topics that belong to no rod.

use super::misnamed::Misnamed;
use super::wall_clock::{Began, WallClock};
use super::{pending, unread};
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::config::Config;
use crate::service::alert::Conditions;
use crate::service::telemetry::{Fault, Health};
use crate::site::clock;
use crate::site::overlap;
use crate::site::store::{ConditionEvent, Store, StoreError, Stretch};
use crate::site::trackers::Site;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Interval at which the store records that a daemon is working.
const ALIVE_EVERY: Duration = Duration::from_secs(300);
/// Time for which the sources may be ahead of the analysis: once it had caught up, and after a start, when there may be an
/// archive to read. No rod counts as silent meanwhile.
const BEHIND: Duration = Duration::from_mins(15);
const BEHIND_AT_START: Duration = Duration::from_hours(24);
/// Subject of the condition of the clock.
const CLOCK: &str = "clock";
/// Largest age of a present record, and largest lead of its clock \[s\].
const FRESH_S: f64 = 86_400.0;
const AHEAD_S: f64 = 600.0;

/// The watch.
pub struct Vigil {
    health: Arc<Health>,
    conditions: Conditions,
    /// Notices that the store does not have yet.
    unkept: Vec<ConditionEvent>,
    clock: WallClock,
    /// Last time at which the store recorded that a daemon is working.
    alive: Option<Instant>,
    misnamed: Misnamed,
    lag: Lag,
}

/// Time for which the sources are ahead of the analysis.
#[derive(Debug)]
struct Lag {
    since: Instant,
    /// Longest such time that is nothing to be told.
    patience: Duration,
}

impl Lag {
    fn new(now: Instant) -> Self {
        Self {
            since: now,
            patience: BEHIND_AT_START,
        }
    }

    /// Returns the time of a lag that lasts too long \[h\].
    fn look(&mut self, is_caught_up: bool, now: Instant) -> Option<f64> {
        if is_caught_up {
            (self.since, self.patience) = (now, BEHIND);
        }
        let lasts = now.saturating_duration_since(self.since);
        (lasts >= self.patience).then_some(lasts.as_secs_f64() / 3600.0)
    }
}

impl Vigil {
    /// Begins the watch over the daemon of a configuration; `told` are begins of conditions that were told past the store. Returns also the time up to which the rods' silence before the start counts: now, or the end of the last daemon's
    /// work if the clock is in doubt.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn begin(
        store: &Store,
        told: Vec<ConditionEvent>,
        config: &Config,
        health: Arc<Health>,
    ) -> Result<(Self, Timestamp), StoreError> {
        let (wall, now) = (clock::now(), Instant::now());
        let last = store.stretches()?.last().copied();
        let (clock, began) = WallClock::begin(last, wall, now);
        let mut unkept = Vec::new();
        for begun in told {
            if !store.has_notice(&begun.condition)? {
                unkept.push(begun);
            }
        }
        let mut standing = store.standing_notices()?;
        standing.extend(unkept.iter().cloned());
        standing
            .iter()
            .for_each(|notice| stands_on(notice, config, &health));
        let mut silent_from = wall;
        match (began, last) {
            (Began::Even, _) | (_, None) => {}
            (Began::Outage(_), Some(last)) => {
                let detail = format!(
                    "no daemon was at work from {} to {wall}: nothing was measured",
                    last.to
                );
                health.fault(Fault::Outage, &detail);
                let begun = ConditionEvent::raised(Fault::Outage.code(), "daemon", last.to, &detail);
                unkept.extend([begun.clone(), begun.cleared(wall)]);
            }
            (Began::Doubted(away_s), Some(last)) => {
                silent_from = last.to;
                let detail = format!(
                    "the clock says {wall}, {:.1} days after a daemon was last at work ({}): look at the clock. Until records of \
                     now arrive, silence counts from this start; no age counts time in which no daemon was at work",
                    away_s / 86_400.0,
                    last.to
                );
                health.hold(Fault::Clock, CLOCK, detail);
            }
        }
        let settle = Duration::from_secs_f64(config.alert.settle_s);
        let vigil = Self {
            conditions: Conditions::new(settle, standing),
            health,
            unkept,
            clock,
            alive: None,
            misnamed: Misnamed::default(),
            lag: Lag::new(now),
        };
        Ok((vigil, silent_from))
    }

    /// Sets another settling time.
    pub fn set_settle(&mut self, settle: Duration) {
        self.conditions.set_settle(settle);
    }

    /// Takes a tick of one second; `is_caught_up`: true if all data has been read.
    pub fn tick(&mut self, site: Option<&Site>, config: &Config, is_caught_up: bool) {
        let now = Instant::now();
        if let Some(step_s) = self.clock.look(clock::now(), now) {
            let detail = format!("the clock was set by {step_s:+.0} s while the daemon ran; look at it");
            self.health.hold(Fault::Clock, CLOCK, detail);
            self.alive = None;
        }
        if let Some(lasts_h) = self.lag.look(is_caught_up, now) {
            let detail = format!("for {lasts_h:.2} h there has been more to read than is analysed");
            self.health.hold(Fault::Behind, "sources", detail);
        } else if is_caught_up {
            self.health.over(Fault::Behind, "sources");
        }
        if let Some(site) = site {
            let unheard: Vec<&RodId> = site.unheard().collect();
            let unread: BTreeMap<&RodId, Option<Timestamp>> = site.unread().collect();
            self.misnamed.look(
                &self.health,
                config,
                |rod| unheard.contains(&&rod.analysis.rod),
                |rod| unread.contains_key(&rod.analysis.rod),
            );
            unread::look(&self.health, config, &unread, clock::now());
        }
    }

    /// Takes the start of a record: a present one confirms the clock.
    pub fn heard(&self, start: Timestamp) {
        if (-AHEAD_S..FRESH_S).contains(&clock::now().seconds_since(start)) {
            self.health.over(Fault::Clock, CLOCK);
        }
    }

    /// Checks the present conditions; returns new notices.
    pub fn look(&mut self) -> Vec<ConditionEvent> {
        let told = self
            .conditions
            .look(&self.health.conditions(), Instant::now(), clock::now());
        self.unkept.extend(told.iter().cloned());
        told
    }

    /// Data for the store to keep now, if any.
    pub fn due(&self) -> Option<(Vec<ConditionEvent>, Stretch)> {
        let is_due = self.alive.is_none_or(|alive| alive.elapsed() >= ALIVE_EVERY);
        (is_due || !self.unkept.is_empty()).then(|| (self.unkept.clone(), self.clock.stretch()))
    }

    /// Line beside the store that keeps over a restart what was told and the store does not have.
    pub fn pending(&self) -> String {
        pending::line(&self.unkept)
    }

    /// Stretch of work up to now, for the store at a clean end.
    pub fn last_stretch(&mut self) -> Stretch {
        self.clock.look(clock::now(), Instant::now());
        self.clock.stretch()
    }

    /// Records that the store has so many notices, and the mark that a daemon is working.
    pub fn kept(&mut self, notices: usize) {
        self.unkept.drain(..notices.min(self.unkept.len()));
        self.alive = Some(Instant::now());
    }
}

/// Holds a condition of before the start that only new data can end; the others are found again by looking.
fn stands_on(notice: &ConditionEvent, config: &Config, health: &Health) {
    let is = |fault: Fault| notice.fault == fault.code();
    // A topic that no rod reads is looked at again beside those of which nothing comes.
    if is(Fault::Topic) && !overlap::is_about(&notice.about) && !config.reads(&notice.about) {
        return health.strays().came(&notice.about);
    }
    let mut lasting = [Fault::Behind, Fault::Clock, Fault::LeftOut, Fault::Topic].into_iter();
    if let Some(fault) = lasting.find(|fault| is(*fault)) {
        health.hold(fault, &notice.about, &notice.detail);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_daemon_that_never_catches_up_is_behind_in_the_end() {
        let begun = Instant::now();
        let mut lag = Lag::new(begun);
        assert_eq!(lag.look(false, begun + BEHIND_AT_START - BEHIND), None);
        assert_eq!(lag.look(false, begun + BEHIND_AT_START), Some(24.0));
        let now = begun + BEHIND_AT_START;
        assert_eq!(lag.look(true, now), None);
        assert_eq!(lag.look(false, now + BEHIND / 2), None);
        assert_eq!(lag.look(false, now + BEHIND), Some(0.25));
    }

    #[test]
    fn what_data_alone_can_end_outlasts_a_restart() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
        let config = Config::parse(&text, "todi.toml").unwrap();
        let read = config.rods[0].channels.all().next().unwrap().topic.clone();
        let overlap = overlap::about(&config.rods[0].analysis.rod);
        let mut store = Store::in_memory().unwrap();
        let notices = [
            ("topic", "/west/disp"),
            ("topic", &read),
            ("topic", &overlap),
            ("behind", "sources"),
            ("sink", "mail"),
        ]
        .map(|(fault, about)| ConditionEvent::raised(fault, about, clock::now(), "stood before"));
        store.watch(&notices, None).unwrap();
        let health = Arc::<Health>::default();
        Vigil::begin(&store, Vec::new(), &config, Arc::clone(&health)).unwrap();
        assert_eq!(health.strays().topics(), ["/west/disp"]);
        assert!(health.lasts(Fault::Behind, "sources"));
        assert!(health.lasts(Fault::Topic, &read) && health.lasts(Fault::Topic, &overlap));
        // The sink is tried anew.
        assert!(!health.lasts(Fault::Sink, "mail"));
    }
}
