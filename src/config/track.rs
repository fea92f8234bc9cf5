//! `[track]`: settings of tracking the relative force.

use super::range::Range;
use super::reader::{Table, key};
use crate::analysis::track::TrackSettings;
use crate::analysis::track::settings::TemperatureUse;

const USES: [(&str, TemperatureUse); 2] = [
    ("compensate", TemperatureUse::Compensate),
    ("ignore", TemperatureUse::Ignore),
];

const HOUR_S: f64 = 3600.0;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> TrackSettings {
    let default = TrackSettings::default();
    // A key of versions before, which knew one lag: lags are learned, whatever they are.
    table.ignore(&["thermal_lag_h"]);
    TrackSettings {
        baseline_records: table.integer(
            key("baseline_records", "accepted records that make up the baseline"),
            5,
            10_000,
            default.baseline_records as u64,
        ) as usize,
        learning_periods: table.integer(
            key(
                "learning_periods",
                "periods that teach what temperature does, the baseline's included: the level of changes is their mean, and limits count from then on",
            ),
            10,
            10_000,
            default.learning_periods as u64,
        ) as usize,
        period_s: HOUR_S
            * table.number(
                key("period_h", "length of a period: the records in it make one statistic of the drift watch [h]"),
                Range::within(1.0, 744.0),
                default.period_s / HOUR_S,
            ),
        reorder_window_s: HOUR_S
            * table.number(
                key("reorder_window_h", "how late a record may come and still count in its period; a file waits as long for readings that come in files of their own, half of alarm.silence_h at most [h]"),
                Range::within(0.0, 168.0),
                default.reorder_window_s / HOUR_S,
            ),
        discrepancy: table.number(
            key(
                "discrepancy",
                "least relative model discrepancy per mode the baseline allows for, if the rod states less [-]",
            ),
            Range::above(0.0, 0.5),
            default.discrepancy,
        ),
        particles: table.integer(
            key("particles", "particles of the static parameters the baseline leaves"),
            64,
            65_536,
            default.particles as u64,
        ) as usize,
        temperature: table.choice(
            key(
                "temperature",
                "compensate: the force is referred to one temperature; ignore: watched as it is",
            ),
            &USES,
            default.temperature,
        ),
        reference_temperature_c: table.optional_number(
            key("reference_temperature_c", "temperature to which the force is referred [degC]"),
            Range::within(-50.0, 80.0),
            "the baseline's mean",
        ),
        expansion_per_k: table.number(
            key("expansion_per_k", "thermal expansion of the rod's material [1/K]"),
            Range::above(0.0, 1e-4),
            default.expansion_per_k,
        ),
    }
}
