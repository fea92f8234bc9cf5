//! Baseline and relative force against methods that share nothing with them: importance sampling and quadrature for the
//! particles, a plain grid with the exact solver for N_t / N_0.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use rand::rngs::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::Exact;
use tirante::analysis::rod::beam::forward::ForwardModel;
use tirante::analysis::rod::emulator::ReducedModel;
use tirante::analysis::rod::prior::{Prior, RodPrior};
use tirante::analysis::signal::record::Timestamp;
use tirante::analysis::track::baseline::BaselineFault;
use tirante::analysis::track::relative::{NoRelative, Relative, Shift};
use tirante::analysis::track::{Baseline, LogMode, Observation};

const LOG_SD: f64 = 1e-3;

fn model() -> ReducedModel {
    ReducedModel::new(*RodPrior::todi().parameterisation())
}

fn log_frequencies(theta: &[f64], u: f64) -> [f64; 5] {
    let mut theta = theta.to_vec();
    theta[0] *= u.exp();
    let mut f = [0.0; 5];
    Exact::new(*RodPrior::todi().parameterisation())
        .frequencies(&theta, &mut f)
        .unwrap();
    f.map(f64::ln)
}

fn observation(logs: &[(usize, f64)], log_sd: f64) -> Observation {
    Observation::of_modes(
        Timestamp::from_nanos(0),
        logs.iter()
            .map(|&(order, log_frequency)| LogMode {
                order,
                log_frequency,
                log_sd,
            })
            .collect(),
    )
}

/// A record of the paper's rod at N_0 e^u with errors.
fn record(u: f64, orders: &[usize], generator: &mut ChaCha8Rng) -> Observation {
    let logs = log_frequencies(&RodPrior::todi().centre(), u);
    let noisy: Vec<(usize, f64)> = orders
        .iter()
        .map(|&n| {
            let z: f64 = StandardNormal.sample(generator);
            (n, logs[n - 1] + LOG_SD * z)
        })
        .collect();
    observation(&noisy, LOG_SD)
}

fn baseline_of(records: &[Observation], discrepancy: f64, particles: usize) -> Baseline {
    Baseline::learn(
        records,
        &RodPrior::todi(),
        &model(),
        &[discrepancy; 5],
        particles,
        9,
    )
    .unwrap()
}

fn thirty(orders: &[usize]) -> Vec<Observation> {
    let mut generator = random::stream(12, 0);
    (0..30).map(|_| record(0.0, orders, &mut generator)).collect()
}

/// Weighted mean and standard deviation.
fn moments(values: &[f64], weights: &[f64]) -> (f64, f64) {
    let sum: f64 = weights.iter().sum();
    let mean = values.iter().zip(weights).map(|(x, w)| w * x).sum::<f64>() / sum;
    let square = values
        .iter()
        .zip(weights)
        .map(|(x, w)| w * (x - mean).powi(2))
        .sum::<f64>()
        / sum;
    (mean, square.sqrt())
}

/// Two million draws from the prior, weighted by the kernel, against the particles: mean and spread of every quantity's
/// logarithm. The narrower the kernel, the more of them come by tempering and Metropolis steps.
#[test]
fn particles_are_the_posterior() {
    let prior = RodPrior::todi();
    let count = 2_000_000;
    let mut generator = random::stream(31, 0);
    let mut thetas = vec![0.0; 7 * count];
    thetas
        .chunks_exact_mut(7)
        .for_each(|theta| prior.sample(&mut generator, theta));
    let mut f = vec![0.0; 3 * count];
    model().frequencies_of_many(&thetas, 3, &mut f);
    for discrepancy in [0.01, 0.003] {
        let baseline = baseline_of(&thirty(&[1, 2, 3]), discrepancy, 4096);
        let weights: Vec<f64> = f
            .chunks_exact(3)
            .map(|row| {
                let square: f64 = row
                    .iter()
                    .zip(&baseline.modes)
                    .map(|(f, mode)| {
                        let variance = discrepancy * discrepancy + mode.log_sd * mode.log_sd;
                        (f.ln() - mode.log_frequency).powi(2) / variance
                    })
                    .sum();
                (-0.5 * square).exp()
            })
            .collect();
        let ess = weights.iter().sum::<f64>().powi(2) / weights.iter().map(|w| w * w).sum::<f64>();
        assert!(ess > 2000.0, "{ess}");
        for quantity in 0..6 {
            let column = |rows: &[f64]| -> Vec<f64> {
                rows.iter().skip(quantity).step_by(7).map(|x| x.ln()).collect()
            };
            let (mean, sd) = moments(&column(&thetas), &weights);
            let particles = column(&baseline.particles);
            let (got, got_sd) = moments(&particles, &vec![1.0; particles.len()]);
            // As good as 1000 independent particles: 0.03 sd of the mean and 0.02 of the spread, four times that.
            assert!(
                (got - mean).abs() < 0.13 * sd,
                "{discrepancy} {quantity}: {got} {mean} {sd}"
            );
            assert!(
                (got_sd / sd - 1.0).abs() < 0.1,
                "{discrepancy} {quantity}: {got_sd} {sd}"
            );
        }
    }
}

/// Only the force is uncertain: its posterior by quadrature, with a kernel a thousandth as wide as the prior and
/// the force two prior standard deviations out.
#[test]
fn a_narrow_kernel_far_from_the_priors_middle_is_reached() {
    let mut priors: Vec<Prior> = RodPrior::todi()
        .centre()
        .into_iter()
        .map(|value| Prior::Fixed { value })
        .collect();
    priors[0] = Prior::LogNormal {
        median: 800e3,
        log_sd: 0.5,
    };
    let prior = RodPrior::new(*RodPrior::todi().parameterisation(), priors).unwrap();
    let centre = prior.centre();
    let logs = log_frequencies(&centre, 1.0);
    let records = vec![observation(&[(1, logs[0] + 2e-4), (2, logs[1])], LOG_SD); 30];
    let baseline = Baseline::learn(&records, &prior, &model(), &[1e-4; 5], 2048, 1).unwrap();
    let (mut values, mut weights) = (Vec::new(), Vec::new());
    for step in -2000..=2000 {
        let u = 1.0 + f64::from(step) * 2e-6;
        let f = log_frequencies(&centre, u);
        let square: f64 = baseline
            .modes
            .iter()
            .map(|mode| (f[mode.order - 1] - mode.log_frequency).powi(2) / (1e-8 + mode.log_sd * mode.log_sd))
            .sum();
        values.push(u);
        weights.push((-0.5 * square - 0.5 * (u / 0.5).powi(2)).exp());
    }
    let (mean, sd) = moments(&values, &weights);
    let particles: Vec<f64> = baseline
        .particles
        .chunks_exact(7)
        .map(|theta| (theta[0] / 800e3).ln())
        .collect();
    let (got, got_sd) = moments(&particles, &vec![1.0; particles.len()]);
    // 2048 particles as good as 500.
    assert!((got - mean).abs() < 0.18 * sd, "{got} {mean} {sd}");
    assert!((got_sd / sd - 1.0).abs() < 0.13, "{got_sd} {sd}");
}

/// Every particle on a fine grid of u, frequencies by the exact solver, no proposal, no polynomial, no reduced model.
fn by_grid(baseline: &Baseline, observation: &Observation, from: f64, to: f64) -> [f64; 5] {
    let (mut us, mut forces, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    let steps = 240;
    for theta in baseline.particles.chunks_exact(7) {
        let before = log_frequencies(theta, 0.0);
        for step in 0..=steps {
            let u = from + (to - from) * f64::from(step) / f64::from(steps);
            let after = log_frequencies(theta, u);
            let square: f64 = baseline
                .modes
                .iter()
                .filter_map(|known| {
                    let mode = observation.mode(known.order)?;
                    let variance = (mode.log_sd * baseline.overdispersion).powi(2) + known.log_sd.powi(2);
                    let shift = after[known.order - 1] - before[known.order - 1];
                    Some((mode.log_frequency - known.log_frequency - shift).powi(2) / variance)
                })
                .sum();
            us.push(u);
            forces.push(theta[0] * u.exp());
            weights.push((-0.5 * square).exp());
        }
    }
    let (mean, sd) = moments(&us, &weights);
    let (force, _) = moments(&forces, &weights);
    let sum: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= sum);
    let quantiles = tirante::analysis::numerics::diagnostics::quantiles(&us, &weights, &[0.025, 0.975]);
    [mean, sd, quantiles[0], quantiles[1], force]
}

/// Standard deviations by which 2.5 % quantiles may differ: of 1024 independent draws, half of them effective, the standard
/// error is 0.12, of a difference of two 0.16.
const QUANTILE: f64 = 0.4;

fn assert_like(relative: &Relative, expected: [f64; 5], tolerance: f64, what: &str) {
    let [mean, sd, low, high, force] = expected;
    assert!(
        (relative.log_ratio - mean).abs() < tolerance * sd,
        "{what}: {} {mean} {sd}",
        relative.log_ratio
    );
    assert!(
        (relative.log_sd / sd - 1.0).abs() < tolerance,
        "{what}: {} {sd}",
        relative.log_sd
    );
    assert!(
        (relative.ratio.q025.ln() - low).abs() < QUANTILE * sd,
        "{what}: {} {low}",
        relative.ratio.q025.ln()
    );
    assert!(
        (relative.ratio.q975.ln() - high).abs() < QUANTILE * sd,
        "{what}: {} {high}",
        relative.ratio.q975.ln()
    );
    assert!(
        (relative.force_n.mean / force - 1.0).abs() < 1e-3,
        "{what}: {} {force}",
        relative.force_n.mean
    );
}

#[test]
fn a_plain_grid_with_the_exact_solver_gives_the_same() {
    let baseline = baseline_of(&thirty(&[1, 2, 3]), 0.01, 256);
    let shift = Shift::new(&baseline, &model());
    let mut generator = random::stream(41, 0);
    for (change, orders) in [
        (0.0, &[1, 2, 3][..]),
        (-0.05, &[1, 2, 3]),
        (-0.2, &[1, 3]),
        (-0.5, &[1, 2, 3]),
        (0.3, &[2]),
    ] {
        let observation = record(f64::ln_1p(change), orders, &mut generator);
        let relative = shift.relative(&observation, 5).unwrap();
        let (middle, half) = (relative.log_ratio, 7.0 * relative.log_sd);
        let expected = by_grid(&baseline, &observation, middle - half, middle + half);
        // 1024 stratified draws: the mean is good to a hundredth of a standard deviation.
        assert_like(&relative, expected, 0.02, &format!("{change} {orders:?}"));
        assert!(relative.ess > 50.0, "{}", relative.ess);
    }
    // A record without information: u is flat over the prepared range, -0.8 to 0.6.
    let vague = observation(
        &log_frequencies(&RodPrior::todi().centre(), 0.0).map(|f| (1, f))[..1],
        0.5,
    );
    let relative = shift.relative(&vague, 5).unwrap();
    assert_like(&relative, by_grid(&baseline, &vague, -0.8, 0.6), 0.03, "vague");
    assert!(relative.log_sd > 0.3 && relative.freedom == 0 && relative.not_axial_p == 1.0);
}

#[test]
fn the_exact_solver_as_the_model_gives_the_same() {
    let records = thirty(&[1, 2, 3]);
    let exact = Exact::new(*RodPrior::todi().parameterisation());
    let baseline = baseline_of(&records, 0.01, 256);
    let mut generator = random::stream(42, 0);
    let observation = record(-0.1, &[1, 2, 3], &mut generator);
    let a = Shift::new(&baseline, &model()).relative(&observation, 1).unwrap();
    let b = Shift::new(&baseline, &exact).relative(&observation, 1).unwrap();
    // The emulator is good to a millionth in ln f and slope.
    assert!((a.log_ratio - b.log_ratio).abs() < 2e-5 && (a.log_sd / b.log_sd - 1.0).abs() < 1e-2);
    let learned = Baseline::learn(&records, &RodPrior::todi(), &exact, &[0.01; 5], 256, 9).unwrap();
    for (a, b) in learned.modes.iter().zip(&baseline.modes) {
        assert!((a.log_frequency - b.log_frequency).abs() < 1e-6 && (a.log_sd / b.log_sd - 1.0).abs() < 1e-3);
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_nearly_the_same() {
    let records = thirty(&[1, 2, 3]);
    let mut generator = random::stream(43, 0);
    let observation = record(-0.05, &[1, 2, 3], &mut generator);
    let baseline = baseline_of(&records, 0.01, 512);
    assert_eq!(baseline, baseline_of(&records, 0.01, 512));
    let shift = Shift::new(&baseline, &model());
    let first = shift.relative(&observation, 1).unwrap();
    assert_eq!(
        first,
        Shift::new(&baseline, &model()).relative(&observation, 1).unwrap()
    );
    for seed in 2..20 {
        let other = shift.relative(&observation, seed).unwrap();
        assert!((other.log_ratio - first.log_ratio).abs() < 0.01 * first.log_sd);
        assert!((other.ratio.q025 - first.ratio.q025).abs() < QUANTILE * first.ratio.sd);
        assert!((other.ratio.q975 - first.ratio.q975).abs() < QUANTILE * first.ratio.sd);
    }
    // Other particles: the remaining effect of chance in the baseline.
    let other = Baseline::learn(&records, &RodPrior::todi(), &model(), &[0.01; 5], 512, 10).unwrap();
    assert_ne!(other.particles, baseline.particles);
    let other = Shift::new(&other, &model()).relative(&observation, 1).unwrap();
    assert!((other.log_ratio - first.log_ratio).abs() < 0.15 * first.log_sd);
}

#[test]
fn what_cannot_be_said_is_named() {
    let records = thirty(&[1, 3]);
    let baseline = baseline_of(&records, 0.01, 128);
    assert_eq!(
        baseline.modes.iter().map(|mode| mode.order).collect::<Vec<_>>(),
        [1, 3]
    );
    let shift = Shift::new(&baseline, &model());
    let logs = log_frequencies(&RodPrior::todi().centre(), 0.0);
    let none = observation(&[(2, logs[1])], LOG_SD);
    assert_eq!(shift.relative(&none, 1), Err(NoRelative::NoCommonMode));
    let empty = observation(&[], LOG_SD);
    assert_eq!(shift.relative(&empty, 1), Err(NoRelative::NoCommonMode));
    // A unit taken for another, and a frequency that is none.
    for factor in [1e-3, 0.5, 2.0, 1e3] {
        let far = observation(
            &[(1, logs[0] + f64::ln(factor)), (3, logs[2] + f64::ln(factor))],
            LOG_SD,
        );
        assert_eq!(shift.relative(&far, 1), Err(NoRelative::OutsideRange), "{factor}");
    }
    let broken = observation(&[(1, f64::NAN), (3, logs[2])], LOG_SD);
    let relative = shift.relative(&broken, 1).unwrap();
    assert_eq!((relative.freedom, relative.misfit.len()), (0, 1));
    // Standard errors of zero and of anything.
    for log_sd in [0.0, 1e-12, 1.0, 1e6, 1e300] {
        let relative = shift
            .relative(&observation(&[(1, logs[0]), (3, logs[2])], log_sd), 1)
            .unwrap();
        let ratio = relative.ratio;
        assert!(
            ratio.q025 < ratio.mean && ratio.mean < ratio.q975 && ratio.sd > 0.0,
            "{log_sd}: {relative:?}"
        );
        assert!(relative.not_axial_p >= 0.0 && relative.record_sd > 0.0);
    }
    let learn =
        |records: &[Observation]| Baseline::learn(records, &RodPrior::todi(), &model(), &[0.01; 5], 128, 1);
    assert_eq!(learn(&[]), Err(BaselineFault::NoMode { records: 0 }));
    assert_eq!(learn(&vec![empty; 4]), Err(BaselineFault::NoMode { records: 4 }));
    let mut rare = records.clone();
    rare[3].modes.push(LogMode {
        order: 5,
        ..records[0].modes[0]
    });
    assert_eq!(learn(&rare).unwrap().modes.len(), 2);
    let identical = learn(&vec![records[0].clone(); 30]).unwrap();
    assert_eq!(identical.overdispersion, 1.0);
    assert!(identical.misfit.is_finite());
    // One record alone is a baseline too, if one is wanted.
    assert_eq!(learn(&records[..1]).unwrap().records, 1);
}

/// The baseline's own error and the uncertain slopes are in the test of many records together, which the record's errors
/// alone would fail.
#[test]
fn many_records_together_are_axial_if_each_is() {
    let mut generator = random::stream(44, 0);
    let baseline = baseline_of(&thirty(&[1, 2, 3]), 0.01, 512);
    let shift = Shift::new(&baseline, &model());
    let count = 400;
    let mut sums = [0.0; 3];
    let mut delta = 0.0;
    for i in 0..count {
        let relative = shift
            .relative(&record(-0.2, &[1, 2, 3], &mut generator), i)
            .unwrap();
        delta += relative.log_ratio / count as f64;
        for (sum, one) in sums.iter_mut().zip(&relative.misfit) {
            *sum += one.residual / count as f64;
        }
    }
    let misfit = |extra: [f64; 3]| {
        std::array::from_fn::<_, 3, _>(|n| tirante::analysis::track::relative::Misfit {
            order: n + 1,
            residual: sums[n] + extra[n],
            sd: LOG_SD / f64::from(count as u32).sqrt(),
        })
    };
    assert!(shift.not_axial_p(delta, &misfit([0.0; 3])) > 0.01);
    assert!(shift.not_axial_p(delta, &misfit([-0.01, 0.0, -0.01])) < 1e-6);
    assert_eq!(shift.not_axial_p(delta, &misfit([0.0; 3])[..1]), 1.0);
    assert_eq!(shift.not_axial_p(delta, &[]), 1.0);
}

/// The followed estimate has the noise of the frequencies and nothing else, however large the change; the
/// posterior mean has more, because it weighs the particles anew by every record's noise.
#[test]
fn the_estimates_noise_does_not_grow_with_the_change() {
    let orders = [1, 2, 3];
    let shift = Shift::new(&baseline_of(&thirty(&orders), 0.01, 512), &model());
    let mut generator = random::stream(77, 0);
    let count = 2000;
    for u in [0.0, -0.35, 0.3] {
        let found: Vec<Relative> = (0..count)
            .map(|seed| shift.relative(&record(u, &orders, &mut generator), seed).unwrap())
            .collect();
        let over_stated = |value: fn(&Relative) -> f64| {
            let mean = found.iter().map(value).sum::<f64>() / count as f64;
            found
                .iter()
                .map(|one| ((value(one) - mean) / one.record_sd).powi(2))
                .sum::<f64>()
                / count as f64
        };
        // Four standard errors of a variance of 2000 normal values: 4 sqrt(2 / 2000).
        let estimate = over_stated(|one| one.estimate);
        assert!((estimate - 1.0).abs() < 0.13, "{u}: {estimate}");
        if u != 0.0 {
            let posterior = over_stated(|one| one.log_ratio);
            assert!(posterior > 1.13, "{u}: {posterior}");
        }
    }
}
