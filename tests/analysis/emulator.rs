//! Campaigns: the emulators' errors over whole ranges, for docs/emulators.md.

use rand::RngExt;
use tirante::analysis::numerics::random;
use tirante::analysis::rod::beam::{Beam, exact};
use tirante::analysis::rod::emulator::fit::Weighting;
use tirante::analysis::rod::emulator::validate::Spread;
use tirante::analysis::rod::emulator::{Pce, Reduced, Training};
use tirante::analysis::rod::prior::RodPrior;

#[test]
#[ignore = "campaign: errors over a million beams, half a minute; run with --release --ignored --nocapture"]
fn errors_over_every_beam() {
    let mut generator = random::stream(77, 0);
    let mut errors = vec![[Vec::new(), Vec::new()]; 5];
    let reduced = Reduced::shared();
    for _ in 0..1_000_000 {
        let u: f64 = generator.random();
        let tension = ((1.0 - u) / (0.2 * u)).powi(2).min(1e29);
        let scale = (tension + 49.0).sqrt();
        let beam = Beam {
            length_m: 1.0,
            flexural_rigidity_n_m2: 1.0,
            mass_per_length_kg_m: 1.0,
            axial_force_n: tension,
            end_stiffness_n_m: [0, 1]
                .map(|_| generator.random())
                .map(|s: f64| s / (1.0 - s) * scale),
        };
        let mut f = [[0.0; 5]; 4];
        reduced.frequencies(&beam, &mut f[0]).unwrap();
        exact::frequencies(&beam, &mut f[1]).unwrap();
        reduced.log_slopes(&beam, &mut f[2]).unwrap();
        exact::log_slopes(&beam, &mut f[3]).unwrap();
        for (mode, errors) in errors.iter_mut().enumerate() {
            errors[0].push(f[0][mode] / f[1][mode] - 1.0);
            errors[1].push(f[2][mode] - f[3][mode]);
        }
    }
    for (mode, [value, slope]) in errors.iter().enumerate() {
        let (value, slope) = (Spread::of(value), Spread::of(slope));
        let terms = reduced.terms(mode + 1);
        let show = |s: &Spread| format!("rms {:.1e} 99.9 % {:.1e} max {:.1e}", s.rms, s.q999, s.max);
        eprintln!(
            "mode {}, {terms} terms: value {}, slope {}",
            mode + 1,
            show(&value),
            show(&slope)
        );
        assert!(value.max < 3e-6 && slope.max < 5e-6);
    }
}

#[test]
#[ignore = "campaign: errors by order and weighting, two minutes; run with --release --ignored --nocapture"]
fn errors_by_order() {
    let prior = RodPrior::todi();
    for order in 3..=8 {
        let training = Training::solve(&prior, order, 50, &|_, _| ()).unwrap();
        for weighting in [Weighting::Equal, Weighting::Quadrature] {
            let pce = Pce::from_training(&prior, &training, weighting);
            let report = pce.report();
            let grid: Vec<f64> = report
                .grid
                .iter()
                .flatten()
                .map(|errors| errors.variance_hz2)
                .collect();
            eprint!(
                "order {order} {weighting:?} {} terms, {} outside:",
                pce.terms(),
                report.outside
            );
            for (mode, variance) in report.modes.iter().zip(grid).take(3) {
                let slope = mode.slope.map_or(f64::NAN, |slope| slope.rms);
                let Spread { rms, max, .. } = mode.value_hz;
                eprint!(" [grid {variance:.1e} rms {rms:.1e} max {max:.1e} slope {slope:.1e}]");
            }
            eprintln!();
        }
    }
}

/// `UPDATE_TABLES=1 cargo test --test analysis the_shipped` writes it anew.
#[test]
fn the_shipped_reduced_emulator_is_the_fitted_one_to_the_bit() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/src/analysis/rod/emulator/reduced.postcard"
    );
    let fitted = Reduced::fit().save().unwrap();
    if std::env::var_os("UPDATE_TABLES").is_some() {
        std::fs::write(path, &fitted).unwrap();
    }
    assert!(
        fitted == std::fs::read(path).unwrap(),
        "the fit has changed: UPDATE_TABLES=1 writes {path}"
    );
    assert!(fitted == Reduced::shared().save().unwrap());
}
