//! Worth of further measurements: the certainty of the axial force that each one buys, by the code of `tirante plan`.

use super::estimate::Estimate;
use super::{Effort, StudyError};
use crate::inference::joint::next::{self, Campaign, Candidate, Known};
use crate::rod::beam::Quantity::{Density, Side, SpringLeft, YoungsModulus};
use crate::rod::beam::forward::MAX_MODES;
use crate::rod::prior::RodPrior;
use crate::rod::query::Query;
use serde::Serialize;

/// Mode orders of an ordinary record.
const MODES: usize = 3;
/// Standard error of its frequencies \[Hz\].
const ERROR_SD_HZ: f64 = 0.01;

/// Uncertainty that one campaign leaves.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Worth {
    /// Quantities measured, in words.
    pub measured: String,
    /// Posterior coefficient of variation of N; the error is the spread between rods.
    pub cv: Estimate,
    /// The same over that of the first campaign, rod by rod.
    pub of_first: Estimate,
}

/// Campaigns beside those of `tirante plan`: other frequencies, single quantities.
fn campaigns(prior: &RodPrior) -> Vec<Candidate> {
    let one = |key, said: &str, frequencies, queries| Candidate {
        key,
        said: said.to_owned(),
        queries,
        frequencies: Some(frequencies),
    };
    let usual = (MODES, ERROR_SD_HZ);
    let tested = vec![(Query::Quantity(YoungsModulus), 0.03)];
    let mut all = vec![
        one("modes-1", "one mode", (1, ERROR_SD_HZ), Vec::new()),
        one("modes-2", "two modes", (2, ERROR_SD_HZ), Vec::new()),
        one("modes-4", "four modes", (4, ERROR_SD_HZ), Vec::new()),
        one("modes-5", "five modes", (MAX_MODES, ERROR_SD_HZ), Vec::new()),
        one(
            "error-2",
            "half the frequency error",
            (MODES, 0.5 * ERROR_SD_HZ),
            Vec::new(),
        ),
        one(
            "error-10",
            "a tenth of the frequency error",
            (MODES, 0.1 * ERROR_SD_HZ),
            Vec::new(),
        ),
        one("modulus", "Young's modulus tested, 3 %", usual, tested),
        one(
            "spring",
            "one spring known, 10 %",
            usual,
            vec![(Query::Quantity(SpringLeft), 0.1)],
        ),
    ];
    let statics = vec![
        (Query::Quantity(Side), 0.005),
        (Query::Quantity(Density), 0.01),
        (Query::Quantity(YoungsModulus), 0.03),
    ];
    all.push(one("statics", "caliper, density, modulus", usual, statics));
    all.extend(next::usual(prior, MODES));
    all
}

/// Expected uncertainty of the force after each campaign, over rods drawn from the prior; every campaign has
/// the same rods and the same errors of frequencies.
///
/// # Errors
/// A prior whose rods cannot be measured.
pub fn worth(
    prior: &RodPrior,
    effort: &Effort,
    seed: u64,
    done: &(dyn Fn(&str) + Sync),
) -> Result<Vec<Worth>, StudyError> {
    let campaigns = campaigns(prior);
    let campaign = Campaign {
        prior,
        discrepancy: &[0.0; MAX_MODES],
        done: &[],
        modes: MODES,
        sd_hz: ERROR_SD_HZ,
        rods: effort.rods,
    };
    let forces = next::forces(&campaign, &campaigns, seed, &|| done("what to measure next"))
        .map_err(|_| StudyError::NoRod)?;
    let cv = |known: Known| known.map(|(mean, sd)| sd / mean);
    let over = |of: &dyn Fn(&[Known]) -> Option<f64>| Estimate::of(forces.iter().filter_map(|rod| of(rod)));
    let row = |(i, measured): (usize, String)| Worth {
        measured,
        cv: over(&|rod| cv(rod[i])),
        of_first: over(&|rod| Some(cv(rod[i])? / cv(rod[0])?)),
    };
    let names = std::iter::once("three modes, 10 mHz each".to_owned())
        .chain(campaigns.iter().map(|campaign| campaign.said.clone()));
    Ok(names.enumerate().map(row).collect())
}
