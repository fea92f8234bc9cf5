//! Readings of the rod's thermometer: taken beside its samples, kept for later records, or told by themselves.

use super::Assembler;
use crate::signal::record::temperature::Temperature;
use crate::signal::record::{Event, Reading, Timestamp};

impl Assembler {
    /// Takes a temperature \[degC\].
    pub fn push_temperature(&mut self, time: Timestamp, celsius: f64) {
        if let Some(temperature) = &mut self.temperature {
            temperature.push(time, celsius);
        }
        self.release(false);
    }

    /// Takes over the temperatures of `other`, which came later than its own.
    pub fn append_temperatures(&mut self, other: &mut Self) {
        if let (Some(own), Some(later)) = (&mut self.temperature, &mut other.temperature) {
            own.append(std::mem::take(later));
        }
        self.release(false);
    }

    /// True if it has readings.
    pub fn has_readings(&self) -> bool {
        self.temperature.as_ref().is_some_and(Temperature::has_any)
    }

    /// Temperature readings up to `until` that belong to no record: between the last record and the end of
    /// the stream, or beside rejected stretches. None is returned twice.
    pub fn leftover(&mut self, until: Timestamp) -> Vec<Reading> {
        self.temperature
            .as_mut()
            .map_or_else(Vec::new, |readings| readings.take(until))
    }

    /// Makes an event of the readings at the end of the stream that belong to no record.
    pub fn tell_leftover(&mut self) {
        let readings = self.leftover(Timestamp::MAX);
        if let Some(last) = readings.last() {
            let at = last.time.max(Timestamp::from_nanos(self.at));
            let rod = self.rod.clone();
            self.events.push((at, Event::Readings { rod, readings }));
        }
    }

    /// Starts again after [`Assembler::finish`] with the readings of the latest day.
    pub fn remember(&mut self) {
        self.renew(true);
        if let Some(readings) = &mut self.temperature {
            readings.remember();
        }
    }
}
