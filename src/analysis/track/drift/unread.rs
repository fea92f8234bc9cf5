//! Errors of the filters by what the temperature did since its last reading.
//!
//! The temperature less what the filters follow, the last reading or its trend, is taken as a Brownian motion. Over its
//! intensity \[K^2/d\] the errors that they gain in a time a have the covariance A \[d\]:
//!
//! ```text
//! A_ij = a - h_i - h_j + h_ij,    h = tau (1 - e^(-a / tau)),    1 / tau_ij = 1 / tau_i + 1 / tau_j
//! ```
//!
//! The course between readings is left to the noise that a bank learns: it is much the same in every period.

use super::filters::FILTERS_D;

/// Covariance of the filters' errors.
pub type Covariance = [[f64; FILTERS_D.len()]; FILTERS_D.len()];

/// A after `passed_d` days.
pub(super) fn gained(passed_d: f64) -> Covariance {
    let holds = FILTERS_D.map(|memory_d| held_d(memory_d, passed_d));
    std::array::from_fn(|i| {
        std::array::from_fn(|j| {
            let (one, other) = (FILTERS_D[i], FILTERS_D[j]);
            let both = if one > 0.0 && other > 0.0 {
                one * other / (one + other)
            } else {
                0.0
            };
            (passed_d - holds[i] - holds[j] + held_d(both, passed_d)).max(0.0)
        })
    })
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

    /// A Brownian temperature in steps of half an hour, read every two days: errors of the filters a day after a reading.
    #[test]
    fn errors_of_filters_are_those_of_a_brownian_temperature() {
        const STEPS: usize = 48;
        let mut generator = random::stream(21, 0);
        let (mut true_filters, mut read) = (Filters::default(), Filters::default());
        let (mut celsius, mut count) = (0.0, 0.0);
        let mut found = Covariance::default();
        for step in 0..STEPS * 10_000 {
            let day = step as f64 / STEPS as f64;
            let kick: f64 = StandardNormal.sample(&mut generator);
            celsius += kick / (STEPS as f64).sqrt();
            true_filters.push(day, celsius);
            if step % (2 * STEPS) == 0 {
                read = true_filters.clone();
            }
            if step % (2 * STEPS) == STEPS {
                let truth = true_filters.at(day).unwrap();
                // Hourly readings that all say the same.
                for hour in 1..=24 {
                    let earlier = day - 1.0 + f64::from(hour) / 24.0;
                    read.push(earlier, read.celsius());
                }
                let held = read.at(day).unwrap();
                let errors: [f64; FILTERS_D.len()] = std::array::from_fn(|at| truth[at] - held[at]);
                count += 1.0;
                for (row, one) in found.iter_mut().zip(errors) {
                    row.iter_mut()
                        .zip(errors)
                        .for_each(|(sum, other)| *sum += one * other);
                }
            }
        }
        let stated = gained(1.0);
        for i in 0..FILTERS_D.len() {
            for j in 0..FILTERS_D.len() {
                let scale = (stated[i][i] * stated[j][j]).sqrt();
                let off = (found[i][j] / count - stated[i][j]) / scale;
                // 5000 independent errors: 2 %, four times of it at most; steps of half an hour move the covariances by 4 %.
                assert!(off.abs() < 0.1, "{i} {j}: {off}");
            }
        }
    }
}
