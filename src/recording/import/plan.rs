//! Settles topics, units, rates and times of a file before it is written, and checks them against a
//! configuration.

use super::agree::{agree, base, no_start, rate, time_units};
use super::asked::{Asked, Wanted, channels_of, choose, told, unit};
use super::grid::{self, Stretch};
use super::resample::resample;
use super::{ImportError, MOST_VALUES, Signal, Stamps, Timing};
use crate::write::{Encoding, Layout};
use std::ops::Range;
use std::sync::Arc;
use tirante_analysis::signal::record::{Timestamp, Unit};

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
mod tests;
