//! `[rod.channel]` and `[rod.temperature]`: location of a rod's samples in a recording.

use super::range::{Range, toml_string};
use super::reader::{Absent, Table, key};
use super::value::Value;
use crate::analysis::signal::record::{Channel, TimeSource, Unit};
use crate::recording::read::FieldPath;

/// Reads one channel; `field` and `unit` are the defaults, `units` the units allowed.
pub(super) fn read(table: &mut Table<'_>, field: &str, units: &[Unit], unit: Unit) -> Option<Channel> {
    let topic = table.take(
        key("topic", "topic of the messages"),
        "1 to 255 bytes of text",
        Absent::Required,
        |value| value.name_string().map(str::to_owned),
        |topic| toml_string(topic),
    );
    let field = table.take(
        key(
            "field",
            "path of the value in a message; a path to an array means one sample an entry",
        ),
        "names with dots between, indices in brackets: point.z, data[3]",
        Absent::Default(field.to_owned()),
        path,
        |path| toml_string(path),
    );
    let words: Vec<(&'static str, Unit)> = units.iter().map(|unit| (unit.key(), *unit)).collect();
    let unit = table.choice(key("unit", "unit of the values in the messages"), &words, unit);
    let time = table.take(
        key(
            "time",
            "stamp that is the time of a message's (first) sample: log time, publish time, or a field",
        ),
        "\"log\", \"publish\" or { field = \"path\" }",
        Absent::Default(TimeSource::Log),
        time,
        |time| match time {
            TimeSource::Log => "\"log\"".to_owned(),
            TimeSource::Publish => "\"publish\"".to_owned(),
            TimeSource::Field(path) => format!("{{ field = {} }}", toml_string(path)),
        },
    );
    let fs_hz = table.maybe_number(
        key(
            "fs_hz",
            "declared sample rate, checked against the stamps; arrays need it [Hz]",
        ),
        Range::within(1e-4, 1e8),
        Absent::Nothing("measured from the stamps"),
    );
    Some(Channel {
        topic: topic?,
        field: field?,
        unit,
        time: time?,
        fs_hz,
    })
}

fn time(value: &Value<'_>) -> Option<TimeSource> {
    if !value.is_table() {
        return value.choice(&[("log", false), ("publish", true)]).map(|publish| {
            if publish {
                TimeSource::Publish
            } else {
                TimeSource::Log
            }
        });
    }
    value.inline(|table| {
        let field = key("field", "path of the time in a message");
        table
            .take(field, "a path", Absent::Required, path, |path| toml_string(path))
            .map(TimeSource::Field)
    })
}

/// Reads a path into a message, in the form of the decoders.
fn path(value: &Value<'_>) -> Option<String> {
    let text = value.name_string()?;
    match FieldPath::parse(text) {
        Ok(_) => Some(text.to_owned()),
        Err(error) => {
            value.fault(error.to_string());
            None
        }
    }
}
