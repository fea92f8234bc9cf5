//! Readings in degrees Fahrenheit behind readings in degrees Celsius, told by what they are once converted.

use super::JUMP_K;
use crate::signal::record::Reading;
use serde::{Deserialize, Serialize};

/// Most by which the first of them, converted, lies from the last reading before, and by which later ones differ from one to the next \[K\]:
/// less than what a return to Celsius makes from -12 degC on.
const FIRST_K: f64 = 6.0;
const NEXT_K: f64 = 10.0;

/// Silence after which what a thermometer read before says nothing of its unit \[s\].
const FORGOTTEN_S: f64 = 14.0 * 86_400.0;

/// Readings that go on as degrees Fahrenheit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Fahrenheit {
    /// The last of them, converted \[degC\].
    last: Reading,
    /// True if the one after it did not go on so.
    has_strayed: bool,
}

impl Fahrenheit {
    /// The first of them, far from the last reading before it and from the level of days, if it lies where it would in degrees Fahrenheit; a
    /// level that one wild reading left is no jump.
    pub fn begins(reading: &Reading, [last_c, level_c]: [f64; 2]) -> Option<Self> {
        let is_far = [last_c, level_c]
            .iter()
            .all(|known_c| (reading.celsius - known_c).abs() > JUMP_K);
        let converted = converted(reading);
        // The reading may be off the level of days.
        let is_near =
            (converted.celsius - last_c).abs() <= FIRST_K && (converted.celsius - level_c).abs() <= JUMP_K;
        (is_far && is_near).then_some(Self {
            last: converted,
            has_strayed: false,
        })
    }

    /// True if a reading goes on as those before it: in winter they come near what was read in Celsius in summer. `None` ends them: the
    /// second in a row that does not, or a long silence.
    pub fn goes_on(&mut self, reading: &Reading) -> Option<bool> {
        let (passed_s, converted) = (reading.time.seconds_since(self.last.time), converted(reading));
        let goes_on = (converted.celsius - self.last.celsius).abs() <= NEXT_K;
        if passed_s > FORGOTTEN_S || (!goes_on && self.has_strayed) {
            return None;
        }
        self.has_strayed = !goes_on;
        if goes_on && passed_s > 0.0 {
            self.last = converted;
        }
        Some(goes_on)
    }
}

/// A reading in degrees Fahrenheit \[degC\].
fn converted(reading: &Reading) -> Reading {
    Reading {
        celsius: (reading.celsius - 32.0) / 1.8,
        ..*reading
    }
}
