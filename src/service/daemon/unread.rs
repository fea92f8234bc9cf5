//! Thermometers that are configured and of which no reading ever came: a condition each, until one does.

use super::left_out;
use crate::analysis::signal::record::time::DAY_S;
use crate::analysis::signal::record::{RodId, Timestamp};
use crate::config::Config;
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeMap;

/// Time for which a rod has records and no reading until that is told \[s\]: the sparsest thermometers in use are read twice a week.
const PATIENCE_S: f64 = 4.0 * DAY_S;

/// The condition of a rod's thermometer.
pub fn about(rod: &RodId, topic: &str) -> String {
    left_out::about(rod, &format!("thermometer {topic}"))
}

/// Begins and ends the conditions; `unread` are rods without a reading so far, with the time since which those with records are expected.
pub fn look(health: &Health, config: &Config, unread: &BTreeMap<&RodId, Option<Timestamp>>, now: Timestamp) {
    for rod in &config.rods {
        let id = &rod.analysis.rod;
        let Some(channel) = &rod.channels.temperature else {
            continue;
        };
        let about = about(id, &channel.topic);
        match unread.get(id) {
            Some(Some(since)) if now.seconds_since(*since) >= PATIENCE_S => {
                let detail = format!(
                    "no reading of {} that can be believed has come since the rod was configured ({since}), though records of it \
                     did: what the temperature does to the force is not told apart from a drift; look at the thermometer, and at \
                     topic, field and unit in [rod.temperature]",
                    channel.topic
                );
                health.hold(Fault::LeftOut, &about, detail);
            }
            Some(_) => {}
            None => health.over(Fault::LeftOut, &about),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thermometer_that_never_comes_is_told_after_days_with_records() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
        let text = text.replace(
            "[rod.channel]\n",
            "[rod.temperature]\ntopic = \"/nave/air\"\n[rod.channel]\n",
        );
        let config = Config::parse(&text, "todi.toml").unwrap();
        let (health, rod) = (Health::default(), &config.rods[0].analysis.rod);
        let since = Timestamp::from_nanos(1_800_000_000_000_000_000);
        let about = about(rod, "/nave/air");
        for (unread, days, lasts) in [
            (Some(None), 10.0, false),
            (Some(Some(since)), 3.9, false),
            (Some(Some(since)), 4.1, true),
            (None, 5.0, false),
        ] {
            let unread = unread.map(|since| (rod, since)).into_iter().collect();
            look(&health, &config, &unread, since.plus_seconds(days * DAY_S));
            assert_eq!(health.lasts(Fault::LeftOut, &about), lasts, "after {days} days");
        }
    }
}
