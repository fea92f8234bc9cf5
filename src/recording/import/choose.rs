//! Assigns channels of a file to configured rods.

use super::asked::{Asked, Wanted, channels_of, choose, told};
use super::contents::describe;
use super::{ImportError, Signal, ramp};
use tirante_analysis::signal::record::{Channel, RodChannels, Unit};

/// Most channels named in an error.
const NAMED: usize = 12;

/// Channels with the options of each, and notes on the assignments made.
type Chosen = (Vec<(Signal, Wanted)>, Vec<String>);

/// A file's channels under the topics of the rods that read them, and notes on the assignments made. Without
/// `is_meant`, the configuration was not named for this file, and only channels with the name of a topic are
/// assigned. `stem`: name of the file without its ending.
///
/// # Errors
/// The assignment is not clear; the sentence names the channels and the next step.
pub(super) fn for_rods(
    signals: Vec<Signal>,
    asked: &Asked<'_>,
    is_meant: bool,
    stem: &str,
) -> Result<Chosen, ImportError> {
    if !asked.channels.is_empty() {
        return named(signals, asked, is_meant, stem);
    }
    let is_topic = |signal: &Signal| channels_of(asked.rods).any(|(_, channel)| channel.topic == signal.name);
    let is_sensor = |signal: &Signal| {
        let mut sensors = asked.rods.iter().flat_map(RodChannels::sensors);
        sensors.any(|channel| channel.topic == signal.name)
    };
    if signals.iter().any(is_sensor) {
        let chosen = signals.into_iter().filter(is_topic);
        let under = |signal: Signal| {
            let topic = signal.name.clone();
            as_topic(signal, topic)
        };
        return Ok((chosen.map(under).collect(), Vec::new()));
    }
    match asked.rods {
        [rod] if is_meant => only(signals, rod, sensor(rod, stem)?),
        [_] => Err(of_nobody(&signals)),
        rods => Err(ImportError::new(format!(
            "none of its channels is called like a topic of the configuration; {}; --channel SOURCE=TOPIC says which is which \
             ({})",
            holds(&signals),
            topics(rods)
        ))),
    }
}

fn as_topic(signal: Signal, topic: String) -> (Signal, Wanted) {
    let wanted = Wanted {
        source: signal.number.to_string(),
        topic: Some(topic),
        unit: None,
    };
    (signal, wanted)
}

/// The sensor of a file whose channels do not name it: the only one, or that whose topic ends the file's name.
fn sensor<'r>(rod: &'r RodChannels, stem: &str) -> Result<&'r Channel, ImportError> {
    if rod.beside.is_none() {
        return Ok(&rod.displacement);
    }
    let words = |text: &str| -> Vec<String> {
        let words = text.split(|c: char| !c.is_alphanumeric());
        words
            .filter(|word| !word.is_empty())
            .map(str::to_lowercase)
            .collect()
    };
    let named = words(stem);
    let fits = |channel: &&Channel| {
        let topic = words(&channel.topic);
        !topic.is_empty() && named.ends_with(&topic)
    };
    let found = rod
        .sensors()
        .filter(fits)
        .max_by_key(|channel| words(&channel.topic).len());
    found.ok_or_else(|| {
        ImportError::new(format!(
            "rod {} has several sensors, and nothing says which of them this file is: name its column, or the end of the file's name, \
             like the topic, or say --channel SOURCE=TOPIC ({})",
            rod.rod,
            topics(std::slice::from_ref(rod))
        ))
    })
}

/// Topics of sensors.
fn topics(rods: &[RodChannels]) -> String {
    let topics: Vec<&str> = rods
        .iter()
        .flat_map(RodChannels::sensors)
        .map(|channel| channel.topic.as_str())
        .collect();
    topics.join(", ")
}

/// Channels of a file in words, for errors.
pub(super) fn holds(signals: &[Signal]) -> String {
    let mut named: Vec<String> = signals
        .iter()
        .take(NAMED)
        .map(|signal| format!("{} {:?} ({})", signal.number, signal.name, describe(signal)))
        .collect();
    if signals.len() > NAMED {
        named.push(format!("and {} more", signals.len() - NAMED));
    }
    let noun = if signals.len() == 1 { "channel" } else { "channels" };
    format!("it holds {noun} {}", named.join(", "))
}

fn is_temperature(signal: &Signal) -> bool {
    let unit = signal.unit.as_deref().and_then(Unit::as_written);
    unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit))
}

/// Channels asked for by name; one without a topic is that of the only rod.
fn named(signals: Vec<Signal>, asked: &Asked<'_>, is_meant: bool, stem: &str) -> Result<Chosen, ImportError> {
    let mut found: Vec<(Signal, Wanted)> = Vec::new();
    let mut notes = Vec::new();
    for (signal, wanted) in choose(signals, asked.channels)? {
        let unit = wanted.and_then(|wanted| wanted.unit);
        let said = wanted.and_then(|wanted| wanted.topic.clone());
        let is_topic = channels_of(asked.rods).any(|(_, channel)| channel.topic == signal.name);
        let topic = match (said, asked.rods) {
            (Some(topic), _) => topic,
            (None, _) if is_topic => signal.name.clone(),
            (None, [rod]) if is_meant => {
                let is_thermometer =
                    unit.map_or(is_temperature(&signal), |unit| Unit::TEMPERATURE.contains(&unit));
                let thermometer = rod.temperature.as_ref().filter(|_| is_thermometer);
                let channel = thermometer.map_or_else(|| sensor(rod, stem), Ok)?;
                channel.topic.clone()
            }
            (None, [_]) => return Err(of_nobody(&[signal])),
            (None, rods) => {
                return Err(ImportError::new(format!(
                    "several rods are configured: --channel {}=TOPIC says whose {} is ({})",
                    signal.number,
                    told(&signal),
                    topics(rods)
                )));
            }
        };
        notes.push(format!(
            "{} is read as {topic}{}",
            told(&signal),
            of_rod(asked.rods, &topic)
        ));
        let (signal, wanted) = as_topic(signal, topic);
        found.push((signal, Wanted { unit, ..wanted }));
    }
    Ok((found, notes))
}

/// Rod that reads a topic, in words.
fn of_rod(rods: &[RodChannels], topic: &str) -> String {
    let of = channels_of(rods).find(|(_, channel)| channel.topic == topic);
    of.map_or_else(String::new, |(rod, _)| format!(" of rod {rod}"))
}

fn of_nobody(signals: &[Signal]) -> ImportError {
    ImportError::new(format!(
        "without --config the rod is not known: `tirante measure FILE` asks for it and writes a configuration, `tirante import` \
         makes a recording; {}",
        holds(signals)
    ))
}

/// Channels of the only rod: the one channel of motion, which is that of `sensor`, and the one thermometer.
fn only(signals: Vec<Signal>, rod: &RodChannels, sensor: &Channel) -> Result<Chosen, ImportError> {
    let motion: Vec<usize> = (0..signals.len())
        .filter(|index| !is_temperature(&signals[*index]) && !ramp::is_time(&signals[*index]))
        .collect();
    let of_unit = |index: &&usize| {
        let written = signals[**index].unit.as_deref();
        written.and_then(Unit::as_written) == Some(sensor.unit)
    };
    let in_unit: Vec<usize> = motion.iter().filter(of_unit).copied().collect();
    let taken = match (&motion[..], &in_unit[..]) {
        ([one], _) | (_, [one]) => *one,
        ([], _) => {
            return Err(ImportError::new(format!(
                "no channel of it can be the motion of rod {}; {}",
                rod.rod,
                holds(&signals)
            )));
        }
        _ => {
            return Err(ImportError::new(format!(
                "which of its channels is rod {} is not clear; {}; --channel says it, by name or number",
                rod.rod,
                holds(&signals)
            )));
        }
    };
    let thermometers: Vec<usize> = (0..signals.len())
        .filter(|index| is_temperature(&signals[*index]))
        .collect();
    let thermometer = match (&rod.temperature, &thermometers[..]) {
        (Some(channel), [one]) => Some((*one, channel.topic.clone())),
        _ => None,
    };
    let mut notes = Vec::new();
    let mut found = Vec::new();
    for (index, signal) in signals.into_iter().enumerate() {
        let topic = match &thermometer {
            Some((at, topic)) if *at == index => topic.clone(),
            _ if index == taken => sensor.topic.clone(),
            _ => continue,
        };
        notes.push(format!("{} is read as {topic} of rod {}", told(&signal), rod.rod));
        found.push(as_topic(signal, topic));
    }
    Ok((found, notes))
}
