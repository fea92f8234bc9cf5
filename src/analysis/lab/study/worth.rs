//! Worth of further measurements: the certainty of the axial force that each one buys.

use super::estimate::Estimate;
use super::{Effort, StudyError, table2};
use crate::inference::Observation;
use crate::lab::mcmc::{self, McmcSettings, Problem};
use crate::numerics::random;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::beam::{Exact, Quantity};
use crate::rod::emulator::ReducedModel;
use crate::rod::prior::{Prior, RodPrior};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;

/// Standard error of a frequency of an ordinary record \[Hz\].
const ERROR_SD_HZ: f64 = 0.01;

/// A measurement campaign on one rod.
struct Scenario {
    name: &'static str,
    modes: usize,
    error_sd_hz: f64,
    /// Quantities measured beside the frequencies, with the relative error of each.
    known: &'static [(Quantity, f64)],
}

const SCENARIOS: [Scenario; 14] = {
    use Quantity::{Density, Side, SpringLeft, SpringRight, YoungsModulus};
    const fn scenario(
        name: &'static str,
        modes: usize,
        error_sd_hz: f64,
        known: &'static [(Quantity, f64)],
    ) -> Scenario {
        Scenario {
            name,
            modes,
            error_sd_hz,
            known,
        }
    }
    [
        scenario("three modes, 10 mHz each", 3, ERROR_SD_HZ, &[]),
        scenario("one mode", 1, ERROR_SD_HZ, &[]),
        scenario("two modes", 2, ERROR_SD_HZ, &[]),
        scenario("four modes", 4, ERROR_SD_HZ, &[]),
        scenario("five modes", 5, ERROR_SD_HZ, &[]),
        scenario("half the frequency error", 3, 0.5 * ERROR_SD_HZ, &[]),
        scenario("a tenth of the frequency error", 3, 0.1 * ERROR_SD_HZ, &[]),
        scenario("side by caliper, 0.5 %", 3, ERROR_SD_HZ, &[(Side, 0.005)]),
        scenario("density weighed, 1 %", 3, ERROR_SD_HZ, &[(Density, 0.01)]),
        scenario(
            "Young's modulus tested, 3 %",
            3,
            ERROR_SD_HZ,
            &[(YoungsModulus, 0.03)],
        ),
        scenario("one spring known, 10 %", 3, ERROR_SD_HZ, &[(SpringLeft, 0.1)]),
        scenario(
            "both springs known, 10 %",
            3,
            ERROR_SD_HZ,
            &[(SpringLeft, 0.1), (SpringRight, 0.1)],
        ),
        scenario(
            "caliper and weighed density",
            3,
            ERROR_SD_HZ,
            &[(Side, 0.005), (Density, 0.01)],
        ),
        scenario(
            "caliper, density, modulus",
            3,
            ERROR_SD_HZ,
            &[(Side, 0.005), (Density, 0.01), (YoungsModulus, 0.03)],
        ),
    ]
};

/// Uncertainty that one campaign leaves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worth {
    /// Quantities measured, in words.
    pub measured: &'static str,
    /// Posterior coefficient of variation of N; the error is the spread between rods.
    pub cv: Estimate,
    /// The same over that of the first campaign, rod by rod.
    pub of_first: Estimate,
}

/// Expected uncertainty of the force after each campaign, over rods drawn from the prior; every campaign has
/// the same rods and the same errors.
///
/// # Errors
/// A rod that cannot be inferred.
pub fn worth(
    prior: &RodPrior,
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Worth>, StudyError> {
    let rods: Vec<Vec<f64>> = (0..effort.rods as u64)
        .into_par_iter()
        .map(|rod| {
            let cvs = SCENARIOS
                .iter()
                .map(|scenario| cv(prior, scenario, effort, seed, rod));
            let cvs = cvs.collect();
            done("what to measure next");
            cvs
        })
        .collect::<Result<_, StudyError>>()?;
    let over = |of: &dyn Fn(&Vec<f64>) -> f64| Estimate::of(rods.iter().map(of));
    let one = |(i, scenario): (usize, &Scenario)| Worth {
        measured: scenario.name,
        cv: over(&|cvs| cvs[i]),
        of_first: over(&|cvs| cvs[i] / cvs[0]),
    };
    Ok(SCENARIOS.iter().enumerate().map(one).collect())
}

/// Posterior coefficient of variation of the force of one rod after one campaign.
fn cv(
    prior: &RodPrior,
    scenario: &Scenario,
    effort: &Effort,
    seed: u64,
    rod: u64,
) -> Result<f64, StudyError> {
    let parameterisation = *prior.parameterisation();
    let mut generator = random::stream(random::seed(&[b"worth", &seed.to_le_bytes()]), rod);
    let mut truth = prior.centre();
    prior.sample(&mut generator, &mut truth);
    let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
    let mut y = [0.0; MAX_MODES];
    Exact::new(parameterisation).frequencies(&truth, &mut y)?;
    y.iter_mut().for_each(|y| *y += scenario.error_sd_hz * normal());
    // Every quantity has its own error, measured or not, so that campaigns share them.
    let errors: Vec<f64> = truth.iter().map(|_| normal()).collect();
    let mut priors = prior.priors().to_vec();
    for &(quantity, error) in scenario.known {
        if let Some(i) = parameterisation.index(quantity) {
            priors[i] = with_measurement(&priors[i], truth[i] * (1.0 + error * errors[i]), error * truth[i]);
        }
    }
    let prior = RodPrior::new(parameterisation, priors).ok_or(StudyError::NoRod)?;
    let observation = Observation::first(&y[..scenario.modes], scenario.error_sd_hz)?;
    let steps = effort.mcmc_steps / table2::CHAINS;
    let chains = mcmc::run(
        &Problem {
            prior: &prior,
            model: &ReducedModel::new(parameterisation),
            observation: &observation,
            discrepancy: &[0.0; MAX_MODES],
        },
        &McmcSettings {
            chains: table2::CHAINS,
            steps,
            burn_in: steps / 2,
            thin: table2::THIN,
        },
        random::seed(&[scenario.name.as_bytes(), &rod.to_le_bytes(), &seed.to_le_bytes()]),
    )?;
    let force = chains.marginal(Quantity::AxialForce);
    Ok(force.map_or(f64::NAN, |force| force.cv))
}

/// A normal prior after a normal measurement of the quantity itself.
fn with_measurement(prior: &Prior, measured: f64, error: f64) -> Prior {
    let (mean, sd) = prior.mean_and_sd();
    let (before, after) = (1.0 / (sd * sd), 1.0 / (error * error));
    Prior::TruncatedNormal {
        mean: (before * mean + after * measured) / (before + after),
        sd: (before + after).sqrt().recip(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measurement_as_good_as_the_prior_halves_the_variance() {
        let prior = Prior::TruncatedNormal { mean: 10.0, sd: 1.0 };
        let Prior::TruncatedNormal { mean, sd } = with_measurement(&prior, 12.0, 1.0) else {
            panic!("still a normal");
        };
        assert!((mean - 11.0).abs() < 1e-12 && (sd * sd - 0.5).abs() < 1e-12);
    }
}
