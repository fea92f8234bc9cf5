//! Result of one record for people: modes, prior and posterior, remarks on their reliability.

use crate::analysis::findings::{CERTAIN, Candidate};
use crate::analysis::identify::{Identification, Plan};
use crate::analysis::inference::Posterior;
use crate::analysis::numerics::diagnostics;
use crate::analysis::rod::beam::Quantity;
use crate::analysis::rod::fixity::Fixity;
use crate::analysis::rod::prior::Prior;
use crate::command::{findings, tests_of_rod};

/// Prior and posterior of every uncertain parameter, with remarks on their reliability.
pub(super) fn describe(plan: &Plan, identification: &Identification) -> String {
    let mut text = String::new();
    let mut line = |content: String| {
        text.push_str(content.trim_end());
        text.push('\n');
    };
    line(identification.rod.to_string());
    if let Some(measurement) = &identification.measurement {
        findings::opening(measurement).into_iter().for_each(&mut line);
    }
    if let Some(labels) = &identification.labels {
        line(format!(
            "  orders of the modes right with a probability of {}",
            findings::probability(labels.probability)
        ));
    }
    line(String::new());
    line("  mode   frequency [Hz]   standard error [Hz]   damping [%]".to_owned());
    for mode in &identification.modes {
        let damping = mode
            .damping
            .map_or_else(|| "-".to_owned(), |zeta| format!("{:.3}", zeta * 100.0));
        let decimals = findings::decimals(Some(mode.sd_hz)).max(4);
        line(format!(
            "  {:>4}   {:>14.decimals$}   {:>19.decimals$}   {damping:>11}",
            mode.order, mode.frequency_hz, mode.sd_hz
        ));
    }
    let uncertain = identification
        .labels
        .as_ref()
        .filter(|labels| labels.probability < CERTAIN && !labels.candidates.is_empty());
    if let Some(labels) = uncertain {
        line(String::new());
        findings::candidates(&Candidate::all(labels))
            .lines()
            .for_each(|candidate| line(candidate.to_owned()));
    }
    line(String::new());
    line(format!(
        "  {:<22} {:>10} {:>5}  {:>10} {:>5}  {:>9} {:>9}",
        "quantity", "prior mean", "CV", "posterior", "CV", "2.5 %", "97.5 %"
    ));
    let prior = &plan.settings().prior;
    for (quantity, before) in prior.parameterisation().quantities().iter().zip(prior.priors()) {
        let (mean, sd) = before.mean_and_sd();
        if before.is_fixed() {
            line(format!("  {:<22} {mean:>10.5}  fixed", quantity.key()));
        } else if let Prior::Fixity(fixity) = before {
            line(fixity_row(*quantity, fixity, &identification.posterior));
        } else if let Some(after) = identification.posterior.marginal(*quantity) {
            line(format!(
                "  {:<22} {:>10.4e} {:>5.3}  {:>10.4e} {:>5.3}  {:>9.4e} {:>9.4e}",
                quantity.key(),
                mean,
                sd / mean,
                after.mean,
                after.cv,
                after.q025,
                after.q975
            ));
        }
    }
    line(String::new());
    let posterior = &identification.posterior;
    line(format!(
        "  {} of {} draws accepted, epsilon {:.4}, effective sample size {:.0}",
        posterior.accepted, posterior.draws, posterior.epsilon, posterior.ess
    ));
    if let Some(reason) = posterior.withheld {
        line(format!("  ! regression adjustment withheld: {reason}"));
    }
    if let Some(tested) = &identification.tested {
        let force = posterior
            .mean(Quantity::AxialForce)
            .zip(posterior.sd(Quantity::AxialForce));
        let (mean, sd) = force.unwrap_or((f64::NAN, f64::NAN));
        line(String::new());
        tests_of_rod::described(tested, mean, sd)
            .into_iter()
            .for_each(&mut line);
        line(String::new());
    }
    let conflict = &identification.conflict;
    line(format!(
        "  conflict {:.1}: standard deviations from the nearest frequencies the model can produce",
        conflict.score
    ));
    let force = posterior.marginal(Quantity::AxialForce);
    findings::doubts(conflict, force.as_ref())
        .into_iter()
        .for_each(&mut line);
    if let Some(shares) = &identification.hangs_on {
        line(String::new());
        findings::hangs_on(shares)
            .lines()
            .for_each(|row| line(row.to_owned()));
    }
    text
}

/// Row of a support given by its fixity: its stiffness has no meaningful mean.
fn fixity_row(support: Quantity, fixity: &Fixity, posterior: &Posterior) -> String {
    let (mean, sd) = fixity.fixity_mean_and_sd();
    let name = match support {
        Quantity::SpringLeft => "fixity_left",
        _ => "fixity_right",
    };
    let values: Vec<f64> = posterior
        .values(support)
        .unwrap_or_default()
        .into_iter()
        .map(|stiffness| fixity.of(stiffness))
        .collect();
    let weights = &posterior.weights;
    let after = diagnostics::mean(&values, weights);
    let quantiles = diagnostics::quantiles(&values, weights, &[0.025, 0.975]);
    format!(
        "  {name:<22} {mean:>10.4} {:>5.3}  {after:>10.4} {:>5.3}  {:>9.4} {:>9.4}",
        sd / mean,
        diagnostics::sd(&values, weights) / after,
        quantiles[0],
        quantiles[1]
    )
}
