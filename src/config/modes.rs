//! `[modes]`: which natural frequencies are looked for, and where not.

use super::range::{Range, toml_float};
use super::reader::{Absent, Table, key};
use super::value::Value;
use crate::forward::MAX_MODES;
use crate::modes::{Mask, ModeSettings};

/// The section.
pub(super) fn read(table: &mut Table<'_>) -> ModeSettings {
    let default = ModeSettings::default();
    let count = table.integer(
        key("count", "mode orders looked for, from the first"),
        1,
        MAX_MODES as u64,
        default.count as u64,
    );
    let masks = table.take(
        key(
            "masks",
            "bands in which no peak is believed: mains hum, a bell motor, a pump [Hz]",
        ),
        "a list of { low_hz, high_hz }, 0 <= low_hz < high_hz <= 100000",
        Absent::Default(default.masks),
        |value| {
            value
                .array()?
                .iter()
                .map(mask)
                .collect::<Vec<_>>()
                .into_iter()
                .collect()
        },
        |masks| show(masks),
    );
    ModeSettings {
        count: count as usize,
        masks: masks.unwrap_or_default(),
    }
}

fn mask(value: &Value<'_>) -> Option<Mask> {
    value.inline(|table| {
        let range = Range::within(0.0, 1e5);
        let low_hz = table.maybe_number(key("low_hz", "lower end [Hz]"), range, Absent::Required);
        let high_hz = table.maybe_number(key("high_hz", "upper end [Hz]"), range, Absent::Required);
        let (low_hz, high_hz) = (low_hz?, high_hz?);
        if low_hz >= high_hz {
            table.fault(format!("low_hz = {low_hz} is not below high_hz = {high_hz}"));
        }
        Some(Mask { low_hz, high_hz })
    })
}

fn show(masks: &[Mask]) -> String {
    let masks: Vec<String> = masks
        .iter()
        .map(|mask| {
            format!(
                "{{ low_hz = {}, high_hz = {} }}",
                toml_float(mask.low_hz),
                toml_float(mask.high_hz)
            )
        })
        .collect();
    format!("[{}]", masks.join(", "))
}
