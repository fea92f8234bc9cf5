//! Tests of the expansion.

use super::*;
use crate::numerics::random;
use crate::rod::beam::Section;
use crate::rod::emulator::OrExact;
use crate::rod::prior::Prior;
use std::sync::LazyLock;

static TODI: LazyLock<(Training, Pce)> = LazyLock::new(|| {
    let prior = RodPrior::todi();
    let training = Training::solve(&prior, 5, 50, &|_, _| ()).unwrap();
    let pce = Pce::from_training(&prior, &training, Weighting::Equal);
    (training, pce)
});

#[test]
fn the_papers_chaos_has_the_errors_that_independent_checks_found() {
    let (_, pce) = &*TODI;
    assert_eq!(pce.terms(), 462);
    let report = pce.report();
    let grid = report.grid.as_ref().unwrap();
    // Design 4.8: about 6e-6, 3e-5, 1e-4 Hz^2; least squares with a constant term has no mean error.
    for (errors, expected) in grid.iter().zip([6e-6, 3e-5, 1e-4]) {
        assert!((errors.variance_hz2 / expected - 1.0).abs() < 0.3, "{errors:?}");
        assert!(errors.mean_hz.abs() < 1e-10);
    }
    // Design 4.2: rms 5e-4, 4e-4, 5e-4, maximum 2e-2.
    for (errors, expected) in report.modes.iter().zip([5e-4, 4e-4, 5e-4]) {
        assert!((errors.relative.rms / expected - 1.0).abs() < 0.3, "{errors:?}");
        assert!(errors.relative.max < 2e-2);
    }
    // Five germs of six or so lie outside 3.32 standard deviations once in 1100 draws each.
    assert!(report.outside > 40 && report.outside < 200, "{}", report.outside);
}

#[test]
fn weighting_by_the_quadrature_is_better_in_the_mean_and_worse_on_the_grid() {
    let (training, equal) = &*TODI;
    let weighted = Pce::from_training(&RodPrior::todi(), training, Weighting::Quadrature);
    for mode in 0..3 {
        let rms = |pce: &Pce| pce.report().modes[mode].value_hz.rms;
        let variance = |pce: &Pce| pce.report().grid.as_ref().unwrap()[mode].variance_hz2;
        assert!(rms(&weighted) < rms(equal));
        assert!(variance(&weighted) > variance(equal));
    }
}

#[test]
fn slopes_are_the_derivatives_of_the_values() {
    let (_, pce) = &*TODI;
    let theta = [7.1e5, 2.2e11, 7800.0, 0.066, 3e5, 5e5, 14.0];
    let mut slopes = [0.0; 5];
    pce.log_slopes(&theta, &mut slopes).unwrap();
    let at = |factor: f64| {
        let mut moved = theta;
        moved[0] *= factor;
        let mut f = [0.0; 5];
        pce.frequencies(&moved, &mut f).unwrap();
        f
    };
    let h = 1e-5f64;
    let (up, down) = (at(h.exp()), at((-h).exp()));
    for i in 0..5 {
        assert!(((up[i] / down[i]).ln() / (2.0 * h) - slopes[i]).abs() < 1e-8);
    }
}

#[test]
fn a_point_has_the_same_bits_alone_and_in_a_block_and_outside_the_exact_model_answers() {
    let prior = RodPrior::todi();
    let (_, pce) = &*TODI;
    let either = OrExact::new(pce.clone());
    let exact = Exact::new(*prior.parameterisation());
    let mut generator = random::stream(11, 0);
    let count = 20 * LANES + 3;
    let mut thetas = vec![0.0; 7 * count];
    thetas
        .chunks_exact_mut(7)
        .for_each(|theta| prior.sample(&mut generator, theta));
    // Far outside, another length, and no rod at all.
    thetas[0] = 3e6;
    thetas[7 + 6] = 13.0;
    thetas[14] = -1.0;
    let (mut alone, mut many, mut any) = ([0.0; 4], vec![0.0; 4 * count], vec![0.0; 4 * count]);
    pce.frequencies_of_many(&thetas, 4, &mut many);
    either.frequencies_of_many(&thetas, 4, &mut any);
    for (i, theta) in thetas.chunks_exact(7).enumerate() {
        let (row, any) = (&many[4 * i..4 * i + 4], &any[4 * i..4 * i + 4]);
        match pce.frequencies(theta, &mut alone) {
            Ok(()) => assert!(row == alone && any == alone && i > 2),
            Err(_) if i == 2 => assert!(any.iter().all(|f| f.is_nan())),
            Err(_) => {
                assert!(row.iter().all(|f| f.is_nan()));
                exact.frequencies(theta, &mut alone).unwrap();
                assert_eq!(any, alone);
            }
        }
    }
    let error = pce.frequencies(&thetas[..7], &mut alone).unwrap_err();
    assert_eq!((error.what, error.value), ("axial_force_n", 3e6));
    let error = pce.frequencies(&thetas[7..14], &mut alone).unwrap_err();
    assert_eq!((error.what, error.low, error.high), ("length_m", 14.0, 14.0));
}

#[test]
fn every_kind_of_prior_can_be_a_germ() {
    let priors = vec![
        Prior::LogNormal {
            median: 2e5,
            log_sd: 0.2,
        },
        Prior::Uniform {
            low: 1.9e11,
            high: 2.1e11,
        },
        Prior::Fixed { value: 7800.0 },
        Prior::TruncatedNormal {
            mean: 0.03,
            sd: 0.001,
        },
        Prior::Uniform { low: 0.0, high: 5e4 },
        Prior::Fixed { value: 0.0 },
        Prior::Fixed { value: 6.0 },
    ];
    let prior = RodPrior::new(Parameterisation::new(Section::Round), priors).unwrap();
    let pce = Pce::fit(&prior, 6, 20, &|_, _| ()).unwrap();
    for mode in &pce.report().modes[..3] {
        assert!(mode.relative.rms < 1e-3, "{mode:?}");
        assert!(mode.slope.unwrap().rms < 5e-3, "{mode:?}");
    }
}

#[test]
fn what_cannot_be_expanded_is_refused() {
    let fixed = |value| Prior::Fixed { value };
    let all_fixed = [8e5, 4e5, 37.0, 4e5, 4e5, 14.0].map(fixed).to_vec();
    let direct = Parameterisation::new(Section::Direct);
    let prior = RodPrior::new(direct, all_fixed.clone()).unwrap();
    assert_eq!(
        Pce::fit(&prior, 3, 10, &|_, _| ()).unwrap_err(),
        FitError::NothingUncertain
    );
    let todi = RodPrior::todi();
    assert_eq!(
        Pce::fit(&todi, 0, 10, &|_, _| ()).unwrap_err(),
        FitError::Order { order: 0 }
    );
    let error = Pce::fit(&todi, 12, 10, &|_, _| ()).unwrap_err();
    assert_eq!(
        error,
        FitError::TooLarge {
            order: 12,
            germs: 6,
            points: 13usize.pow(6)
        }
    );
    // A known force leaves frequencies, but no slope.
    let mut known_force = all_fixed;
    known_force[3] = Prior::TruncatedNormal { mean: 4e5, sd: 4e4 };
    let prior = RodPrior::new(direct, known_force).unwrap();
    let pce = Pce::fit(&prior, 3, 10, &|_, _| ()).unwrap();
    assert!(pce.log_slopes(&prior.centre(), &mut [0.0]).is_err());
    assert!(pce.report().modes.iter().all(|mode| mode.slope.is_none()));
}
