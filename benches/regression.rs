//! Speed of the temperature regression, the thermal lags and the search for a change.
//!
//! `cargo bench --bench regression`

use divan::{Bencher, black_box};
use tirante::record::{Reading, Timestamp};
use tirante::track::change::{self, Sample};
use tirante::track::regression::{Regression, RegressionPrior, Statistic};
use tirante::track::thermal::{LAGS_S, Thermal};

fn main() {
    divan::main();
}

fn delta(day: i64) -> f64 {
    0.003 * ((day * 7919 % 1000) as f64 / 288.7 - 1.73)
}

fn warmer(day: i64) -> f64 {
    7.5 * (day as f64 / 58.1).sin() + ((day * 104_729 % 100) as f64 / 25.0 - 2.0)
}

fn learned(days: i64) -> Regression {
    let mut regression = Regression::new(&RegressionPrior {
        slope_mean: -0.01,
        slope_sd: 0.006,
        intercept_sd: 0.02,
        curvature_sd: 6e-6,
        lags: LAGS_S.len(),
    });
    for day in 0..days {
        let warmer_k = LAGS_S.map(|lag_s| warmer(day) * (1.0 - lag_s / 2e5));
        regression.update(&Statistic {
            period: day,
            delta: delta(day) - 0.006 * warmer(day),
            sd: 0.003,
            warmer_k: &warmer_k,
        });
    }
    regression
}

/// Prediction, residual and update of one period.
#[divan::bench(args = [30, 365])]
fn period(bencher: Bencher, days: i64) {
    let regression = learned(days);
    let warmer_k = LAGS_S.map(|_| warmer(days));
    let statistic = Statistic {
        period: days,
        delta: delta(days) - 0.006 * warmer(days),
        sd: 0.003,
        warmer_k: &warmer_k,
    };
    bencher
        .with_inputs(|| regression.clone())
        .bench_values(|mut regression| {
            black_box(regression.predict(&statistic));
            black_box(regression.residual(&statistic));
            regression.update(&statistic);
            regression
        });
}

/// The state as text.
#[divan::bench]
fn state_to_json(bencher: Bencher) {
    let regression = learned(365);
    bencher.bench(|| serde_json::to_string(&regression).map(|text| text.len()));
}

/// One reading through six lags.
#[divan::bench]
fn reading(bencher: Bencher) {
    let mut thermal = Thermal::new(LAGS_S.to_vec());
    let mut seconds = 0.0;
    bencher.bench_local(|| {
        seconds += 300.0;
        thermal.push(Reading {
            time: Timestamp::from_nanos(0).plus_seconds(seconds),
            celsius: 12.0,
        });
    });
}

/// Onset, size and rate of a step in a series of days.
#[divan::bench(args = [100, 400, 3650], sample_count = 10)]
fn estimate(bencher: Bencher, days: i64) {
    let samples: Vec<Sample> = (0..days)
        .map(|day| Sample {
            start: Timestamp::from_nanos(0).plus_seconds(86_400.0 * day as f64),
            delta: delta(day) - 0.006 * warmer(day) - if day > days - 20 { 0.02 } else { 0.0 },
            warmer_k: warmer(day),
        })
        .collect();
    bencher.bench(|| change::estimate(black_box(&samples), 0, 0.2));
}
