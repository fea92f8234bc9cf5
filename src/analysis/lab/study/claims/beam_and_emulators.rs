//! The models: the chaos's errors, frequencies that no beam has, and the springs.

use super::{Claim, EARLIER, PAPER, claim, printed_as};
use crate::lab::study::estimate::{CLOSE, DISAGREE};
use crate::lab::study::{Study, paper};

pub(super) fn chaos(study: &Study) -> Vec<Claim> {
    let Some((report, grid)) = study
        .emulators
        .iter()
        .find_map(|report| Some((report, report.grid.as_ref()?)))
    else {
        return Vec::new();
    };
    let variances: Vec<f64> = grid.iter().take(3).map(|g| g.variance_hz2).collect();
    let tails: Vec<f64> = report.modes.iter().take(3).map(|m| m.value_hz.max).collect();
    let shown = |values: &[f64]| {
        let all: Vec<String> = values.iter().map(|v| format!("{v:.1e}")).collect();
        all.join(", ")
    };
    let worst = tails.iter().copied().fold(0.0, f64::max);
    let largest = variances.iter().copied().fold(0.0, f64::max);
    vec![
        claim(
            EARLIER,
            "the order-5 chaos has grid error variances of about 6e-6, 3e-5, 1e-4 Hz\u{b2} and tail errors near 0.1 Hz",
            variances
                .iter()
                .zip(
                    [(6e-6, 1e-6), (3e-5, 1e-5), (1e-4, 1e-4)].map(|(value, digit)| printed_as(value, digit)),
                )
                .all(|(v, wanted)| wanted.is_about(*v))
                && printed_as(0.1, 0.1).is_about(worst),
            format!(
                "grid variances {} Hz\u{b2}; largest errors over 20 000 draws of the prior {} Hz",
                shown(&variances),
                shown(&tails)
            ),
        ),
        claim(
            PAPER,
            "section 4.4: grid error variances below 1.364e-5 Hz\u{b2}, largest tail errors 5e-3, 5e-2, 4e-2 Hz",
            largest < paper::GRID_ERROR.1
                && tails
                    .iter()
                    .zip(paper::TAIL_ERRORS_HZ)
                    .all(|(t, printed)| *t < printed || printed_as(printed, 0.0).is_about(*t)),
            format!(
                "grid variances {} Hz\u{b2}, largest errors {} Hz; the likeliest reason is where the paper looked for tails: its points are not said",
                shown(&variances),
                shown(&tails)
            ),
        ),
    ]
}

pub(super) fn beam(study: &Study) -> Vec<Claim> {
    let ratios = study.springs.frequency_hz.iter().map(|f| f[2] / f[0]);
    let smallest = ratios.fold(f64::INFINITY, f64::min);
    let posterior = study.parts.iter().flat_map(|part| &part.checks);
    let smallest = posterior
        .map(|check| check.smallest_ratio)
        .fold(smallest, f64::min);
    let printed =
        |a: &&crate::lab::study::assumptions::Assumed| (a.error_sd_hz - paper::error_sd_hz()).abs() < 1e-12;
    let conflict = study
        .assumptions
        .iter()
        .find(printed)
        .map_or(f64::NAN, |a| a.conflict);
    vec![claim(
        EARLIER,
        "no tensioned beam on rotational springs has f3/f1 below 3; the observed 2.950 cannot come from the model",
        smallest >= 3.0 - 1e-9 && conflict > DISAGREE,
        format!(
            "smallest f3/f1 over every posterior {smallest:.4}; the record lies {conflict:.1} standard deviations (31.6 mHz) from the nearest such beam"
        ),
    )]
}

pub(super) fn springs(study: &Study) -> Vec<Claim> {
    let total = |spring: bool| {
        let all = study.sensitivity.iter();
        let one = all.filter(|s| (s.quantity.key().starts_with("spring")) == spring);
        one.map(|s| s.total).fold(0.0, f64::max)
    };
    let (hinged, clamped) = (study.springs.hinged_hz, study.springs.clamped_hz);
    vec![claim(
        PAPER,
        "section 4.2: the frequencies are little sensitive to the springs, which cannot be learned",
        total(true) < CLOSE,
        format!(
            "largest total Sobol index of a spring {:.4}, of the others {:.3}. Between hinge and clamp mode 1 still moves by {:.1} %, which is {:.0} % of N",
            total(true),
            total(false),
            100.0 * (clamped[0] / hinged[0] - 1.0),
            // N goes with the frequency to the power of about 1 / 0.45.
            100.0 * ((clamped[0] / hinged[0]).powf(1.0 / 0.45) - 1.0)
        ),
    )]
}
