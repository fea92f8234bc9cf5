//! Several sensors of one rod, identified jointly: frequencies from the best combination of records, amplitude ratios as data.

use super::{Identification, Measurement, Plan, Refusal};
use crate::inference::joint::Datum;
use crate::inference::{SensorRatio, Tested};
use crate::rod::query::Query;
use crate::signal::array::{Array, Ratio};
use crate::signal::modes::Mode;
use crate::signal::record::{Record, Rejection, Unit};

/// Half width of the band in which a mode of the combination is looked for, as a share of its frequency.
const NEAR: f64 = 0.04;
/// Standard errors by which frequencies of combination and first sensor may differ.
const AGREE: f64 = 5.0;

/// One sensor's record.
#[derive(Debug, Clone, Copy)]
pub struct Sensed<'a> {
    /// Its place, as a share of the length.
    pub at: f64,
    /// Unit of its channel.
    pub unit: Unit,
    /// Relative standard error of its calibration \[-\].
    pub gain_sd: f64,
    /// Its record.
    pub record: &'a Record,
}

/// What several sensors give together.
#[derive(Debug)]
pub struct ArrayResult {
    /// The identification, or the reason why there is none.
    pub outcome: Result<Identification, Refusal>,
    /// Sensors that were left out, by index, with the reason.
    pub left_out: Vec<(usize, String)>,
}

impl Plan {
    /// Analyses records of one moment, of one sensor each, together with `data` of that moment. The first that shows numbered modes
    /// leads, a displacement before a strain; others are left out where they cannot be put beside it.
    pub fn run_array(&self, sensed: &[Sensed<'_>], data: &[Datum]) -> ArrayResult {
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
                left_out,
            };
        };
        // The lead first; those that lead to nothing by themselves may still help where the lead knows the modes.
        left_out.clear();
        order.retain(|&i| i != lead);
        order.insert(0, lead);
        let record = sensed[lead].record;
        let (modes, ratios) = self.beside(sensed, &mut order, &estimate.modes, &mut left_out);
        let measured = ratios.iter().filter_map(|ratio| {
            let (sensor, reference) = (&sensed[order[ratio.sensor]], &sensed[order[ratio.reference]]);
            datum(sensor, reference, ratio)
        });
        let measured: Vec<Datum> = measured.collect();
        let shapes: Vec<SensorRatio> = measured.iter().filter_map(SensorRatio::of).collect();
        let all = [measured, data.to_vec()].concat();
        let seed = self.seed_of(&record.identity());
        let measurement = Measurement::new(record, record.identity(), estimate.evidence);
        let outcome = match self.infer(Some(record.start), modes, &all, seed) {
            Ok(found) => Ok(Identification {
                measurement: Some(measurement),
                labels: Some(estimate.labels),
                tested: found.tested.map(|tested| Tested { shapes, ..tested }),
                ..found
            }),
            Err(rejection) => Err(Refusal {
                rejection,
                measurement: Some(Box::new(measurement)),
                labels: Some(estimate.labels),
            }),
        };
        ArrayResult { outcome, left_out }
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

/// A ratio as a datum of the rod; `None` for sensors that the model does not compare.
fn datum(sensor: &Sensed<'_>, reference: &Sensed<'_>, ratio: &Ratio) -> Option<Datum> {
    let order = ratio.order;
    let (sensor_strain, reference_strain) = (sensor.unit.is_strain(), reference.unit.is_strain());
    let (query, value, sd) = match (sensor_strain, reference_strain) {
        (false, false) => {
            let query = Query::AmplitudeRatio {
                order,
                at: sensor.at,
                reference_at: reference.at,
            };
            (query, ratio.value, ratio.sd)
        }
        (true, false) => {
            let query = Query::StrainRatio {
                order,
                strain_at: sensor.at,
                read_at: reference.at,
            };
            (query, ratio.value, ratio.sd)
        }
        (false, true) => {
            let query = Query::StrainRatio {
                order,
                strain_at: reference.at,
                read_at: sensor.at,
            };
            let value = 1.0 / ratio.value;
            (query, value, ratio.sd * value * value)
        }
        (true, true) => return None,
    };
    Some(Datum {
        query,
        value,
        sd,
        gain_sd: sensor.gain_sd.hypot(reference.gain_sd),
    })
}
