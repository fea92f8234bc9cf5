//! Sensors of rods with several that are left out of record after record: a condition each, until one is used again.

use super::{late_readings, unread};
use crate::analysis::identify::{LeftOut, Sensors};
use crate::analysis::signal::record::RodId;
use crate::config::Config;
use crate::service::telemetry::{Fault, Health};
use std::collections::BTreeMap;

/// Number of records in a row that each sensor was left out of.
#[derive(Debug, Default)]
pub struct Runs(BTreeMap<(RodId, String), usize>);

/// The condition of a sensor.
pub fn about(rod: &RodId, sensor: &str) -> String {
    format!("rod {rod}, sensor {sensor}")
}

impl Runs {
    /// Takes the sensors of a rod's record; `patience` records in a row without one are a condition.
    pub fn take(&mut self, rod: &RodId, sensors: &Sensors, patience: usize, health: &Health) {
        if sensors.is_of_one() {
            return;
        }
        for sensor in &sensors.used {
            self.0.remove(&(rod.clone(), sensor.clone()));
            health.over(Fault::LeftOut, &about(rod, sensor));
        }
        for LeftOut { sensor, why } in &sensors.left_out {
            let run = self.0.entry((rod.clone(), sensor.clone())).or_insert(0);
            *run += 1;
            if *run >= patience {
                health.hold(Fault::LeftOut, &about(rod, sensor), why);
            }
        }
    }

    /// Ends the conditions of sensors that are no longer configured.
    pub fn retain(&mut self, config: &Config, health: &Health) {
        let conditions = health.conditions();
        let is_configured = |text: &str| {
            config.rods.iter().any(|rod| {
                let id = &rod.analysis.rod;
                let mut sensors = rod.analysis.sensors.iter();
                let thermometer = rod.channels.temperature.as_ref();
                sensors.any(|sensor| about(id, &sensor.name) == text)
                    || thermometer.is_some_and(|channel| {
                        [unread::about, late_readings::about]
                            .iter()
                            .any(|about| about(id, &channel.topic) == text)
                    })
            })
        };
        for condition in conditions.iter().filter(|held| held.fault == Fault::LeftOut) {
            if !is_configured(&condition.about) {
                health.over(Fault::LeftOut, &condition.about);
            }
        }
        self.0
            .retain(|(rod, sensor), _| is_configured(&about(rod, sensor)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_is_a_condition_after_some_records_without_it_until_it_is_used() {
        let (health, rod, mut runs) = (Health::default(), RodId::from("north"), Runs::default());
        let without = Sensors {
            used: vec!["/a".to_owned()],
            left_out: vec![LeftOut {
                sensor: "/b".to_owned(),
                why: "no record".to_owned(),
            }],
        };
        let with = Sensors {
            used: vec!["/b".to_owned()],
            left_out: Vec::new(),
        };
        for (sensors, holds) in [
            (&without, false),
            (&with, false),
            (&without, false),
            (&without, true),
            (&without, true),
            (&with, false),
        ] {
            runs.take(&rod, sensors, 2, &health);
            assert_eq!(health.lasts(Fault::LeftOut, "rod north, sensor /b"), holds);
            assert!(!health.lasts(Fault::LeftOut, "rod north, sensor /a"));
        }
        runs.take(&rod, &without, 1, &health);
        runs.retain(&Config::built_in(), &health);
        assert!(health.conditions().is_empty());
    }
}
