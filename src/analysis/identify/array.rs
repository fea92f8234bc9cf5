//! Several sensors of one rod, identified jointly: frequencies from the best combination of records, amplitude ratios as data.

use super::ratios::{data_of, is_silent};
use super::{Identification, Measurement, Plan, Refusal};
use crate::inference::joint::Datum;
use crate::inference::{SensorRatio, Tested};
use crate::signal::array::{Array, Ratio, Unsynchronised};
use crate::signal::modes::Mode;
use crate::signal::record::{Event, Moment, Record, Rejection, Timestamp, Unit};
use serde::{Deserialize, Serialize};

/// Half width of the band in which a mode of the combination is looked for, as a share of its frequency.
const NEAR: f64 = 0.04;
/// Standard errors by which frequencies of combination and first sensor may differ.
const AGREE: f64 = 5.0;
/// A sensor of a rod that has several.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Name for people: its topic.
    pub name: String,
    /// Its place, as a share of the length.
    pub at: f64,
    /// Standard error of its place \[m\].
    pub at_sd_m: f64,
    /// Unit of its channel.
    pub unit: Unit,
    /// Relative standard error of its calibration \[-\].
    pub gain_sd: f64,
}

/// Sensors of a moment, by name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Sensors {
    /// Those whose records were used, the leading one first.
    pub used: Vec<String>,
    /// Those that were left out.
    pub left_out: Vec<LeftOut>,
}

impl Sensors {
    /// True for a refused stretch of one sensor that is no moment of the rod.
    pub fn is_of_one(&self) -> bool {
        self.used.is_empty() && self.left_out.len() == 1
    }
}

/// A sensor that was left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Name of the sensor.
    pub sensor: String,
    /// Reason, for people.
    pub why: String,
}

/// Part of an identification that comes from several sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// The sensors.
    pub sensors: Sensors,
    /// Number of the leading sensor, from 0.
    pub lead: usize,
    /// Modal amplitudes of the sensors against each other.
    pub ratios: Vec<Datum>,
}

/// One sensor's record.
#[derive(Debug, Clone, Copy)]
pub struct Sensed<'a> {
    /// Its place, as a share of the length.
    pub at: f64,
    /// Standard error of its place \[m\].
    pub at_sd_m: f64,
    /// Unit of its channel.
    pub unit: Unit,
    /// Relative standard error of its calibration \[-\].
    pub gain_sd: f64,
    /// Its record.
    pub record: &'a Record,
}

/// Findings of several sensors together.
#[derive(Debug)]
pub struct ArrayResult {
    /// The identification, or the reason why there is none.
    pub outcome: Result<Identification, Refusal>,
    /// Sensors whose records were used, by index, the leading one first.
    pub used: Vec<usize>,
    /// Sensors that were left out, by index, with the reason.
    pub left_out: Vec<(usize, String)>,
    /// Modal amplitudes of the sensors against each other, which are data of the outcome.
    pub ratios: Vec<Datum>,
}

/// Reasons for the sensors of a moment that gave no record.
fn without_record(moment: &Moment) -> Vec<(usize, String)> {
    let refused = moment.seen.iter().filter_map(|(sensor, event)| match event {
        Event::Rejected { rejection, .. } => Some((*sensor, rejection.to_string())),
        _ => None,
    });
    let nothing = match moment.is_early {
        true => "the moment closed before its record came: what waits for other sensors took too much memory",
        false => "no record that belongs to this moment",
    };
    let absent = moment.absent.iter().map(|sensor| (*sensor, nothing.to_owned()));
    refused.chain(absent).collect()
}

impl Plan {
    /// Analyses a moment of a rod with several sensors; names those that its outcome comes from.
    pub fn run_moment(&self, moment: &Moment) -> (Result<Identification, Refusal>, Sensors) {
        let (mut numbers, mut sensed) = (Vec::new(), Vec::new());
        for (number, record) in moment.records() {
            if let Some(sensor) = self.settings.sensors.get(number) {
                numbers.push(number);
                sensed.push(Sensed {
                    at: sensor.at,
                    at_sd_m: sensor.at_sd_m,
                    unit: sensor.unit,
                    gain_sd: sensor.gain_sd,
                    record,
                });
            }
        }
        let found = self.run_array(&sensed);
        let used: Vec<usize> = found.used.into_iter().map(|i| numbers[i]).collect();
        let refused = found.left_out.into_iter().map(|(i, why)| (numbers[i], why));
        let sensors = self.named(&used, refused.chain(without_record(moment)).collect());
        let joint = |lead: usize| Joint {
            sensors: sensors.clone(),
            lead,
            ratios: found.ratios,
        };
        let outcome = found.outcome.map(|identification| Identification {
            joint: used.first().copied().map(joint),
            ..identification
        });
        (outcome, sensors)
    }

    /// Sensors of a moment of which no record was used, for the reason `why`.
    pub fn sensors_unused(&self, moment: &Moment, why: &str) -> Sensors {
        let records = moment.records().map(|(sensor, _)| (sensor, why.to_owned()));
        self.named(&[], records.chain(without_record(moment)).collect())
    }

    /// Sensors by name, those left out in their order.
    fn named(&self, used: &[usize], mut left_out: Vec<(usize, String)>) -> Sensors {
        let name = |number: usize| {
            let sensor = self.settings.sensors.get(number);
            sensor.map_or_else(String::new, |sensor| sensor.name.clone())
        };
        left_out.sort_by_key(|(number, _)| *number);
        let left_out = left_out.into_iter().map(|(number, why)| LeftOut {
            sensor: name(number),
            why,
        });
        Sensors {
            used: used.iter().map(|&number| name(number)).collect(),
            left_out: left_out.collect(),
        }
    }

    /// Analyses records of one moment, of one sensor each. The first that shows numbered modes
    /// leads, a displacement before a strain; others are left out where they cannot be put beside it.
    pub fn run_array(&self, sensed: &[Sensed<'_>]) -> ArrayResult {
        let mut left_out = Vec::new();
        let mut lead = None;
        let mut first_refusal = None;
        let mut order: Vec<usize> = (0..sensed.len()).collect();
        order.sort_by_key(|&i| sensed[i].unit.is_strain());
        for &i in &order {
            match self.modal.identify(sensed[i].record) {
                Ok(estimate) => {
                    lead = Some((i, estimate));
                    break;
                }
                Err(found) => {
                    left_out.push((i, found.rejection.to_string()));
                    let record = sensed[i].record;
                    first_refusal.get_or_insert_with(|| Refusal {
                        rejection: found.rejection,
                        measurement: found
                            .evidence
                            .map(|evidence| Box::new(Measurement::new(record, record.identity(), *evidence))),
                        labels: found.labels,
                    });
                }
            }
        }
        let Some((lead, estimate)) = lead else {
            let nothing = || Rejection::NoLabel {
                peaks: 0,
                detail: "there is no sensor".to_owned(),
            };
            return ArrayResult {
                outcome: Err(first_refusal.unwrap_or_else(|| nothing().into())),
                used: Vec::new(),
                left_out,
                ratios: Vec::new(),
            };
        };
        // The lead first; those that lead to nothing by themselves may still help where the lead knows the modes.
        let refused_alone = std::mem::take(&mut left_out);
        order.retain(|&i| i != lead);
        order.insert(0, lead);
        let record = sensed[lead].record;
        let (modes, ratios) = self.beside(sensed, &mut order, &estimate.modes, &mut left_out);
        for (i, why) in &mut left_out {
            if let Some((_, alone)) = refused_alone.iter().find(|(refused, _)| refused == i) {
                *why = format!("{why}; alone: {alone}");
            }
        }
        let sensors: Vec<Sensed<'_>> = order.iter().map(|&i| sensed[i]).collect();
        let ratios = data_of(&sensors, &ratios, &self.settings.prior);
        let seed = self.seed_of(&record.identity());
        let measurement = Measurement::new(record, record.identity(), estimate.evidence);
        let outcome = match self.infer_beside(Some(record.start), modes, &ratios, &[], seed) {
            Ok(found) => Ok(Identification {
                measurement: Some(measurement),
                labels: Some(estimate.labels),
                ..found
            }),
            Err(rejection) => Err(Refusal {
                rejection,
                measurement: Some(Box::new(measurement)),
                labels: Some(estimate.labels),
            }),
        };
        ArrayResult {
            outcome,
            used: order,
            left_out,
            ratios,
        }
    }

    /// Posterior of a moment's frequencies, jointly with amplitude ratios between its sensors and other data.
    pub(super) fn infer_beside(
        &self,
        start: Option<Timestamp>,
        modes: Vec<Mode>,
        ratios: &[Datum],
        data: &[Datum],
        seed: u64,
    ) -> Result<Identification, Rejection> {
        let found = self.infer(start, modes, &[ratios, data].concat(), seed)?;
        let shapes = ratios.iter().filter_map(SensorRatio::of).collect();
        Ok(Identification {
            tested: found.tested.map(|tested| Tested { shapes, ..tested }),
            ..found
        })
    }

    /// Frequencies of the combinations, and amplitude ratios between the sensors of `order`, of which those that cannot be compared are
    /// taken out.
    fn beside(
        &self,
        sensed: &[Sensed<'_>],
        order: &mut Vec<usize>,
        modes: &[Mode],
        left_out: &mut Vec<(usize, String)>,
    ) -> (Vec<Mode>, Vec<Ratio>) {
        let first = sensed[order[0]];
        let records: Vec<(&Record, i32)> = order
            .iter()
            .map(|&i| {
                (
                    sensed[i].record,
                    sensed[i].unit.derivative() - first.unit.derivative(),
                )
            })
            .collect();
        let (mut array, refused) = Array::new(&records);
        for (i, why) in refused.into_iter().rev() {
            left_out.push((order.remove(i), why.to_string()));
        }
        'again: while array.len() > 1 {
            let (mut better, mut ratios) = (Vec::new(), Vec::new());
            for mode in modes {
                match array.sight(mode) {
                    Ok(Some(sight)) => {
                        let combined = array.combined(first.record, &sight.weights);
                        better.push(self.refined(mode, &combined).unwrap_or(*mode));
                        ratios.extend(sight.ratios);
                    }
                    Ok(None) => better.push(*mode),
                    Err((i, why)) => {
                        left_out.push((order.remove(i), why.to_string()));
                        array.remove(i);
                        continue 'again;
                    }
                }
            }
            if let Some(i) = (1..array.len()).rev().find(|&i| is_silent(i, &ratios)) {
                left_out.push((order.remove(i), Unsynchronised::Silent.to_string()));
                array.remove(i);
                continue 'again;
            }
            return (better, ratios);
        }
        // Alone, the lead's own frequencies are the best.
        (modes.to_vec(), Vec::new())
    }

    /// The mode in the combination; `None` where it does not agree with the lead's.
    fn refined(&self, mode: &Mode, combined: &Record) -> Option<Mode> {
        let (low, high) = (1.0 - NEAR, 1.0 + NEAR);
        let search = self.modal.search();
        let found = search
            .evidence(combined, low * mode.frequency_hz, high * mode.frequency_hz)
            .ok()?;
        let away = |f: f64| (f - mode.frequency_hz).abs();
        let nearest = found
            .resonances
            .iter()
            .filter(|resonance| !resonance.line)
            .min_by(|a, b| away(a.frequency_hz).total_cmp(&away(b.frequency_hz)))?;
        let agrees = away(nearest.frequency_hz) <= AGREE * mode.sd_hz.hypot(nearest.frequency_sd_hz);
        agrees.then_some(Mode {
            frequency_hz: nearest.frequency_hz,
            sd_hz: nearest.frequency_sd_hz,
            damping: Some(nearest.damping),
            ..*mode
        })
    }
}
