//! Tests of a force that changes year by year since before the first record: the change since commissioning holds it, and its onset is
//! not put later.

use super::compensated::Compensated;
use super::first_weeks::air;
use super::{BankPrior, Change, Filters, Seen, ThermalPrior};
use crate::numerics::random;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

const HOURS: usize = 24;
const LIMIT: f64 = 3652.0;
const LEARNING_PERIODS: usize = 30;
const NOISE: f64 = 0.0015;

/// Change since commissioning on one day, and the true one.
struct Shown {
    day: usize,
    change: f64,
    sd: f64,
    truth: f64,
}

/// A rod beside hourly readings, of which the force changes by this share a year; the change at the end as an alarm tells it.
fn follow(seed: u64, days: usize, per_year: f64) -> (Vec<Shown>, Option<Change>) {
    let mut generator = random::stream(91, seed);
    let air = air(&mut generator, days);
    let per_k = -generator.random_range(0.004..0.012);
    let keep = (-1.0 / generator.random_range(2.0..6.0_f64)).exp();
    let thermal = ThermalPrior {
        slope_mean_per_k: -0.01,
        slope_sd_per_k: 0.01,
        curvature_sd_per_k2: 1e-5,
        is_sparse: false,
    };
    let mut filters = Filters::default();
    let (mut rod, mut watch) = (air[0], None);
    let (mut shown, mut commissioned) = (Vec::new(), Vec::new());
    let mut change = None;
    for (hour, celsius) in air.iter().enumerate() {
        rod = keep * rod + (1.0 - keep) * celsius;
        let time = hour as f64 / HOURS as f64;
        if time < 40.0 {
            continue;
        }
        filters.push(time, *celsius);
        let Some(filtered) = filters.at(time).filter(|_| hour % HOURS == 11) else {
            continue;
        };
        let watch = watch.get_or_insert_with(|| {
            let prior = BankPrior::thermal(NOISE, thermal);
            Compensated::new(prior, filtered[0], time, LIMIT, true)
        });
        let noise: f64 = StandardNormal.sample(&mut generator);
        let moved = per_year * (time - 40.0) / 365.25;
        let columns = watch.columns(time, Some(&filtered), None).unwrap();
        let seen = Seen {
            day: time,
            began: time,
            measured: time,
            ratio: per_k * (rod - 13.0) + moved + NOISE * noise,
            sd: NOISE,
            columns: &columns,
            unread_k2: None,
        };
        watch.learn_level(time, seen.ratio, &columns, LEARNING_PERIODS, false);
        watch.detector.step(&seen);
        if commissioned.len() < LEARNING_PERIODS {
            commissioned.push(moved);
            continue;
        }
        let level = commissioned.iter().sum::<f64>() / commissioned.len() as f64;
        let (mean, sd) = watch.change(&seen, LIMIT, false).unwrap();
        shown.push(Shown {
            day: hour / HOURS - 40,
            change: mean,
            sd,
            truth: moved - level,
        });
        change = (watch.detector.statistic() > LIMIT)
            .then(|| watch.detector.change())
            .flatten();
    }
    (shown, change)
}

#[test]
fn the_change_since_commissioning_holds_a_loss_that_went_on_before() {
    let days = [60, 120, 180, 300];
    for per_year in [0.0, -0.02, -0.05] {
        let mut held = [0; 4];
        for seed in 0..16 {
            let (shown, _) = follow(seed, 310, per_year);
            for (count, day) in held.iter_mut().zip(days) {
                let one = shown.iter().find(|one| one.day == day).unwrap();
                *count += usize::from((one.change - one.truth).abs() < 1.96 * one.sd);
            }
        }
        // Of 64. What is expected beforehand holds 95 % over all rates; one at the edge of it, in months in which slow weather may explain it,
        // is held less often.
        let least = if per_year == 0.0 { 60 } else { 48 };
        assert!(held.iter().sum::<usize>() >= least, "{per_year}: {held:?}");
    }
}

#[test]
fn the_onset_of_a_loss_that_went_on_before_is_the_first_day() {
    let (mut told, mut held) = (0, 0);
    for seed in 0..16 {
        if let (_, Some(change)) = follow(seed, 330, -0.05) {
            told += 1;
            held += usize::from(change.onset_interval[0] <= 41.0);
        }
    }
    assert!(told >= 12 && held + 1 >= told, "{held} of {told}");
}
