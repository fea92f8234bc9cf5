//! The inference against posteriors known in closed form, and its edges.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::doubles::{Hinged, Linear};
use std::collections::BTreeMap;
use std::sync::Arc;
use tirante::analysis::inference::{
    AbcSettings, Accept, Adjustment, Distance, Inference, Method, Noise, Observation, PlanError, Posterior,
    Source, Stop, Table, Tables,
};
use tirante::analysis::rod::beam::exact::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::beam::{Parameterisation, Quantity, Section};
use tirante::analysis::rod::emulator::fallback::OrExact;
use tirante::analysis::rod::emulator::reduced::ReducedModel;
use tirante::analysis::rod::fixity::Fixity;
use tirante::analysis::rod::prior::{Prior, RodPrior};
use tirante::analysis::signal::record::Rejection;

const FORCE: Quantity = Quantity::AxialForce;
const RIGIDITY: Quantity = Quantity::FlexuralRigidity;

fn settings(draws: usize, accept: Accept) -> AbcSettings {
    AbcSettings {
        draws,
        accept,
        distance: Distance::Euclidean,
        noise: Noise::Record,
        method: Method::Rejection,
        adjustment: Adjustment::None,
    }
}

fn linear(settings: AbcSettings, modes: usize, discrepancy: f64) -> Inference {
    Inference::plan(
        Linear::prior(),
        Arc::new(Linear::new()),
        vec![discrepancy; modes],
        settings,
        modes,
        &Tables::new(11),
    )
    .unwrap()
}

/// An observation somewhat off the prior's centre: frequencies of (10.8, 18.5) shifted a little.
fn observation(orders: &[usize], sd: f64) -> Observation {
    let y = |order: usize| {
        let [a, b] = Linear::SLOPES[order - 1];
        Linear::OFFSETS[order - 1] + 10.8 * a + 18.5 * b + 0.02 * order as f64
    };
    Observation::new(
        orders.to_vec(),
        orders.iter().map(|&order| y(order)).collect(),
        vec![sd; orders.len()],
    )
    .unwrap()
}

/// Mean within `k` Monte Carlo standard errors and standard deviation within the matching relative
/// error k / sqrt(2 ESS) of what they should be.
fn assert_close(posterior: &Posterior, quantity: Quantity, mean: f64, sd: f64, k: f64) {
    let marginal = posterior.marginal(quantity).unwrap();
    let mean_error = k * sd / posterior.ess.sqrt();
    assert!(
        (marginal.mean - mean).abs() < mean_error,
        "mean {} should be {mean} +- {mean_error}",
        marginal.mean
    );
    let sd_error = k * sd / (2.0 * posterior.ess).sqrt();
    assert!(
        (marginal.sd - sd).abs() < sd_error,
        "sd {} should be {sd} +- {sd_error}",
        marginal.sd
    );
}

/// Rejection within a ball of radius epsilon is the exact posterior of a model with one more error,
/// uniform in the ball, of variance epsilon^2 / (modes + 2) per mode. At a small epsilon its shape no
/// longer matters, so the conjugate posterior with the variances added is the answer.
#[test]
fn rejection_gives_the_conjugate_posterior() {
    for orders in [
        &[1][..],
        &[2],
        &[1, 2],
        &[1, 3],
        &[1, 2, 3],
        &[1, 2, 3, 4],
        &[1, 2, 3, 4, 5],
    ] {
        let inference = linear(settings(1_000_000, Accept::Quantile(0.002)), 5, 0.0);
        let observation = observation(orders, 0.3);
        let posterior = inference.run(&observation, 3).unwrap();
        assert_eq!(posterior.accepted, 2000);
        let variance = 0.09 + posterior.epsilon.powi(2) / (orders.len() as f64 + 2.0);
        let variance = vec![variance; orders.len()];
        let (mean, p) = Linear::posterior(orders, &observation.frequency_hz, &variance);
        // 28 comparisons of 2000 draws: four standard errors.
        assert_close(&posterior, FORCE, mean[0], p[0][0].sqrt(), 4.0);
        assert_close(&posterior, RIGIDITY, mean[1], p[1][1].sqrt(), 4.0);
    }
}

#[test]
fn the_error_shrinks_with_epsilon_to_the_exact_posterior() {
    let observation = observation(&[1, 2, 3], 0.1);
    let (mean, p) = Linear::posterior(&[1, 2, 3], &observation.frequency_hz, &[0.01; 3]);
    let spread = |epsilon: f64| {
        let inference = linear(settings(1_000_000, Accept::Epsilon(epsilon)), 3, 0.0);
        inference.run(&observation, 3).unwrap()
    };
    let exact = p[0][0].sqrt();
    let [wide, middle, narrow] = [2.0, 0.6, 0.1].map(spread);
    let excess = |posterior: &Posterior| posterior.sd(FORCE).unwrap() / exact - 1.0;
    assert!(
        excess(&wide) > 2.0 * excess(&middle),
        "{} {}",
        excess(&wide),
        excess(&middle)
    );
    assert!(excess(&middle) > 3.0 * excess(&narrow).abs());
    // At epsilon = sd the added variance is a fifth of the error's: 4 % of the posterior's sd.
    let (near_mean, near) = Linear::posterior(&[1, 2, 3], &observation.frequency_hz, &[0.01 + 0.002; 3]);
    assert_close(&narrow, FORCE, near_mean[0], near[0][0].sqrt(), 4.0);
    assert!((near_mean[0] - mean[0]).abs() < 0.1 * exact);
}

/// A discrepancy that is the same share of every frequency widens the error: near the observation it
/// is a normal error of variance (d y)^2, which the closed form takes at the observed frequencies. The
/// posterior's frequencies stay within 2 % of those, hence the margin of 3 % beside Monte Carlo.
#[test]
fn discrepancy_widens_the_posterior_as_it_should() {
    let orders = [1, 2, 3];
    let observation = observation(&orders, 0.05);
    let inference = linear(settings(1_000_000, Accept::Quantile(0.002)), 3, 0.02);
    let posterior = inference.run(&observation, 5).unwrap();
    let variance: Vec<f64> = observation
        .frequency_hz
        .iter()
        .map(|f| 0.0025 + (0.02 * f).powi(2) + posterior.epsilon.powi(2) / 5.0)
        .collect();
    let (mean, p) = Linear::posterior(&orders, &observation.frequency_hz, &variance);
    let sd = p[0][0].sqrt();
    assert!((posterior.mean(FORCE).unwrap() - mean[0]).abs() < (0.03 + 4.0 / 2000f64.sqrt()) * sd);
    assert!((posterior.sd(FORCE).unwrap() / sd - 1.0).abs() < 0.03 + 4.0 / 4000f64.sqrt());
    let without = linear(settings(1_000_000, Accept::Quantile(0.002)), 3, 0.0);
    assert!(posterior.sd(FORCE).unwrap() > 1.5 * without.run(&observation, 5).unwrap().sd(FORCE).unwrap());
}

/// Regression adjustment removes the widening by epsilon: even with 10 % accepted, mean and sd are those
/// of the exact posterior. The logarithm of the parameters is not exactly linear in the frequencies;
/// over the accepted range of some per cent this leaves under 1 % of the sd.
#[test]
fn regression_adjustment_removes_the_tolerance() {
    let orders = [1, 2, 3];
    let observation = observation(&orders, 0.3);
    let (mean, p) = Linear::posterior(&orders, &observation.frequency_hz, &[0.09; 3]);
    let run = |adjustment| {
        let settings = AbcSettings {
            adjustment,
            ..settings(200_000, Accept::Quantile(0.1))
        };
        linear(settings, 3, 0.0).run(&observation, 9).unwrap()
    };
    let plain = run(Adjustment::None);
    let adjusted = run(Adjustment::Linear);
    assert!(
        plain.sd(FORCE).unwrap() > 1.1 * p[0][0].sqrt(),
        "tolerance too small to test anything"
    );
    assert_eq!(adjusted.adjustment, Adjustment::Linear);
    assert!(adjusted.ess < adjusted.accepted as f64);
    assert_close(&adjusted, FORCE, mean[0], p[0][0].sqrt(), 4.0);
    assert_close(&adjusted, RIGIDITY, mean[1], p[1][1].sqrt(), 4.0);
}

#[test]
fn the_three_distances_rank_as_defined() {
    // Against brute force in f64 on the table itself: the same set but for draws whose distance is the
    // tolerance to f32 rounding.
    let observation = Observation::new(vec![1, 2, 3], vec![4.2, 11.0, 23.5], vec![0.01, 0.3, 0.1]).unwrap();
    let noiseless = |distance| AbcSettings {
        distance,
        noise: Noise::Fixed(0.0),
        ..settings(20_000, Accept::Quantile(0.01))
    };
    for distance in [Distance::Euclidean, Distance::Relative] {
        let inference = linear(noiseless(distance), 3, 0.0);
        let posterior = inference.run(&observation, 1).unwrap();
        let table = inference.table();
        let mut all: Vec<f64> = (0..table.draws())
            .map(|draw| {
                (0..3)
                    .map(|mode| {
                        let difference =
                            f64::from(table.frequency(draw, mode)) - observation.frequency_hz[mode];
                        let unit = match distance {
                            Distance::Relative => observation.frequency_hz[mode],
                            _ => 1.0,
                        };
                        (difference / unit).powi(2)
                    })
                    .sum::<f64>()
                    .sqrt()
            })
            .collect();
        all.sort_by(f64::total_cmp);
        assert!((posterior.epsilon / all[199] - 1.0).abs() < 1e-4);
        assert_eq!(posterior.accepted, 200);
    }
    // Without noise and discrepancy a Mahalanobis distance has no unit.
    let inference = linear(noiseless(Distance::Mahalanobis), 3, 0.0);
    assert!(matches!(
        inference.run(&observation, 1),
        Err(Rejection::NoLabel { .. })
    ));
    // With equal standard errors it is the Euclidean one in their unit.
    let equal = Observation::first(&observation.frequency_hz, 0.2).unwrap();
    let run = |distance| {
        let settings = AbcSettings {
            distance,
            ..settings(20_000, Accept::Quantile(0.01))
        };
        linear(settings, 3, 0.0).run(&equal, 1).unwrap()
    };
    let (euclidean, mahalanobis) = (run(Distance::Euclidean), run(Distance::Mahalanobis));
    assert!((mahalanobis.epsilon * 0.2 / euclidean.epsilon - 1.0).abs() < 1e-5);
}

#[test]
fn a_quantile_and_its_epsilon_accept_the_same_draws() {
    let observation = observation(&[1, 2], 0.1);
    let by_quantile = linear(settings(50_000, Accept::Quantile(0.02)), 2, 0.0)
        .run(&observation, 4)
        .unwrap();
    // A hair above, for the rounding of the square.
    let epsilon = by_quantile.epsilon * (1.0 + 1e-7);
    let by_epsilon = linear(settings(50_000, Accept::Epsilon(epsilon)), 2, 0.0)
        .run(&observation, 4)
        .unwrap();
    assert_eq!(by_quantile.particles, by_epsilon.particles);
}

/// Sequential ABC ends at the same tolerance with the same posterior as rejection.
#[test]
fn sequential_gives_the_conjugate_posterior() {
    let observation = observation(&[1, 2, 3], 0.3);
    let settings = AbcSettings {
        method: Method::Sequential,
        ..settings(1_000_000, Accept::Epsilon(0.25))
    };
    let posterior = linear(settings, 3, 0.0).run(&observation, 21).unwrap();
    assert_eq!(posterior.stop, Some(Stop::TargetReached));
    assert_eq!(posterior.epsilon, 0.25);
    assert_eq!(posterior.accepted, 2000);
    assert!(posterior.ess > 1000.0, "ESS {}", posterior.ess);
    assert!(posterior.draws < 500_000, "{} draws", posterior.draws);
    let variance = [0.09 + 0.25f64.powi(2) / 5.0; 3];
    let (mean, p) = Linear::posterior(&[1, 2, 3], &observation.frequency_hz, &variance);
    assert_close(&posterior, FORCE, mean[0], p[0][0].sqrt(), 4.0);
    assert_close(&posterior, RIGIDITY, mean[1], p[1][1].sqrt(), 4.0);
    for theta in posterior.particles.chunks_exact(6) {
        assert_eq!(theta[2..], [1.0, 0.0, 0.0, 1.0]);
    }
}

#[test]
fn sequential_names_its_reason_to_stop() {
    let observation = observation(&[1, 2, 3], 0.05);
    let run = |draws, accept| {
        let settings = AbcSettings {
            method: Method::Sequential,
            ..settings(draws, accept)
        };
        linear(settings, 3, 0.0).run(&observation, 2).unwrap()
    };
    assert_eq!(run(20_000, Accept::Quantile(0.05)).stop, Some(Stop::BudgetUsed));
    // An epsilon far below the standard error: nearly every proposal misses by its noise alone.
    let late = run(5_000_000, Accept::Epsilon(1e-4));
    assert_eq!(late.stop, Some(Stop::AcceptanceTooLow));
    assert!(late.epsilon > 1e-4 && late.epsilon < 0.05);
}

/// The same seed gives the same bits at one, two and five threads: table, rejection, sequence.
#[test]
fn threads_do_not_matter() {
    let observation = observation(&[1, 2, 3], 0.1);
    let all = |threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| {
            let rejection = AbcSettings {
                adjustment: Adjustment::Linear,
                ..settings(30_000, Accept::Quantile(0.02))
            };
            let sequential = AbcSettings {
                method: Method::Sequential,
                ..settings(30_000, Accept::Quantile(0.02))
            };
            [rejection, sequential].map(|settings| {
                let posterior = linear(settings, 3, 0.01).run(&observation, 77).unwrap();
                let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                (
                    bits(&posterior.particles),
                    bits(&posterior.weights),
                    posterior.epsilon.to_bits(),
                )
            })
        })
    };
    let one = all(1);
    assert_eq!(one, all(2));
    assert_eq!(one, all(5));
}

#[test]
fn the_record_seed_moves_the_noise_and_nothing_else() {
    let observation = observation(&[1, 2, 3], 0.3);
    let inference = linear(settings(20_000, Accept::Quantile(0.01)), 3, 0.0);
    let [a, b, c] = [1, 2, 20_001].map(|seed| inference.run(&observation, seed).unwrap());
    assert_ne!(a.particles, b.particles);
    // A full turn of the noise table.
    assert_eq!(a.particles, c.particles);
}

fn square_with_only_force_uncertain() -> RodPrior {
    let todi = RodPrior::todi();
    let priors = todi
        .priors()
        .iter()
        .enumerate()
        .map(|(i, prior)| match i {
            0 => *prior,
            _ => Prior::Fixed {
                value: prior.centre(),
            },
        })
        .collect();
    RodPrior::new(*todi.parameterisation(), priors).unwrap()
}

/// With the force alone uncertain it follows from the first frequency: N = m (2 l f)^2 - (pi / l)^2 EI,
/// with relative standard deviation about 2 sd_f / f.
#[test]
fn everything_fixed_but_the_force() {
    let prior = square_with_only_force_uncertain();
    let model = Hinged::new();
    let mut theta = prior.centre();
    theta[0] = 700e3;
    let mut f = [0.0; 3];
    model.frequencies(&theta, &mut f).unwrap();
    let inference = Inference::plan(
        prior,
        Arc::new(model),
        vec![0.0; 3],
        settings(100_000, Accept::Quantile(0.005)),
        3,
        &Tables::new(1),
    )
    .unwrap();
    for orders in [vec![1], vec![2, 3]] {
        let frequencies = orders.iter().map(|&order| f[order - 1]).collect();
        let sds = vec![0.01; orders.len()];
        let posterior = inference
            .run(&Observation::new(orders, frequencies, sds).unwrap(), 5)
            .unwrap();
        // 500 particles with an sd under 1 %: the mean is good to a tenth of a per cent.
        assert!((posterior.mean(FORCE).unwrap() / 700e3 - 1.0).abs() < 2e-3);
        assert!(posterior.cv(FORCE).unwrap() < 0.012);
        for row in posterior.particles.chunks_exact(7) {
            assert_eq!(row[1..], theta[1..]);
        }
    }
}

#[test]
fn a_prior_beyond_the_model_is_refused_not_cut() {
    let run = |lowest_force| {
        let mut model = Hinged::new();
        model.lowest_force = lowest_force;
        let inference = Inference::plan(
            RodPrior::todi(),
            Arc::new(model),
            vec![0.0; 3],
            settings(100_000, Accept::Quantile(0.01)),
            3,
            &Tables::new(1),
        )
        .unwrap();
        let invalid = inference.table().invalid();
        (
            invalid,
            inference.run(&Observation::first(&[4.5, 9.2, 14.0], 0.03).unwrap(), 1),
        )
    };
    // 800 +- 160 kN: 3.5 sd below the mean lie 2e-4 of the draws, 1.25 sd below a tenth.
    let (few, posterior) = run(240e3);
    let posterior = posterior.unwrap();
    assert!((5..100).contains(&few), "{few}");
    assert_eq!(posterior.invalid, few);
    assert!(posterior.particles.iter().all(|value| value.is_finite()));
    let (many, refused) = run(600e3);
    assert!(many > 9_000);
    assert!(
        matches!(refused, Err(Rejection::OutsideEmulator { .. })),
        "{refused:?}"
    );
}

#[test]
fn nothing_near_is_a_rejection_not_a_posterior() {
    let inference = linear(settings(20_000, Accept::Epsilon(0.05)), 3, 0.0);
    let far = Observation::first(&[100.0, 200.0, 300.0], 0.01).unwrap();
    match inference.run(&far, 1) {
        Err(Rejection::NothingAccepted {
            accepted: 0,
            draws: 20_000,
            needed: 50,
            ..
        }) => {}
        other => panic!("{other:?}"),
    }
    // Frequencies beyond any f32 square still compare: the quantile accepts its share.
    let inference = linear(settings(20_000, Accept::Quantile(0.01)), 3, 0.0);
    let absurd = Observation::first(&[1e5, 2e5, 1e6], 0.01).unwrap();
    assert_eq!(inference.run(&absurd, 1).unwrap().accepted, 200);
}

#[test]
fn observations_that_are_none_are_refused() {
    let inference = linear(settings(20_000, Accept::Quantile(0.01)), 3, 0.0);
    let observation = |orders: &[usize], f: &[f64], sd: &[f64]| Observation {
        orders: orders.to_vec(),
        frequency_hz: f.to_vec(),
        sd_hz: sd.to_vec(),
    };
    for bad in [
        observation(&[], &[], &[]),
        observation(&[1, 2], &[4.0], &[0.1]),
        observation(&[1], &[f64::NAN], &[0.1]),
        observation(&[1], &[4.0], &[f64::NAN]),
        observation(&[2, 2], &[4.0, 5.0], &[0.1, 0.1]),
        observation(&[0], &[4.0], &[0.1]),
    ] {
        assert!(
            matches!(inference.run(&bad, 1), Err(Rejection::NoLabel { .. })),
            "{bad:?}"
        );
    }
    let beyond = observation(&[1, 4], &[4.0, 40.0], &[0.1, 0.1]);
    assert!(matches!(
        inference.run(&beyond, 1),
        Err(Rejection::OutsideEmulator { .. })
    ));
}

#[test]
fn plans_that_cannot_be_are_refused() {
    let plan = |change: &dyn Fn(&mut AbcSettings), discrepancy: Vec<f64>, modes| {
        let mut settings = settings(20_000, Accept::Quantile(0.01));
        change(&mut settings);
        let model = Arc::new(Linear::new());
        Inference::plan(
            Linear::prior(),
            model,
            discrepancy,
            settings,
            modes,
            &Tables::new(1),
        )
        .err()
    };
    let same = |_: &mut AbcSettings| {};
    assert_eq!(plan(&same, vec![0.0; 3], 3), None);
    assert!(matches!(
        plan(&same, vec![0.0; 2], 3),
        Some(PlanError::Discrepancy { .. })
    ));
    assert!(matches!(
        plan(&same, vec![0.0, -0.1, 0.0], 3),
        Some(PlanError::Discrepancy { .. })
    ));
    assert!(matches!(
        plan(&same, vec![0.0, f64::NAN, 0.0], 3),
        Some(PlanError::Discrepancy { .. })
    ));
    assert!(matches!(plan(&same, vec![], 0), Some(PlanError::Modes { .. })));
    assert!(matches!(
        plan(&same, vec![0.0; 6], 6),
        Some(PlanError::Modes { .. })
    ));
    assert!(matches!(
        plan(&|s| s.draws = 0, vec![0.0], 1),
        Some(PlanError::Draws { .. })
    ));
    for alpha in [0.0, -1.0, 1.5, f64::NAN, 0.0001] {
        let change = move |s: &mut AbcSettings| s.accept = Accept::Quantile(alpha);
        assert!(
            matches!(plan(&change, vec![0.0], 1), Some(PlanError::Quantile { .. })),
            "{alpha}"
        );
    }
    for epsilon in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let change = move |s: &mut AbcSettings| s.accept = Accept::Epsilon(epsilon);
        assert!(
            matches!(plan(&change, vec![0.0], 1), Some(PlanError::Epsilon { .. })),
            "{epsilon}"
        );
    }
    let change = |s: &mut AbcSettings| s.noise = Noise::Fixed(f64::NAN);
    assert!(matches!(
        plan(&change, vec![0.0], 1),
        Some(PlanError::Noise { .. })
    ));
    let other = Inference::plan(
        RodPrior::todi(),
        Arc::new(Linear::new()),
        vec![0.0],
        settings(20_000, Accept::Quantile(0.01)),
        1,
        &Tables::new(1),
    );
    assert!(matches!(other.err(), Some(PlanError::Section { .. })));
}

/// The whole share accepted is the prior, in the table's order.
#[test]
fn accepting_everything_returns_the_prior() {
    let inference = linear(settings(5_000, Accept::Quantile(1.0)), 2, 0.0);
    let posterior = inference.run(&observation(&[1, 2], 0.1), 8).unwrap();
    assert_eq!(posterior.accepted, 5_000);
    assert_close(&posterior, FORCE, 10.0, 1.0, 4.0);
    let mut first = vec![0.0; 6];
    inference.table().theta(0, &mut first);
    assert_eq!(posterior.particles[..6], first);
}

#[test]
fn rods_alike_share_their_table() {
    let tables = Tables::new(5);
    let plan = |prior: RodPrior| {
        Inference::plan(
            prior,
            Arc::new(Hinged::new()),
            vec![0.0; 3],
            settings(20_000, Accept::Quantile(0.01)),
            3,
            &tables,
        )
        .unwrap()
    };
    let (a, b) = (plan(RodPrior::todi()), plan(RodPrior::todi()));
    assert!(std::ptr::eq(a.table(), b.table()));
    let other = plan(square_with_only_force_uncertain());
    assert!(!std::ptr::eq(a.table(), other.table()));
    // Twelve bytes of frequency and four for each uncertain quantity per draw.
    let bytes = |tables: &[&Table]| {
        let pieces: BTreeMap<_, _> = tables.iter().flat_map(|table| table.pieces()).collect();
        pieces.values().sum::<usize>()
    };
    assert_eq!(bytes(&[a.table()]), 20 * 1024 * (12 + 24));
    assert_eq!(bytes(&[other.table()]), 20 * 1024 * (12 + 4));
    // A rod of another length has frequencies of its own, and the same parameters.
    let todi = RodPrior::todi();
    let mut priors = todi.priors().to_vec();
    priors[6] = Prior::Fixed { value: 12.0 };
    let shorter = plan(RodPrior::new(*todi.parameterisation(), priors).unwrap());
    assert_eq!(bytes(&[a.table(), shorter.table()]), 20 * 1024 * (12 + 24 + 12));
}

/// The paper's study (Table 2, ABC column) as far as it can be repeated: a density prior of mean 7000
/// and 500 of 10 000 accepted give its figures; as printed (7500, 100 of 10 000) they do not come out.
/// Forty repetitions of the study (docs/abc.md) gave the scatter of one study used here.
#[test]
fn the_papers_table_2_reproduces_with_the_density_of_table_3() {
    let run = |density: f64, alpha: f64| {
        let todi = RodPrior::todi();
        let mut priors = todi.priors().to_vec();
        priors[2] = Prior::TruncatedNormal {
            mean: density,
            sd: 0.1 * density,
        };
        let prior = RodPrior::new(*todi.parameterisation(), priors).unwrap();
        let model = Arc::new(Exact::new(*prior.parameterisation()));
        let settings = AbcSettings {
            noise: Noise::Fixed(1e-3f64.sqrt()),
            ..settings(400_000, Accept::Quantile(alpha))
        };
        let inference = Inference::plan(prior, model, vec![0.0; 3], settings, 3, &Tables::new(4)).unwrap();
        let observation = Observation::first(&[4.492, 9.288, 13.252], 0.0).unwrap();
        inference.run(&observation, 12).unwrap()
    };
    // (published, scatter of one study of 10 000 draws and of the printed rounding)
    let near = |found: f64, published: f64, scatter: f64| {
        assert!(
            (found - published).abs() < 2.5 * scatter,
            "{found} is not {published} +- {scatter}"
        );
    };
    let posterior = run(7000.0, 0.05);
    near(
        posterior.mean(Quantity::YoungsModulus).unwrap(),
        1.59e11,
        0.027e11,
    );
    near(posterior.cv(Quantity::YoungsModulus).unwrap(), 0.350, 0.009);
    near(posterior.mean(Quantity::Density).unwrap(), 7580.0, 39.0);
    near(posterior.cv(Quantity::Density).unwrap(), 0.082, 0.003);
    near(posterior.mean(Quantity::Side).unwrap(), 0.075, 0.0006);
    near(posterior.cv(Quantity::Side).unwrap(), 0.082, 0.003);
    near(posterior.mean(FORCE).unwrap(), 558e3, 7.1e3);
    near(posterior.cv(FORCE).unwrap(), 0.206, 0.008);
    // As printed: an independent computation found 559 kN, 0.19 and 1.15e11. Scatter: 4000 particles.
    let printed = run(7500.0, 0.01);
    near(printed.mean(FORCE).unwrap(), 559e3, 1.9e3);
    near(printed.cv(FORCE).unwrap(), 0.19, 0.005);
    near(printed.mean(Quantity::YoungsModulus).unwrap(), 1.15e11, 0.008e11);
}

/// The paper's record conflicts with the model: this is reported, and its posterior is not extrapolated.
#[test]
fn conflicts_are_told_apart_from_wrong_priors() {
    let prior = RodPrior::todi();
    let model = Arc::new(Exact::new(*prior.parameterisation()));
    let settings = AbcSettings {
        draws: 100_000,
        ..AbcSettings::default()
    };
    let inference = Inference::plan(prior, model, vec![0.0; 3], settings, 3, &Tables::new(4)).unwrap();
    let todi = Observation::first(&[4.492, 9.288, 13.252], 1e-3f64.sqrt()).unwrap();
    let posterior = inference.run(&todi, 1).unwrap();
    assert_eq!(posterior.adjustment, Adjustment::None);
    let reason = posterior.withheld.unwrap().to_string();
    assert!(
        reason.contains("standard deviations from the nearest draws of the prior, more than 5"),
        "{reason}"
    );
    let conflict = inference.conflict(&todi).unwrap();
    assert!(
        conflict.score > 10.0 && conflict.prior_tail < 1e-3 && conflict.prior_distance < 1.0,
        "{conflict:?}"
    );
    let violation = conflict.violation.unwrap();
    assert_eq!((violation.higher, violation.lower), (3, 2));
    assert_eq!(
        violation.to_string(),
        "f3/f2 = 1.427, a tensioned beam on rotational springs has 1.500 to 2.250"
    );

    // A third mode 0.5 % too low for any beam, seven standard errors: a conflict, yet within reach.
    let slight = Observation::first(&[4.5, 9.005, 13.4474], 0.01).unwrap();
    assert!(inference.conflict(&slight).unwrap().score > 3.0);
    let posterior = inference.run(&slight, 1).unwrap();
    assert_eq!(posterior.adjustment, Adjustment::Linear);
    // Metropolis on the exact likelihood: 675 kN, cv 0.162; rejection alone gives 559 kN.
    assert!((posterior.mean(FORCE).unwrap() - 675e3).abs() < 0.5 * 0.162 * 675e3);

    // A record of the rod the prior expects: adjusted, no conflict, in the middle of the prior.
    let expected = Observation::first(&[5.25, 10.70, 16.53], 1e-3f64.sqrt()).unwrap();
    assert_eq!(
        inference.run(&expected, 1).unwrap().adjustment,
        Adjustment::Linear
    );
    let conflict = inference.conflict(&expected).unwrap();
    assert!(
        conflict.score < 2.0 && conflict.violation.is_none(),
        "{conflict:?}"
    );
    assert!(conflict.prior_tail > 0.02, "{conflict:?}");

    // The pattern of a beam, at twice the frequencies the prior expects: the prior is wrong, not the beam.
    let fast = Observation::first(&[10.50, 21.40, 33.06], 1e-3f64.sqrt()).unwrap();
    let conflict = inference.conflict(&fast).unwrap();
    assert!(conflict.score < 2.0 && conflict.prior_tail < 2e-3, "{conflict:?}");
}

/// Another forward model is another argument. The tables share their draws, so the posteriors differ by
/// the emulator's error alone, a hundredth of a millihertz: a few draws at the rim of the tolerance.
#[test]
fn emulator_and_exact_model_give_one_posterior() {
    let run = |model: Arc<dyn ForwardModel>| {
        let settings = AbcSettings {
            draws: 100_000,
            ..AbcSettings::default()
        };
        let prior = RodPrior::todi();
        let inference = Inference::plan(prior, model, vec![0.0; 3], settings, 3, &Tables::new(4)).unwrap();
        let record = Observation::first(&[5.25, 10.70, 16.53], 0.01).unwrap();
        inference.run(&record, 1).unwrap()
    };
    let parameterisation = *RodPrior::todi().parameterisation();
    let exact = run(Arc::new(Exact::new(parameterisation)));
    let reduced = run(Arc::new(OrExact::new(ReducedModel::new(parameterisation))));
    let sd = exact.sd(FORCE).unwrap();
    assert!((exact.mean(FORCE).unwrap() - reduced.mean(FORCE).unwrap()).abs() < 0.01 * sd);
    assert!((reduced.sd(FORCE).unwrap() / sd - 1.0).abs() < 0.01);
}

/// A rod of known size and material only, as `init` describes it: 9.5 m, 50 mm square.
fn unknown_rod(density: Prior) -> RodPrior {
    let support = Prior::Fixity(Fixity {
        low: 0.0,
        high: 0.99,
        ends: 2.0,
        unit_n_m: 1.0,
    });
    let normal = |mean: f64, cv: f64| Prior::TruncatedNormal { mean, sd: cv * mean };
    let priors = vec![
        Prior::LogUniform {
            low: 1e3,
            high: 7.5e5,
        },
        normal(190e9, 0.10),
        density,
        normal(0.05, 0.02),
        support,
        support,
        Prior::Fixed { value: 9.5 },
    ];
    RodPrior::new(Parameterisation::new(Section::Square), priors)
        .unwrap()
        .with_fixities_in_place()
}

const DENSITY: Prior = Prior::TruncatedNormal {
    mean: 7650.0,
    sd: 0.03 * 7650.0,
};

/// The inference of a prior with a discrepancy of 1 %, as by default.
fn defaults(prior: RodPrior, modes: usize) -> Inference {
    let model = Arc::new(OrExact::new(ReducedModel::new(*prior.parameterisation())));
    let settings = AbcSettings::default();
    Inference::plan(prior, model, vec![0.01; modes], settings, modes, &Tables::new(4)).unwrap()
}

/// Frequencies of a rod of 100 kN (40 MPa) with supports of 5 EI / l.
fn frequencies_of_the_rod(modes: usize) -> Observation {
    let rod = Exact::new(Parameterisation::new(Section::Square));
    let k = 5.0 * 190e9 * 0.05f64.powi(4) / 12.0 / 9.5;
    let mut f = vec![0.0; modes];
    rod.frequencies(&[1e5, 190e9, 7650.0, 0.05, k, k, 9.5], &mut f)
        .unwrap();
    Observation::first(&f, 0.003).unwrap()
}

fn log_variance(posterior: &Posterior) -> f64 {
    let logs: Vec<f64> = posterior.values(FORCE).unwrap().iter().map(|n| n.ln()).collect();
    tirante::analysis::numerics::diagnostics::sd(&logs, &posterior.weights).powi(2)
}

/// Check of `if_known`: with a source fixed at the values of the posterior, one after the other, the variance
/// of ln N falls by its `if_known`. Each variance of 2000 weighted draws scatters by 4 %, the mean of twelve
/// by 1 %; the tolerance of ABC changes between the runs. 0.08 leaves room for both, and is half of the
/// smallest fall looked at but one.
#[test]
fn a_source_known_exactly_takes_its_share_away() {
    let prior = unknown_rod(DENSITY);
    let inference = defaults(prior.clone(), 3);
    let observation = frequencies_of_the_rod(3);
    let posterior = inference.run(&observation, 3).unwrap();
    let shares = inference.variance_shares(&observation, &posterior).unwrap();
    println!("{shares:?}");
    let total: f64 = shares.sources.iter().map(|part| part.share).sum();
    assert!((total - 1.0).abs() < 0.02, "{shares:?}");
    assert!(shares.explained > 0.85, "{shares:?}");
    assert!(
        shares
            .sources
            .windows(2)
            .all(|pair| pair[0].share >= pair[1].share)
    );
    let width = prior.priors().len();
    for (source, columns) in [
        (Source::Modulus, &[1][..]),
        (Source::Density, &[2]),
        (Source::Section, &[3]),
        (Source::Springs, &[4, 5]),
    ] {
        // Twelve particles drawn by weight represent the posterior of the source.
        let mut cumulated = 0.0;
        let mut next = 0.5 / 12.0;
        let mut sum = 0.0;
        let mut count = 0;
        for (theta, weight) in posterior.particles.chunks_exact(width).zip(&posterior.weights) {
            cumulated += weight;
            if cumulated < next {
                continue;
            }
            next += 1.0 / 12.0;
            let mut priors = prior.priors().to_vec();
            for &column in columns {
                priors[column] = Prior::Fixed { value: theta[column] };
            }
            let known = RodPrior::new(*prior.parameterisation(), priors).unwrap();
            sum += log_variance(&defaults(known, 3).run(&observation, 3).unwrap());
            count += 1;
        }
        let fall = 1.0 - sum / f64::from(count) / log_variance(&posterior);
        let part = shares.sources.iter().find(|part| part.source == source).unwrap();
        println!("{source:?}: said {:.3}, found {fall:.3}", part.if_known);
        assert!(
            (part.if_known - fall).abs() < 0.08,
            "{source:?} {fall} {shares:?}"
        );
    }
}

/// With one frequency nothing checks the mass, and the force follows it: this is reported, and true. A
/// density 5 % too high moves the force by the reported amount, within the tenth of a posterior standard
/// deviation by which two tables differ.
#[test]
fn one_frequency_does_not_check_the_mass_and_that_is_said() {
    let observation = frequencies_of_the_rod(1);
    let run = |density: f64| {
        let inference = defaults(unknown_rod(Prior::Fixed { value: density }), 1);
        let posterior = inference.run(&observation, 3).unwrap();
        let shares = inference.variance_shares(&observation, &posterior).unwrap();
        let logs: Vec<f64> = posterior.values(FORCE).unwrap().iter().map(|n| n.ln()).collect();
        let mean = tirante::analysis::numerics::diagnostics::mean(&logs, &posterior.weights);
        (mean, log_variance(&posterior).sqrt(), shares)
    };
    let (right, sd, shares) = run(7650.0);
    let (wrong, ..) = run(7650.0 * 1.05);
    assert_eq!(shares.mass.learned.round(), 0.0);
    let said = shares.said.last().unwrap();
    assert!(
        said.starts_with("Nothing in these frequencies checks the mass"),
        "{said}"
    );
    let followed = (wrong - right) / 1.05f64.ln();
    println!("said {:.2}, found {followed:.2}", shares.mass.force_per_mass);
    assert!(
        (followed - shares.mass.force_per_mass).abs() < 0.1 * sd / 1.05f64.ln() + 0.2,
        "{followed} {shares:?}"
    );
}

/// Frequencies no rod of the prior has are outside it, whether the prior of the force is narrow or spans three decades; those of
/// its own rods never are.
#[test]
fn frequencies_of_no_rod_lie_outside_the_prior() {
    let absurd = Observation::first(&[1000.0, 2000.0, 3000.0], 0.03).unwrap();
    for prior in [RodPrior::todi(), unknown_rod(DENSITY)] {
        let model = Exact::new(*prior.parameterisation());
        let inference = defaults(prior.clone(), 3);
        let conflict = inference.conflict(&absurd).unwrap();
        assert!(conflict.is_outside_prior, "{conflict:?}");
        // A unit mistaken the other way round.
        let slow = Observation::first(&[0.005, 0.01, 0.015], 0.0).unwrap();
        assert!(inference.conflict(&slow).unwrap().is_outside_prior);
        // An error as large as the slowest rods' frequencies makes these no faster.
        let coarse = Observation::first(&[1000.0, 2000.0, 3000.0], 1.0).unwrap();
        assert!(inference.conflict(&coarse).unwrap().is_outside_prior);
        let mut generator = tirante::analysis::numerics::random::stream(0x0d, 0);
        let mut theta = vec![0.0; 7];
        let mut f = [0.0; 3];
        let mut farthest = 0.0f64;
        for _ in 0..500 {
            prior.sample(&mut generator, &mut theta);
            model.frequencies(&theta, &mut f).unwrap();
            let own = Observation::first(&f, 0.0).unwrap();
            let conflict = inference.conflict(&own).unwrap();
            assert!(!conflict.is_outside_prior, "{conflict:?}");
            farthest = farthest.max(conflict.prior_distance);
        }
        assert!(farthest < 1.2, "{farthest}");
    }
    // A prior with an end: a string of twice and a half its largest force, which no draw of it approaches.
    let prior = unknown_rod(DENSITY);
    let model = Exact::new(*prior.parameterisation());
    let inference = defaults(prior, 3);
    let taut = [1.9e6, 190e9, 7650.0, 0.05, 1e3, 1e3, 9.5];
    let mut f = [0.0; 3];
    model.frequencies(&taut, &mut f).unwrap();
    for sd in [0.003, 0.1] {
        let conflict = inference.conflict(&Observation::first(&f, sd).unwrap()).unwrap();
        assert!(conflict.is_outside_prior, "{f:?} {sd}: {conflict:?}");
    }
}
