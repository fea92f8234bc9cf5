//! Amplitude ratios between the sensors of a rod, as data of its posterior.

use super::array::Sensed;
use crate::inference::joint::Datum;
use crate::rod::prior::RodPrior;
use crate::rod::query::{Queries, Query};
use crate::signal::array::Ratio;

/// Standard errors that a ratio must be away from zero to be turned upside down: nearer, its inverse is not normal.
const INVERTED: f64 = 5.0;
/// Half the distance of two places between which a ratio's slope is taken, as a share of the length.
const SLOPE: f64 = 1e-4;

/// True for a sensor that was compared, and shows no mode.
pub(super) fn is_silent(sensor: usize, ratios: &[Ratio]) -> bool {
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
pub(super) fn data_of(sensors: &[Sensed<'_>], ratios: &[Ratio], prior: &RodPrior) -> Vec<Datum> {
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
    use crate::signal::record::{Record, RodId, Timestamp, Unit};
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
