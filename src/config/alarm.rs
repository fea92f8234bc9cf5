//! `[alarm]`: when alarms are raised and repeated.

use super::range::Range;
use super::reader::{Absent, Table, key};
use crate::analysis::signal::record::time::DAY_S;
use crate::analysis::track::AlarmSettings;

const HOUR_S: f64 = 3600.0;

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> AlarmSettings {
    let default = AlarmSettings::default();
    // Keys of the control charts of versions before: a configuration that has them is still read.
    table.ignore(&["step_k", "ramp_k"]);
    AlarmSettings {
        arl0_years: table.number(
            key("arl0_years", "mean time between false drift alarms of one rod [years]"),
            Range::within(0.1, 1000.0),
            default.arl0_years,
        ),
        compare_rods: table
            .take(
                key(
                    "compare_rods",
                    "whether the site's rods bear witness for each other; false: each is watched alone, as where they are in different buildings",
                ),
                "true or false",
                Absent::Default(default.compare_rods),
                |value| value.boolean(),
                bool::to_string,
            )
            .unwrap_or(default.compare_rods),
        limit_loss: table.number(
            key(
                "limit_loss",
                "relative loss of force since the baseline, at the reference temperature, that must not be exceeded [-]",
            ),
            Range::above(0.0, 0.9),
            default.limit_loss,
        ),
        limit_probability: table.number(
            key("limit_probability", "P(loss > limit_loss | data) from which on the limit counts as exceeded [-]"),
            Range::within(0.5, 0.9999),
            default.limit_probability,
        ),
        not_axial_p: table.number(
            key(
                "not_axial_p",
                "a period whose frequencies a change of axial force explains with less than this probability counts as not axial [-]",
            ),
            Range::above(0.0, 0.1),
            default.not_axial_p,
        ),
        conflict_sd: table.number(
            key("conflict_sd", "conflict of a record with the model that counts [sd]"),
            Range::within(1.0, 100.0),
            default.conflict_sd,
        ),
        confirm: table.integer(
            key("confirm", "periods or records in a row that raise, and that clear, a condition other than drift and suspected"),
            1,
            100,
            default.confirm as u64,
        ) as usize,
        sensor_records: table.integer(
            key("sensor_records", "rejected or implausible records in a row that mean the sensor needs attention"),
            1,
            1000,
            default.sensor_records as u64,
        ) as usize,
        silence_s: HOUR_S
            * table.number(
                key("silence_h", "time without a record after which there is no data [h]"),
                Range::within(0.1, 8784.0),
                default.silence_s / HOUR_S,
            ),
        repeat_s: DAY_S
            * table.number(
                key("repeat_d", "time after which an alarm nobody acknowledged is told again [d]"),
                Range::within(0.01, 366.0),
                default.repeat_s / DAY_S,
            ),
    }
}
