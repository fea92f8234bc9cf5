//! Topics that belong to no rod, while nothing comes of a rod, of one of its sensors, or of its thermometer: most likely one is a
//! misspelling of the other.

use super::left_out;
use crate::config::unheard::{self, Unheard};
use crate::config::{Config, RodConfig};
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeSet;

/// Topics that are conditions at present.
#[derive(Debug, Default)]
pub struct Misnamed {
    held: BTreeSet<String>,
}

impl Misnamed {
    /// Checks the topics received; `is_unheard`: true for a rod without data, `is_unread` for one without a temperature reading so far.
    /// While every rod, sensor and thermometer has data, other topics are ignored.
    pub fn look(
        &mut self,
        health: &Health,
        config: &Config,
        is_unheard: impl Fn(&RodConfig) -> bool,
        is_unread: impl Fn(&RodConfig) -> bool,
    ) {
        let unheard: Vec<Unheard<'_>> = config
            .rods
            .iter()
            .flat_map(|rod| {
                let thermometer = Unheard::thermometer(rod).filter(|_| is_unread(rod));
                of_sensors(rod, is_unheard(rod), health)
                    .into_iter()
                    .chain(thermometer)
            })
            .collect();
        let mut holds = BTreeSet::new();
        for topic in health.strays().topics() {
            let Some(meant) = unheard::meant(config, &unheard, &topic) else {
                continue;
            };
            let detail = format!(
                "topic {topic} comes and belongs to no rod; of those of which nothing comes, {}",
                meant.remedy()
            );
            health.hold(Fault::Topic, &topic, detail);
            holds.insert(topic);
        }
        for topic in self.held.difference(&holds) {
            health.over(Fault::Topic, topic);
        }
        self.held = holds;
    }
}

/// Topics of a rod's sensors of which nothing comes: of one that has data those that are left out of every record.
fn of_sensors<'c>(rod: &'c RodConfig, is_unheard: bool, health: &Health) -> Vec<Unheard<'c>> {
    let id = &rod.analysis.rod;
    let is_left_out = |number: usize| {
        let sensor = rod.analysis.sensors.get(number);
        sensor.is_some_and(|sensor| health.lasts(Fault::LeftOut, &left_out::about(id, &sensor.name)))
    };
    let sensors = Unheard::sensors(rod, !is_unheard).enumerate();
    let sensors = sensors.filter(|(number, _)| is_unheard || is_left_out(*number));
    sensors.map(|(_, sensor)| sensor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelled_topic_of_a_further_sensor_is_named_with_the_one_meant() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
        let channel = "[rod.channel]\n";
        let several = text.replace(
            channel,
            "[[rod.sensor]]\ntopic = \"/laser/second\"\nat = 0.1\n[rod.channel]\nat = 0.4\n",
        );
        assert!(several.len() > text.len());
        let config = Config::parse(&several, "several.toml").unwrap();
        let (health, mut misnamed) = (Health::default(), Misnamed::default());
        for topic in ["/laser/secnd", "/imu"] {
            health.strays().came(topic);
        }
        let mut look = || misnamed.look(&health, &config, |_| false, |_| false);
        look();
        assert!(health.conditions().is_empty());
        let rod = &config.rods[0].analysis.rod;
        health.hold(
            Fault::LeftOut,
            &left_out::about(rod, "/laser/second"),
            "no record",
        );
        look();
        let conditions = health.conditions();
        let told: Vec<_> = conditions
            .iter()
            .filter(|held| held.fault == Fault::Topic)
            .collect();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].about == "/laser/secnd" && told[0].detail.contains("is /laser/second"));
        assert!(told[0].detail.contains("[[rod.sensor]]"));
        health.over(Fault::LeftOut, &left_out::about(rod, "/laser/second"));
        look();
        assert!(health.conditions().is_empty());
    }

    #[test]
    fn a_misspelled_topic_of_a_thermometer_is_named_though_every_rod_has_data() {
        let text = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/todi.toml")).unwrap();
        let text = text.replace(
            "[rod.channel]\n",
            "[rod.temperature]\ntopic = \"/niave/air\"\n[rod.channel]\n",
        );
        let config = Config::parse(&text, "todi.toml").unwrap();
        let (health, mut misnamed) = (Health::default(), Misnamed::default());
        for topic in ["/nave/air", "/imu"] {
            health.strays().came(topic);
        }
        // A rod that was never heard of has a topic as well; the thermometer's is nearer.
        for is_unheard in [false, true] {
            misnamed.look(&health, &config, |_| is_unheard, |_| true);
            let conditions = health.conditions();
            let told = conditions.iter().find(|held| held.about == "/nave/air").unwrap();
            assert!(told.detail.contains("is /niave/air") && told.detail.contains("[rod.temperature]"));
        }
        misnamed.look(&health, &config, |_| false, |_| false);
        assert!(health.conditions().is_empty());
    }
}
