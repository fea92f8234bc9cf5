//! Tests of rods with one reading a day or less: the weeks in which a bank learns what a reading misses, and what it says of a record a day after
//! one.

use super::{BankPrior, Detector, Filters, Regressors, Seen, ThermalPrior};
use crate::numerics::random;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;
use std::ops::Range;

const STEPS: usize = 24;

/// Error that records state: a seventh of what the force fluctuates by.
const STATED_SD: f64 = 3e-4;

/// Hourly air from 40 days before the first record: season, days of changing amplitude, weather of three days.
pub(super) fn air(generator: &mut impl rand::Rng, days: usize) -> Vec<f64> {
    let phase: f64 = generator.random_range(0.0..TAU);
    let (mut clear, mut weather) = (0.0, 0.0);
    let mut normal = |sd: f64| -> f64 {
        let draw: f64 = StandardNormal.sample(generator);
        sd * draw
    };
    let mut step = |state: &mut f64, sd: f64, memory: f64| {
        let keep = (-1.0 / memory).exp();
        *state = keep * *state + normal(sd * (1.0 - keep * keep).sqrt());
        *state
    };
    (0..(40 + days) * STEPS)
        .map(|hour| {
            let day = hour as f64 / STEPS as f64;
            let amplitude = 3.0 * step(&mut clear, 0.4, 72.0).exp();
            13.0 + 7.5 * (TAU * day / 365.25 + phase).cos()
                + amplitude * (TAU * (day - 15.0 / 24.0)).cos()
                + step(&mut weather, 2.5, 72.0)
        })
        .collect()
}

/// A record: age of its reading, its residual in standard deviations, R after it.
struct Followed {
    age_d: f64,
    residual: f64,
    evidence: f64,
}

/// The records of a rod to which nothing happens, with readings after `gaps_d` days in turn and a lag within `lags_h`.
fn follow(seed: u64, days: usize, gaps_d: &[usize], lags_h: Range<f64>) -> Vec<Followed> {
    let mut generator = random::stream(77, seed);
    let air = air(&mut generator, days);
    let per_k = -generator.random_range(0.005..0.02);
    let lag_h: f64 = generator.random_range(lags_h);
    let keep = (-1.0 / lag_h).exp();
    let mut rod = Vec::with_capacity(air.len());
    let mut state = air[0];
    for celsius in &air {
        state = keep * state + (1.0 - keep) * celsius;
        rod.push(state);
    }
    let at = |series: &[f64], day: f64| {
        let hour = day * STEPS as f64;
        let (whole, share) = (hour.floor() as usize, hour.fract());
        series[whole] + share * (series[(whole + 1).min(series.len() - 1)] - series[whole])
    };
    let thermal = ThermalPrior {
        slope_mean_per_k: -0.01,
        slope_sd_per_k: 0.01,
        curvature_sd_per_k2: 1e-5,
        is_sparse: true,
    };
    let mut detector = Detector::new(BankPrior::thermal(STATED_SD, thermal));
    let mut filters = Filters::default();
    let mut reference = None;
    let mut followed = Vec::new();
    let (mut next, mut gaps_d) = (0, gaps_d.iter().cycle());
    for day in 0..days {
        let read = 40.0 + day as f64 + (9.75 + generator.random_range(-2.0..2.0)) / 24.0;
        let noise: f64 = StandardNormal.sample(&mut generator);
        if day == next {
            filters.push(read, ((at(&air, read) + 0.1 * noise) * 10.0).round() / 10.0);
            next += gaps_d.next().copied().unwrap_or(1);
        }
        let time = 40.0 + day as f64 + (11.0 + generator.random_range(-1.0..1.0)) / 24.0;
        let noise: f64 = StandardNormal.sample(&mut generator);
        if generator.random_bool(0.1) {
            continue;
        }
        let Some(filtered) = filters.at(time) else {
            continue;
        };
        let reference_c = *reference.get_or_insert(filtered[0]);
        let regressors = Regressors {
            reference_c,
            origin: 40.0,
        };
        let columns = regressors.thermal(time, &filtered);
        let ratio = per_k * (at(&rod, time) - reference_c) + 0.002 * noise;
        let law = detector.step(&Seen {
            day: time,
            began: time,
            measured: time,
            ratio,
            sd: STATED_SD,
            columns: &columns,
            unread_k2: filters.unread_k2(time).as_ref(),
        });
        followed.push(Followed {
            age_d: filters.last_day().map_or(f64::NAN, |last| time - last),
            residual: law.map_or(f64::NAN, |law| law.residual(ratio)),
            evidence: detector.statistic(),
        });
    }
    followed
}

#[test]
fn what_one_reading_a_day_misses_is_no_change() {
    let seeds = 48;
    let is_told = |seed: &u64| {
        follow(*seed, 62, &[1], 3.0..24.0)
            .iter()
            .any(|one| one.evidence > 3652.0)
    };
    let told = (0..seeds).filter(is_told).count();
    // 58 of 3652 are promised, for the bank's own law: 0.8 of 48. Scaled by the stated error alone it was 13.
    assert!(told <= 2, "{told} of {seeds}");
}

#[test]
fn a_record_a_day_after_its_reading_has_the_law_that_is_stated() {
    let (mut fresh, mut stale) = (Vec::new(), Vec::new());
    for seed in 0..24 {
        for one in follow(seed, 400, &[3, 4], 2.0..6.0).iter().skip(30) {
            let class = if one.age_d < 0.5 { &mut fresh } else { &mut stale };
            class.push(one.residual);
        }
    }
    let held = |residuals: &[f64]| {
        let inside = residuals.iter().filter(|residual| residual.abs() < 1.96);
        inside.count() as f64 / residuals.len() as f64
    };
    // Stated alike they were 97.6 and 87.0 %.
    let (fresh, stale) = (held(&fresh), held(&stale));
    assert!(
        (0.9..0.98).contains(&fresh) && (0.9..0.98).contains(&stale),
        "{fresh} {stale}"
    );
}
