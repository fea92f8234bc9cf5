//! Figure 6 and the statements of section 5.1 about it: distances between the columns of Table 2.

use super::{Claim, PAPER, claim};
use crate::lab::study::Part;
use crate::lab::study::cases::{self, Case};
use crate::lab::study::estimate::DISAGREE;
use crate::lab::study::verdict::positive;

pub(super) fn figure_6(part: &Part) -> Vec<Claim> {
    let find = |name: &str| part.cases.iter().find(|case| case.name == name);
    let (Some(a), Some(b), Some(c), Some(d)) = (find("A"), find("B"), find("C"), find("D")) else {
        return Vec::new();
    };
    let chance = |case: &Case| {
        let values = case.quantities.iter().map(|apart| apart.chance.value);
        values.fold(0.0, f64::max)
    };
    // The paper's is one run.
    let within = |case: &Case| {
        let bound = cases::bound(case.name).unwrap_or(f64::INFINITY);
        let mut all = case.quantities.iter().map(|apart| apart.divergence);
        all.all(|divergence| divergence.value - DISAGREE * divergence.error < bound)
    };
    let list = [a, b, d].map(|case| {
        format!(
            "{}: at most {:.4} (paper below {}, two runs of one column {:.4})",
            case.name,
            case.largest_divergence(),
            cases::bound(case.name).unwrap_or(f64::NAN),
            chance(case)
        )
    });
    // Divergence that the other model adds to that of two runs on one model, at its largest.
    let added = |case: &Case| {
        let of = case.quantities.iter().map(|apart| {
            let (divergence, chance) = (apart.divergence, apart.chance);
            let error = divergence.error_of_mean().hypot(chance.error_of_mean());
            (divergence.value - chance.value, error)
        });
        of.max_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::NAN, f64::NAN))
    };
    let (of_a, of_b) = (added(a), added(b));
    let shown = |(value, error): (f64, f64)| {
        if error.is_finite() {
            format!("{value:.4} \u{b1} {error:.4}")
        } else {
            format!("{value:.4}")
        }
    };
    let beyond = |apart: &cases::Apart| apart.divergence.value + DISAGREE * apart.divergence.error > 0.2;
    let force = &c.quantities[0].divergence;
    vec![
        claim(
            PAPER,
            "figure 6: divergences of cases A, B and D stay below 0.15, 0.016 and 0.12",
            within(a) && within(b) && within(d),
            list.join("; "),
        ),
        claim(
            PAPER,
            "figure 6: in case C the divergence of N alone exceeds 0.2",
            beyond(&c.quantities[0]) && !c.quantities[1..].iter().all(beyond),
            format!(
                "N: {:.3} \u{b1} {:.3}; largest {:.3}",
                force.value,
                force.error,
                c.largest_divergence()
            ),
        ),
        claim(
            PAPER,
            "section 5.1: ABC is less sensitive to the emulator than MCMC (case B against A)",
            positive(of_a.0 - of_b.0, of_a.1.hypot(of_b.1)),
            format!(
                "what the chaos adds to the divergence of two runs on one model: MCMC {}, ABC {}",
                shown(of_a),
                shown(of_b)
            ),
        ),
        ratios_of_b(a, b),
    ]
}

/// Verdict, by the paper's own Table 2: the ratios of CVs spread more in case B than in case A, as the text
/// says.
fn ratios_of_b(a: &Case, b: &Case) -> Claim {
    let range = |case: &Case| {
        let ratios = case.quantities.iter().filter_map(|apart| apart.paper_cv_ratio);
        ratios.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), ratio| {
            (low.min(ratio.value), high.max(ratio.value))
        })
    };
    let (of_a, of_b) = (range(a), range(b));
    claim(
        PAPER,
        "section 5.1: the ratios of CVs have a wider range in case B than in case A",
        of_b.1 - of_b.0 > of_a.1 - of_a.0,
        format!(
            "by the paper's own Table 2: A {:.2} to {:.2}, B {:.2} to {:.2}",
            of_a.0, of_a.1, of_b.0, of_b.1
        ),
    )
}
