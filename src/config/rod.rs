//! `[[rod]]`: one rod, its priors, and the location of its samples.

use super::RodConfig;
use super::range::{Range, toml_float, toml_string};
use super::reader::{Absent, Table, key};
use super::value::{Value, toml_floats};
use super::{channel, modes, prior, sensor, test};
use crate::analysis::identify::AnalysisSettings;
use crate::analysis::inference::AbcSettings;
use crate::analysis::rod::beam::forward::MAX_MODES;
use crate::analysis::rod::beam::{Parameterisation, Quantity, Section};
use crate::analysis::rod::emulator::ModelSettings;
use crate::analysis::rod::prior::{Prior, RodPrior};
use crate::analysis::signal::modes::ModeSettings;
use crate::analysis::signal::record::{RodChannels, RodId, Unit};
use crate::analysis::signal::spectrum::{PeakSettings, WelchSettings};

/// Settings that all rods of a site share.
pub(super) struct Shared {
    pub(super) welch: WelchSettings,
    pub(super) peaks: PeakSettings,
    pub(super) modes: ModeSettings,
    pub(super) abc: AbcSettings,
    pub(super) model: ModelSettings,
    pub(super) seed: u64,
    /// Furthest that a sensor of a rod is waited for \[s\].
    pub(super) wait_s: f64,
}

/// Default of the relative model discrepancy.
const DISCREPANCY: f64 = 0.01;

/// Reads all rods; `None` in the place of one with a fault.
pub(super) fn read_all(root: &mut Table<'_>, shared: &Shared) -> Vec<Option<RodConfig>> {
    let mut ids: Vec<(String, usize)> = Vec::new();
    let mut channels: Vec<(String, String, usize)> = Vec::new();
    let rods = root.list("rod", "A rod.", |table| {
        let rod = read(table, shared);
        let line = table.line_of("id");
        if let Some(rod) = &rod {
            let id = &rod.analysis.rod.0;
            // Ids become names of files and addresses, some of which ignore case.
            match ids.iter().find(|(other, _)| other.eq_ignore_ascii_case(id)) {
                Some((_, first)) => {
                    table.fault_of("id", format!("\"{id}\" is the id of the rod in line {first} too"))
                }
                None => ids.push((id.clone(), line)),
            }
            let keys = std::iter::once("channel").chain(std::iter::repeat("sensor"));
            for (at, channel) in keys.zip(rod.channels.sensors()) {
                let place = (channel.topic.clone(), channel.field.clone());
                match channels
                    .iter()
                    .find(|(topic, field, _)| (topic, field) == (&place.0, &place.1))
                {
                    Some((topic, field, first)) => table.fault_of(
                        at,
                        format!(
                            "topic \"{topic}\", field \"{field}\" is a channel of the rod in line {first} {}",
                            if *first == line { "already" } else { "too" }
                        ),
                    ),
                    None => channels.push((place.0, place.1, line)),
                }
            }
        }
        rod
    });
    check_thermometers(root, &rods, &channels);
    if rods.is_empty() && !root.has("rod") {
        root.absence_of(
            "rod",
            "at least one [[rod]] is wanted, config/minimal.toml shows one",
        );
    }
    rods
}

/// Refuses a thermometer that is the motion of a rod; `channels`: topics and fields of the motions, with the lines of their rods.
fn check_thermometers(root: &Table<'_>, rods: &[Option<RodConfig>], channels: &[(String, String, usize)]) {
    for own in rods.iter().flatten().map(|rod| &rod.channels) {
        let Some(channel) = &own.temperature else {
            continue;
        };
        let is_same =
            |(topic, field, _): &&(String, String, usize)| (topic, field) == (&channel.topic, &channel.field);
        if let Some((topic, field, line)) = channels.iter().find(is_same) {
            root.fault_of(
                "rod",
                format!(
                    "the temperature of rod {} is topic \"{topic}\", field \"{field}\", which is the motion of the rod in line {line}: \
                     name the topic of its thermometer",
                    own.rod
                ),
            );
        }
    }
}

fn read(table: &mut Table<'_>, shared: &Shared) -> Option<RodConfig> {
    let id = table.take(
        key("id", "name of the rod, unique within the site"),
        "1 to 64 letters, digits, '-', '_', '.'; not starting with '.'",
        Absent::Required,
        id,
        |id| toml_string(id),
    );
    let length = prior::take(table, Quantity::Length);
    let sections: Vec<(&'static str, Section)> = Section::ALL.iter().map(|s| (s.key(), *s)).collect();
    let section = table.take(
        key(
            "section",
            "cross-section; direct: flexural rigidity and mass per length are given instead",
        ),
        super::value::quoted(&Section::ALL.map(Section::key)),
        Absent::Required,
        |value| value.choice(&sections),
        |section| toml_string(section.key()),
    );
    let discrepancy = table
        .take(
            key("discrepancy", "relative model discrepancy (sd of b / y), one for all modes or one per mode; 0 is the paper's [-]"),
            "0 <= discrepancy <= 0.5, or a list with one per mode",
            Absent::Default(vec![DISCREPANCY]),
            |value| discrepancy(value, shared.modes.count),
            |list| if let [one] = list.as_slice() { toml_float(*one) } else { toml_floats(list) },
        )
        .map(|list| if let [one] = list[..] { vec![one; shared.modes.count] } else { list });
    let priors = section.map(|section| {
        table.section(
            "priors",
            "What is known about the rod beforehand (SI).",
            |table| {
                let quantities = section
                    .quantities()
                    .iter()
                    .filter(|&&quantity| quantity != Quantity::Length);
                quantities
                    .map(|&quantity| prior::take(table, quantity))
                    .collect::<Vec<Option<Prior>>>()
            },
        )
    });
    if priors.is_none() {
        table.ignore(&["priors"]);
    }
    let modes = table.section(
        "modes",
        "Its modes, where more is known of them than of the site's others.",
        |table| modes::of_rod(table, &shared.modes),
    );
    let has_others = table.has("sensor");
    let displacement = table.section(
        "channel",
        "Its displacement, velocity or acceleration.",
        |table| {
            let channel = channel::read(table, "value", &Unit::MOTION, Unit::Metre);
            (channel, sensor::of_channel(table, has_others))
        },
    );
    let (displacement, (at, at_sd_m, gain_sd)) = displacement;
    let further = sensor::read_all(table);
    if !further.is_empty() && at.is_none() {
        table.fault_of(
            "channel",
            "at is wanted beside [[rod.sensor]]: the place of this sensor",
        );
    }
    let temperature = table.optional_section("temperature", "Its temperature.", |table| {
        channel::read(table, "value", &Unit::TEMPERATURE, Unit::Celsius)
    });

    let prior = section
        .zip(priors)
        .and_then(|(section, priors)| Some((section, priors.into_iter().collect::<Option<Vec<Prior>>>()?)))
        .zip(length)
        .and_then(|((section, mut priors), length)| {
            priors.push(length);
            RodPrior::new(Parameterisation::new(section), priors)
        });
    let tests = test::read_all(table, prior.as_ref());

    let (id, prior) = (RodId(id?), prior?);
    let temperature = match temperature {
        Some(channel) => Some(channel?),
        None => None,
    };
    let displacement = displacement?;
    let further = further.into_iter().collect::<Option<Vec<_>>>()?;
    let (sensors, beside) = match at {
        Some(at) if !further.is_empty() => {
            let (sensors, beside) =
                sensor::all(&displacement, (at, at_sd_m, gain_sd), further, shared.wait_s);
            (sensors, Some(beside))
        }
        _ => (Vec::new(), None),
    };
    Some(RodConfig {
        analysis: AnalysisSettings {
            rod: id.clone(),
            prior,
            tests: tests.into_iter().collect::<Option<Vec<_>>>()?,
            sensors,
            discrepancy: discrepancy?,
            welch: shared.welch,
            peaks: shared.peaks,
            modes,
            abc: shared.abc,
            model: shared.model,
            seed: shared.seed,
        },
        channels: RodChannels {
            rod: id,
            displacement,
            temperature,
            beside,
        },
    })
}

pub(super) fn id(value: &Value<'_>) -> Option<String> {
    let id = rod_id(value.name_string()?);
    id.map_err(|why| value.fault(why)).ok()
}

/// Checks the id of a rod.
///
/// # Errors
/// It cannot be one: the reason.
pub fn rod_id(text: &str) -> Result<String, String> {
    let is_id = (1..=64).contains(&text.len())
        && !text.starts_with('.')
        && text
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
    match is_id {
        true => Ok(text.to_owned()),
        false => Err(format!(
            "\"{text}\" is no id: 1 to 64 letters, digits, '-', '_' and '.', not starting with '.'"
        )),
    }
}

fn discrepancy(value: &Value<'_>, modes: usize) -> Option<Vec<f64>> {
    let range = Range::within(0.0, 0.5);
    if !value.is_array() {
        return value.number(range).map(|one| vec![one]);
    }
    let list = value.numbers(range, 1, MAX_MODES)?;
    if list.len() != modes {
        value.fault(format!("has {} entries, modes.count = {modes}", list.len()));
        return None;
    }
    Some(list)
}
