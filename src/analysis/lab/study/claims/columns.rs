//! Table 2: its columns that we reproduce, and the settings that reproduce those of MCMC.

use super::{Claim, EARLIER, OURS, agreement, claim, column, printed_as};
use crate::lab::study::estimate::{Comparison, DISAGREE};
use crate::lab::study::paper::{self, INFERRED, Table2Column};
use crate::lab::study::table2::{Column, Sampler};
use crate::lab::study::{Part, Study};

pub(super) fn table_2(printed: &Part, inferred: &Part) -> Vec<Claim> {
    let mut claims = Vec::new();
    let force = |column: &Column| column.estimate(|run| run.mean[0]);
    let modulus = |column: &Column| column.estimate(|run| run.mean[1]);
    if let Some(abc) = column(inferred, Sampler::Abc) {
        let (agree, all, worst) = agreement(&abc.comparisons(inferred.setting));
        claims.push(claim(
            EARLIER,
            "Table 2's ABC column comes out with a density prior of mean 7000 and 500 of 10 000 accepted",
            agree == all,
            format!("{agree} of {all} figures within {DISAGREE} standard errors; {worst}"),
        ));
    }
    if let Some(abc) = column(printed, Sampler::Abc) {
        let (agree, all, worst) = agreement(&abc.comparisons(printed.setting));
        claims.push(claim(
            EARLIER,
            "it does not come out as printed (7500, alpha 0.01)",
            agree < all,
            format!("{agree} of {all} figures within {DISAGREE} standard errors; {worst}"),
        ));
    }
    if let Some(many) = column(printed, Sampler::AbcOfMany) {
        let (n, e) = (force(many), modulus(many));
        let cv = many.estimate(|run| run.cv[0]);
        claims.push(claim(
            EARLIER,
            "as printed, many draws give N = 559 kN with CV 0.19 and E = 1.15e11 Pa",
            printed_as(559e3, 1e3).is_about(n.value)
                && printed_as(0.19, 0.01).is_about(cv.value)
                && printed_as(1.15e11, 1e9).is_about(e.value),
            format!(
                "N = {:.1} kN, CV {:.3}, E = {:.3e} Pa; at this tolerance, not in the limit of none",
                1e-3 * n.value,
                cv.value,
                e.value
            ),
        ));
    }
    if let Some(mcmc) = column(printed, Sampler::Mcmc) {
        let (n, e) = (force(mcmc), modulus(mcmc));
        let (agree, all, _) = agreement(&mcmc.comparisons(printed.setting));
        claims.push(claim(
            EARLIER,
            "MCMC with an error variance of 1e-3 cannot give Table 2",
            agree < all,
            format!(
                "{agree} of {all} figures within {DISAGREE} standard errors; its posterior has E = {:.1e} Pa, no iron, and N = {:.0} kN: the rod becomes a string because the data ask for less than one",
                e.value,
                1e-3 * n.value
            ),
        ));
    }
    claims.extend(unit_variance(inferred));
    claims
}

/// Distance of our MCMC from the printed column with a unit error variance.
fn unit_variance(part: &Part) -> Option<Claim> {
    let chains = part
        .columns
        .iter()
        .filter(|column| column.which.sampler == Sampler::Mcmc && column.which.printed().is_some());
    let comparisons: Vec<Comparison> = chains
        .flat_map(|column| column.comparisons(part.setting))
        .filter(|c| c.paper.is_some())
        .collect();
    let about = |c: &&Comparison| c.paper.is_some_and(|printed| printed.is_about(c.ours.value));
    let close = comparisons.iter().filter(about).count();
    let largest = |statistic: &str| {
        let own = comparisons.iter().filter(|c| c.statistic == statistic);
        let off = own.filter_map(|c| Some((c.ours.value / c.paper?.value - 1.0).abs()));
        100.0 * off.fold(0.0, f64::max)
    };
    let (agree, all, worst) = agreement(&comparisons);
    let evidence = format!(
        "both MCMC columns: {close} of {all} figures are close; means differ by up to {:.0} %, CVs by up to {:.0} %. {agree} of {all} figures within {DISAGREE} standard errors; {worst}",
        largest("mean"),
        largest("cv")
    );
    let statement = "with a unit error variance MCMC comes close to Table 2 (every figure within 5 %)";
    (all > 0).then(|| claim(EARLIER, statement, close == all, evidence))
}

/// Verdict: no error variance reproduces a column of MCMC.
pub(super) fn no_variance(study: &Study) -> Option<Claim> {
    let columns: [(&str, &Table2Column); 2] = [("elements", &paper::MCMC), ("chaos", &paper::MCMC_PCE)];
    let figures = 2 * INFERRED.len();
    let mut nearest: Option<(f64, String)> = None;
    let mut most = 0;
    for assumed in study.assumptions.iter().filter(|a| a.discrepancy == 0.0) {
        for (name, column) in columns {
            let (off, agree) = assumed.against(column);
            most = most.max(agree);
            if nearest.as_ref().is_none_or(|(least, _)| off < *least) {
                nearest = Some((
                    off,
                    format!(
                        "nearest: an sd of {} Hz and a density prior of {:.0} for the column on {name}, largest difference {:.0} %",
                        assumed.error_sd_hz,
                        assumed.density_kg_m3,
                        100.0 * off
                    ),
                ));
            }
        }
    }
    let (_, nearest) = nearest?;
    Some(claim(
        OURS,
        "no error variance from 1e-4 to 2.25 Hz\u{b2} gives either MCMC column, with either density prior",
        most < figures,
        format!("at most {most} of {figures} figures within {DISAGREE} standard errors; {nearest}"),
    ))
}
