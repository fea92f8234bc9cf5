//! Columns that repeat fields of a record's row, so that SQL and spreadsheets can query them.

use crate::analysis::track::SetAside;
use crate::site::record_row::RecordRow;
use rusqlite::types::Value;
use serde::Serialize;

/// One column: name, SQL type, and the function that gives its value for a record.
pub(super) struct Column {
    pub(super) name: &'static str,
    sql: &'static str,
    pub(super) of: fn(&RecordRow) -> Value,
}

const TEXT: &str = "TEXT";
const REQUIRED: &str = "TEXT NOT NULL";
const INTEGER: &str = "INTEGER";
const REAL: &str = "REAL";

const fn column(name: &'static str, sql: &'static str, of: fn(&RecordRow) -> Value) -> Column {
    Column { name, sql, of }
}

/// Columns in the table's order, one per line.
#[rustfmt::skip]
pub(super) const COLUMNS: [Column; 47] = [
    column("start", TEXT, |row| row.start.map(|time| time.to_string()).into()),
    column("duration_s", REAL, |row| real(row.duration_s)),
    column("fs_hz", REAL, |row| real(row.fs_hz)),
    column("state", REQUIRED, |row| text(Some(&row.state))),
    column("state_reason", TEXT, |row| text(row.state_reason.as_ref())),
    column("segment", INTEGER, |row| integer(row.segment)),
    column("set_aside", TEXT, |row| text(row.set_aside.map(SetAside::code))),
    column("rejection", TEXT, |row| text(row.rejection.as_ref().map(|reason| &reason.code))),
    column("rejection_message", TEXT, |row| text(row.rejection.as_ref().map(|reason| &reason.message))),
    column("relative_force", REAL, |row| real(row.relative_force.map(|of| of.mean))),
    column("relative_force_sd", REAL, |row| real(row.relative_force.map(|of| of.sd))),
    column("relative_force_q025", REAL, |row| real(row.relative_force.map(|of| of.q025))),
    column("relative_force_q975", REAL, |row| real(row.relative_force.map(|of| of.q975))),
    column("relative_force_at_reference", REAL, |row| real(row.relative_force_at_reference.map(|of| of.mean))),
    column("relative_force_at_reference_sd", REAL, |row| real(row.relative_force_at_reference.map(|of| of.sd))),
    column("relative_force_at_reference_q025", REAL, |row| real(row.relative_force_at_reference.map(|of| of.q025))),
    column("relative_force_at_reference_q975", REAL, |row| real(row.relative_force_at_reference.map(|of| of.q975))),
    column("tracked_force_n", REAL, |row| real(row.tracked_force_n.map(|of| of.mean))),
    column("tracked_force_sd_n", REAL, |row| real(row.tracked_force_n.map(|of| of.sd))),
    column("tracked_force_q025_n", REAL, |row| real(row.tracked_force_n.map(|of| of.q025))),
    column("tracked_force_q975_n", REAL, |row| real(row.tracked_force_n.map(|of| of.q975))),
    column("force_at_reference_n", REAL, |row| real(row.force_at_reference_n.map(|of| of.mean))),
    column("force_at_reference_sd_n", REAL, |row| real(row.force_at_reference_n.map(|of| of.sd))),
    column("force_at_reference_q025_n", REAL, |row| real(row.force_at_reference_n.map(|of| of.q025))),
    column("force_at_reference_q975_n", REAL, |row| real(row.force_at_reference_n.map(|of| of.q975))),
    column("reference_temperature_c", REAL, |row| real(row.reference_temperature_c)),
    column("temperature_c", REAL, |row| real(row.temperature_c)),
    column("not_axial_p", REAL, |row| real(row.not_axial_p)),
    column("axial_force_n", REAL, |row| real(row.axial_force_n.map(|of| of.mean))),
    column("axial_force_sd_n", REAL, |row| real(row.axial_force_n.map(|of| of.sd))),
    column("axial_force_cv", REAL, |row| real(row.axial_force_n.map(|of| of.cv))),
    column("axial_force_q025_n", REAL, |row| real(row.axial_force_n.map(|of| of.q025))),
    column("axial_force_q50_n", REAL, |row| real(row.axial_force_n.map(|of| of.q50))),
    column("axial_force_q975_n", REAL, |row| real(row.axial_force_n.map(|of| of.q975))),
    column("parameters", TEXT, |row| json(&row.parameters)),
    column("epsilon", REAL, |row| real(row.epsilon)),
    column("draws", INTEGER, |row| integer(row.draws)),
    column("accepted", INTEGER, |row| integer(row.accepted)),
    column("ess", REAL, |row| real(row.ess)),
    column("conflict", REAL, |row| real(row.conflict)),
    column("prior_tail", REAL, |row| real(row.prior_tail)),
    column("flags", TEXT, |row| json(&row.flags)),
    column("seed", TEXT, |row| row.seed.map(|seed| seed.to_string()).into()),
    column("config", REQUIRED, |row| text(Some(&row.config))),
    column("analysis_version", INTEGER, |row| integer(row.analysis_version)),
    column("alarms", TEXT, |row| json(&row.alarms)),
    column("events", TEXT, |row| json(&row.events)),
];

fn text(value: Option<impl AsRef<str>>) -> Value {
    value.map(|text| text.as_ref().to_owned()).into()
}

/// A number; NULL if it is not finite, as in JSON.
fn real(value: Option<f64>) -> Value {
    value.filter(|number| number.is_finite()).into()
}

fn integer<T: TryInto<i64>>(value: Option<T>) -> Value {
    value.and_then(|number| number.try_into().ok()).into()
}

/// A JSON object or list as text, keys in alphabetical order.
fn json(value: &impl Serialize) -> Value {
    let value = serde_json::to_value(value).ok();
    value.map(|value| value.to_string()).into()
}

/// Column definitions of the table.
pub(super) fn definitions() -> String {
    let columns: Vec<String> = COLUMNS
        .iter()
        .map(|column| format!("{} {}", column.name, column.sql))
        .collect();
    columns.join(",\n            ")
}
