//! Tests of the bank: the batch posterior, densities, covariances, what is kept.

use super::super::{Coefficient, Fluctuation, Seen};
use super::*;
use crate::numerics::random;
use nalgebra::{DMatrix, DVector};

/// A prior of two columns and a single member with memory.
fn single() -> BankPrior {
    BankPrior {
        stated_sd: 0.002,
        noise_sd: 0.002,
        intercept_sd: 0.03,
        columns: vec![
            Coefficient {
                mean: -0.005,
                sd: 0.01,
            },
            Coefficient { mean: 0.0, sd: 0.002 },
        ],
        members: vec![Fluctuation {
            variance: 2.0,
            memory_d: 4.0,
            slow_variance: 0.5,
            slow_memory_d: 25.0,
            probability: 1.0,
        }],
        kick: 0.002,
        again: 0.0,
        spells: [1.0, 0.0, 0.0],
    }
}

/// Periods with gaps, other stated errors, and a change of -1 % from the twentieth on.
fn periods(count: usize) -> Vec<(f64, f64, f64, [f64; 2])> {
    let mut generator = random::stream(5, 0);
    let mut day = 100.0;
    let mut normal = move || -> f64 { StandardNormal.sample(&mut generator) };
    (0..count)
        .map(|k| {
            day += [1.0, 1.0, 0.5, 3.0, 0.0, 9.0][k % 6];
            let columns = [8.0 * (day / 20.0_f64).sin() + normal(), (day / 60.0_f64).cos()];
            let change = if k < 20 { 0.0 } else { -0.01 };
            let ratio = 0.004 - 0.006 * columns[0] + 0.001 * columns[1] + change + 0.003 * normal();
            (day, ratio, 0.002 * (1.0 + 0.3 * (k % 3) as f64), columns)
        })
        .collect()
}

/// The whole series at once by dense linear algebra: mean and covariance of (c, a, b_1, b_2), and the noise's law.
#[test]
fn a_member_equals_the_batch_posterior() {
    let prior = single();
    let data = periods(60);
    let mut bank = Bank::new(&prior);
    let mut change: Option<Bank> = None;
    for (k, (day, ratio, sd, columns)) in data.iter().enumerate() {
        let seen = Seen {
            day: *day,
            began: *day,
            measured: *day,
            ratio: *ratio,
            sd: *sd,
            columns,
            unread_k2: None,
        };
        let mut row = Row::new(&prior, &seen).unwrap();
        let passage = Passage::new(&prior, bank.day, *day);
        bank.advance(&passage);
        if k == 20 {
            // In noise variances, so that the batch may take it as known beforehand.
            let mut copy = bank.clone();
            let [scale2, ..] = copy.blocks[0].scale2();
            copy.blocks[0].widen(0, 30.0 * scale2);
            change = Some(copy);
        } else if let Some(change) = &mut change {
            change.advance(&passage);
        }
        bank.learn(&prior, &row, &passage, &mut Workspace::default());
        if let Some(change) = &mut change {
            change.learn(&prior, row.with_onset(1.0), &passage, &mut Workspace::default());
        }
    }
    let found = &change.unwrap().blocks[0];

    let n = data.len();
    let s0 = prior.noise_sd;
    let design = DMatrix::from_fn(n, 4, |k, j| match j {
        0 => f64::from(u8::from(k >= 20)),
        1 => 1.0,
        _ => data[k].3[j - 2],
    });
    let before = DMatrix::from_diagonal(&DVector::from_vec(vec![
        30.0,
        (0.03 / s0) * (0.03 / s0),
        (0.01 / s0) * (0.01 / s0),
        (0.002 / s0) * (0.002 / s0),
    ]));
    let fluctuation = &prior.members[0];
    let cov = DMatrix::from_fn(n, n, |i, j| {
        let gap = (data[i].0 - data[j].0).abs();
        let error = if i == j {
            0.3 + 0.7 * (data[i].2 / s0) * (data[i].2 / s0)
        } else {
            0.0
        };
        error
            + fluctuation.variance * (-gap / fluctuation.memory_d).exp()
            + fluctuation.slow_variance * (-gap / fluctuation.slow_memory_d).exp()
    });
    let expected = DVector::from_vec(vec![0.0, 0.0, -0.005, 0.0]);
    let off = DVector::from_iterator(n, data.iter().map(|period| period.1)) - &design * &expected;
    let inverse = (&cov + &design * &before * design.transpose())
        .try_inverse()
        .unwrap();
    let gain = &before * design.transpose() * &inverse;
    let mean = &expected + &gain * &off;
    let after = &before - &gain * &design * &before;
    let rate = 2.0 * s0 * s0 + 0.5 * (off.transpose() * &inverse * &off)[(0, 0)];

    assert_eq!(found.shape[0], 2.0 + 0.5 * n as f64);
    let of_noise = found.rate[0];
    assert!((of_noise / rate - 1.0).abs() < 1e-9, "{of_noise} {rate}");
    for i in 0..4 {
        // The dense inverse has a condition near 1e6, and the state 60 steps of rounding.
        let sd = after[(i, i)].sqrt();
        assert!(
            (found.mean()[i][0] - mean[i]).abs() < 1e-8 * s0 * sd,
            "{i}: {} {}",
            found.mean()[i][0],
            mean[i]
        );
        for j in i..4 {
            let entry = found.cov(i, j)[0];
            let scale = sd * after[(j, j)].sqrt();
            assert!(
                (entry - after[(i, j)]).abs() < 1e-8 * scale,
                "{i} {j}: {entry} {}",
                after[(i, j)]
            );
        }
    }
}

/// The predictive density integrates to one: this makes R less the number of periods a martingale.
#[test]
fn the_predictive_density_is_a_density() {
    let prior = BankPrior::peers(0.002);
    let mut bank = Bank::new(&prior);
    for (k, (day, ratio, sd, columns)) in periods(40).iter().enumerate() {
        let columns = [0.01 * columns[0], 1e-4 * columns[0] * columns[0], 0.0, 0.1];
        let seen = Seen {
            day: *day,
            began: *day,
            measured: *day,
            ratio: *ratio,
            sd: *sd,
            columns: &columns,
            unread_k2: None,
        };
        let mut row = Row::new(&prior, &seen).unwrap();
        let passage = Passage::new(&prior, bank.day, *day);
        bank.advance(&passage);
        if k % 13 == 12 {
            for copy in [bank.clone(), bank.with_change(0.015)] {
                let h = 1.0;
                let law = copy.law(&row);
                let density = |z: f64| {
                    // Substitution y = mean + sd sinh(z): the tail of t_3 to 1e4 standard deviations, within the clamp.
                    row.ratio = law.mean + law.sd * z.sinh();
                    libm::exp(copy.clone().learn(
                        &prior,
                        row.clone().with_onset(h),
                        &passage,
                        &mut Workspace::default(),
                    )) * law.sd
                        * z.cosh()
                };
                // Trapezoids of a smooth function; the part beyond 60 sd is 0.01 of t_3 beyond some 5 scales.
                let reach = (60.0_f64).asinh();
                let (mut density, steps) = (density, 1200);
                let width = 2.0 * reach / f64::from(steps);
                let sum: f64 = (0..=steps)
                    .map(|step| density(-reach + width * f64::from(step)) * width)
                    .sum();
                assert!((sum - 1.0).abs() < 1e-3, "period {k}: {sum}");
            }
        }
        let row = Row::new(&prior, &seen).unwrap();
        bank.learn(&prior, &row, &passage, &mut Workspace::default());
    }
}

/// Ten years of hourly periods leave covariances symmetric by storage and positive on the diagonal.
#[test]
fn covariances_stay_positive() {
    let prior = single();
    let mut bank = Bank::new(&prior);
    for hour in 0..87_660_u32 {
        let day = f64::from(hour) / 24.0;
        let columns = [15.0 * (day / 58.0).sin(), (day / 58.1).cos()];
        let ratio = -0.005 * columns[0] + 0.001 * f64::from(hour % 5);
        let seen = Seen {
            day,
            began: day,
            measured: day,
            ratio,
            sd: 0.002,
            columns: &columns,
            unread_k2: None,
        };
        let row = Row::new(&prior, &seen).unwrap();
        let passage = Passage::new(&prior, bank.day, day);
        bank.advance(&passage);
        assert!(
            bank.learn(&prior, &row, &passage, &mut Workspace::default())
                .is_finite()
        );
    }
    let member = &bank.blocks[0];
    let width = member.mean().len();
    let dense = DMatrix::from_fn(width - 1, width - 1, |i, j| {
        member.cov(i.min(j) + 1, i.max(j) + 1)[0]
    });
    let least = dense.symmetric_eigenvalues().min();
    assert!(least > 0.0, "{least}");
}

/// Members share blocks, the last of which has lanes to spare; what is kept has neither.
#[test]
fn a_bank_is_read_back_as_it_was_kept() {
    let prior = BankPrior::peers(0.002);
    let mut bank = Bank::new(&prior);
    for (day, ratio, sd, columns) in periods(30) {
        let columns = [0.01 * columns[0], 1e-4 * columns[0], 0.0, 0.1];
        let seen = Seen {
            day,
            began: day,
            measured: day,
            ratio,
            sd,
            columns: &columns,
            unread_k2: None,
        };
        let row = Row::new(&prior, &seen).unwrap();
        let passage = Passage::new(&prior, bank.day, day);
        bank.advance(&passage);
        bank.learn(&prior, &row, &passage, &mut Workspace::default());
    }
    let change = bank.with_change(0.015);
    assert!(
        !change.count.is_multiple_of(LANES) && change.count < bank.count,
        "{}",
        change.count
    );
    for bank in [bank, change] {
        let kept: serde_json::Value = serde_json::to_value(&bank).unwrap();
        assert_eq!(kept["members"].as_array().unwrap().len(), bank.count);
        let bytes = postcard::to_stdvec(&bank).unwrap();
        assert_eq!(postcard::from_bytes::<Bank>(&bytes).unwrap(), bank);
    }
}

#[test]
fn what_no_filter_can_take_is_refused_and_the_rest_is_survived() {
    let prior = single();
    let seen = |day, ratio, sd, columns| Seen {
        day,
        began: day,
        measured: day,
        ratio,
        sd,
        columns,
        unread_k2: None,
    };
    for bad in [
        seen(f64::NAN, 0.0, 0.002, &[0.0, 0.0]),
        seen(0.0, f64::INFINITY, 0.002, &[0.0, 0.0]),
        seen(0.0, 0.0, f64::NAN, &[0.0, 0.0]),
        seen(0.0, 0.0, 0.002, &[0.0, f64::NAN]),
        seen(0.0, 0.0, 0.002, &[0.0, 1e9]),
        seen(0.0, 0.0, 0.002, &[0.0]),
    ] {
        assert_eq!(Row::new(&prior, &bad), None);
    }
    let mut bank = Bank::new(&prior);
    let odd = [
        (0.0, 0.0, 0.0),
        (0.0, -1.0, 0.002),
        (1e5, 0.001, 0.002),
        (5.0, 1e300, 0.002),
        (1e5, 0.0, 1e300),
        (1e9, 0.001, -0.002),
    ];
    for (day, ratio, sd) in odd {
        let row = Row::new(&prior, &seen(day, ratio, sd, &[1.0, 1.0])).unwrap();
        let passage = Passage::new(&prior, bank.day, day);
        bank.advance(&passage);
        assert!(
            bank.learn(&prior, &row, &passage, &mut Workspace::default())
                .is_finite(),
            "{day} {ratio} {sd}"
        );
        let law = bank.law(&row);
        assert!(
            law.mean.abs() < 0.1 && law.sd > 0.0 && law.sd.is_finite(),
            "{law:?}"
        );
    }
}
