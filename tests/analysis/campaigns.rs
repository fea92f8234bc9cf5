//! Statistical campaigns too long for every run: quality of the defaults, and limits of the paper's own
//! study. Each prints the table that `docs/abc.md` shows.
//!
//! `cargo test --release --test analysis -- --ignored --nocapture campaigns::[name]`
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::doubles::metropolis::{metropolis, moments};
use rayon::prelude::*;
use std::sync::Arc;
use tirante::analysis::inference::{
    AbcSettings, Accept, Adjustment, Distance, Inference, Method, Noise, Observation, Tables,
};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::exact::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::beam::{Parameterisation, Quantity, Section};
use tirante::analysis::rod::prior::{Prior, RodPrior};

/// Records drawn from prior and model, with equal standard errors.
fn records(count: usize, modes: usize, sd: f64, seed: u64) -> Vec<Observation> {
    use rand_distr::{Distribution, StandardNormal};
    let prior = RodPrior::todi();
    let model = Exact::new(*prior.parameterisation());
    let mut generator = random::stream(seed, 0);
    (0..count)
        .map(|_| {
            let mut theta = vec![0.0; 7];
            prior.sample(&mut generator, &mut theta);
            let mut f = vec![0.0; modes];
            model.frequencies(&theta, &mut f).unwrap();
            for f in &mut f {
                let z: f64 = StandardNormal.sample(&mut generator);
                *f += sd * z;
            }
            Observation::first(&f, sd).unwrap()
        })
        .collect()
}

/// Error of the posterior mean of N in posterior standard deviations (root mean square over records)
/// and ratio of standard deviations (geometric mean and extremes), against Metropolis.
fn compare(modes: usize, sd: f64, choices: &[AbcSettings]) {
    const RECORDS: usize = 12;
    const STEPS: usize = 2_000_000;
    let prior = RodPrior::todi();
    let model: Arc<dyn ForwardModel> = Arc::new(Exact::new(*prior.parameterisation()));
    let tables = Tables::new(2024);
    let records = records(RECORDS, modes, sd, 99);
    let chains = |seed| -> Vec<(f64, f64)> {
        records
            .par_iter()
            .enumerate()
            .map(|(i, record)| {
                let rows = metropolis(&prior, model.as_ref(), record, 0.0, STEPS, seed + i as u64);
                moments(&rows, 7, 0)
            })
            .collect()
    };
    let (first, second) = (chains(1000), chains(2000));
    let reference: Vec<(f64, f64)> = first
        .iter()
        .zip(&second)
        .map(|(a, b)| (0.5 * (a.0 + b.0), 0.5 * (a.1 + b.1)))
        .collect();
    let disagreement = rms(first.iter().zip(&second).map(|(a, b)| (a.0 - b.0) / (2.0 * a.1)));
    println!(
        "{modes} modes, sd {:.1} mHz; Metropolis' own error of the mean {disagreement:.3} sd",
        1e3 * sd
    );
    for &settings in choices {
        let inference = Inference::plan(
            prior.clone(),
            model.clone(),
            vec![0.0; modes],
            settings,
            modes,
            &tables,
        )
        .unwrap();
        let posteriors: Vec<_> = records
            .iter()
            .enumerate()
            .map(|(i, record)| inference.run(record, 31 * i as u64 + 7).unwrap())
            .collect();
        let force = Quantity::AxialForce;
        let pairs = || posteriors.iter().zip(&reference);
        let shift = rms(pairs().map(|(p, (mean, sd))| (p.mean(force).unwrap() - mean) / sd));
        let ratios: Vec<f64> = pairs().map(|(p, (_, sd))| p.sd(force).unwrap() / sd).collect();
        let centre = (ratios.iter().map(|r| r.ln()).sum::<f64>() / RECORDS as f64).exp();
        let low = ratios.iter().copied().fold(f64::INFINITY, f64::min);
        let high = ratios.iter().copied().fold(0.0, f64::max);
        let epsilon = posteriors.iter().map(|p| p.epsilon).sum::<f64>() / RECORDS as f64;
        let AbcSettings {
            draws,
            accept,
            distance,
            method,
            adjustment,
            ..
        } = settings;
        println!(
            "  {draws:8} {accept:?} {distance:?} {method:?} {adjustment:?}: mean off {shift:.3} sd, sd ratio {centre:.3} ({low:.3} to {high:.3}), epsilon {epsilon:.4}"
        );
    }
}

const CHOICE: AbcSettings = AbcSettings {
    draws: 200_000,
    accept: Accept::Quantile(0.02),
    distance: Distance::Euclidean,
    noise: Noise::Record,
    method: Method::Rejection,
    adjustment: Adjustment::Linear,
};

#[test]
#[ignore = "campaign: defaults of AbcSettings, about 4 minutes; run with --release --ignored --nocapture defaults"]
fn defaults() {
    let mut choices = Vec::new();
    for (draws, alphas) in [
        (10_000, &[0.05, 0.01][..]),
        (200_000, &[0.05, 0.02, 0.01, 0.002]),
        (1_000_000, &[0.05, 0.02, 0.01, 0.002]),
    ] {
        for &alpha in alphas {
            for distance in [Distance::Euclidean, Distance::Relative] {
                for adjustment in [Adjustment::None, Adjustment::Linear] {
                    choices.push(AbcSettings {
                        draws,
                        accept: Accept::Quantile(alpha),
                        distance,
                        adjustment,
                        ..CHOICE
                    });
                }
            }
        }
    }
    for sd in [0.002, 0.005, 0.01, 0.02, 0.0316] {
        compare(3, sd, &choices);
    }
}

#[test]
#[ignore = "campaign: other numbers of modes, and the sequence, about 4 minutes; run with --release --ignored --nocapture modes"]
fn modes() {
    let sequence = |draws| AbcSettings {
        draws,
        method: Method::Sequential,
        accept: Accept::Quantile(2000.0 / draws as f64),
        ..CHOICE
    };
    let alpha = |alpha| AbcSettings {
        accept: Accept::Quantile(alpha),
        ..CHOICE
    };
    let relative = AbcSettings {
        distance: Distance::Relative,
        ..CHOICE
    };
    let plain = AbcSettings {
        adjustment: Adjustment::None,
        ..CHOICE
    };
    let choices = [
        CHOICE,
        alpha(0.01),
        alpha(0.05),
        relative,
        plain,
        sequence(50_000),
        sequence(200_000),
        AbcSettings {
            adjustment: Adjustment::None,
            ..sequence(200_000)
        },
    ];
    for modes in [1, 2, 3, 5] {
        compare(modes, 0.01, &choices);
    }
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0), |(sum, count), x| (sum + x * x, count + 1));
    (sum / f64::from(count)).sqrt()
}

/// Table 1 with another prior mean of the density; its coefficient of variation stays 0.10.
fn todi(density: f64) -> RodPrior {
    let todi = RodPrior::todi();
    let mut priors = todi.priors().to_vec();
    priors[2] = tirante::analysis::rod::prior::Prior::TruncatedNormal {
        mean: density,
        sd: 0.1 * density,
    };
    RodPrior::new(*todi.parameterisation(), priors).unwrap()
}

/// The paper's Table 2, ABC column: repeated studies of 10 000 draws, then the limit of many draws at
/// the same share accepted, then the limit of a vanishing share.
#[test]
#[ignore = "campaign: the paper's Table 2, about 2 minutes; run with --release --ignored --nocapture table_2"]
fn table_2() {
    let paper = Observation::first(&[4.492, 9.288, 13.252], 0.0).unwrap();
    let quantities = [
        Quantity::YoungsModulus,
        Quantity::Density,
        Quantity::Side,
        Quantity::AxialForce,
    ];
    let run = |density: f64, draws: usize, alpha: f64, adjustment: Adjustment, seed: u64| {
        let prior = todi(density);
        let settings = AbcSettings {
            draws,
            accept: Accept::Quantile(alpha),
            distance: Distance::Euclidean,
            noise: Noise::Fixed(1e-3f64.sqrt()),
            method: Method::Rejection,
            adjustment,
        };
        let model = Arc::new(Exact::new(*prior.parameterisation()));
        let inference = Inference::plan(prior, model, vec![0.0; 3], settings, 3, &Tables::new(seed)).unwrap();
        let posterior = inference.run(&paper, seed).unwrap();
        let mut figures: Vec<f64> = quantities
            .iter()
            .flat_map(|&q| [posterior.mean(q).unwrap(), posterior.cv(q).unwrap()])
            .collect();
        figures.push(posterior.epsilon);
        figures.push(if posterior.adjustment == adjustment {
            1.0
        } else {
            0.0
        });
        figures
    };
    let show = |name: &str, figures: &[f64], errors: Option<&[f64]>| {
        let pm = |i: usize, scale: f64, digits: usize| match errors {
            Some(errors) => format!(
                "{:.*} +- {:.*}",
                digits,
                figures[i] * scale,
                digits,
                errors[i] * scale
            ),
            None => format!("{:.*}", digits, figures[i] * scale),
        };
        println!(
            "{name}: E {} e11 (cv {}), rho {} ({}), a {} ({}), N {} kN ({}), epsilon {}",
            pm(0, 1e-11, 3),
            pm(1, 1.0, 3),
            pm(2, 1.0, 0),
            pm(3, 1.0, 3),
            pm(4, 1.0, 4),
            pm(5, 1.0, 3),
            pm(6, 1e-3, 1),
            pm(7, 1.0, 3),
            pm(8, 1.0, 3)
        );
    };
    println!("paper: E 1.59e11 (0.350), rho 7580 (0.082), a 0.075 (0.082), N 558 kN (0.206)");
    for density in [7500.0, 7000.0] {
        for alpha in [0.01, 0.05] {
            let studies: Vec<Vec<f64>> = (0..40)
                .map(|seed| run(density, 10_000, alpha, Adjustment::None, seed))
                .collect();
            let mean: Vec<f64> = (0..9)
                .map(|i| studies.iter().map(|s| s[i]).sum::<f64>() / 40.0)
                .collect();
            let sd: Vec<f64> = (0..9)
                .map(|i| (studies.iter().map(|s| (s[i] - mean[i]).powi(2)).sum::<f64>() / 39.0).sqrt())
                .collect();
            show(
                &format!("rho {density}, alpha {alpha}, 40 studies of 10 000, mean +- sd of one study"),
                &mean,
                Some(&sd),
            );
            let figures = run(density, 4_000_000, alpha, Adjustment::None, 1);
            show(
                &format!("rho {density}, alpha {alpha}, 4 000 000 draws"),
                &figures,
                None,
            );
        }
        for draws in [4_000_000, 20_000_000] {
            for accepted in [4000.0, 400.0] {
                let alpha = accepted / draws as f64;
                let figures = run(density, draws, alpha, Adjustment::None, 2);
                show(&format!("rho {density}, {accepted} of {draws}"), &figures, None);
            }
        }
        let figures = run(density, 1_000_000, 0.01, Adjustment::Linear, 2);
        show(
            &format!("rho {density}, alpha 0.01 adjusted ({})", figures[9]),
            &figures,
            None,
        );
    }
}

/// Posteriors of the paper's observation under other assumptions: the exact posterior of its model, of a unit
/// error variance, and of a model discrepancy, by Metropolis and by the default ABC.
#[test]
#[ignore = "campaign: the paper's conflicting observation, about 1 minute; run with --release --ignored --nocapture conflicting"]
fn conflicting() {
    let prior = RodPrior::todi();
    let model = Arc::new(Exact::new(*prior.parameterisation()));
    let tables = Tables::new(3);
    for (sd, discrepancy) in [
        (1e-3f64.sqrt(), 0.0),
        (1.0, 0.0),
        (0.01, 0.01),
        (0.01, 0.02),
        (0.01, 0.03),
    ] {
        let record = Observation::first(&[4.492, 9.288, 13.252], sd).unwrap();
        let chains: Vec<Vec<f64>> = (0..2u64)
            .into_par_iter()
            .map(|seed| metropolis(&prior, model.as_ref(), &record, discrepancy, 4_000_000, seed))
            .collect();
        let inference = Inference::plan(
            prior.clone(),
            model.clone(),
            vec![discrepancy; 3],
            AbcSettings {
                draws: 1_000_000,
                ..AbcSettings::default()
            },
            3,
            &tables,
        )
        .unwrap();
        let posterior = inference.run(&record, 1).unwrap();
        let conflict = inference.conflict(&record).unwrap();
        println!(
            "sd {sd:.4} Hz, discrepancy {discrepancy}: conflict {:.2}, prior tail {:.4}, {}",
            conflict.score,
            conflict.prior_tail,
            conflict
                .violation
                .map_or(String::from("no ratio violated"), |v| v.to_string())
        );
        for (name, column) in [("N", 0), ("E", 1), ("rho", 2), ("a", 3)] {
            let q = prior.parameterisation().quantities()[column];
            let [a, b] = [0, 1].map(|i| moments(&chains[i], 7, column));
            println!(
                "    {name:4} Metropolis {:.4e} and {:.4e} (cv {:.3}, {:.3}); ABC {:.4e} (cv {:.3}), epsilon {:.3}, {:?}",
                a.0,
                b.0,
                a.1 / a.0,
                b.1 / b.0,
                posterior.mean(q).unwrap(),
                posterior.cv(q).unwrap(),
                posterior.epsilon,
                posterior.adjustment
            );
        }
    }
}

/// Records at the edge of the model and beyond: a string with its third mode lowered by 0 to 3 %, where
/// the tolerance matters most. N by Metropolis and by four ways of ABC.
#[test]
#[ignore = "campaign: records at the model's edge, about 2 minutes; run with --release --ignored --nocapture edge"]
fn edge() {
    let prior = RodPrior::todi();
    let model = Arc::new(Exact::new(*prior.parameterisation()));
    let tables = Tables::new(3);
    let ways = [
        ("default", AbcSettings::default()),
        (
            "no adjustment",
            AbcSettings {
                adjustment: Adjustment::None,
                ..AbcSettings::default()
            },
        ),
        (
            "1 000 000 draws",
            AbcSettings {
                draws: 1_000_000,
                accept: Accept::Quantile(0.002),
                ..AbcSettings::default()
            },
        ),
        (
            "sequence",
            AbcSettings {
                method: Method::Sequential,
                ..AbcSettings::default()
            },
        ),
    ];
    let cases: Vec<([f64; 3], f64)> = [0.0, 0.0025, 0.005, 0.01, 0.02, 0.03]
        .iter()
        .map(|lowered| ([4.5, 9.005, 13.515 * (1.0 - lowered)], 0.01))
        .chain([([4.492, 9.288, 13.252], 1e-3f64.sqrt())])
        .collect();
    let references: Vec<(f64, f64)> = cases
        .par_iter()
        .map(|(f, sd)| {
            let record = Observation::first(f, *sd).unwrap();
            moments(
                &metropolis(&prior, model.as_ref(), &record, 0.0, 2_000_000, 1),
                7,
                0,
            )
        })
        .collect();
    for ((f, sd), (mean, spread)) in cases.iter().zip(references) {
        let record = Observation::first(f, *sd).unwrap();
        println!(
            "{f:?}, sd {sd:.4}: Metropolis N {:.1} kN, cv {:.3}",
            mean / 1e3,
            spread / mean
        );
        for (name, settings) in ways {
            let inference =
                Inference::plan(prior.clone(), model.clone(), vec![0.0; 3], settings, 3, &tables).unwrap();
            let posterior = inference.run(&record, 1).unwrap();
            println!(
                "    {name:16} N {:.1} kN, cv {:.3}, epsilon {:.3}, {:?} {:?}; conflict {:.2}",
                posterior.mean(Quantity::AxialForce).unwrap() / 1e3,
                posterior.cv(Quantity::AxialForce).unwrap(),
                posterior.epsilon,
                posterior.adjustment,
                posterior.stop,
                inference.conflict(&record).unwrap().score
            );
        }
    }
}

/// A rod as `init` describes it, 9.5 m and 50 mm square, with stresses of a band \[Pa\].
fn unknown_rod(stress: (f64, f64)) -> RodPrior {
    use tirante::analysis::rod::fixity::Fixity;
    let normal = |mean: f64, cv: f64| Prior::TruncatedNormal { mean, sd: cv * mean };
    let support = Prior::Fixity(Fixity {
        low: 0.0,
        high: 0.99,
        ends: 2.0,
        unit_n_m: 1.0,
    });
    let area = 0.05 * 0.05;
    let priors = vec![
        Prior::LogUniform {
            low: stress.0 * area,
            high: stress.1 * area,
        },
        normal(190e9, 0.10),
        normal(7650.0, 0.03),
        normal(0.05, 0.02),
        support,
        support,
        Prior::Fixed { value: 9.5 },
    ];
    RodPrior::new(Parameterisation::new(Section::Square), priors)
        .unwrap()
        .with_fixities_in_place()
}

/// Modes a force gains from, by discrepancy and stress: the median posterior standard deviation of ln N, exact model and likelihood.
#[test]
#[ignore = "campaign: 540 Metropolis chains, about 5 minutes"]
fn modes_that_earn_their_place() {
    use rand_distr::{Distribution, StandardNormal};
    const RODS: usize = 30;
    const STEPS: usize = 60_000;
    for stress in [(8e6, 60e6), (60e6, 300e6)] {
        let truths = unknown_rod(stress);
        let prior = unknown_rod((4e5, 300e6));
        let model = Exact::new(*prior.parameterisation());
        for discrepancy in [0.001, 0.003, 0.01] {
            let mut line = format!(
                "{:>3.0} to {:>3.0} MPa, discrepancy {:.1} %:",
                stress.0 * 1e-6,
                stress.1 * 1e-6,
                discrepancy * 100.0
            );
            for modes in [3, 5, 8] {
                let mut sds: Vec<f64> = (0..RODS as u64)
                    .into_par_iter()
                    .map(|rod| {
                        let mut generator = random::stream(0x0dd5, rod);
                        let mut theta = vec![0.0; 7];
                        truths.sample(&mut generator, &mut theta);
                        let mut f = vec![0.0; 8];
                        model.frequencies(&theta, &mut f).unwrap();
                        for f in &mut f {
                            let z: f64 = StandardNormal.sample(&mut generator);
                            *f *= 1.0 + discrepancy * z;
                        }
                        f.truncate(modes);
                        // Beyond the modes that `Observation::new` lets pass.
                        let observation = Observation {
                            orders: (1..=modes).collect(),
                            sd_hz: f.iter().map(|f| 1e-4 * f).collect(),
                            frequency_hz: f,
                        };
                        let mut rows = metropolis(&prior, &model, &observation, discrepancy, STEPS, 7 + rod);
                        rows.iter_mut().step_by(7).for_each(|n| *n = n.ln());
                        moments(&rows, 7, 0).1
                    })
                    .collect();
                sds.sort_by(f64::total_cmp);
                line += &format!("  modes 1-{modes} {:>4.1} %", 100.0 * sds[RODS / 2]);
            }
            println!("{line}");
        }
    }
}
