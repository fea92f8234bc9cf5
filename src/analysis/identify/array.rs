//! Several sensors of one rod, identified jointly: frequencies from the best combination of records, amplitude ratios as data.

use super::{Identification, Measurement, Plan, Refusal};
use crate::inference::joint::Datum;
use crate::inference::{SensorRatio, Tested};
use crate::rod::prior::RodPrior;
use crate::rod::query::{Queries, Query};
use crate::signal::array::{Array, Ratio, Unsynchronised};
use crate::signal::modes::Mode;
use crate::signal::record::{Event, Moment, Record, Rejection, Timestamp, Unit};
use serde::{Deserialize, Serialize};

/// Half width of the band in which a mode of the combination is looked for, as a share of its frequency.
const NEAR: f64 = 0.04;
/// Standard errors by which frequencies of combination and first sensor may differ.
const AGREE: f64 = 5.0;
/// Standard errors that a ratio must be away from zero to be turned upside down: nearer, its inverse is not normal.
const INVERTED: f64 = 5.0;
/// Half the distance of two places between which a ratio's slope is taken, as a share of the length.
const SLOPE: f64 = 1e-4;

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

/// True for a sensor that was compared, and shows no mode.
fn is_silent(sensor: usize, ratios: &[Ratio]) -> bool {
    let mut own = ratios
        .iter()
        .filter(|ratio| ratio.sensor == sensor || ratio.reference == sensor)
        .peekable();
    own.peek().is_some() && own.all(|ratio| ratio.sensor == sensor && !ratio.is_seen())
}

/// Ratios between `sensors` as data of the rod, without those that the model does not compare.
///
/// One sensor's gain is in all pairs of which it is, one sensor's place in all their ratios. Both enter as independent from pair to
/// pair and from ratio to ratio, with the variance times their number n: `d d' <= n diag(d^2)`, so no combination of them counts for more
/// than it is worth.
fn data_of(sensors: &[Sensed<'_>], ratios: &[Ratio], prior: &RodPrior) -> Vec<Datum> {
    let compared: Vec<(&Ratio, Query, f64, f64)> = ratios
        .iter()
        .filter_map(|ratio| {
            let (query, value, sd) = comparison(&sensors[ratio.sensor], &sensors[ratio.reference], ratio)?;
            Some((ratio, query, value, sd))
        })
        .collect();
    let pair = |ratio: &Ratio| {
        (
            ratio.sensor.min(ratio.reference),
            ratio.sensor.max(ratio.reference),
        )
    };
    let mut pairs: Vec<(usize, usize)> = compared.iter().map(|(ratio, ..)| pair(ratio)).collect();
    let times = |pairs: &[(usize, usize)], sensor: usize| {
        let own = pairs.iter().filter(|(a, b)| *a == sensor || *b == sensor);
        own.count() as f64
    };
    let in_ratios: Vec<f64> = (0..sensors.len()).map(|sensor| times(&pairs, sensor)).collect();
    pairs.sort_unstable();
    pairs.dedup();
    let gain = |sensor: usize| times(&pairs, sensor).sqrt() * sensors[sensor].gain_sd;
    compared
        .into_iter()
        .filter_map(|(ratio, query, value, sd)| {
            let places = [ratio.sensor, ratio.reference].map(|i| {
                let sensor = &sensors[i];
                let slope_per_m = slope_per_m(prior, query, sensor.at)?;
                Some(in_ratios[i].sqrt() * sensor.at_sd_m * slope_per_m)
            });
            Some(Datum {
                query,
                value,
                sd: sd.hypot(places[0]?).hypot(places[1]?),
                gain_sd: gain(ratio.sensor).hypot(gain(ratio.reference)),
            })
        })
        .collect()
}

/// Derivative of a ratio by the place of its sensor at `at`, of the rod at the prior's centre.
fn slope_per_m(prior: &RodPrior, query: Query, at: f64) -> Option<f64> {
    // A gauge on a support: inwards of it.
    let middle = at.clamp(SLOPE, 1.0 - SLOPE);
    let moved = |to: f64| {
        let place = |own: f64| if own == at { to } else { own };
        match query {
            Query::AmplitudeRatio {
                order,
                at,
                reference_at,
            } => Query::AmplitudeRatio {
                order,
                at: place(at),
                reference_at: place(reference_at),
            },
            Query::StrainRatio {
                order,
                strain_at,
                read_at,
            } => Query::StrainRatio {
                order,
                strain_at: place(strain_at),
                read_at: place(read_at),
            },
            other => other,
        }
    };
    let parameterisation = *prior.parameterisation();
    let both = vec![moved(middle - SLOPE), moved(middle + SLOPE)];
    let (centre, mut answers) = (prior.centre(), [0.0; 2]);
    Queries::new(parameterisation, both)?
        .answers(&centre, &mut answers)
        .ok()?;
    let apart_m = 2.0 * SLOPE * parameterisation.beam(&centre).length_m;
    Some((answers[1] - answers[0]) / apart_m)
}

/// A ratio as a query with value and standard error; `None` for sensors that the model does not compare.
fn comparison(sensor: &Sensed<'_>, reference: &Sensed<'_>, ratio: &Ratio) -> Option<(Query, f64, f64)> {
    let order = ratio.order;
    match (sensor.unit.is_strain(), reference.unit.is_strain()) {
        (false, false) => {
            let query = Query::AmplitudeRatio {
                order,
                at: sensor.at,
                reference_at: reference.at,
            };
            Some((query, ratio.value, ratio.sd))
        }
        (true, false) => {
            let query = Query::StrainRatio {
                order,
                strain_at: sensor.at,
                read_at: reference.at,
            };
            Some((query, ratio.value, ratio.sd))
        }
        (false, true) => {
            let query = Query::StrainRatio {
                order,
                strain_at: reference.at,
                read_at: sensor.at,
            };
            let value = 1.0 / ratio.value;
            let is_clear = ratio.value.abs() >= INVERTED * ratio.sd;
            is_clear.then_some((query, value, ratio.sd * value * value))
        }
        (true, true) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::record::{RodId, Timestamp};
    use std::f64::consts::PI;

    fn record() -> Record {
        Record {
            rod: RodId("a".to_owned()),
            start: Timestamp::from_nanos(0),
            fs_hz: 200.0,
            samples: Vec::new(),
            temperature_c: None,
            readings: Vec::new(),
            excitation: None,
            clock_sd: 0.0,
            flags: Vec::new(),
        }
    }

    fn sensors<'a>(record: &'a Record, places: &[f64], at_sd_m: f64) -> Vec<Sensed<'a>> {
        let sensor = |&at: &f64| Sensed {
            at,
            at_sd_m,
            unit: Unit::Metre,
            gain_sd: 0.01,
            record,
        };
        places.iter().map(sensor).collect()
    }

    fn ratio(order: usize, sensor: usize, reference: usize, value: f64) -> Ratio {
        Ratio {
            order,
            sensor,
            reference,
            value,
            sd: 1e-3,
        }
    }

    #[test]
    fn an_error_of_place_is_another_in_every_mode() {
        // A hinged rod: ratio sin(n pi x) / sin(n pi x_r), its slope n pi cos(n pi x) / (sin(n pi x_r) l).
        let prior = RodPrior::todi();
        let mut priors = prior.priors().to_vec();
        (priors[4], priors[5]) = (0.0.into(), 0.0.into());
        let prior = RodPrior::new(*prior.parameterisation(), priors).unwrap();
        let record = record();
        let sensors = sensors(&record, &[0.4, 0.1], 0.01);
        let ratios = [ratio(1, 1, 0, 0.3), ratio(2, 1, 0, 1.0), ratio(3, 1, 0, -1.4)];
        let data = data_of(&sensors, &ratios, &prior);
        for (n, datum) in (1..).zip(&data) {
            let wave = f64::from(n) * PI;
            let (sin, cos) = (wave * 0.1).sin_cos();
            let (sin_r, cos_r) = (wave * 0.4).sin_cos();
            let (own, other) = (
                wave * cos / sin_r / 14.0,
                wave * sin * cos_r / (sin_r * sin_r) / 14.0,
            );
            // Three ratios over one pair of places.
            let place = 3f64.sqrt() * 0.01 * own.hypot(other);
            let expected = place.hypot(1e-3);
            assert!(
                (datum.sd / expected - 1.0).abs() < 1e-3,
                "{n}: {} {expected}",
                datum.sd
            );
            // One pair: its gain once.
            assert!((datum.gain_sd - 0.01 * 2f64.sqrt()).abs() < 1e-12);
        }
    }

    #[test]
    fn a_gain_that_is_in_several_pairs_counts_once() {
        // Mean of the logarithms of three ratios over sensor 0: its variance has all of the reference's gain.
        let record = record();
        let sensors = sensors(&record, &[0.4, 0.1, 0.2, 0.3], 0.0);
        let ratios: Vec<Ratio> = (1..4).map(|i| ratio(1, i, 0, 0.5)).collect();
        let data = data_of(&sensors, &ratios, &RodPrior::todi());
        let mean_variance: f64 = data.iter().map(|datum| datum.gain_sd.powi(2)).sum::<f64>() / 9.0;
        let truth = 0.01f64.powi(2) * (1.0 + 1.0 / 3.0);
        assert!(mean_variance >= truth * (1.0 - 1e-12), "{mean_variance} {truth}");
        assert!((mean_variance / truth - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_strain_that_may_be_nothing_is_not_turned_upside_down() {
        let record = record();
        let mut sensors = sensors(&record, &[0.05, 0.1], 0.0);
        sensors[0].unit = Unit::Microstrain;
        let vague = Ratio {
            sd: 0.3,
            ..ratio(1, 1, 0, 1.0)
        };
        assert!(data_of(&sensors, &[vague], &RodPrior::todi()).is_empty());
        let clear = Ratio { sd: 0.1, ..vague };
        let [datum] = data_of(&sensors, &[clear], &RodPrior::todi())[..] else {
            panic!()
        };
        assert!((datum.value - 1.0).abs() < 1e-12 && (datum.sd - 0.1).abs() < 1e-12);
    }

    #[test]
    fn a_sensor_is_silent_that_shows_no_mode() {
        let nothing = Ratio {
            sd: 0.1,
            ..ratio(1, 2, 0, 0.05)
        };
        let both = [nothing, Ratio { order: 2, ..nothing }, ratio(1, 1, 0, 0.5)];
        assert!(is_silent(2, &both) && !is_silent(1, &both));
        // At the node of one mode, seen in another; compared with, where the lead saw nothing; not compared at all.
        assert!(!is_silent(2, &[nothing, ratio(2, 2, 0, 0.5)]));
        assert!(!is_silent(2, &[nothing, ratio(2, 0, 2, 0.01)]));
        assert!(!is_silent(3, &both));
    }
}
