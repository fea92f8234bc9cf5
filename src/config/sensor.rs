//! `[[rod.sensor]]`: further sensors of a rod, beside that of `[rod.channel]`.

use super::RodConfig;
use super::channel;
use super::range::Range;
use super::reader::{Absent, Table, key};
use crate::analysis::identify::Sensor;
use crate::analysis::signal::record::{Beside, Channel, Unit};

/// Default of the relative standard error of a sensor's calibration.
const GAIN_ERROR: f64 = 0.01;
/// Default of the standard error of a sensor's place \[m\]: a tape measure's.
const PLACE_ERROR_M: f64 = 0.01;

/// Least time for which a sensor of a rod is waited for \[s\]: sensors that run together come in turn.
const LEAST_WAIT_S: f64 = 60.0;

/// A further sensor as written.
pub(super) struct Further {
    pub(super) channel: Channel,
    /// Its place, as a share of the length.
    at: f64,
    /// Standard error of its place \[m\].
    at_sd_m: f64,
    /// Relative standard error of its calibration \[-\].
    gain_sd: f64,
}

/// All sensors of a rod for its analysis, that of `[rod.channel]` first, with its place and errors; and the channels of the further ones.
pub(super) fn all(
    first: &Channel,
    (at, at_sd_m, gain_sd): (f64, f64, f64),
    further: Vec<Further>,
    wait_s: f64,
) -> (Vec<Sensor>, Beside) {
    let named = |channel: &Channel, (at, at_sd_m, gain_sd): (f64, f64, f64)| {
        let others = std::iter::once(first).chain(further.iter().map(|further| &further.channel));
        let is_topic_shared = others.filter(|other| other.topic == channel.topic).count() > 1;
        Sensor {
            name: match is_topic_shared {
                true => format!("{} {}", channel.topic, channel.field),
                false => channel.topic.clone(),
            },
            at,
            at_sd_m,
            unit: channel.unit,
            gain_sd,
        }
    };
    let mut sensors = vec![named(first, (at, at_sd_m, gain_sd))];
    sensors.extend(
        further
            .iter()
            .map(|own| named(&own.channel, (own.at, own.at_sd_m, own.gain_sd))),
    );
    let channels = further.into_iter().map(|further| further.channel).collect();
    let wait_s = wait_s.max(LEAST_WAIT_S);
    (sensors, Beside { channels, wait_s })
}

/// Refuses a silence that is told before the records of a rod one of whose sensors died.
pub(super) fn check_patience(root: &Table<'_>, silence_s: f64, rods: &[Option<RodConfig>]) {
    for rod in rods.iter().flatten() {
        if let Some(beside) = rod
            .channels
            .beside
            .as_ref()
            .filter(|beside| beside.wait_s >= silence_s)
        {
            root.fault_of(
                "alarm",
                format!(
                    "silence_h = {} is not longer than the {} h for which a sensor of rod {} is waited for (track.reorder_window_h, a \
                     minute at least): one that dies would be told as no data of the rod",
                    silence_s / 3600.0,
                    beside.wait_s / 3600.0,
                    rod.analysis.rod
                ),
            );
        }
    }
}

/// Place of the sensor of `[rod.channel]`, wanted where there are others, with its standard error \[m\], and error of the calibration.
/// They say nothing of a sensor that is alone.
pub(super) fn of_channel(table: &mut Table<'_>, has_others: bool) -> (Option<f64>, f64, f64) {
    let at = table.maybe_number(
        key(
            "at",
            "where the sensor looks, as a share of the length from the left support; wanted beside [[rod.sensor]] [-]",
        ),
        Range::within(0.0, 1.0),
        Absent::Nothing("not known"),
    );
    let (place_error_m, gain_error) = (place_error_m(table), gain_error(table));
    // A configuration with every default filled in is read back: these say nothing.
    let said = [
        ("at", at.is_some()),
        ("gain_error", gain_error != GAIN_ERROR),
        ("place_error_m", place_error_m != PLACE_ERROR_M),
    ];
    for (name, _) in said.into_iter().filter(|(_, is_said)| *is_said && !has_others) {
        let why = "has no effect here, only with [[rod.sensor]]; remove it";
        table.fault_of(name, why.to_owned());
    }
    (at, place_error_m, gain_error)
}

/// Reads the further sensors of a rod; `None` in the place of one with a fault.
pub(super) fn read_all(table: &mut Table<'_>) -> Vec<Option<Further>> {
    table.list(
        "sensor",
        "A further sensor of the rod, on the same clock and at the same rate.",
        |table| {
            let channel = channel::read(table, "value", &Unit::SENSOR, Unit::Metre);
            let at = table.maybe_number(
                key(
                    "at",
                    "where it is, as a share of the length from the left support [-]",
                ),
                Range::within(0.0, 1.0),
                Absent::Required,
            );
            let (at_sd_m, gain_sd) = (place_error_m(table), gain_error(table));
            let (channel, at) = (channel?, at?);
            if !channel.unit.is_strain() && (at == 0.0 || at == 1.0) {
                table.fault_of(
                    "at",
                    "lies on a support, where nothing moves; only a strain gauge may".to_owned(),
                );
                return None;
            }
            Some(Further {
                channel,
                at,
                at_sd_m,
                gain_sd,
            })
        },
    )
}

fn gain_error(table: &mut Table<'_>) -> f64 {
    table.number(
        key("gain_error", "relative standard error of its calibration [-]"),
        Range::within(1e-4, 0.5),
        GAIN_ERROR,
    )
}

fn place_error_m(table: &mut Table<'_>) -> f64 {
    table.number(
        key("place_error_m", "standard error of its place [m]"),
        Range::within(0.0, 1.0),
        PLACE_ERROR_M,
    )
}
