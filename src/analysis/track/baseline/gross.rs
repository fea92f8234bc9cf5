//! Rows of a baseline with a gross error: a mode taken for another, a peak that is none.

use super::levels::usable;
use crate::rod::beam::forward::MAX_MODES;
use crate::track::observation::Observation;

/// Fewest records with a mode of which one can be told to be wrong, and the largest share that is: more are no mistakes.
const FEWEST: usize = 10;
const LARGEST_SHARE: f64 = 0.1;
/// Distance of ln f from the median of its mode, in robust standard deviations and by itself: twice that in force, which no weather
/// makes in a single record.
const FAR_SD: f64 = 8.0;
const FAR: f64 = 0.03;
/// Standard deviation of a normal law over its median absolute deviation.
const OVER_MAD: f64 = 1.4826;

/// True for each record of a baseline but those in which a mode lies grossly off all others; for all of them if these are many.
pub(crate) fn are_sound(observations: &[Observation]) -> Vec<bool> {
    let mut is_gross = vec![false; observations.len()];
    for order in 1..=MAX_MODES {
        let value = |observation: &Observation| {
            let mut modes = observation.modes.iter();
            let mode = modes.find(|mode| mode.order == order && usable(mode.log_frequency, mode.log_sd));
            mode.map(|mode| mode.log_frequency)
        };
        let values: Vec<f64> = observations.iter().filter_map(value).collect();
        if values.len() < FEWEST {
            continue;
        }
        let middle = median(values.clone());
        let scatter = OVER_MAD * median(values.iter().map(|x| (x - middle).abs()).collect());
        let far = (FAR_SD * scatter).max(FAR);
        for (gross, observation) in is_gross.iter_mut().zip(observations) {
            *gross |= value(observation).is_some_and(|x| (x - middle).abs() > far);
        }
    }
    let count = is_gross.iter().filter(|gross| **gross).count() as f64;
    if count > LARGEST_SHARE * observations.len() as f64 {
        is_gross.fill(false);
    }
    is_gross.into_iter().map(|gross| !gross).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::record::Timestamp;
    use crate::track::observation::LogMode;

    fn rows(count: usize, of: impl Fn(usize, usize) -> f64) -> Vec<Observation> {
        let row = |i: usize| Observation {
            modes: (1..=3)
                .map(|order| LogMode {
                    order,
                    log_frequency: of(i, order),
                    log_sd: 5e-4,
                })
                .collect(),
            start: Timestamp::from_nanos(i as i64 * 86_400_000_000_000),
            duration_s: 60.0,
            readings: Vec::new(),
            rms: 0.0,
            conflict: 0.0,
        };
        (0..count).map(row).collect()
    }

    /// Weather of 10 K on a rod held by its walls, 2 % a kelvin.
    fn weather(i: usize, order: usize) -> f64 {
        (4.0 * order as f64).ln() + 0.05 * (0.7 * i as f64).sin()
    }

    #[test]
    fn a_row_of_shifted_modes_is_left_out_and_weather_is_not() {
        let shifted = rows(30, |i, order| weather(i, if i == 13 { order + 1 } else { order }));
        let kept: Vec<usize> = (0..30).filter(|&i| !are_sound(&shifted)[i]).collect();
        assert_eq!(kept, [13]);
        assert!(are_sound(&rows(30, weather)).iter().all(|kept| *kept));
        // Many are none: a force that changed, or two rods of one topic.
        let step = rows(30, |i, order| weather(i, order) - if i < 10 { 0.3 } else { 0.0 });
        assert!(are_sound(&step).iter().all(|kept| *kept));
        assert!(are_sound(&shifted[10..18]).iter().all(|kept| *kept));
    }
}
