//! Thermometers whose readings do not come in time for the records that they are for: a condition each, until a record has its temperature.

use super::left_out;
use crate::analysis::outcome::Outcome;
use crate::analysis::signal::record::{Reading, RodId, STALE_S, Timestamp};
use crate::config::Config;
use crate::service::telemetry::{Fault, Health};
use std::collections::{BTreeMap, VecDeque};

/// Most records of a rod whose readings may still come.
const MOST: usize = 64;
/// Most readings that are remembered, one in five minutes as records have them: two days.
const MOST_READINGS: usize = 576;

/// Records without a temperature, and how many of them have readings all the same.
#[derive(Debug, Default)]
pub struct LateReadings(BTreeMap<RodId, Late>);

#[derive(Debug, Default)]
struct Late {
    /// Begin and end of the latest records without a temperature.
    without: VecDeque<[Timestamp; 2]>,
    /// Times of the latest readings.
    readings: VecDeque<Timestamp>,
    /// Number of records in a row whose readings did not come in time.
    run: usize,
}

/// The condition of a rod's thermometer.
pub fn about(rod: &RodId, topic: &str) -> String {
    left_out::about(rod, &format!("readings of {topic}"))
}

impl LateReadings {
    /// Takes a record, in the order in which they come.
    pub fn record(&mut self, outcome: &Outcome, config: &Config, health: &Health) {
        if let Outcome::Identified(identification) = outcome
            && let Some(measurement) = &identification.measurement
        {
            let rod = &identification.rod;
            self.readings(rod, &measurement.readings, config, health);
            let end = measurement.start.plus_seconds(measurement.duration_s);
            let has_temperature = measurement.temperature_c.is_some();
            self.take(rod, [measurement.start, end], has_temperature, config, health);
        }
    }

    fn take(
        &mut self,
        rod: &RodId,
        span: [Timestamp; 2],
        has_temperature: bool,
        config: &Config,
        health: &Health,
    ) {
        let Some(topic) = topic(config, rod) else {
            return;
        };
        let late = self.0.entry(rod.clone()).or_default();
        if has_temperature {
            late.without.clear();
            late.run = 0;
            return health.over(Fault::LeftOut, &about(rod, topic));
        }
        late.without.truncate(MOST - 1);
        late.without.push_front(span);
        late.look(&about(rod, topic), topic, config, health);
    }

    /// Takes readings of a rod's thermometer.
    pub fn readings(&mut self, rod: &RodId, readings: &[Reading], config: &Config, health: &Health) {
        let (Some(topic), false) = (topic(config, rod), readings.is_empty()) else {
            return;
        };
        let late = self.0.entry(rod.clone()).or_default();
        late.readings.extend(readings.iter().map(|reading| reading.time));
        let over = late.readings.len().saturating_sub(MOST_READINGS);
        late.readings.drain(..over);
        late.look(&about(rod, topic), topic, config, health);
    }
}

impl Late {
    /// Counts records without a temperature for which there are readings.
    fn look(&mut self, about: &str, topic: &str, config: &Config, health: &Health) {
        let is_of = |reading: &Timestamp, [start, end]: &[Timestamp; 2]| {
            (start.plus_seconds(-(STALE_S as f64))..=*end).contains(reading)
        };
        let before = self.without.len();
        let readings = &self.readings;
        self.without
            .retain(|span| !readings.iter().any(|reading| is_of(reading, span)));
        self.run += before - self.without.len();
        if self.without.len() < before && self.run >= config.alarm.sensor_records {
            let detail = format!(
                "readings of {topic} do not come in time for the records that they are for: {} in a row had no temperature; bring its \
                 files sooner, or set [track] reorder_window_h to the hours that they take; samples and readings must come the same \
                 way, both through the folder or both through the sockets",
                self.run
            );
            health.hold(Fault::LeftOut, about, detail);
        }
    }
}

/// Topic of a rod's thermometer.
fn topic<'c>(config: &'c Config, rod: &RodId) -> Option<&'c str> {
    let rod = config.rods.iter().find(|own| own.analysis.rod == *rod)?;
    let channel = rod.channels.temperature.as_ref()?;
    Some(&channel.topic)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_that_come_too_late_are_told_until_a_record_has_its_own() {
        let text =
            std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/config/campaign.toml")).unwrap();
        let config = Config::parse(&text, "campaign.toml").unwrap();
        let rod = config.rods[0].analysis.rod.clone();
        let (health, mut late) = (Health::default(), LateReadings::default());
        let at = |minute: usize| {
            Timestamp::from_nanos(1_800_000_000_000_000_000).plus_seconds(60.0 * minute as f64)
        };
        let reading = |minute| Reading {
            time: at(minute),
            celsius: 7.0,
        };
        let is_told = || health.lasts(Fault::LeftOut, &about(&rod, "/nave/air"));
        let few = config.alarm.sensor_records;
        assert!(few > 1);
        for hour in 0..few {
            assert!(!is_told());
            late.take(&rod, [at(60 * hour), at(60 * hour + 5)], false, &config, &health);
            // Between the records, and for each a quarter of an hour before or less.
            late.readings(
                &rod,
                &[reading(60 * hour + 30), reading(60 * hour)],
                &config,
                &health,
            );
        }
        assert!(is_told());
        // Of one without any reading nothing is known.
        late.take(&rod, [at(6000), at(6005)], false, &config, &health);
        assert!(is_told() && late.0[&rod].run == few);
        // Readings that came another way, before the record.
        late.readings(&rod, &[reading(6030)], &config, &health);
        late.take(&rod, [at(6030), at(6035)], false, &config, &health);
        assert_eq!(late.0[&rod].run, few + 1);
        late.take(&rod, [at(6060), at(6065)], true, &config, &health);
        assert!(!is_told());
        for hour in 200..300 {
            late.take(&rod, [at(60 * hour), at(60 * hour + 5)], false, &config, &health);
        }
        assert!(!is_told() && late.0[&rod].without.len() == MOST);
    }
}
