//! `[[rod.sensor]]`: further sensors of a rod, beside that of `[rod.channel]`.

use super::channel;
use super::range::Range;
use super::reader::{Absent, Table, key};
use crate::analysis::signal::record::{Channel, RodChannels, RodId, Unit};

/// Default of the relative standard error of a sensor's calibration.
const GAIN_ERROR: f64 = 0.01;
/// Default of the standard error of a sensor's place \[m\]: a tape measure's.
const PLACE_ERROR_M: f64 = 0.01;

/// A sensor of a rod.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Location of its samples in a recording.
    pub channel: Channel,
    /// Its place, as a share of the length.
    pub at: f64,
    /// Standard error of its place \[m\].
    pub at_sd_m: f64,
    /// Relative standard error of its calibration \[-\].
    pub gain_sd: f64,
}

impl Sensor {
    /// Its channel as that of a rod of its own, by which its samples are read.
    pub fn as_rod(&self, rod: &RodId, number: usize) -> RodChannels {
        RodChannels {
            // No id of a rod has such a character.
            rod: RodId(format!("{rod}#{number}")),
            displacement: self.channel.clone(),
            temperature: None,
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
pub(super) fn read_all(table: &mut Table<'_>) -> Vec<Option<Sensor>> {
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
            Some(Sensor {
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
