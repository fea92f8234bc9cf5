//! Sites of which nothing is heard, neither result nor heartbeat, and sites whose clock is wrong.

use super::beats::Heard;
use super::centre::SiteState;
use crate::config::settings::hub::SiteSettings;
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeMap;

/// Interval of looks \[ns\].
const EVERY_NS: i64 = 1_000_000_000;
/// Largest distance of a site's clock from the post's that is not told \[s\].
pub const CLOCK_OFF_S: f64 = 60.0;

/// The watch over the silence of all sites.
pub struct Silence {
    /// Latest heartbeat of each site.
    beats: BTreeMap<String, Heard>,
    /// Time since which the post is heard \[ns since 1970\]: no site was silent because the hub was deaf.
    since_ns: i64,
    /// The same of heartbeats; `None` while they are not heard.
    beats_since_ns: Option<i64>,
    looked_ns: i64,
}

impl Silence {
    /// Begins with the heartbeats that the database has.
    pub fn begin(beats: BTreeMap<String, Heard>, now_ns: i64) -> Self {
        Self {
            beats,
            since_ns: now_ns,
            beats_since_ns: None,
            looked_ns: 0,
        }
    }

    /// True once a second, and after the clock was set.
    pub fn is_due(&mut self, now_ns: i64) -> bool {
        let is_due = !(0..EVERY_NS).contains(&now_ns.saturating_sub(self.looked_ns));
        if is_due {
            self.looked_ns = now_ns;
        }
        is_due
    }

    /// Takes heartbeats that came; `since_ns` is the time since which they are heard, if they are.
    pub fn take(&mut self, came: BTreeMap<String, Heard>, since_ns: Option<i64>) {
        self.beats.extend(came);
        self.beats_since_ns = since_ns;
    }

    /// Tells which sites are silent, which are again heard, and whose clock is wrong. A site of which nothing ever came is not
    /// there yet; of one without heartbeats nothing is said before `is_caught_up`, when all messages are read.
    pub fn tell(
        &self,
        listed: &[SiteSettings],
        known: &BTreeMap<String, SiteState>,
        health: &Health,
        (now_ns, is_caught_up): (i64, bool),
    ) {
        for site in listed {
            let name = &site.name;
            let beat = self.beats.get(name);
            let heard_ns = heard_ns(known.get(name), beat);
            if heard_ns == 0 || (beat.is_none() && !is_caught_up) {
                continue;
            }
            // Of a site that sends heartbeats nothing is known while none can be heard.
            let since_ns = beat.map_or(Some(self.since_ns), |_| {
                self.beats_since_ns.map(|ns| ns.max(self.since_ns))
            });
            let silent_s = since_ns.map_or(0.0, |since_ns| {
                now_ns.saturating_sub(heard_ns.max(since_ns)) as f64 * 1e-9
            });
            if now_ns.saturating_sub(heard_ns) as f64 * 1e-9 <= site.silent_s {
                health.over(Fault::Silent, name);
            } else if silent_s > site.silent_s && !health.lasts(Fault::Silent, name) {
                let since = super::sites::moment(heard_ns).unwrap_or_default();
                let detail = format!("site {name}: neither results nor heartbeats since {since}");
                health.hold(Fault::Silent, name, detail);
            }
            let off_s = beat.map_or(0.0, Heard::clock_off_s);
            if off_s.abs() <= CLOCK_OFF_S {
                health.over(Fault::Clock, name);
            } else if !health.lasts(Fault::Clock, name) {
                let detail = format!("site {name}: its clock is off by {off_s:+.0} s");
                health.hold(Fault::Clock, name, detail);
            }
        }
    }
}

/// Time at which the latest of a site was heard, result or heartbeat \[ns since 1970\]; 0 if nothing ever was.
pub fn heard_ns(known: Option<&SiteState>, beat: Option<&Heard>) -> i64 {
    let message_ns = known.map_or(0, |state| state.heard_ns);
    message_ns.max(beat.map_or(0, |heard| heard.heard_ns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::forward::beat::Heartbeat;

    const SECOND: i64 = 1_000_000_000;
    const BEGIN: i64 = 1_780_000_000 * SECOND;

    fn heard(at_s: i64, off_s: i64) -> BTreeMap<String, Heard> {
        let heard_ns = BEGIN + at_s * SECOND;
        let beat = Heartbeat {
            time_ns: heard_ns + off_s * SECOND,
            epoch: "00ff".to_owned(),
            through: 7,
            version: "0.1.0".to_owned(),
            state: "ok".to_owned(),
            rods: BTreeMap::new(),
            stopped_since: None,
            conditions: Vec::new(),
            refused: BTreeMap::new(),
        };
        [("todi".to_owned(), Heard { heard_ns, beat })].into()
    }

    #[test]
    fn a_site_is_silent_after_its_limit_in_which_the_hub_could_hear_it() {
        let listed = ["todi", "gubbio"].map(|name| SiteSettings {
            name: name.to_owned(),
            link: None,
            position: None,
            silent_s: 100.0,
            command_key: None,
            config: None,
        });
        let (health, none) = (Health::default(), BTreeMap::new());
        // A hub that was away for a day does not blame the site.
        let mut silence = Silence::begin(heard(-86_400, 0), BEGIN);
        silence.take(BTreeMap::new(), Some(BEGIN));
        let look = |silence: &Silence, at_s: i64| {
            silence.tell(&listed, &none, &health, (BEGIN + at_s * SECOND, true));
            (
                health.lasts(Fault::Silent, "todi"),
                health.lasts(Fault::Clock, "todi"),
            )
        };
        assert_eq!(look(&silence, 100), (false, false));
        assert_eq!(look(&silence, 101), (true, false));
        silence.take(heard(150, 59), Some(BEGIN));
        assert_eq!(look(&silence, 151), (false, false));
        silence.take(heard(160, -61), Some(BEGIN));
        assert_eq!(look(&silence, 161), (false, true));
        assert_eq!(look(&silence, 261), (true, true));
        silence.take(heard(300, 0), Some(BEGIN));
        assert_eq!(look(&silence, 300), (false, false));
        // While no heartbeat can be heard, its silence proves nothing.
        silence.take(BTreeMap::new(), None);
        assert_eq!(look(&silence, 420), (false, false));
        // Nothing ever came of the other.
        assert!(!health.lasts(Fault::Silent, "gubbio"));
        // A message is heard as a heartbeat is.
        let state = SiteState {
            heard_ns: BEGIN + 450 * SECOND,
            ..SiteState::default()
        };
        let known = [("todi".to_owned(), state)].into();
        silence.take(BTreeMap::new(), Some(BEGIN));
        silence.tell(&listed, &known, &health, (BEGIN + 500 * SECOND, true));
        assert!(!health.lasts(Fault::Silent, "todi"));
        silence.tell(&listed, &known, &health, (BEGIN + 551 * SECOND, true));
        assert!(health.lasts(Fault::Silent, "todi"));
    }

    #[test]
    fn a_look_is_due_once_a_second_and_after_the_clock_was_set() {
        let mut silence = Silence::begin(BTreeMap::new(), BEGIN);
        let due = [0, 1, SECOND, SECOND + 5, -SECOND, 1].map(|ns| silence.is_due(BEGIN + ns));
        assert_eq!(due, [true, false, true, false, true, true]);
    }
}
