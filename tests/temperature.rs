//! Residuals of the temperature regression over simulated seasons: are they what they claim, N(0, 1) and independent?

use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use tirante::random;
use tirante::record::{Reading, Timestamp};
use tirante::track::regression::{Regression, RegressionPrior, Statistic};
use tirante::track::thermal::{LAGS_S, Thermal};

const DAY_S: f64 = 86_400.0;
/// E A alpha / N_0 of a fully restrained rod [1/K].
const FULL: f64 = 0.02;

/// One way the world may be.
#[derive(Debug, Clone, Copy)]
struct World {
    restraint: f64,
    lag_s: f64,
    phi: f64,
    season: usize,
    noise: f64,
    /// What the measurement says its error is, over the noise.
    stated: f64,
    learned: usize,
    charted: usize,
}

const WORLD: World = World {
    restraint: 0.3,
    lag_s: 7200.0,
    phi: 0.0,
    season: 0,
    noise: 0.003,
    stated: 1.0,
    learned: 30,
    charted: 365,
};

fn prior() -> RegressionPrior {
    RegressionPrior {
        slope_mean: -0.5 * FULL,
        slope_sd: 0.3 * FULL,
        intercept_sd: 0.02,
        lags: LAGS_S.len(),
    }
}

/// Days as they come: period, delta, low-passed temperatures less the reference.
fn history(world: &World, seed: u64) -> Vec<(i64, f64, Vec<f64>)> {
    let mut generator = random::stream(seed, 0);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut generator) };
    let days = world.learned + world.charted;
    let mut lags = LAGS_S.to_vec();
    lags.push(world.lag_s);
    let mut thermal = Thermal::new(lags);
    // Season with a swing of 15 K, day of 8 K, weather of 2 K with a memory of three days.
    let (memory, mut weather) = ((-1.0 / 72.0f64).exp(), 2.0 * normal());
    let mut error = normal();
    let start = 0.25 * 365.25 * world.season as f64;
    let mut result = Vec::with_capacity(days);
    let mut reference: Option<(Vec<f64>, f64)> = None;
    for day in 0..days + 5 {
        let mut sums = vec![0.0; LAGS_S.len() + 1];
        for hour in 0..24 {
            let time = start + day as f64 + hour as f64 / 24.0;
            weather = memory * weather + 2.0 * (1.0 - memory * memory).sqrt() * normal();
            let celsius = 12.0
                - 7.5 * (std::f64::consts::TAU * time / 365.25).cos()
                - 4.0 * (std::f64::consts::TAU * (time - 0.125)).cos()
                + weather;
            let stamp = Timestamp::from_nanos(0).plus_seconds(time * DAY_S);
            thermal.push(Reading { time: stamp, celsius });
            // Records at four hours of the day.
            if hour % 6 == 3 {
                let now = thermal.at(stamp).unwrap();
                sums.iter_mut().zip(now).for_each(|(sum, now)| *sum += 0.25 * now);
            }
        }
        if day < 5 {
            continue; // the lags settle
        }
        error = world.phi * error + (1.0 - world.phi * world.phi).sqrt() * normal();
        let rod = sums.pop().unwrap();
        let (lagged_0, rod_0) = reference.get_or_insert_with(|| (sums.clone(), rod)).clone();
        let mean = 1.0 - world.restraint * FULL * (rod - rod_0);
        let delta = mean.max(0.1).ln() + world.noise * error;
        let warmer = sums.iter().zip(lagged_0).map(|(now, then)| now - then).collect();
        result.push((day as i64, delta, warmer));
    }
    result
}

/// Residuals after learning.
fn residuals(world: &World, seed: u64) -> Vec<f64> {
    let mut regression = Regression::new(&prior());
    let mut result = Vec::new();
    for (index, (period, delta, warmer_k)) in history(world, seed).iter().enumerate() {
        let statistic = Statistic {
            period: *period,
            delta: *delta,
            sd: world.noise * world.stated,
            warmer_k,
        };
        if index >= world.learned {
            let r = regression.residual(&statistic);
            result.push(r);
            if r.abs() > 5.0 {
                continue;
            }
        }
        regression.update(&statistic);
    }
    result
}

/// Moments and tails over many histories: variance, autocorrelation of neighbours, share beyond 3, sup distance of
/// the distribution function, and the share of histories in which a pair of CUSUM charts alarms.
#[derive(Debug, Clone, Copy)]
struct Judged {
    mean: f64,
    variance: f64,
    lag1: f64,
    beyond3: f64,
    distance: f64,
    alarms: f64,
}

/// Chart limits for k = 0.5 and k = 0.2 clamped at 5.
const CHARTS: [(f64, f64); 2] = [(0.5, 7.70), (0.2, 16.4)];

fn alarms(residuals: &[f64]) -> bool {
    CHARTS.iter().any(|&(k, h)| {
        let (mut up, mut down) = (0.0f64, 0.0f64);
        residuals.iter().any(|r| {
            let r = r.clamp(-5.0, 5.0);
            up = (up + r - k).max(0.0);
            down = (down - r - k).max(0.0);
            up > h || down > h
        })
    })
}

fn judge(all: &[Vec<f64>]) -> Judged {
    let mut values: Vec<f64> = all.iter().flatten().copied().collect();
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|r| r * r).sum::<f64>() / n;
    let pairs: f64 = all
        .iter()
        .flat_map(|run| run.windows(2))
        .map(|pair| pair[0] * pair[1])
        .sum();
    let lag1 = pairs / (n - all.len() as f64);
    let beyond3 = values.iter().filter(|r| r.abs() > 3.0).count() as f64 / n;
    values.sort_by(f64::total_cmp);
    let phi = |z: f64| 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
    let distance = values
        .iter()
        .enumerate()
        .map(|(i, r)| (phi(*r) - (i as f64 + 0.5) / n).abs())
        .fold(0.0, f64::max);
    let alarms = all.iter().filter(|run| alarms(run)).count() as f64 / all.len() as f64;
    Judged {
        mean,
        variance,
        lag1,
        beyond3,
        distance,
        alarms,
    }
}

fn run(world: &World, histories: u64) -> Judged {
    let all: Vec<Vec<f64>> = (0..histories)
        .into_par_iter()
        .map(|seed| residuals(world, seed + 1))
        .collect();
    judge(&all)
}

#[test]
#[ignore = "campaign: residuals over seasons, lags, restraints and autocorrelations; run with --release --nocapture --ignored"]
fn campaign() {
    let count: u64 = std::env::var("HISTORIES")
        .ok()
        .and_then(|text| text.parse().ok())
        .unwrap_or(400);
    let ideal: Vec<Vec<f64>> = (0..20_000u64)
        .map(|seed| {
            let mut generator = random::stream(seed, 9);
            (0..365).map(|_| StandardNormal.sample(&mut generator)).collect()
        })
        .collect();
    println!("ideal: {:.4?}", judge(&ideal));
    for learned in [30, 90, 365] {
        for restraint in [0.0, 0.3, 1.0] {
            for phi in [0.0, 0.4] {
                for season in 0..4 {
                    for lag_s in [7200.0, 10_000.0] {
                        if season != 0 && lag_s == 7200.0 {
                            continue;
                        }
                        let world = World {
                            learned,
                            restraint,
                            phi,
                            season,
                            lag_s,
                            ..WORLD
                        };
                        let j = run(&world, count);
                        println!(
                            "learned {learned:3} kappa {restraint:.1} phi {phi:.1} season {season} lag {lag_s:6.0}: mean {:+.3} var {:.3} lag1 {:+.3} >3 {:.5} KS {:.4} alarms {:.3}",
                            j.mean, j.variance, j.lag1, j.beyond3, j.distance, j.alarms
                        );
                    }
                }
            }
        }
    }
}
