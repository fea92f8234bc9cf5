//! `[[simulation.rod]]`: one simulated rod, its true state and its sensor.

use super::super::RodConfig;
use super::super::prior::{quantity_key, sane};
use super::super::range::{Range, toml_float, toml_string};
use super::super::reader::{Absent, Table, key};
use super::super::value::toml_floats;
use super::{fault, load};
use crate::analysis::lab::synthesis::{
    AddedMass, Change, FurtherSensor, Line, Sensor, SimulatedRod, Thermal, Truth,
};
use crate::analysis::rod::beam::forward::{MAX_MODES, MAX_ORDERS};
use crate::analysis::rod::beam::{Parameterisation, Section};
use crate::analysis::signal::record::Channel;

/// Default damping ratio: iron between masonry walls.
const DAMPING: f64 = 0.002;

/// Reads one rod; `None` if a fault leaves nothing to build.
pub(super) fn read(
    table: &mut Table<'_>,
    rods: &[Option<RodConfig>],
    has_climate: bool,
    records: usize,
) -> Option<SimulatedRod> {
    let id = table.take(
        key("id", "id of the [[rod]] it stands for"),
        "the id of a [[rod]]",
        Absent::Required,
        |value| value.name_string().map(str::to_owned),
        |id| toml_string(id),
    );
    let config = id
        .as_ref()
        .and_then(|id| rods.iter().flatten().find(|rod| rod.analysis.rod.0 == *id));
    if let (Some(id), None) = (&id, config)
        && rods.iter().all(Option::is_some)
    {
        let known: Vec<&str> = rods
            .iter()
            .flatten()
            .map(|rod| rod.analysis.rod.0.as_str())
            .collect();
        table.fault_of(
            "id",
            format!("no [[rod]] is called \"{id}\", there are: {}", known.join(", ")),
        );
    }
    let frequencies_hz = table.take(
        key(
            "frequencies_hz",
            "natural frequencies given directly, without a beam behind them [Hz]",
        ),
        "a list of 1 to 12 ascending numbers, 0.01 to 10000",
        Absent::Nothing("those of the truth's beam"),
        |value| {
            let list = value.numbers(Range::within(0.01, 1e4), 1, MAX_ORDERS)?;
            if list.windows(2).any(|pair| pair[0] >= pair[1]) {
                value.fault("is not in ascending order");
            }
            Some(list)
        },
        |list| toml_floats(list),
    );
    let is_beam = !table.has("frequencies_hz");
    let modes = table.integer(
        key("modes", "mode orders simulated, from the first").only(is_beam, "no frequencies_hz"),
        1,
        MAX_ORDERS as u64,
        MAX_MODES as u64,
    ) as usize;
    let modes = frequencies_hz.as_ref().map_or(modes, Vec::len);
    let damping = table
        .take(
            key("damping", "damping ratio, one for all modes or one per mode [-]"),
            "0.00001 <= damping <= 0.5, or a list with one per mode",
            Absent::Default(vec![DAMPING]),
            |value| {
                let range = Range::within(1e-5, 0.5);
                if !value.is_array() {
                    return value.number(range).map(|one| vec![one]);
                }
                let list = value.numbers(range, 1, MAX_ORDERS)?;
                if list.len() != modes {
                    value.fault(format!("has {} entries, modes = {modes}", list.len()));
                }
                Some(list)
            },
            |list| {
                if let [one] = list.as_slice() {
                    toml_float(*one)
                } else {
                    toml_floats(list)
                }
            },
        )
        .map(|list| {
            if let [one] = list[..] {
                vec![one; modes]
            } else {
                list
            }
        });
    let ambient_m = table.number(
        key(
            "ambient_m",
            "standard deviation of the first mode's ambient response at its antinode [m]",
        ),
        Range::within(0.0, 0.1),
        20e-6,
    );
    let section = config.map(|config| config.analysis.prior.parameterisation().section());
    let theta = match (is_beam, config) {
        (false, _) => {
            if table.has("truth") {
                table.ignore(&["truth"]);
                table.fault_of("truth", "has no effect beside frequencies_hz; remove one of them");
            }
            None
        }
        (true, Some(config)) => Some(table.section(
            "truth",
            "What a simulated rod is in truth (SI).",
            |table| truth(table, config),
        )),
        (true, None) => {
            table.ignore(&["truth"]);
            None
        }
    };
    let sensor = table.section("sensor", "The sensor of a simulated rod.", sensor);
    let further = table.list(
        "further",
        "A further sensor of a simulated rod: one of its [[rod.sensor]].",
        |table| further(table, config),
    );
    let pull = table.optional_section(
        "pull",
        "Pulls or blows on a schedule, beside the ambient load.",
        load::pull,
    );
    let gusts = table.optional_section("gusts", "Gusts: an ambient load that is not steady.", load::gusts);
    let knocks = table.optional_section("knocks", "Blows at random times.", load::knocks);
    let neighbour = table.optional_section(
        "neighbour",
        "A rod of the same make beside it, whose vibration reaches the sensor.",
        load::neighbour,
    );
    let resonances = table.list(
        "resonance",
        "A resonance of something else that the sensor sees.",
        load::resonance,
    );
    let thermal_of = |table: &mut Table<'_>| thermal(table, section);
    let thermal = table.optional_section("thermal", "How temperature acts on the axial force.", thermal_of);
    if thermal.is_some() && !has_climate {
        table.fault_of("thermal", "has no effect without [simulation.climate]");
    }
    if thermal.is_some() && !is_beam {
        table.fault_of("thermal", "has no effect on frequencies_hz");
    }
    let interference = table.list("line", "A sinusoid that is no mode.", |table| Line {
        frequency_hz: table
            .maybe_number(
                key("frequency_hz", "its frequency [Hz]"),
                Range::above(0.0, 5e4),
                Absent::Required,
            )
            .unwrap_or(1.0),
        amplitude_m: table
            .maybe_number(
                key("amplitude_m", "its amplitude [m]"),
                Range::within(0.0, 1.0),
                Absent::Required,
            )
            .unwrap_or(0.0),
    });
    let changes = table.list(
        "change",
        "A change of the axial force besides temperature.",
        change,
    );
    if !changes.is_empty() && !is_beam {
        table.fault_of("change", "has no effect on frequencies_hz");
    }
    let added_mass = table.optional_section("added_mass", "A mass hung onto a simulated rod.", added_mass);
    if added_mass.is_some() && !is_beam {
        table.fault_of("added_mass", "has no effect on frequencies_hz");
    }
    let faults = table.list("fault", "Something that goes wrong in some records.", |table| {
        fault::read(table, records)
    });

    let config = config?;
    let truth = match (frequencies_hz, theta) {
        (Some(list), _) => Truth::Frequencies(list),
        (None, Some(theta)) => Truth::Beam {
            section: section?,
            theta,
        },
        (None, None) => return None,
    };
    Some(SimulatedRod {
        damping: damping?,
        ambient_m,
        gusts,
        pull,
        knocks,
        neighbour,
        resonances: resonances.into_iter().collect::<Option<Vec<_>>>()?,
        sensor,
        further: further
            .into_iter()
            .map(|further| {
                let (channel, sensor) = further?;
                let strain_over_m = match (&truth, channel.unit.is_strain()) {
                    (_, false) => None,
                    (Truth::Beam { section, theta }, true) => {
                        let height_m = Parameterisation::new(*section).height(theta);
                        if height_m.is_none() {
                            table.fault_of("further", "a strain gauge wants a section with a height");
                        }
                        Some(0.5 * height_m?)
                    }
                    (Truth::Frequencies(_), true) => {
                        table.fault_of("further", "a strain gauge wants a beam, not frequencies_hz");
                        return None;
                    }
                };
                Some(FurtherSensor {
                    channel,
                    sensor,
                    strain_over_m,
                })
            })
            .collect::<Option<_>>()?,
        truth,
        interference,
        thermal: thermal.unwrap_or(FREE),
        changes,
        added_mass,
        faults: faults.into_iter().collect::<Option<Vec<_>>>()?,
        ..by_default(config)
    })
}

/// Thermal settings of a rod unaffected by temperature.
const FREE: Thermal = Thermal {
    restraint: 0.0,
    expansion_per_k: 0.0,
    axial_rigidity_n: None,
    reference_c: None,
    lag_h: 0.0,
};

/// Default simulation of a configured rod: at the centre of its priors, with a good sensor in
/// ambient vibration.
pub(super) fn by_default(config: &RodConfig) -> SimulatedRod {
    SimulatedRod {
        rod: config.analysis.rod.clone(),
        displacement: config.channels.displacement.clone(),
        temperature: config.channels.temperature.clone(),
        truth: Truth::Beam {
            section: config.analysis.prior.parameterisation().section(),
            theta: config.analysis.prior.centre(),
        },
        damping: vec![DAMPING; MAX_MODES],
        ambient_m: 20e-6,
        gusts: None,
        pull: None,
        knocks: None,
        neighbour: None,
        resonances: Vec::new(),
        sensor: Sensor {
            at: 0.4,
            noise_m: 1e-6,
            pink_m: 0.0,
            resolution_m: 1e-8,
        },
        further: Vec::new(),
        interference: Vec::new(),
        thermal: FREE,
        changes: Vec::new(),
        added_mass: None,
        faults: Vec::new(),
    }
}

fn truth(table: &mut Table<'_>, config: &RodConfig) -> Vec<f64> {
    let prior = &config.analysis.prior;
    let quantities = prior.parameterisation().quantities().iter().zip(prior.centre());
    quantities
        .map(|(&quantity, centre)| {
            let absent = Absent::Nothing("the prior's centre");
            table
                .maybe_number(quantity_key(quantity), sane(quantity), absent)
                .unwrap_or(centre)
        })
        .collect()
}

pub(super) fn share_of_length() -> Range {
    Range::within(0.01, 0.99)
}

fn sensor(table: &mut Table<'_>) -> Sensor {
    Sensor {
        at: table.number(
            key(
                "at",
                "where it looks, as a share of the length; 0.5 sees no even mode [-]",
            ),
            share_of_length(),
            0.4,
        ),
        noise_m: table.number(
            key("noise_m", "standard deviation of its white noise, per sample [m]"),
            Range::within(0.0, 0.1),
            1e-6,
        ),
        pink_m: table.number(
            key("pink_m", "standard deviation of its 1/f noise above 1 mHz [m]"),
            Range::within(0.0, 0.1),
            0.0,
        ),
        resolution_m: table.number(
            key("resolution_m", "smallest step of its output, 0 for none [m]"),
            Range::within(0.0, 0.01),
            1e-8,
        ),
    }
}

/// Channel, place and noise of a further sensor.
fn further(table: &mut Table<'_>, config: Option<&RodConfig>) -> Option<(Channel, Sensor)> {
    let topic = table.take(
        key("topic", "topic of the [[rod.sensor]] it stands for"),
        "the topic of a [[rod.sensor]]",
        Absent::Required,
        |value| value.name_string().map(str::to_owned),
        |topic| toml_string(topic),
    );
    let known: Vec<_> = config.map_or_else(Vec::new, |config| {
        let sensors = config.channels.sensors().zip(&config.analysis.sensors);
        sensors.skip(1).collect()
    });
    let own = topic
        .as_ref()
        .and_then(|topic| known.iter().find(|(channel, _)| channel.topic == *topic));
    if let (Some(topic), None, Some(_)) = (&topic, own, config) {
        let known: Vec<&str> = known.iter().map(|(channel, _)| channel.topic.as_str()).collect();
        table.fault_of(
            "topic",
            format!(
                "no [[rod.sensor]] reads \"{topic}\", there are: {}",
                known.join(", ")
            ),
        );
    }
    let at = table.maybe_number(
        key("at", "where it is in truth, as a share of the length [-]"),
        Range::within(0.0, 1.0),
        Absent::Nothing("that of the [[rod.sensor]]"),
    );
    let noise_m = table.number(
        key(
            "noise",
            "standard deviation of its white noise, per sample, in the SI unit of its channel [m or 1]",
        ),
        Range::within(0.0, 0.1),
        1e-6,
    );
    let (channel, own) = own?;
    Some((
        (*channel).clone(),
        Sensor {
            at: at.unwrap_or(own.at),
            noise_m,
            pink_m: 0.0,
            resolution_m: 0.0,
        },
    ))
}

fn thermal(table: &mut Table<'_>, section: Option<Section>) -> Thermal {
    let is_direct = section == Some(Section::Direct);
    let rigidity = Range::within(1e3, 1e12);
    let meaning = key("axial_rigidity_n", "axial rigidity E A [N]");
    let absent = if is_direct {
        Absent::Required
    } else {
        Absent::Nothing("E and A of the truth")
    };
    Thermal {
        restraint: table.number(
            key("restraint", "restraint of the ends, 0 free to 1 rigid [-]"),
            Range::within(0.0, 1.0),
            0.5,
        ),
        expansion_per_k: table.number(
            key("expansion_per_k", "expansion coefficient [1/K]"),
            Range::within(0.0, 1e-4),
            1.2e-5,
        ),
        axial_rigidity_n: table.maybe_number(meaning, rigidity, absent),
        reference_c: table.maybe_number(
            key(
                "reference_c",
                "temperature at which the truth's axial force holds [degC]",
            ),
            Range::within(-60.0, 60.0),
            Absent::Nothing("the climate's mean"),
        ),
        lag_h: table.number(
            key("lag_h", "time constant with which the rod follows the air [h]"),
            Range::within(0.0, 120.0),
            1.0,
        ),
    }
}

fn change(table: &mut Table<'_>) -> Change {
    let days = Range::within(0.0, 36_525.0);
    Change {
        start_d: table.number(
            key("start_d", "begin, from the start of the simulation [d]"),
            days,
            0.0,
        ),
        over_d: table.number(
            key("over_d", "how long it grows before it stays; 0 is a step [d]"),
            days,
            0.0,
        ),
        relative: table
            .maybe_number(
                key(
                    "relative",
                    "final change as a share of the truth's axial force [-]",
                ),
                Range::within(-0.99, 10.0),
                Absent::Required,
            )
            .unwrap_or(0.0),
    }
}

fn added_mass(table: &mut Table<'_>) -> AddedMass {
    AddedMass {
        mass_kg: table
            .maybe_number(
                key("mass_kg", "how much [kg]"),
                Range::above(0.0, 1e4),
                Absent::Required,
            )
            .unwrap_or(0.0),
        at: table.number(
            key("at", "where, as a share of the length [-]"),
            share_of_length(),
            0.5,
        ),
        start_d: table.number(
            key("start_d", "from when, from the start of the simulation [d]"),
            Range::within(0.0, 36_525.0),
            0.0,
        ),
    }
}
