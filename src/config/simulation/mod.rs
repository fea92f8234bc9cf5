//! `[simulation]`: settings of `tirante simulate`.

mod fault;
mod load;
mod rod;

use super::RodConfig;
use super::range::Range;
use super::reader::{Absent, Table, key};
use crate::analysis::lab::synthesis::{Climate, SimulatedRod, Simulation};
use crate::analysis::signal::record::{Channel, TimeSource, Timestamp, Unit};
use crate::recording::write::{Compression, Encoding, Precision};

/// A simulation with its file format.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulationConfig {
    /// Rods, surroundings and faults simulated.
    pub simulation: Simulation,
    /// Encoding of messages.
    pub encoding: Encoding,
    /// Floating-point precision of a sample.
    pub precision: Precision,
    /// Compression of the file.
    pub compression: Compression,
}

const ENCODINGS: [(&str, Encoding); 3] = [
    ("json", Encoding::Json),
    ("protobuf", Encoding::Protobuf),
    ("ros2", Encoding::Ros2),
];
const PRECISIONS: [(&str, Precision); 2] = [("single", Precision::Single), ("double", Precision::Double)];
const COMPRESSIONS: [(&str, Compression); 3] = [
    ("zstd", Compression::Zstd),
    ("lz4", Compression::Lz4),
    ("none", Compression::None),
];

/// Most samples of a simulated record, which is held in memory.
const MOST_SAMPLES: f64 = 2e7;

/// 2026-01-01T00:00:00Z.
const START: Timestamp = Timestamp::from_nanos(1_767_225_600_000_000_000);

/// Reads the section; `rods` are the rods of the configuration, `None` in the place of one with a
/// fault.
pub(super) fn read(table: &mut Table<'_>, rods: &[Option<RodConfig>]) -> Option<SimulationConfig> {
    let fs_hz = table.number(key("fs_hz", "sample rate [Hz]"), Range::within(0.01, 1e8), 100.0);
    let start = table.take(
        key("start", "time of the first sample"),
        "a time with an offset, from 1970 on: 2026-03-01T06:00:00Z",
        Absent::Default(START),
        |value| {
            let time = value.time()?;
            if time < Timestamp::from_nanos(0) {
                value.fault("lies before 1970, where MCAP time starts");
            }
            Some(time)
        },
        |time| format!("\"{time}\""),
    );
    let record_s = table.number(
        key("record_s", "length of a record [s]"),
        Range::within(1e-3, 86_400.0),
        60.0,
    );
    let records = table.integer(key("records", "number of records"), 1, 1_000_000, 1) as usize;
    let interval_s = table.number(
        key(
            "interval_s",
            "from the start of a record to the start of the next [s]",
        ),
        Range::within(1.0, 3.2e7),
        3600.0,
    );
    let samples_per_message = table.integer(
        key(
            "samples_per_message",
            "samples in one message; 1 writes scalars, more write arrays",
        ),
        1,
        1_000_000,
        1,
    ) as usize;
    let encoding = table.choice(
        key("encoding", "encoding of the messages"),
        &ENCODINGS,
        Encoding::Json,
    );
    let precision = table.choice(
        key("precision", "bits a sample keeps: 32 or 64"),
        &PRECISIONS,
        Precision::Single,
    );
    let compression = table.choice(
        key("compression", "compression of the file"),
        &COMPRESSIONS,
        Compression::Zstd,
    );
    if record_s * fs_hz > MOST_SAMPLES {
        table.fault_of(
            "record_s",
            format!("{record_s} s at {fs_hz} Hz are more than {MOST_SAMPLES:e} samples in a record"),
        );
    }
    if record_s * fs_hz < 2.0 {
        table.fault_of(
            "record_s",
            format!("{record_s} s at {fs_hz} Hz are fewer than two samples"),
        );
    }
    if records > 1 && interval_s < record_s {
        table.fault_of(
            "interval_s",
            format!("{interval_s} s is shorter than a record of {record_s} s"),
        );
    }
    let climate = table.optional_section("climate", "Air temperature of a simulation.", climate);
    let has_climate = climate.is_some();
    let mut listed = table.list("rod", "A simulated rod.", |table| {
        rod::read(table, rods, has_climate, records)
    });
    if listed.is_empty() && !table.has("rod") {
        listed = rods
            .iter()
            .flatten()
            .map(|config| Some(rod::by_default(config)))
            .collect();
    }
    let listed = listed.into_iter().collect::<Option<Vec<SimulatedRod>>>()?;
    let written = Written {
        encoding,
        is_batch: samples_per_message > 1,
        fs_hz,
    };
    check_channels(table, &listed, written);
    Some(SimulationConfig {
        simulation: Simulation {
            fs_hz,
            start: start?,
            record_s,
            records,
            interval_s,
            samples_per_message,
            climate,
            rods: listed,
        },
        encoding,
        precision,
        compression,
    })
}

fn climate(table: &mut Table<'_>) -> Climate {
    let kelvin = Range::within(0.0, 60.0);
    Climate {
        mean_c: table.number(
            key("mean_c", "mean of the year [degC]"),
            Range::within(-60.0, 60.0),
            14.0,
        ),
        season_k: table.number(
            key("season_k", "amplitude of the season, half of the range [K]"),
            kelvin,
            8.0,
        ),
        warmest_day: table.number(
            key("warmest_day", "day of the year of the seasonal maximum [d]"),
            Range::within(1.0, 366.0),
            205.0,
        ),
        day_k: table.number(
            key("day_k", "amplitude of the day, half of the range [K]"),
            kelvin,
            3.0,
        ),
        warmest_hour: table.number(
            key("warmest_hour", "hour (UTC) of the daily maximum [h]"),
            Range::within(0.0, 24.0),
            14.0,
        ),
        weather_k: table.number(
            key("weather_k", "standard deviation of the weather [K]"),
            kelvin,
            2.0,
        ),
        weather_d: table.number(
            key("weather_d", "correlation time of the weather [d]"),
            Range::within(0.01, 60.0),
            3.0,
        ),
        noise_k: table.number(
            key("noise_k", "standard deviation of the thermometer's noise [K]"),
            Range::within(0.0, 10.0),
            0.1,
        ),
        every_s: table.number(
            key(
                "every_s",
                "from one temperature message to the next within a record [s]",
            ),
            Range::within(0.01, 86_400.0),
            10.0,
        ),
        between_s: table.maybe_number(
            key(
                "between_s",
                "from one temperature message to the next between records [s]",
            ),
            Range::within(1.0, 86_400.0),
            Absent::Nothing("no temperature between records"),
        ),
    }
}

#[derive(Clone, Copy)]
struct Written {
    encoding: Encoding,
    is_batch: bool,
    fs_hz: f64,
}

/// Checks that the rods' channels fit the recording to be written, so that it can be read.
fn check_channels(table: &Table<'_>, rods: &[SimulatedRod], written: Written) {
    for rod in rods {
        let fault = |message: String| table.fault_of("rod", format!("\"{}\": {message}", rod.rod));
        let channel = &rod.displacement;
        if ![Unit::Metre, Unit::Millimetre, Unit::Micrometre, Unit::Nanometre].contains(&channel.unit) {
            fault(format!(
                "only displacement is simulated, its channel's unit is {}",
                channel.unit.key()
            ));
        }
        if written.is_batch {
            match channel.fs_hz {
                Some(declared) if declared != written.fs_hz => {
                    fault(format!(
                        "its channel declares fs_hz = {declared}, simulated are {} Hz",
                        written.fs_hz
                    ));
                }
                None => fault(format!(
                    "arrays are written: its channel must declare fs_hz = {}",
                    written.fs_hz
                )),
                _ => {}
            }
        }
        let check = |channel: &Channel, is_batch: bool| {
            let field = written.encoding.samples_field(is_batch);
            if channel.field != field {
                fault(format!(
                    "encoding and samples_per_message write field \"{field}\", its channel {} reads \"{}\"",
                    channel.topic, channel.field
                ));
            }
            if let TimeSource::Field(time) = &channel.time {
                match written.encoding.time_field(is_batch) {
                    Some(field) if field == time => {}
                    Some(field) => fault(format!(
                        "time stands in field \"{field}\", its channel reads \"{time}\""
                    )),
                    None => fault(format!(
                        "with samples_per_message = 1 no time is written into messages, its channel reads \"{time}\""
                    )),
                }
            }
        };
        check(channel, written.is_batch);
        for further in &rod.further {
            if further.channel.unit.si() != "m" && !further.channel.unit.is_strain() {
                fault(format!(
                    "displacement and strain are simulated, the unit of {} is {}",
                    further.channel.topic,
                    further.channel.unit.key()
                ));
            }
            check(&further.channel, written.is_batch);
        }
        if let Some(temperature) = &rod.temperature {
            check(temperature, false);
        }
    }
    // Several rods may share a thermometer, but nothing else.
    for (i, rod) in rods.iter().enumerate() {
        let topic = &rod.displacement.topic;
        let taken = rods.iter().enumerate().any(|(j, other)| {
            (j < i && other.displacement.topic == *topic)
                || other
                    .temperature
                    .as_ref()
                    .is_some_and(|temperature| temperature.topic == *topic)
        });
        if taken {
            table.fault_of("rod", format!("\"{}\": topic {topic} is written twice", rod.rod));
        }
        if rods[..i].iter().any(|other| other.rod == rod.rod) {
            table.fault_of("rod", format!("\"{}\" is simulated twice", rod.rod));
        }
    }
}
