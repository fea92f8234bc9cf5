//! Columns that repeat fields of a record's JSON line, for SQL and spreadsheets.

use rusqlite::types::Value;
use serde_json::Value as Json;

/// One column: its name, its SQL type, and its path in the JSON line.
pub(super) struct Column {
    pub(super) name: &'static str,
    kind: Kind,
    pointer: &'static str,
}

#[derive(Clone, Copy)]
enum Kind {
    Text,
    Required,
    Integer,
    Real,
    /// An unsigned 64-bit number, as decimal text: SQLite's integers are signed.
    Seed,
    /// A JSON object or list.
    Json,
}

const fn column(name: &'static str, kind: Kind, pointer: &'static str) -> Column {
    Column { name, kind, pointer }
}

/// The columns in the table's order.
pub(super) const COLUMNS: [Column; 47] = [
    column("start", Kind::Text, "/start"),
    column("duration_s", Kind::Real, "/duration_s"),
    column("fs_hz", Kind::Real, "/fs_hz"),
    column("state", Kind::Required, "/state"),
    column("state_reason", Kind::Text, "/state_reason"),
    column("segment", Kind::Integer, "/segment"),
    column("set_aside", Kind::Text, "/set_aside"),
    column("rejection", Kind::Text, "/rejection/code"),
    column("rejection_message", Kind::Text, "/rejection/message"),
    column("relative_force", Kind::Real, "/relative_force/mean"),
    column("relative_force_sd", Kind::Real, "/relative_force/sd"),
    column("relative_force_q025", Kind::Real, "/relative_force/q025"),
    column("relative_force_q975", Kind::Real, "/relative_force/q975"),
    column(
        "relative_force_at_reference",
        Kind::Real,
        "/relative_force_at_reference/mean",
    ),
    column(
        "relative_force_at_reference_sd",
        Kind::Real,
        "/relative_force_at_reference/sd",
    ),
    column(
        "relative_force_at_reference_q025",
        Kind::Real,
        "/relative_force_at_reference/q025",
    ),
    column(
        "relative_force_at_reference_q975",
        Kind::Real,
        "/relative_force_at_reference/q975",
    ),
    column("tracked_force_n", Kind::Real, "/tracked_force_n/mean"),
    column("tracked_force_sd_n", Kind::Real, "/tracked_force_n/sd"),
    column("tracked_force_q025_n", Kind::Real, "/tracked_force_n/q025"),
    column("tracked_force_q975_n", Kind::Real, "/tracked_force_n/q975"),
    column("force_at_reference_n", Kind::Real, "/force_at_reference_n/mean"),
    column("force_at_reference_sd_n", Kind::Real, "/force_at_reference_n/sd"),
    column(
        "force_at_reference_q025_n",
        Kind::Real,
        "/force_at_reference_n/q025",
    ),
    column(
        "force_at_reference_q975_n",
        Kind::Real,
        "/force_at_reference_n/q975",
    ),
    column("reference_temperature_c", Kind::Real, "/reference_temperature_c"),
    column("temperature_c", Kind::Real, "/temperature_c"),
    column("not_axial_p", Kind::Real, "/not_axial_p"),
    column("axial_force_n", Kind::Real, "/axial_force_n/mean"),
    column("axial_force_sd_n", Kind::Real, "/axial_force_n/sd"),
    column("axial_force_cv", Kind::Real, "/axial_force_n/cv"),
    column("axial_force_q025_n", Kind::Real, "/axial_force_n/q025"),
    column("axial_force_q50_n", Kind::Real, "/axial_force_n/q50"),
    column("axial_force_q975_n", Kind::Real, "/axial_force_n/q975"),
    column("parameters", Kind::Json, "/parameters"),
    column("epsilon", Kind::Real, "/epsilon"),
    column("draws", Kind::Integer, "/draws"),
    column("accepted", Kind::Integer, "/accepted"),
    column("ess", Kind::Real, "/ess"),
    column("conflict", Kind::Real, "/conflict"),
    column("prior_tail", Kind::Real, "/prior_tail"),
    column("flags", Kind::Json, "/flags"),
    column("seed", Kind::Seed, "/seed"),
    column("config", Kind::Required, "/config"),
    column("analysis_version", Kind::Integer, "/analysis_version"),
    column("alarms", Kind::Json, "/alarms"),
    column("events", Kind::Json, "/events"),
];

/// Column definitions of the table.
pub(super) fn definitions() -> String {
    let columns: Vec<String> = COLUMNS
        .iter()
        .map(|column| {
            let kind = match column.kind {
                Kind::Text | Kind::Seed | Kind::Json => "TEXT",
                Kind::Required => "TEXT NOT NULL",
                Kind::Integer => "INTEGER",
                Kind::Real => "REAL",
            };
            format!("{} {kind}", column.name)
        })
        .collect();
    columns.join(",\n            ")
}

impl Column {
    /// Value of the column in a line; NULL if absent or of another type.
    pub(super) fn of(&self, line: &Json) -> Value {
        let Some(value) = line.pointer(self.pointer).filter(|value| !value.is_null()) else {
            return Value::Null;
        };
        match self.kind {
            Kind::Text | Kind::Required => value.as_str().map(|text| Value::Text(text.to_owned())),
            Kind::Integer => value.as_i64().map(Value::Integer),
            Kind::Real => value.as_f64().map(Value::Real),
            Kind::Seed => value.as_u64().map(|seed| Value::Text(seed.to_string())),
            Kind::Json => Some(Value::Text(value.to_string())),
        }
        .unwrap_or(Value::Null)
    }
}

/// Paths of the columns in a line.
#[cfg(test)]
pub(crate) fn pointers() -> impl Iterator<Item = &'static str> {
    COLUMNS.iter().map(|column| column.pointer)
}
