//! The baseline's mean log-frequencies while the force moves and modes come and go.
//!
//! ```text
//! x_tn = ln f_tn = y_n + s_n delta_t + k_n delta_t^2 / 2 + e_tn,   delta_t = ln(N_t / N_0),  e_tn ~ N(0, sd_tn^2)
//! ```
//!
//! with slopes `s_n = d ln f_n / d ln N` and curvatures `k_n` from the model. A plain mean of ln f_n over the records in
//! which mode n was measured would refer each mode to another mean force. Here `delta_t ~ N(0, SWING^2)` is
//! integrated out, which leaves generalised least squares in y with covariance `diag(sd_t^2) + SWING^2 s s'` per record
//! (best linear unbiased prediction, Robinson 1991). The swing is far wider than a record's error of delta, so that it only serves to
//! weigh down uninformative records, and N_0 is the geometric mean force of the records, each weighted by
//! `1 / (var(delta_t) + SWING^2)`: equally, if they are equally good. The model's slopes are uncertain: they
//! are corrected by the records' own swing, the particles' covariance being their prior.

use crate::rod::beam::forward::MAX_MODES;
use crate::track::observation::Observation;
use nalgebra::{SMatrix, SVector};

/// Prior standard deviation of a record's ln(N_t / N_0).
const SWING: f64 = 0.1;

/// Rounds of levels, forces and slopes in turn; the slopes' corrections are small, and each round gains two digits.
const ROUNDS: usize = 5;

/// Least standard error of ln f accepted: below it lies the models' own error.
pub(crate) const LEAST_LOG_SD: f64 = 1e-6;

pub(crate) type Square = SMatrix<f64, MAX_MODES, MAX_MODES>;
pub(crate) type Column = SVector<f64, MAX_MODES>;

/// Slopes of ln f_n by ln N around the baseline, with their uncertainty by model and prior; one slot per mode
/// order.
#[derive(Debug, Clone)]
pub(crate) struct Slopes {
    /// Mean of d ln f_n / d ln N.
    pub mean: Column,
    /// Their covariance.
    pub covariance: Square,
    /// Mean of the second derivative.
    pub curvature: Column,
}

/// The levels found; one slot per mode order, unused ones zero.
#[derive(Debug, Clone)]
pub(crate) struct Levels {
    /// ln f_n at N_0.
    pub level: Column,
    /// Its standard error.
    pub sd: Column,
    /// Scatter over the standard errors, as a factor, at least one.
    pub overdispersion: f64,
    /// delta_t, one per record.
    #[cfg_attr(not(test), expect(dead_code, reason = "the tests judge the forces"))]
    pub deltas: Vec<f64>,
}

/// One record: its log-frequencies and their precisions, zero where a mode is not used.
struct Row {
    x: Column,
    precision: Column,
}

/// True if a measured mode can be used.
pub(crate) fn usable(log_frequency: f64, log_sd: f64) -> bool {
    log_frequency.is_finite() && log_sd.is_finite() && log_sd >= 0.0
}

/// Fits the levels of the modes with `used[order - 1]`, each measured in at least one record.
pub(crate) fn fit(observations: &[Observation], used: &[bool; MAX_MODES], slopes: &Slopes) -> Levels {
    let rows: Vec<Row> = observations
        .iter()
        .map(|observation| row(observation, used))
        .collect();
    let mut s = slopes.mean;
    let mut deltas = vec![0.0; rows.len()];
    let mut estimate = levels(&rows, used, &s, &slopes.curvature, &deltas);
    let mut slope_covariance = slopes.covariance;
    let mut free_slopes = 0.0;
    for _ in 0..ROUNDS {
        for (row, delta) in rows.iter().zip(&mut deltas) {
            *delta = force(row, &estimate.level, &s, &slopes.curvature, *delta);
        }
        if let Some((corrected, covariance, free)) = correct(&rows, used, slopes, &estimate.level, &deltas) {
            (s, slope_covariance, free_slopes) = (corrected, covariance, free);
        }
        estimate = levels(&rows, used, &s, &slopes.curvature, &deltas);
    }
    for (row, delta) in rows.iter().zip(&mut deltas) {
        *delta = force(row, &estimate.level, &s, &slopes.curvature, *delta);
    }
    let modes = used.iter().filter(|used| **used).count() as f64;
    let (mut squares, mut freedom) = (0.0, 1.0 - modes - free_slopes);
    for (row, delta) in rows.iter().zip(&deltas) {
        let residual = row.x - estimate.level - moved(&s, &slopes.curvature, *delta);
        squares += residual.component_mul(&residual).dot(&row.precision);
        freedom += (row.precision.iter().filter(|p| **p > 0.0).count() as f64 - 1.0).max(0.0);
    }
    let dispersion = if freedom >= 1.0 {
        (squares / freedom).max(1.0)
    } else {
        1.0
    };
    // Effect of wrong slopes on a level: the mean delta of the records in which it was measured.
    let mut lever = Square::zeros();
    for (gain, delta) in estimate.gains.iter().zip(&deltas) {
        lever += gain * *delta;
    }
    let by_slopes = lever * slope_covariance * lever.transpose();
    let variance = estimate.measurement * dispersion + estimate.unlinked + by_slopes;
    Levels {
        level: estimate.level,
        sd: variance.diagonal().map(|variance| variance.max(0.0).sqrt()),
        overdispersion: dispersion.sqrt(),
        deltas,
    }
}

fn row(observation: &Observation, used: &[bool; MAX_MODES]) -> Row {
    let (mut x, mut precision) = (Column::zeros(), Column::zeros());
    for mode in &observation.modes {
        let slot = mode.order.wrapping_sub(1);
        if used.get(slot) == Some(&true) && usable(mode.log_frequency, mode.log_sd) {
            x[slot] = mode.log_frequency;
            precision[slot] = mode.log_sd.max(LEAST_LOG_SD).powi(-2);
        }
    }
    Row { x, precision }
}

/// Change of each ln f_n by a change of ln N by `delta`.
fn moved(slopes: &Column, curvature: &Column, delta: f64) -> Column {
    slopes * delta + curvature * (0.5 * delta * delta)
}

/// Share of SWING's variance that remains in delta_t: `SWING^2 / (1 + SWING^2 information)`.
fn remaining(row: &Row, slopes: &Column) -> f64 {
    let information = slopes.component_mul(slopes).dot(&row.precision);
    SWING * SWING / (1.0 + SWING * SWING * information)
}

/// Predicted delta_t of one record; `before` is the delta_t at which the curvature is evaluated.
fn force(row: &Row, level: &Column, slopes: &Column, curvature: &Column, before: f64) -> f64 {
    let residual = row.x - level - curvature * (0.5 * before * before);
    remaining(row, slopes) * slopes.component_mul(&residual).dot(&row.precision)
}

struct Estimate {
    level: Column,
    /// Linear map from each record's x to the levels.
    gains: Vec<Square>,
    /// Covariance by the frequencies' errors.
    measurement: Square,
    /// Covariance by forces that no common mode links.
    unlinked: Square,
}

fn levels(
    rows: &[Row],
    used: &[bool; MAX_MODES],
    slopes: &Column,
    curvature: &Column,
    deltas: &[f64],
) -> Estimate {
    // A mode that is not used gets a precision of its own, and a level of zero.
    let absent = Column::from_fn(|i, _| if used[i] { 0.0 } else { 1.0 });
    let mut total = Square::from_diagonal(&absent);
    let mut sum = Column::zeros();
    let mut inverses = Vec::with_capacity(rows.len());
    for (row, delta) in rows.iter().zip(deltas) {
        let scaled = row.precision.component_mul(slopes);
        let inverse =
            Square::from_diagonal(&row.precision) - scaled * scaled.transpose() * remaining(row, slopes);
        total += inverse;
        sum += inverse * (row.x - curvature * (0.5 * delta * delta));
        inverses.push(inverse);
    }
    // Positive definite: each used mode was measured, and the swing has a finite variance.
    let covariance = total
        .cholesky()
        .map_or_else(Square::identity, |factor| factor.inverse());
    let share: f64 = rows
        .iter()
        .map(|row| 1.0 - remaining(row, slopes) / (SWING * SWING))
        .sum();
    let (mut measurement, mut unlinked) = (Square::zeros(), Square::zeros());
    let mut gains = Vec::with_capacity(rows.len());
    for (row, inverse) in rows.iter().zip(inverses) {
        let gain = covariance * inverse;
        let variance = row.precision.map(|p| if p > 0.0 { p.recip() } else { 0.0 });
        measurement += gain * Square::from_diagonal(&variance) * gain.transpose();
        // A common change of all forces is a change of N_0 and no error.
        let weight = (1.0 - remaining(row, slopes) / (SWING * SWING)) / share.max(f64::MIN_POSITIVE);
        let stray = gain * slopes - slopes * weight;
        unlinked += stray * stray.transpose() * (SWING * SWING);
        gains.push(gain);
    }
    Estimate {
        level: covariance * sum,
        gains,
        measurement,
        unlinked,
    }
}

/// Slopes corrected by the records' swing, their covariance, and the number of slopes that the records
/// determine.
fn correct(
    rows: &[Row],
    used: &[bool; MAX_MODES],
    slopes: &Slopes,
    level: &Column,
    deltas: &[f64],
) -> Option<(Column, Square, f64)> {
    let mut prior = slopes.covariance;
    for i in 0..MAX_MODES {
        // Accuracy of the model itself, and a wide prior for a mode that is not used.
        prior[(i, i)] += if used[i] { 1e-10 } else { 1.0 };
    }
    let information = prior.cholesky()?.inverse();
    let mut total = information;
    let mut sum = information * slopes.mean;
    for (row, &delta) in rows.iter().zip(deltas) {
        let y = row.x - level - slopes.curvature * (0.5 * delta * delta);
        total += Square::from_diagonal(&row.precision) * (delta * delta);
        sum += row.precision.component_mul(&y) * delta;
    }
    let covariance = total.cholesky()?.inverse();
    let modes = used.iter().filter(|used| **used).count() as f64;
    // The slopes' common scale is that of delta: the records cannot fix it.
    let free = (MAX_MODES as f64 - (covariance * information).trace() - 1.0).clamp(0.0, modes - 1.0);
    Some((covariance * sum, covariance, free))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::signal::record::Timestamp;
    use crate::track::observation::LogMode;
    use rand::rngs::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const USED: [bool; MAX_MODES] = [true, true, true, false, false];
    const LEVEL: [f64; 3] = [1.5, 2.2, 2.6];
    const SLOPE: [f64; 3] = [0.45, 0.42, 0.38];

    fn slopes() -> Slopes {
        let mut mean = Column::zeros();
        let mut covariance = Square::zeros();
        for i in 0..3 {
            mean[i] = SLOPE[i];
            covariance[(i, i)] = 1e-4;
        }
        Slopes {
            mean,
            covariance,
            curvature: Column::zeros(),
        }
    }

    fn record(
        delta: f64,
        slope: [f64; 3],
        log_sd: f64,
        errors: f64,
        generator: &mut ChaCha8Rng,
    ) -> Observation {
        let mode = |n: usize| {
            let z: f64 = StandardNormal.sample(generator);
            LogMode {
                order: n + 1,
                log_frequency: LEVEL[n] + slope[n] * delta + errors * z,
                log_sd,
            }
        };
        Observation::of_modes(Timestamp::from_nanos(0), (0..3).map(mode).collect())
    }

    fn swing(t: usize) -> f64 {
        0.05 * (0.3 * t as f64).sin()
    }

    #[test]
    fn complete_records_of_equal_quality_give_the_plain_mean() {
        let mut generator = random::stream(1, 0);
        let records: Vec<Observation> = (0..30)
            .map(|t| record(swing(t), SLOPE, 1e-3, 1e-3, &mut generator))
            .collect();
        let levels = fit(&records, &USED, &slopes());
        for n in 0..3 {
            let mean = records
                .iter()
                .map(|record| record.modes[n].log_frequency)
                .sum::<f64>()
                / 30.0;
            // The slopes' correction is the only thing that can move it, and it does not.
            assert!((levels.level[n] - mean).abs() < 1e-9);
            let sd = 1e-3 * levels.overdispersion / 30f64.sqrt();
            assert!((levels.sd[n] / sd - 1.0).abs() < 1e-2, "{} {sd}", levels.sd[n]);
        }
        let mean = (0..30).map(swing).sum::<f64>() / 30.0;
        for (t, delta) in levels.deltas.iter().enumerate() {
            // Standard error of one record 1.4e-3, of the mean a fifth of that.
            assert!((delta - (swing(t) - mean)).abs() < 6e-3);
        }
    }

    #[test]
    fn a_mode_missing_while_the_force_was_low_is_referred_to_the_same_force() {
        let mut generator = random::stream(2, 0);
        let mut records: Vec<Observation> = (0..30)
            .map(|t| record(swing(t), SLOPE, 1e-3, 0.0, &mut generator))
            .collect();
        for (t, record) in records.iter_mut().enumerate() {
            if swing(t) < 0.0 {
                record.modes.remove(1);
            }
        }
        let levels = fit(&records, &USED, &slopes());
        let common: Vec<f64> = (0..3).map(|n| (levels.level[n] - LEVEL[n]) / SLOPE[n]).collect();
        // Shrinkage leaves a share v_t / SWING^2 = 2e-4 of forces of 0.05; a plain mean would be off by 0.03.
        assert!(
            (common[1] - common[0]).abs() < 2e-5 && (common[2] - common[0]).abs() < 2e-5,
            "{common:?}"
        );
        let mean = (0..30).map(swing).sum::<f64>() / 30.0;
        assert!((common[0] - mean).abs() < 5e-5, "{} {mean}", common[0]);
    }

    #[test]
    fn standard_errors_are_those_of_repeated_baselines() {
        let repeats = 400;
        let mut squares = [0.0; 2];
        for repeat in 0..repeats {
            let mut generator = random::stream(3, repeat);
            let mut records: Vec<Observation> = (0..30)
                .map(|t| record(swing(t), SLOPE, 1e-3, 1e-3, &mut generator))
                .collect();
            for (t, record) in records.iter_mut().enumerate() {
                if swing(t) < 0.0 {
                    record.modes.remove(1);
                }
            }
            let levels = fit(&records, &USED, &slopes());
            // Differences of modes, in which a common change of force cancels.
            for (i, n) in [1, 2].into_iter().enumerate() {
                let ratio = SLOPE[n] / SLOPE[0];
                let error = (levels.level[n] - LEVEL[n]) - ratio * (levels.level[0] - LEVEL[0]);
                let sd = levels.sd[n].hypot(ratio * levels.sd[0]);
                squares[i] += (error / sd).powi(2) / repeats as f64;
            }
        }
        // Independent errors are assumed of levels that share records: somewhat too much or too little where a mode
        // is missing. Monte Carlo error 0.07.
        assert!(squares.iter().all(|s| (0.6..1.35).contains(s)), "{squares:?}");
    }

    #[test]
    fn scatter_beyond_the_stated_errors_is_seen_and_a_useless_record_changes_nothing() {
        let mut generator = random::stream(4, 0);
        let mut records: Vec<Observation> = (0..60)
            .map(|t| record(swing(t), SLOPE, 1e-3, 3e-3, &mut generator))
            .collect();
        let levels = fit(&records, &USED, &slopes());
        // 118 degrees of freedom: 3 +- 0.2.
        assert!(
            (levels.overdispersion - 3.0).abs() < 0.6,
            "{}",
            levels.overdispersion
        );
        records.push(record(0.0, SLOPE, 10.0, 10.0, &mut generator));
        let with = fit(&records, &USED, &slopes());
        assert!(
            (with.level - levels.level).amax() < 1e-5,
            "{:e}",
            (with.level - levels.level).amax()
        );
        assert!((with.overdispersion - levels.overdispersion).abs() < 0.1);
    }

    #[test]
    fn slopes_that_the_prior_has_wrong_do_not_look_like_scatter() {
        let mut generator = random::stream(5, 0);
        // One and two prior standard deviations off, under a swing of 20 %.
        let slope = [SLOPE[0] - 0.01, SLOPE[1], SLOPE[2] + 0.02];
        let records: Vec<Observation> = (0..365)
            .map(|t| record(4.0 * swing(t), slope, 1e-3, 1e-3, &mut generator))
            .collect();
        let levels = fit(&records, &USED, &slopes());
        assert!(levels.overdispersion < 1.1, "{}", levels.overdispersion);
        let mut stubborn = slopes();
        stubborn.covariance = Square::zeros();
        assert!(fit(&records, &USED, &stubborn).overdispersion > 1.3);
    }

    #[test]
    fn one_mode_alone_has_the_mean_and_no_scatter_to_judge() {
        let mut generator = random::stream(6, 0);
        let records: Vec<Observation> = (0..30)
            .map(|t| record(swing(t), SLOPE, 1e-3, 1e-3, &mut generator))
            .collect();
        let levels = fit(&records, &[true, false, false, false, false], &slopes());
        let mean = records
            .iter()
            .map(|record| record.modes[0].log_frequency)
            .sum::<f64>()
            / 30.0;
        assert!((levels.level[0] - mean).abs() < 1e-9);
        assert_eq!(levels.overdispersion, 1.0);
        assert!(levels.sd[0] > 0.0 && levels.sd[0] < 3e-4);
    }
}
