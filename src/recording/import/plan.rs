//! Settles topics, units, rates and times of a file before it is written, and checks them against a
//! configuration.

use super::agree::{agree, base, no_start, rate, time_units};
use super::asked::{Asked, Wanted, channels_of, choose, told, unit};
use super::grid::{self, Stretch};
use super::resample::resample;
use super::{ImportError, MOST_VALUES, Signal, Stamps, Timing};
use crate::analysis::signal::record::{Timestamp, Unit};
use crate::recording::write::{Encoding, Layout};
use std::ops::Range;
use std::sync::Arc;

/// Most samples in a message.
const BATCH: usize = 4096;

/// A recording that can be written.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Encoding of its messages.
    pub encoding: Encoding,
    /// Channels, each with a topic of its own.
    pub channels: Vec<Planned>,
}

/// A channel of a plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Name in the file.
    pub name: String,
    /// Unit as the file writes it.
    pub written_unit: Option<String>,
    /// Topic.
    pub topic: String,
    /// Unit of the samples.
    pub unit: Unit,
    /// Sample rate \[Hz\].
    pub fs_hz: f64,
    /// Number of samples per message: one or a batch.
    pub layout: Layout,
    /// Samples.
    pub values: Vec<f64>,
    /// Stretches without a gap: time of the first sample, and range of the samples.
    pub stretches: Vec<(Timestamp, Range<usize>)>,
    /// Largest distance of a stamp from its place on the grid \[s\]; `None` without stamps.
    pub deviation_s: Option<f64>,
    /// True if the samples are interpolated.
    pub is_resampled: bool,
    /// True if the unit is given; otherwise the metre is assumed.
    pub says_unit: bool,
    /// True if the start is given.
    pub says_start: bool,
    /// True if each sample keeps its own stamp, because they are uneven.
    pub is_stamped: bool,
    /// True if the rate is given or follows from the stamps; of uneven ones the record measures it.
    pub says_rate: bool,
}

impl Planned {
    /// Number of missing samples.
    pub fn missing(&self) -> usize {
        self.values.iter().filter(|value| !value.is_finite()).count()
    }

    /// The interpolation in words; `None` without one.
    pub fn interpolation(&self) -> Option<String> {
        let deviation_s = self.deviation_s.filter(|_| self.is_resampled)?;
        Some(format!("interpolated up to {deviation_s:.2e} s from a stamp"))
    }

    /// Field of a message that holds the samples.
    pub fn field(&self, encoding: Encoding) -> &'static str {
        encoding.samples_field(matches!(self.layout, Layout::Batch(_)))
    }
}

impl Plan {
    /// Settles all that is open.
    ///
    /// # Errors
    /// Something is missing or contradicts: a unit, the rate, the time, a channel; the sentence names the
    /// remedy.
    pub fn new(signals: Vec<Signal>, asked: &Asked<'_>, encoding: Encoding) -> Result<Self, ImportError> {
        let chosen = choose(signals, asked.channels)?;
        let plan = Self::of(chosen, asked, encoding)?;
        plan.check(asked.rods, true)?;
        Ok(plan)
    }

    /// The same for channels already assigned to rods, to be read without being written.
    pub(super) fn to_read(signals: Vec<(Signal, Wanted)>, asked: &Asked<'_>) -> Result<Self, ImportError> {
        let chosen = signals
            .iter()
            .map(|(_, wanted)| wanted.clone())
            .collect::<Vec<_>>();
        let signals = signals.into_iter().map(|(signal, _)| signal);
        let pairs = signals
            .zip(&chosen)
            .map(|(signal, wanted)| (signal, Some(wanted)));
        let plan = Self::of(pairs.collect(), asked, Encoding::Protobuf)?;
        plan.check(asked.rods, false)?;
        Ok(plan)
    }

    fn of(
        chosen: Vec<(Signal, Option<&Wanted>)>,
        asked: &Asked<'_>,
        encoding: Encoding,
    ) -> Result<Self, ImportError> {
        let mut grids = Vec::new();
        let mut plan = Self {
            encoding,
            channels: Vec::new(),
        };
        for (signal, wanted) in chosen {
            let planned = plan.settle(signal, wanted, asked, &mut grids)?;
            plan.channels.push(planned);
        }
        Ok(plan)
    }

    fn settle(
        &self,
        signal: Signal,
        wanted: Option<&Wanted>,
        asked: &Asked<'_>,
        grids: &mut Vec<(Arc<Stamps>, grid::Grid)>,
    ) -> Result<Planned, ImportError> {
        let topic = self.topic(&signal, wanted)?;
        let unit = unit(&signal, wanted, asked, &topic)?;
        let told = told(&signal);
        let says_start = asked.start.is_some() || super::has_start(&signal);
        let mut values = signal.values;
        let most = MOST_VALUES.saturating_sub(self.channels.iter().map(|c| c.values.len()).sum());
        let (fs_hz, stretches, deviation_s) = match &signal.timing {
            Timing::Stamps(stamps) => {
                let is_motion = !unit.is_some_and(|unit| Unit::TEMPERATURE.contains(&unit));
                if let Some(rates) = time_units(stamps).filter(|_| is_motion) {
                    return Err(ImportError::new(format!(
                        "nothing says the unit of the time column, and {told} would have a rate of ({rates}): --time-unit says it"
                    )));
                }
                let base_ns = base(stamps, asked, &told)?;
                let grid = match asked.resample_hz {
                    Some(fs_hz) => {
                        let (grid, resampled) = resample(stamps, &values, fs_hz, most)?;
                        values = resampled;
                        grid
                    }
                    None => match grids.iter().find(|(known, _)| Arc::ptr_eq(known, stamps)) {
                        Some((_, grid)) => grid.clone(),
                        None => {
                            let grid = grid::even(stamps).or_else(|error| {
                                let stamped = asked.keeps_stamps.then(|| grid::uneven(stamps)).flatten();
                                stamped.ok_or(error)
                            })?;
                            grids.push((Arc::clone(stamps), grid.clone()));
                            grid
                        }
                    },
                };
                // The stretches between uneven stamps' longer intervals give no rate: the record measures it.
                let is_even = grid.stretches.len() < values.len().max(2);
                if !grid.holes.is_empty() {
                    let end = grid.stretches.last().map_or(0, |stretch| stretch.samples.end);
                    if end > most {
                        return Err(ImportError::too_long());
                    }
                    values = grid.filled(values);
                }
                if asked.resample_hz.is_none() && is_even {
                    agree(grid.fs_hz, asked.rate_hz, &told)?;
                }
                let place = |stretch: &Stretch| {
                    let time = Timestamp::from_nanos(stretch.start_ns.saturating_add(base_ns));
                    (time, stretch.samples.clone())
                };
                (
                    asked.rate_hz.filter(|_| !is_even).unwrap_or(grid.fs_hz),
                    grid.stretches.iter().map(place).collect(),
                    Some(grid.deviation_s),
                )
            }
            timing => {
                if asked.resample_hz.is_some() {
                    return Err(ImportError::new(format!(
                        "{told} has no stamps to resample from: leave --resample out"
                    )));
                }
                let of_config = channels_of(asked.rods)
                    .find(|(_, channel)| channel.topic == topic)
                    .and_then(|(_, channel)| channel.fs_hz);
                let fs_hz = rate(timing, asked.rate_hz, of_config, &told)?;
                let of_file = match timing {
                    Timing::Rate { start, .. } => *start,
                    _ => None,
                };
                if let (Some(of_file), Some(start)) = (of_file, asked.start)
                    && of_file != start
                {
                    return Err(ImportError::new(format!(
                        "{told} begins at {of_file} by the file, at {start} by --start: leave --start out"
                    )));
                }
                let start = of_file.or(asked.start).or(asked.start_else);
                let start = start.ok_or_else(|| no_start(&told))?;
                (fs_hz, vec![(start, 0..values.len())], None)
            }
        };
        if !(1e-4..=1e6).contains(&fs_hz) {
            return Err(ImportError::new(format!(
                "{told}: a rate of {fs_hz} Hz lies outside 0.0001 Hz to 1 MHz"
            )));
        }
        let says_unit = unit.is_some();
        let unit = unit.unwrap_or(Unit::Metre);
        let is_stamped = stretches.len() > 1 && stretches.len() == values.len();
        let is_batch = !Unit::TEMPERATURE.contains(&unit) && fs_hz > 2.0 && !is_stamped;
        Ok(Planned {
            name: signal.name,
            written_unit: signal.unit,
            topic,
            unit,
            fs_hz,
            // About a second a message. Temperatures come one by one, as the pipeline reads them beside records.
            layout: if is_batch {
                Layout::Batch((fs_hz.ceil() as usize).min(BATCH))
            } else {
                Layout::Sample
            },
            values,
            stretches,
            deviation_s,
            is_resampled: asked.resample_hz.is_some(),
            says_unit,
            says_start,
            is_stamped,
            says_rate: !is_stamped || asked.rate_hz.is_some(),
        })
    }

    fn topic(&self, signal: &Signal, wanted: Option<&Wanted>) -> Result<String, ImportError> {
        let is_taken = |topic: &str| self.channels.iter().any(|channel| channel.topic == topic);
        let topic = match wanted.and_then(|wanted| wanted.topic.clone()) {
            Some(topic) if is_taken(&topic) => {
                return Err(ImportError::new(format!(
                    "two channels of the topic {topic:?} are asked for"
                )));
            }
            Some(topic) => topic,
            None => {
                let name = match signal.name.as_str() {
                    "" => format!("channel-{}", signal.number),
                    name => name.to_owned(),
                };
                let mut topic = name.clone();
                let mut number = 2;
                while is_taken(&topic) {
                    topic = format!("{name}-{number}");
                    number += 1;
                }
                topic
            }
        };
        if topic.len() > 255 || topic.chars().any(char::is_control) {
            return Err(ImportError::new(format!(
                "{} cannot be a topic (1 to 255 bytes of text): --channel {}=TOPIC names it",
                super::lines::shown(&topic),
                signal.number
            )));
        }
        Ok(topic)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::signal::record::{Channel, RodChannels, RodId, TimeSource};

    fn signal(name: &str, unit: Option<&str>, timing: Timing) -> Signal {
        Signal {
            name: name.into(),
            number: 1,
            unit: unit.map(str::to_owned),
            timing,
            values: vec![0.5; 10],
        }
    }

    fn steady(start: Option<Timestamp>) -> Timing {
        Timing::Rate {
            fs_hz: 200.0,
            rounding: 0.0,
            start,
        }
    }

    fn planned(signals: Vec<Signal>, asked: &Asked<'_>) -> Result<Vec<Planned>, String> {
        let plan = Plan::new(signals, asked, Encoding::Protobuf);
        plan.map(|plan| plan.channels).map_err(|error| error.to_string())
    }

    const START: Timestamp = Timestamp::from_nanos(1_772_344_800_000_000_000);

    fn reads(topic: &str, unit: Unit, field: &str, fs_hz: f64) -> RodChannels {
        RodChannels {
            rod: RodId("nave".into()),
            displacement: Channel {
                topic: topic.into(),
                field: field.into(),
                unit,
                time: TimeSource::Log,
                fs_hz: Some(fs_hz),
            },
            temperature: None,
            beside: None,
        }
    }

    #[test]
    fn what_is_missing_is_named_with_the_next_step() {
        let asked = Asked::default();
        let refused = |signal: Signal| planned(vec![signal], &asked).unwrap_err();
        assert!(refused(signal("d", None, steady(Some(START)))).contains("--unit"));
        assert!(refused(signal("d", Some("V"), steady(Some(START)))).contains("\"V\""));
        assert!(refused(signal("d", Some("mm"), steady(None))).contains("--start"));
        assert!(refused(signal("d", Some("mm"), Timing::Unknown)).contains("--rate"));
        let good = planned(vec![signal("d", Some("mm"), steady(Some(START)))], &asked).unwrap();
        assert_eq!(
            (good[0].unit, good[0].fs_hz, good[0].topic.as_str()),
            (Unit::Millimetre, 200.0, "d")
        );
    }

    /// 200 Hz in ms would be 0.2 Hz in seconds: slower than any rod moves, but right for a thermometer.
    #[test]
    fn times_of_an_unknown_unit_are_not_taken_for_seconds_of_a_motion() {
        let stamped = |unit: Option<&str>, says_unit: bool| {
            let stamps = Stamps {
                nanos: (0..10).map(|i| i * 5_000_000_000).collect(),
                absolute: false,
                resolution_ns: 1_000_000_000,
                says_unit,
                lines: Vec::new(),
            };
            let asked = Asked {
                start: Some(START),
                any_unit: true,
                ..Asked::default()
            };
            planned(vec![signal("d", unit, Timing::Stamps(Arc::new(stamps)))], &asked)
        };
        for unit in [Some("mm"), None] {
            let said = stamped(unit, false).unwrap_err();
            assert!(
                said.contains("s: 0.2 Hz, ms: 200 Hz, us: 200000 Hz") && said.contains("--time-unit"),
                "{said}"
            );
        }
        assert_eq!(stamped(Some("mm"), true).unwrap()[0].fs_hz, 0.2);
        assert_eq!(stamped(Some("\u{b0}C"), false).unwrap()[0].fs_hz, 0.2);
    }

    #[test]
    fn contradictions_name_both_sides() {
        let one = || vec![signal("d", Some("mm"), steady(Some(START)))];
        let asked = Asked {
            unit: Some(Unit::Metre),
            ..Asked::default()
        };
        assert_eq!(
            planned(one(), &asked).unwrap_err(),
            "channel 1 (d) is in mm by the file, in m by the command line"
        );
        let asked = Asked {
            rate_hz: Some(256.0),
            ..Asked::default()
        };
        assert!(
            planned(one(), &asked)
                .unwrap_err()
                .contains("200 Hz by the file, 256 Hz by --rate")
        );
        let rods = [reads("d", Unit::Micrometre, "values", 200.0)];
        let asked = Asked {
            rods: &rods,
            ..Asked::default()
        };
        let error = planned(one(), &asked).unwrap_err();
        assert!(
            error.contains("is in mm") && error.contains("of rod nave in um"),
            "{error}"
        );
        for (rod, word) in [
            (
                reads("e", Unit::Millimetre, "values", 200.0),
                "--channel SOURCE=TOPIC",
            ),
            (reads("d", Unit::Millimetre, "value", 200.0), "\"value\""),
            (reads("d", Unit::Millimetre, "values", 100.0), "fs_hz = 100"),
        ] {
            let rods = [rod];
            let error = planned(
                one(),
                &Asked {
                    rods: &rods,
                    ..Asked::default()
                },
            )
            .unwrap_err();
            assert!(error.contains(word), "{error}");
        }
        let rods = [reads("d", Unit::Millimetre, "values", 200.0)];
        assert!(
            planned(
                one(),
                &Asked {
                    rods: &rods,
                    ..Asked::default()
                }
            )
            .is_ok()
        );
    }

    #[test]
    fn the_configuration_says_a_unit_the_file_does_not_say() {
        let rods = [reads("d", Unit::Micrometre, "values", 200.0)];
        let asked = Asked {
            rods: &rods,
            ..Asked::default()
        };
        let found = planned(vec![signal("d", None, steady(Some(START)))], &asked).unwrap();
        assert_eq!(found[0].unit, Unit::Micrometre);
    }

    #[test]
    fn a_unit_for_all_is_not_the_thermometers() {
        let asked = Asked {
            unit: Some(Unit::Millimetre),
            ..Asked::default()
        };
        let signals = vec![
            signal("d", None, steady(Some(START))),
            signal("air", Some("°C"), steady(Some(START))),
        ];
        let found = planned(signals, &asked).unwrap();
        assert_eq!((found[0].unit, found[1].unit), (Unit::Millimetre, Unit::Celsius));
        assert_eq!(found[1].layout, Layout::Sample);
    }

    #[test]
    fn channels_are_chosen_renamed_and_numbered_when_alike() {
        let signals = || {
            let mut second = signal("d", Some("mm"), steady(Some(START)));
            second.number = 2;
            vec![signal("d", Some("mm"), steady(Some(START))), second]
        };
        let topics = |found: Vec<Planned>| found.into_iter().map(|channel| channel.topic).collect::<Vec<_>>();
        assert_eq!(
            topics(planned(signals(), &Asked::default()).unwrap()),
            ["d", "d-2"]
        );
        let wanted = [Wanted::parse("2=/nave,mm").unwrap()];
        let asked = Asked {
            channels: &wanted,
            ..Asked::default()
        };
        assert_eq!(topics(planned(signals(), &asked).unwrap()), ["/nave"]);
        let wanted = [Wanted::parse("x").unwrap()];
        let asked = Asked {
            channels: &wanted,
            ..Asked::default()
        };
        assert!(
            planned(signals(), &asked)
                .unwrap_err()
                .contains("there is: 1 (d), 2 (d)")
        );
        assert!(Wanted::parse("2=/nave,parsec").is_err() && Wanted::parse("=x").is_err());
        assert_eq!(
            Wanted::parse("a b=,um").unwrap(),
            Wanted {
                source: "a b".into(),
                topic: None,
                unit: Some(Unit::Micrometre)
            }
        );
    }

    #[test]
    fn a_rate_of_six_digits_is_the_round_one() {
        let timing = Timing::Rate {
            fs_hz: 1.0 / 9.76562e-4,
            rounding: 0.5e-5 / 9.76562,
            start: Some(START),
        };
        let found = planned(vec![signal("d", Some("mm"), timing)], &Asked::default()).unwrap();
        assert_eq!(found[0].fs_hz, 1024.0);
    }

    #[test]
    fn a_rate_of_few_digits_is_the_round_one_or_none() {
        let read = |step_s: f64, last_digit_s: f64| {
            let timing = Timing::Rate {
                fs_hz: 1.0 / step_s,
                rounding: 0.5 * last_digit_s / step_s,
                start: Some(START),
            };
            let found = planned(vec![signal("d", Some("mm"), timing)], &Asked::default())?;
            Ok::<f64, String>(found[0].fs_hz)
        };
        for (step_s, last_digit_s, fs_hz) in [
            (0.000_977, 1e-6, 1024.0),
            (0.005, 1e-6, 200.0),
            (0.006_667, 1e-6, 150.0),
            (0.003_333, 1e-6, 300.0),
            (0.000_625, 1e-6, 1600.0),
            (1.953_13e-3, 1e-8, 512.0),
        ] {
            assert_eq!(read(step_s, last_digit_s).unwrap(), fs_hz, "{step_s}");
        }
        // 1117 to 1119 Hz: nothing round; 0.0005 to one digit: 1000 to 2000 Hz.
        for (step_s, last_digit_s) in [(0.000_894_4, 1e-6), (0.000_5, 1e-4)] {
            let error = read(step_s, last_digit_s).unwrap_err();
            assert!(
                error.contains("so few digits") && error.contains("--rate"),
                "{error}"
            );
        }
        // The configuration's rate within the rounding counts.
        let rods = [reads("d", Unit::Millimetre, "values", 1023.7)];
        let timing = Timing::Rate {
            fs_hz: 1.0 / 0.000_977,
            rounding: 5e-7 / 0.000_977,
            start: Some(START),
        };
        let asked = Asked {
            rods: &rods,
            ..Asked::default()
        };
        let found = planned(vec![signal("d", Some("mm"), timing)], &asked).unwrap();
        assert_eq!(found[0].fs_hz, 1023.7);
    }

    #[test]
    fn a_start_that_contradicts_the_files_is_refused() {
        let asked = Asked {
            start: Some(START.plus_seconds(60.0)),
            ..Asked::default()
        };
        let error = planned(vec![signal("d", Some("mm"), steady(Some(START)))], &asked).unwrap_err();
        assert!(
            error.contains("by the file") && error.contains("--start"),
            "{error}"
        );
        assert!(planned(vec![signal("d", Some("mm"), steady(None))], &asked).is_ok());
    }
}
