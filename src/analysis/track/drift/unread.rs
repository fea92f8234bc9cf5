//! Errors of the filters by what the temperature did between its readings.
//!
//! Between readings, and after the last, the temperature is taken as a Brownian motion. Its mean given the readings is the straight
//! line between them and the last one held on: what the filters follow. Over the motion's intensity \[K^2/d\] their errors have the
//! covariance U \[d\], after a time a without a reading, and with one at its end:
//!
//! ```text
//! U <- E U E + A              E = diag e^(-a / tau_i),     A_ij = a - h_i - h_j + h_ij
//! U <- E U E + A - c c' / a   c_i = a - h_i,               h = tau (1 - e^(-a / tau)),    1 / tau_ij = 1 / tau_i + 1 / tau_j
//! ```

use super::filters::FILTERS_D;

/// Covariance of the filters' errors.
pub type Covariance = [[f64; FILTERS_D.len()]; FILTERS_D.len()];

/// U after `passed_d` days without a reading.
pub(super) fn after(unread: &Covariance, passed_d: f64) -> Covariance {
    let forgets = FILTERS_D.map(|memory_d| {
        if memory_d > 0.0 {
            libm::exp(-passed_d / memory_d)
        } else {
            0.0
        }
    });
    let holds = FILTERS_D.map(|memory_d| held_d(memory_d, passed_d));
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let (one, other) = (FILTERS_D[i], FILTERS_D[j]);
            let both = if one > 0.0 && other > 0.0 {
                one * other / (one + other)
            } else {
                0.0
            };
            let gained = passed_d - holds[i] - holds[j] + held_d(both, passed_d);
            forgets[i] * forgets[j] * unread[i][j] + gained.max(0.0)
        })
    })
}

/// U at a reading `passed_d` days after the last.
pub(super) fn to_reading(unread: &Covariance, passed_d: f64) -> Covariance {
    let told = FILTERS_D.map(|memory_d| passed_d - held_d(memory_d, passed_d));
    let mut after = after(unread, passed_d);
    for (row, one) in after.iter_mut().zip(told) {
        for (unread, other) in row.iter_mut().zip(told) {
            *unread -= one * other / passed_d;
        }
    }
    after
}

/// h of one time constant.
fn held_d(memory_d: f64, passed_d: f64) -> f64 {
    if memory_d > 0.0 {
        -memory_d * libm::expm1(-passed_d / memory_d)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::track::drift::Filters;
    use rand_distr::{Distribution, StandardNormal};

    /// A Brownian temperature in steps of half an hour, read every two days: errors of the filters half a day after a reading.
    #[test]
    fn errors_of_filters_are_those_of_a_brownian_temperature() {
        const STEPS: usize = 48;
        let mut generator = random::stream(21, 0);
        let mut true_filters = Filters::default();
        let mut read = Filters::default();
        let (mut celsius, mut unread, mut count) = (0.0, Covariance::default(), 0.0);
        let mut found = Covariance::default();
        for step in 0..STEPS * 20_000 {
            let day = step as f64 / STEPS as f64;
            let kick: f64 = StandardNormal.sample(&mut generator);
            celsius += kick / (STEPS as f64).sqrt();
            true_filters.push(day, celsius);
            if step % (2 * STEPS) == 0 {
                read.push(day, celsius);
                if step > 0 {
                    unread = to_reading(&unread, 2.0);
                }
            }
            // From a hundred days on the slowest filter has forgotten its start.
            if day > 100.0 && step % (2 * STEPS) == STEPS / 2 {
                let (truth, held) = (true_filters.at(day).unwrap(), read.at(day).unwrap());
                let errors: [f64; FILTERS_D.len()] = std::array::from_fn(|at| truth[at] - held[at]);
                count += 1.0;
                for (row, one) in found.iter_mut().zip(errors) {
                    row.iter_mut()
                        .zip(errors)
                        .for_each(|(sum, other)| *sum += one * other);
                }
            }
        }
        let stated = after(&unread, 0.5);
        for i in 0..FILTERS_D.len() {
            for j in 0..FILTERS_D.len() {
                let scale = (stated[i][i] * stated[j][j]).sqrt();
                let off = (found[i][j] / count - stated[i][j]) / scale;
                // 10 000 errors, those of the slow filters remembered for up to fifteen readings: 1 to 6 %; the fast ones restart in gaps
                // of six of their times, which moves them by 12 % of a day's change at a reading.
                assert!(off.abs() < 0.1, "{i} {j}: {off}");
            }
        }
    }
}
