//! `[modes]` and `[rod.modes]`: natural frequencies searched for, and where.

use super::range::{Range, toml_float};
use super::reader::{Absent, Table, key};
use super::value::{Value, toml_floats};
use crate::analysis::rod::beam::forward::{MAX_MODES, MAX_ORDERS};
use crate::analysis::signal::modes::{Mask, ModeSettings, ModeWindow};

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> ModeSettings {
    let default = ModeSettings::default();
    let count = table.integer(
        key(
            "count",
            "mode orders that the force uses, from the first; 1 says that the first mode is among the peaks",
        ),
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
    let least_probability = table.number(
        key(
            "least_probability",
            "least joint probability of the mode orders told; below it there is no force [-]",
        ),
        Range::within(0.5, 0.9999),
        default.least_probability,
    );
    ModeSettings {
        count: count as usize,
        masks: masks.unwrap_or_default(),
        least_probability,
        ..default
    }
}

/// Modes of one rod: the site's with the rod's own settings.
pub(super) fn of_rod(table: &mut Table<'_>, shared: &ModeSettings) -> ModeSettings {
    let band_hz = table.take(
        key("band_hz", "lowest and highest frequency of any mode [Hz]"),
        "[low, high], 0 < low < high <= 100000",
        Absent::Nothing("all that the prior allows"),
        band,
        |band_hz| toml_floats(band_hz),
    );
    let windows = table.take(
        key(
            "windows",
            "modes assigned by hand: the clearest peak in a window is that mode [Hz]",
        ),
        format!("a list of {{ order, low_hz, high_hz }}, orders 1 to {MAX_ORDERS} ascending, windows apart"),
        Absent::Default(Vec::new()),
        windows,
        |windows| show_windows(windows),
    );
    ModeSettings {
        band_hz,
        windows: windows.unwrap_or_default(),
        ..shared.clone()
    }
}

fn band(value: &Value<'_>) -> Option<[f64; 2]> {
    let list = value.numbers(Range::above(0.0, 1e5), 2, 2)?;
    let band_hz = [list[0], list[1]];
    if band_hz[0] >= band_hz[1] {
        value.fault(format!("{} is not below {}", band_hz[0], band_hz[1]));
        return None;
    }
    Some(band_hz)
}

fn windows(value: &Value<'_>) -> Option<Vec<ModeWindow>> {
    let windows: Vec<ModeWindow> = value
        .array()?
        .iter()
        .map(window)
        .collect::<Vec<_>>()
        .into_iter()
        .collect::<Option<_>>()?;
    for pair in windows.windows(2) {
        if pair[0].order >= pair[1].order {
            value.fault(format!(
                "mode {} comes after mode {}",
                pair[1].order, pair[0].order
            ));
            return None;
        }
        if pair[0].high_hz > pair[1].low_hz {
            value.fault(format!(
                "the window of mode {} ends above the beginning of that of mode {}",
                pair[0].order, pair[1].order
            ));
            return None;
        }
    }
    Some(windows)
}

fn window(value: &Value<'_>) -> Option<ModeWindow> {
    value.inline(|table| {
        let order = table.take(
            key("order", "mode order"),
            format!("1 <= order <= {MAX_ORDERS}"),
            Absent::Required,
            |value| value.integer(1, MAX_ORDERS as u64),
            u64::to_string,
        );
        let (low_hz, high_hz) = ends(table)?;
        Some(ModeWindow {
            order: order? as usize,
            low_hz,
            high_hz,
        })
    })
}

fn mask(value: &Value<'_>) -> Option<Mask> {
    value.inline(|table| {
        let (low_hz, high_hz) = ends(table)?;
        Some(Mask { low_hz, high_hz })
    })
}

/// Reads both ends of a range of frequencies.
fn ends(table: &mut Table<'_>) -> Option<(f64, f64)> {
    let range = Range::within(0.0, 1e5);
    let low_hz = table.maybe_number(key("low_hz", "lower end [Hz]"), range, Absent::Required);
    let high_hz = table.maybe_number(key("high_hz", "upper end [Hz]"), range, Absent::Required);
    let (low_hz, high_hz) = (low_hz?, high_hz?);
    if low_hz >= high_hz {
        table.fault(format!("low_hz = {low_hz} is not below high_hz = {high_hz}"));
    }
    Some((low_hz, high_hz))
}

fn show_windows(windows: &[ModeWindow]) -> String {
    let windows: Vec<String> = windows
        .iter()
        .map(|window| {
            format!(
                "{{ order = {}, low_hz = {}, high_hz = {} }}",
                window.order,
                toml_float(window.low_hz),
                toml_float(window.high_hz)
            )
        })
        .collect();
    format!("[{}]", windows.join(", "))
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
