//! Temperature readings that cannot be what they claim: another unit, a broken wire, a thermometer that is
//! stuck.
//!
//! * `fahrenheit` readings in degrees Fahrenheit, by what they are in degrees Celsius
//! * `standstill` dead thermometers, by the law of the thermometer's own standstills

mod fahrenheit;
mod standstill;

use crate::signal::record::{POSSIBLE_C, Reading, Timestamp};
use fahrenheit::Fahrenheit;
use serde::{Deserialize, Serialize};
use standstill::{Standstill, Still};

/// Most that the temperature changes at once, what a day without readings and a day of doubted ones add, and the most in
/// any time \[K\]: weather and sun stay below, and degrees Fahrenheit lie at least 22 K above the same degrees Celsius
/// from -12 degC on.
const JUMP_K: f64 = 20.0;
const SILENT_K_PER_DAY: f64 = 0.5;
const DOUBTED_K_PER_DAY: f64 = 0.1;
const MOST_K: f64 = 45.0;

/// Readings that lie far from few accepted ones and near each other: so many, and so many times as many, overrule them.
const OVERRULING: u32 = 12;
const OVERRULING_TIMES: u32 = 3;

/// Readings from which there is a level, and those that its mean goes back.
const FEWEST: u32 = 24;
const LEVEL_READINGS: u32 = 48;

/// Memory for judging the next reading.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Thermometer {
    /// Last accepted reading.
    last: Option<Reading>,
    /// Time since which readings have lain far from it.
    away: Option<Timestamp>,
    /// Last of the readings that lie far from it and follow each other, and their number.
    #[serde(default)]
    elsewhere: Option<(Reading, u32)>,
    /// Number of accepted readings, and their level: a running mean \[degC\].
    #[serde(default)]
    accepted: u32,
    #[serde(default)]
    level_c: f64,
    /// Readings since it went away as one in degrees Fahrenheit would.
    #[serde(default)]
    fahrenheit: Option<Fahrenheit>,
    /// Law of its own standstills.
    #[serde(default)]
    standstill: Standstill,
    /// True while readings of the present standstill wait for later ones, or are not accepted.
    #[serde(default)]
    is_held: bool,
    /// Reason why the last reading was not believed.
    doubt: Option<Doubt>,
}

/// Time without readings after which a thermometer is silent \[s\]: the sparsest in use are read once a day.
const SILENT_S: f64 = 2.0 * 86_400.0;

/// Reason why a reading is not believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Doubt {
    /// It lies far from the readings before.
    Jump,
    /// It lies where it would in degrees Fahrenheit.
    Fahrenheit,
    /// It has not changed for longer than this thermometer's readings do.
    Still,
}

impl Thermometer {
    /// Judges a reading; returns true if it is accepted.
    pub fn believes(&mut self, reading: &Reading) -> bool {
        self.doubt = self.look(reading);
        self.doubt.is_none()
    }

    /// Time up to which readings are trusted. In a standstill that is rare for this thermometer it is that of
    /// its first reading: those after it wait until the temperature changes, and are withdrawn when it is
    /// found dead. `None` before any reading.
    pub fn trusted_until(&self) -> Option<Timestamp> {
        let last = self.last?.time;
        Some(if self.is_held {
            self.standstill.since().unwrap_or(last)
        } else {
            last
        })
    }

    /// True if equal readings, though trusted so far, may be those of a thermometer that died: at `now`, unless it is found dead
    /// already, or silent, and its readings are not used any more.
    pub fn may_have_died(&self, now: Timestamp) -> bool {
        let speaks = |last: &Reading| now.seconds_since(last.time) < SILENT_S;
        self.doubt.is_none() && self.last.as_ref().is_some_and(speaks) && self.standstill.is_unusual()
    }

    /// One clause for people with the reason why there is no temperature.
    pub fn message(&self) -> &'static str {
        match self.doubt {
            None => "no reading comes",
            Some(Doubt::Jump) => "the temperature jumped: check unit and wiring of the thermometer",
            Some(Doubt::Fahrenheit) => {
                "the temperature jumped as from degrees Celsius to Fahrenheit: check the unit of the thermometer"
            }
            Some(Doubt::Still) => {
                "the temperature has not changed for longer than it ever should: check the thermometer"
            }
        }
    }

    fn look(&mut self, reading: &Reading) -> Option<Doubt> {
        if !POSSIBLE_C.contains(&reading.celsius) {
            return Some(Doubt::Jump);
        }
        let Some(last) = self.last else {
            self.last = Some(*reading);
            (self.accepted, self.level_c) = (1, reading.celsius);
            self.standstill.take(reading);
            return None;
        };
        let passed_s = reading.time.seconds_since(last.time);
        if self.goes_on_as_fahrenheit(reading) {
            return Some(Doubt::Fahrenheit);
        }
        let away = self.away.unwrap_or(reading.time);
        let days = |from: Timestamp, to: Timestamp| to.seconds_since(from).abs() / 86_400.0;
        let jump_k =
            JUMP_K + SILENT_K_PER_DAY * days(last.time, away) + DOUBTED_K_PER_DAY * days(away, reading.time);
        if (reading.celsius - last.celsius).abs() > jump_k.min(MOST_K) {
            self.away = Some(away);
            if self.is_overruled_by(reading) {
                *self = Self::default();
                return self.look(reading);
            }
            if self.fahrenheit.is_none() && self.begins_as_fahrenheit(reading, &last) {
                return Some(Doubt::Fahrenheit);
            }
            return Some(Doubt::Jump);
        }
        (self.away, self.elsewhere) = (None, None);
        if passed_s <= 0.0 {
            return None;
        }
        self.accepted = self.accepted.saturating_add(1);
        self.level_c += (reading.celsius - self.level_c) / f64::from(self.accepted.min(LEVEL_READINGS));
        self.last = Some(*reading);
        let still = self.standstill.take(reading);
        self.is_held = still != Still::No;
        (still == Still::Dead).then_some(Doubt::Still)
    }

    /// True if the readings away follow each other, and are many beside few accepted ones: these were wild, as a thermometer's first
    /// reading after it was switched on may be, and not all that came since.
    fn is_overruled_by(&mut self, reading: &Reading) -> bool {
        let follows = |last: &Reading| (reading.celsius - last.celsius).abs() <= JUMP_K;
        let before = self
            .elsewhere
            .filter(|(last, _)| follows(last))
            .map_or(0, |(_, count)| count);
        self.elsewhere = Some((*reading, before + 1));
        self.accepted < FEWEST && before + 1 >= OVERRULING.max(OVERRULING_TIMES * self.accepted)
    }

    /// True if readings in degrees Fahrenheit begin with this one, which lies far from the last.
    fn begins_as_fahrenheit(&mut self, reading: &Reading, last: &Reading) -> bool {
        self.fahrenheit = Some([last.celsius, self.level_c])
            .filter(|_| self.accepted >= FEWEST)
            .and_then(|known_c| Fahrenheit::begins(reading, known_c));
        self.fahrenheit.is_some()
    }

    /// True if a reading goes on as those in degrees Fahrenheit before it.
    fn goes_on_as_fahrenheit(&mut self, reading: &Reading) -> bool {
        let goes_on = self.fahrenheit.as_mut().and_then(|known| known.goes_on(reading));
        if goes_on.is_none() {
            self.fahrenheit = None;
        }
        goes_on == Some(true)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(hour: f64, celsius: f64) -> Reading {
        Reading {
            time: Timestamp::from_nanos(0).plus_seconds(3600.0 * hour),
            celsius,
        }
    }

    fn of_a_month() -> Thermometer {
        let mut thermometer = Thermometer::default();
        for hour in 0..720 {
            let hour = f64::from(hour);
            assert!(thermometer.believes(&reading(hour, 8.0 + 8.0 * (hour * 0.2618).sin())));
        }
        thermometer
    }

    #[test]
    fn another_unit_and_a_broken_wire_are_no_weather() {
        for celsius in [-12.0, -5.0, 3.0, 10.0, 16.0] {
            let mut thermometer = of_a_month();
            thermometer.last = Some(reading(719.0, celsius));
            let fahrenheit = 1.8 * celsius + 32.0;
            for hour in 0..10 {
                assert!(!thermometer.believes(&reading(720.0 + f64::from(hour), fahrenheit)));
            }
            assert!(thermometer.message().contains("unit"));
            assert!(thermometer.believes(&reading(731.0, celsius + 1.0)));
        }
        for wrong in [85.0, -127.0, 1e9, f64::NAN, f64::INFINITY] {
            assert!(!of_a_month().believes(&reading(720.0, wrong)), "{wrong}");
        }
        // A summer after a winter without readings.
        let mut thermometer = of_a_month();
        thermometer.last = Some(reading(719.0, -2.0));
        assert!(thermometer.believes(&reading(720.0 + 24.0 * 150.0, 33.0)));
    }

    /// A year from May on: in January they read less than in Celsius on the day of the change.
    #[test]
    fn degrees_fahrenheit_are_not_believed_in_winter_either() {
        let mut thermometer = of_a_month();
        let celsius = |hour: f64| {
            let (day, year) = (
                hour / 24.0 * std::f64::consts::TAU,
                hour / 8766.0 * std::f64::consts::TAU,
            );
            10.0 + 12.0 * year.sin() + 5.0 * day.sin()
        };
        for hour in (0..8766).step_by(7).map(f64::from) {
            let wrong = reading(720.0 + hour, 1.8 * celsius(hour) + 32.0);
            assert!(!thermometer.believes(&wrong), "{hour} {}", wrong.celsius);
        }
        assert!(thermometer.message().contains("Fahrenheit"));
        assert!(thermometer.believes(&reading(720.0 + 8767.0, celsius(8767.0))));
        assert!(thermometer.believes(&reading(720.0 + 8768.0, celsius(8768.0))));
    }

    /// A first reading of zero, which those after it overrule, and one that was wild: what follows is far from it and no other unit.
    #[test]
    fn a_wild_reading_makes_no_degrees_fahrenheit_of_those_after_it() {
        let mut thermometer = Thermometer::default();
        assert!(thermometer.believes(&reading(0.0, 0.0)));
        let believed = (1..2400)
            .filter(|hour| thermometer.believes(&reading(f64::from(*hour), 27.0 + f64::from(hour % 3))));
        assert_eq!(believed.count(), 2399 - (OVERRULING as usize - 1));
        let mut thermometer = of_a_month();
        assert!(thermometer.believes(&reading(720.0, -4.0)));
        assert!(!thermometer.believes(&reading(721.0, 16.5)));
        assert!(thermometer.believes(&reading(722.0, 12.0)));
    }

    /// Ten good readings are not overruled by as many in another unit, and a level of a day by none.
    #[test]
    fn accepted_readings_are_overruled_only_by_many_more() {
        for (accepted, doubted) in [(1, 11), (10, 29), (24, 1000)] {
            let mut thermometer = Thermometer::default();
            for hour in 0..accepted {
                assert!(thermometer.believes(&reading(f64::from(hour), 12.0 + f64::from(hour % 2))));
            }
            for hour in 0..doubted {
                let at = reading(f64::from(accepted) + 0.1 * f64::from(hour), 55.0);
                assert!(!thermometer.believes(&at), "{accepted} {hour}");
            }
        }
        // What jumps about overrules nothing.
        let mut thermometer = Thermometer::default();
        assert!(thermometer.believes(&reading(0.0, 0.0)));
        let wild = |hour: u32| reading(f64::from(hour), if hour.is_multiple_of(2) { 30.0 } else { 60.0 });
        assert!((1..100).all(|hour| !thermometer.believes(&wild(hour))));
    }

    #[test]
    fn a_thermometer_that_stands_still_is_told_from_a_room_of_constant_temperature() {
        let mut thermometer = of_a_month();
        let believed = (0..100).filter(|&hour| thermometer.believes(&reading(720.0 + f64::from(hour), 9.0)));
        assert_eq!(believed.count(), 11);
        assert!(thermometer.message().contains("not changed"));
        // All but the first of the equal readings is withdrawn, not only those after it was found.
        assert_eq!(thermometer.trusted_until(), Some(reading(720.0, 9.0).time));
        assert!(thermometer.believes(&reading(821.0, 9.1)));
        assert_eq!(thermometer.trusted_until(), Some(reading(821.0, 9.1).time));
        // Constant from the start; later in steps of half a kelvin, each for weeks.
        let mut thermometer = Thermometer::default();
        for hour in 0..3000 {
            let celsius = 18.0 + 0.5 * f64::from(hour / 700);
            assert!(thermometer.believes(&reading(f64::from(hour), celsius)), "{hour}");
        }
    }

    #[test]
    fn equal_readings_that_are_not_everyday_may_be_of_a_dead_thermometer() {
        let mut thermometer = of_a_month();
        for (hour, celsius, may_have_died) in [(720.0, 9.0, false), (721.0, 9.0, true), (722.0, 9.1, false)] {
            assert!(thermometer.believes(&reading(hour, celsius)));
            let at = |hour: f64| reading(hour, celsius).time;
            assert_eq!(thermometer.may_have_died(at(hour)), may_have_died, "{hour}");
            // A silent one misleads nobody.
            assert!(!thermometer.may_have_died(at(hour + 49.0)), "{hour}");
        }
        // Nor does one that was found dead.
        let last = (722..822)
            .map(f64::from)
            .find(|&hour| !thermometer.believes(&reading(hour + 1.0, 9.1)))
            .unwrap();
        assert!(!thermometer.may_have_died(reading(last + 1.0, 9.1).time));
        // One that reads whole kelvins stands still for hours every day.
        let mut coarse = Thermometer::default();
        let celsius = |hour: u32| (8.0 + 4.0 * (f64::from(hour) * 0.2618).sin()).round();
        let doubted = (0..720)
            .filter(|&hour| {
                let reading = reading(f64::from(hour), celsius(hour));
                coarse.believes(&reading) && coarse.may_have_died(reading.time)
            })
            .count();
        assert!(doubted < 36, "{doubted}");
    }

    #[test]
    fn what_comes_late_is_judged_and_teaches_nothing() {
        let mut thermometer = of_a_month();
        let before = thermometer.clone();
        assert!(thermometer.believes(&reading(700.0, 9.0)));
        assert_eq!(thermometer, before);
        assert!(!thermometer.believes(&reading(700.0, 60.0)));
        assert!(thermometer.believes(&reading(720.0, 9.0)));
    }

    /// A state of an earlier version is resumed; its standstill is counted again.
    #[test]
    fn a_state_of_an_earlier_version_is_read() {
        let text =
            r#"{"last":{"time":0,"celsius":9.0},"away":null,"still":[0,7],"longest_s":7200.0,"doubt":null}"#;
        let written = text.replace(
            "\"time\":0",
            &format!(
                "\"time\":{}",
                serde_json::to_string(&reading(0.0, 9.0).time).unwrap()
            ),
        );
        let mut thermometer: Thermometer = serde_json::from_str(&written).unwrap();
        assert_eq!(thermometer.trusted_until(), Some(reading(0.0, 9.0).time));
        assert!(!thermometer.believes(&reading(1.0, 60.0)));
        assert!(thermometer.believes(&reading(2.0, 9.1)));
    }
}
