//! Times for which the folder waits for what may still come.

use std::time::Duration;

/// Times for which the folder waits.
#[derive(Debug, Clone, Copy)]
pub struct Waits {
    /// Without growth, until a recording counts as cut short.
    pub(super) settle: Duration,
    /// For the file that goes on with open samples.
    pub(super) join: Duration,
    /// For the readings of a thermometer that writes files of its own.
    pub(super) readings: Duration,
}

impl Waits {
    /// The times in seconds; one beyond what a clock can count never ends.
    pub fn new(settle_s: f64, join_s: f64, readings_s: f64) -> Self {
        Self {
            settle: duration(settle_s),
            join: duration(join_s),
            readings: duration(readings_s),
        }
    }

    /// Changes the time for the readings of a thermometer.
    pub fn set_readings(&mut self, readings_s: f64) {
        self.readings = duration(readings_s);
    }
}

fn duration(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
}
