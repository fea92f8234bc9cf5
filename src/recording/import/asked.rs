//! Options for a file, and the checks that file, command line and configuration agree.

use super::{ImportError, Signal, is_time_name};
use std::collections::BTreeSet;
use tirante_analysis::signal::record::{Channel, RodChannels, Timestamp, Unit};

/// A channel asked for, as `SOURCE[=TOPIC][,UNIT]`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Wanted {
    /// Name or number of the channel in the file.
    pub source: String,
    /// Topic it gets; `None`: its name.
    pub topic: Option<String>,
    /// Unit, if the file does not give it.
    pub unit: Option<Unit>,
}

impl Wanted {
    /// Parses `SOURCE`, `SOURCE=TOPIC`, `SOURCE=TOPIC,UNIT` or `SOURCE=,UNIT`.
    ///
    /// # Errors
    /// There is no source, or the unit is not supported.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (source, rest) = text.split_once('=').unwrap_or((text, ""));
        let (topic, unit) = match rest.rsplit_once(',') {
            Some((topic, unit)) => (topic, Some(unit)),
            None => (rest, None),
        };
        let unit = unit
            .map(|unit| Unit::as_written(unit).ok_or_else(|| unknown_unit(unit)))
            .transpose()?;
        if source.trim().is_empty() {
            return Err("SOURCE[=TOPIC][,UNIT] is expected".to_owned());
        }
        Ok(Self {
            source: source.trim().to_owned(),
            topic: Some(topic.trim())
                .filter(|topic| !topic.is_empty())
                .map(str::to_owned),
            unit,
        })
    }
}

/// Error message for an unsupported unit.
pub fn unknown_unit(unit: &str) -> String {
    let known: Vec<&str> = Unit::MOTION
        .iter()
        .chain(&Unit::TEMPERATURE)
        .map(|unit| unit.key())
        .collect();
    format!("{unit:?} is no unit; there is {}", known.join(", "))
}

/// Options for a file.
#[derive(Debug, Clone, Default)]
pub struct Asked<'a> {
    /// Channels asked for; empty: all.
    pub channels: &'a [Wanted],
    /// Unit of channels whose unit is not given otherwise.
    pub unit: Option<Unit>,
    /// Sample rate \[Hz\].
    pub rate_hz: Option<f64>,
    /// Time of the first sample.
    pub start: Option<Timestamp>,
    /// Rate to interpolate to \[Hz\].
    pub resample_hz: Option<f64>,
    /// Rods of the configuration the result is for; empty: any.
    pub rods: &'a [RodChannels],
    /// Default for a missing start; `None`: a missing start is an error.
    pub start_else: Option<Timestamp>,
    /// True if a missing unit is allowed: the samples are then taken as they are.
    pub any_unit: bool,
    /// True if uneven stamps are kept, to be judged where records are made; otherwise they are an error.
    pub keeps_stamps: bool,
}

pub(super) fn channels_of(rods: &[RodChannels]) -> impl Iterator<Item = (&str, &Channel)> {
    rods.iter()
        .flat_map(|rod| rod.all().map(|channel| (rod.rod.0.as_str(), channel)))
}

/// Gives channels of one name names of their own: `disp`, `disp-2`. Names of times stay.
pub(super) fn tell_apart<'n>(names: impl IntoIterator<Item = &'n mut String>) {
    let mut known: BTreeSet<String> = BTreeSet::new();
    for name in names {
        if !name.is_empty() && !is_time_name(name) && known.contains(name) {
            let mut numbered = (2..).map(|number| format!("{name}-{number}"));
            *name = numbered.find(|next| !known.contains(next)).unwrap_or_default();
        }
        known.insert(name.clone());
    }
}

/// Signals asked for, in the order asked.
pub(super) fn choose(
    signals: Vec<Signal>,
    wanted: &[Wanted],
) -> Result<Vec<(Signal, Option<&Wanted>)>, ImportError> {
    if wanted.is_empty() {
        return Ok(signals.into_iter().map(|signal| (signal, None)).collect());
    }
    let mut left: Vec<Option<Signal>> = signals.into_iter().map(Some).collect();
    let names: Vec<(String, usize)> = left
        .iter()
        .flatten()
        .map(|signal| (signal.name.clone(), signal.number))
        .collect();
    let mut chosen = Vec::with_capacity(wanted.len());
    for one in wanted {
        let source = &one.source;
        let named = names.iter().position(|(name, _)| name == source);
        let found = named.or_else(|| names.iter().position(|(_, number)| number.to_string() == *source));
        let Some(place) = found else {
            let known: Vec<String> = names
                .iter()
                .map(|(name, number)| format!("{number} ({name})"))
                .collect();
            return Err(ImportError::new(format!(
                "no channel {source:?}; there is: {}",
                known.join(", ")
            )));
        };
        match left.get_mut(place).and_then(Option::take) {
            Some(signal) => chosen.push((signal, Some(one))),
            None => return Err(ImportError::new(format!("channel {source:?} is asked for twice"))),
        }
    }
    Ok(chosen)
}

/// Name of a signal in messages.
pub(super) fn told(signal: &Signal) -> String {
    match signal.name.as_str() {
        "" => format!("channel {}", signal.number),
        name => format!("channel {} ({name})", signal.number),
    }
}

/// Unit on which file, command line and configuration agree.
pub(super) fn unit(
    signal: &Signal,
    wanted: Option<&Wanted>,
    asked: &Asked<'_>,
    topic: &str,
) -> Result<Option<Unit>, ImportError> {
    let told = told(signal);
    let written = signal.unit.as_deref();
    let of_file = written.and_then(Unit::as_written);
    let is_temperature = |unit: &Unit| Unit::TEMPERATURE.contains(unit);
    // A unit for all channels does not apply to the thermometer among them.
    let of_all = asked
        .unit
        .filter(|unit| of_file.is_none_or(|of_file| is_temperature(&of_file) == is_temperature(unit)));
    let of_person = wanted.and_then(|wanted| wanted.unit).or(of_all);
    if let (Some(of_file), Some(of_person)) = (of_file, of_person)
        && of_file != of_person
    {
        return Err(ImportError::new(format!(
            "{told} is in {} by the file, in {} by the command line",
            of_file.key(),
            of_person.key()
        )));
    }
    let settled = of_person.or(of_file);
    for (rod, channel) in channels_of(asked.rods).filter(|(_, channel)| channel.topic == topic) {
        match settled {
            Some(unit) if unit != channel.unit => {
                return Err(ImportError::new(format!(
                    "{told} is in {}, but the configuration reads {topic:?} of rod {rod} in {}: correct whichever is wrong",
                    unit.key(),
                    channel.unit.key()
                )));
            }
            Some(_) => {}
            // The file has a unit that is not supported; the unit of the configuration may differ from it.
            None if written.is_some() => {}
            None => return Ok(Some(channel.unit)),
        }
    }
    if settled.is_some() || asked.any_unit {
        return Ok(settled);
    }
    Err({
        let what = match written {
            Some(written) => format!("the unit {written:?} of {told} is none of ours"),
            None => format!("the file does not say the unit of {told}"),
        };
        ImportError::new(format!(
            "{what}: --unit UNIT or --channel {}=,UNIT says it",
            signal.number
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_are_told_apart_and_times_are_not() {
        let mut names = ["disp", "disp", "disp-2", "time", "time", "", ""].map(str::to_owned);
        tell_apart(&mut names);
        assert_eq!(names, ["disp", "disp-2", "disp-2-2", "time", "time", "", ""]);
    }
}
