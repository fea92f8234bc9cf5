//! The channel of a rod's samples: from flags, from a file's channels, from answers.

use super::BadArguments;
use super::questions::Questions;
use crate::analysis::signal::record::Unit;
use crate::recording::read::contents::Content;
use std::io::BufRead;

/// Flags about the channel.
#[derive(Debug, Clone, Copy, Default)]
pub struct Wanted<'a> {
    /// Topic or name of the channel.
    pub topic: Option<&'a str>,
    /// Field of a message that holds the samples.
    pub field: Option<&'a str>,
    /// Unit of the samples.
    pub unit: Option<Unit>,
    /// Sample rate \[Hz\].
    pub fs_hz: Option<f64>,
    /// True if a unit is required; without one samples count as metres, which changes no frequency.
    pub needs_unit: bool,
}

/// Channel and unit of the samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Topic or name of the channel.
    pub topic: String,
    /// Field of a message that holds the samples.
    pub field: String,
    /// Field of the messages' own time; without one the stamps beside them count.
    pub stamp: Option<String>,
    /// Unit of the samples.
    pub unit: Unit,
    /// True if file, flag or answer gave the unit.
    pub says_unit: bool,
    /// Sample rate \[Hz\], where it is not in the stamps.
    pub fs_hz: Option<f64>,
}

impl Sensor {
    /// Chooses among the channels of a file; among none without a file.
    ///
    /// # Errors
    /// There is no such channel, its field or unit is unknown, or a choice is needed and cannot be asked for.
    pub fn of<R: BufRead>(
        wanted: &Wanted<'_>,
        found: Option<&[Content]>,
        questions: &mut Questions<R>,
    ) -> anyhow::Result<Self> {
        let topic = topic(wanted.topic, found, questions)?;
        let content = found
            .unwrap_or_default()
            .iter()
            .find(|content| content.topic == topic);
        let field = match (wanted.field, content.map(|content| &content.field)) {
            (Some(field), _) => field.to_owned(),
            (None, Some(Ok(field))) => field.clone(),
            (None, Some(Err(fault))) => {
                let numbers = content.map_or(&[][..], |content| &content.numbers);
                match numbers {
                    [] => {
                        return Err(BadArguments(format!(
                            "--field is needed: of {topic} none of the usual fields can be read ({fault})"
                        ))
                        .into());
                    }
                    [only] => only.clone(),
                    several => {
                        let list = several.join(", ");
                        let question = format!("field of the samples, one of {list}");
                        questions.ask(&question, "--field", |answer| {
                            let is_there = several.iter().any(|field| field == answer);
                            match is_there {
                                true => Ok(answer.to_owned()),
                                false => Err(format!("{answer:?} is none of {list}")),
                            }
                        })?
                    }
                }
            }
            (None, None) => "value".to_owned(),
        };
        let unit = match (wanted.unit, content.and_then(|content| content.unit)) {
            (Some(unit), Some(said)) if unit != said => {
                return Err(BadArguments(format!(
                    "--unit {}: the recording says {}",
                    unit.key(),
                    said.key()
                ))
                .into());
            }
            (None, None) if wanted.needs_unit => {
                let question = "unit of the samples (m, mm, um, mm/s, m/s2, g ...)";
                Some(questions.ask(question, "--unit", |answer| {
                    Unit::as_written(answer)
                        .filter(|unit| Unit::MOTION.contains(unit))
                        .ok_or_else(|| format!("{answer:?} is no unit of motion known here"))
                })?)
            }
            (unit, said) => unit.or(said),
        };
        Ok(Self {
            stamp: content.and_then(|content| content.stamp.clone()),
            topic,
            field,
            unit: unit.unwrap_or(Unit::Metre),
            says_unit: unit.is_some(),
            fs_hz: wanted
                .fs_hz
                .or_else(|| content.and_then(|content| content.array_fs_hz)),
        })
    }
}

/// Topic asked for, the only one that can be motion, the only one declared as motion, or an answer.
fn topic<R: BufRead>(
    wanted: Option<&str>,
    found: Option<&[Content]>,
    questions: &mut Questions<R>,
) -> anyhow::Result<String> {
    let Some(found) = found else {
        return match wanted {
            Some(topic) => Ok(topic.to_owned()),
            None => questions.ask(
                "topic of the samples",
                "--topic or a recording",
                |answer| match answer.is_empty() {
                    true => Err("a name is expected".to_owned()),
                    false => Ok(answer.to_owned()),
                },
            ),
        };
    };
    let is_motion = |content: &&Content| content.unit.is_none_or(|unit| Unit::MOTION.contains(&unit));
    let topics: Vec<&str> = found
        .iter()
        .filter(is_motion)
        .map(|content| content.topic.as_str())
        .collect();
    if let Some(wanted) = wanted {
        return match found.iter().any(|content| content.topic == wanted) {
            true => Ok(wanted.to_owned()),
            false => Err(BadArguments(format!(
                "--topic {wanted}: the recording has {}",
                topics.join(", ")
            ))
            .into()),
        };
    }
    let telling: Vec<&str> = found
        .iter()
        .filter(|content| content.unit.is_some())
        .filter(is_motion)
        .map(|content| content.topic.as_str())
        .collect();
    match (&topics[..], &telling[..]) {
        ([], _) => {
            Err(BadArguments("the recording has no channel of motion with messages".to_owned()).into())
        }
        ([only], _) | (_, [only]) => Ok((*only).to_owned()),
        (several, _) => {
            let list = several.join(", ");
            let question = format!("topic of the samples, one of {list}");
            questions.ask(&question, "--topic", |answer| match several.contains(&answer) {
                true => Ok(answer.to_owned()),
                false => Err(format!("{answer:?} is none of {list}")),
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn content(topic: &str, unit: Option<Unit>) -> Content {
        Content {
            topic: topic.into(),
            field: Ok("values".into()),
            numbers: Vec::new(),
            stamp: None,
            unit,
            array_fs_hz: Some(200.0),
        }
    }

    fn chosen(wanted: &Wanted<'_>, found: Option<&[Content]>, answers: &str) -> anyhow::Result<Sensor> {
        let mut questions = Questions {
            answers: answers.as_bytes(),
            is_terminal: !answers.is_empty(),
        };
        Sensor::of(wanted, found, &mut questions)
    }

    #[test]
    fn the_only_channel_of_motion_is_taken_and_of_several_one_is_asked_for() {
        let (mm, celsius) = (Some(Unit::Millimetre), Some(Unit::Celsius));
        let any = Wanted::default();
        let one = [content("/rod", mm), content("/air", celsius)];
        let sensor = chosen(&any, Some(&one), "").unwrap();
        assert_eq!(
            (sensor.topic.as_str(), sensor.unit, sensor.fs_hz),
            ("/rod", Unit::Millimetre, Some(200.0))
        );
        // The hammer beside it has no unit, so it is not known to be a motion.
        let telling = [content("hammer", None), content("laser", mm)];
        assert_eq!(chosen(&any, Some(&telling), "").unwrap().topic, "laser");
        let several = [content("a", mm), content("b", mm)];
        let said = chosen(&any, Some(&several), "").unwrap_err().to_string();
        assert!(
            said.contains("--topic is needed") && said.contains("a, b"),
            "{said}"
        );
        assert_eq!(chosen(&any, Some(&several), "c\nb\n").unwrap().topic, "b");
    }

    #[test]
    fn fields_that_were_found_are_offered() {
        let robot = [Content {
            field: Err("no field `value`".into()),
            numbers: vec!["point.x".into(), "point.z".into()],
            stamp: Some("header.stamp".into()),
            ..content("/laser", Some(Unit::Metre))
        }];
        let said = chosen(&Wanted::default(), Some(&robot), "")
            .unwrap_err()
            .to_string();
        assert!(
            said.contains("--field is needed") && said.contains("point.x, point.z"),
            "{said}"
        );
        let sensor = chosen(&Wanted::default(), Some(&robot), "point.y\npoint.z\n").unwrap();
        assert_eq!(
            (sensor.field.as_str(), sensor.stamp.as_deref()),
            ("point.z", Some("header.stamp"))
        );
    }

    #[test]
    fn a_unit_is_asked_for_only_where_it_matters() {
        let bare = [content("[:]", None)];
        let sensor = chosen(&Wanted::default(), Some(&bare), "").unwrap();
        assert_eq!((sensor.unit, sensor.says_unit), (Unit::Metre, false));
        let must = Wanted {
            needs_unit: true,
            ..Wanted::default()
        };
        assert!(
            chosen(&must, Some(&bare), "")
                .unwrap_err()
                .to_string()
                .contains("--unit is needed")
        );
        let sensor = chosen(&must, None, "\n/rod\nV\ndegC\num\n").unwrap();
        assert_eq!((sensor.topic.as_str(), sensor.unit), ("/rod", Unit::Micrometre));
    }
}
