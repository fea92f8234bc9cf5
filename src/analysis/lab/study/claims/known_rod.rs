//! Table 3, figures 7 and 8: gain by more frequencies for a rod whose truth is known.

use super::{Claim, EARLIER, PAPER, agreement, claim, printed_as};
use crate::lab::study::estimate::{CLOSE, Comparison, Estimate};
use crate::lab::study::paper::{self, INFERRED};
use crate::lab::study::verdict::larger;
use crate::lab::study::{Part, Study, table3};
use crate::rod::beam::Exact;
use crate::rod::beam::forward::ForwardModel;

pub(super) fn table_3(study: &Study) -> Vec<Claim> {
    let mut evidence = Vec::new();
    let mut holds = false;
    for part in &study.parts {
        let late = part.rows.iter().filter(|row| row.frequencies >= 3);
        let comparisons: Vec<Comparison> = late
            .flat_map(|row| table3::comparisons(row, part.setting))
            .collect();
        let (agree, all, worst) = agreement(&comparisons);
        holds |= agree == all && all > 0;
        evidence.push(format!("{}: {agree} of {all}, {worst}", part.setting.key()));
    }
    vec![claim(
        EARLIER,
        "Table 3 (density prior 7000) comes out for three, four and five frequencies, with one share accepted at least",
        holds,
        evidence.join("; "),
    )]
}

/// Verdict: the row of one frequency belongs to the rod of the other rows. One frequency is all the data
/// there is, so the posterior's means must give it back.
pub(super) fn one_frequency() -> Option<Claim> {
    let prior = paper::prior(paper::TABLE_3_DENSITY);
    let exact = Exact::new(*prior.parameterisation());
    let first = |inferred: &[f64; 4]| {
        let mut theta = prior.centre();
        theta[..4].copy_from_slice(inferred);
        let mut y = [0.0];
        exact.frequencies(&theta, &mut y).ok().map(|()| y[0])
    };
    let (printed, truth) = (first(&paper::TABLE_3[0])?, first(&paper::TRUTH)?);
    Some(claim(
        PAPER,
        "Table 3's row of one frequency is of the same rod as the others",
        (printed / truth - 1.0).abs() < CLOSE,
        format!(
            "its means give a first frequency of {printed:.3} Hz, the true parameters {truth:.3} Hz; the real record has {:.3} Hz. Likeliest reason: that row was run on other data, perhaps the real record",
            paper::OBSERVED_HZ[0]
        ),
    ))
}

/// Verdict, by Table 3's own figures: its means come nearer to the truth with every frequency.
pub(super) fn towards_the_truth() -> Claim {
    let off = |row: &[f64; 4]| {
        let off = row
            .iter()
            .zip(&paper::TRUTH)
            .map(|(mean, truth)| (mean / truth - 1.0).abs());
        off.sum::<f64>() / INFERRED.len() as f64
    };
    let all = paper::TABLE_3.map(|row| off(&row));
    let shown: Vec<String> = all.iter().map(|off| format!("{:.1} %", 100.0 * off)).collect();
    claim(
        PAPER,
        "section 5.2: the posterior means move towards the truth as frequencies are added",
        all.is_sorted_by(|a, b| a > b),
        format!(
            "by the paper's own Table 3 the means are off by {} on average with one to five frequencies; E leaves its truth from three on",
            shown.join(", ")
        ),
    )
}

pub(super) fn enough(part: &Part) -> Vec<Claim> {
    let bmape: Vec<Estimate> = part.rows.iter().map(|row| row.bmape).collect();
    let [one, _, three, four, five] = &bmape[..] else {
        return Vec::new();
    };
    let percent = |e: &Estimate| format!("{:.2} \u{b1} {:.2} %", 100.0 * e.value, 100.0 * e.error);
    let all: Vec<String> = bmape.iter().map(percent).collect();
    let good = |row: &table3::Row| {
        let mut means = row.quantities.iter().zip(paper::TRUTH);
        means.all(|(cell, truth)| printed_as(truth, 0.0).is_about(cell.mean.value))
    };
    vec![
        claim(
            PAPER,
            "figure 8: the error (BMAPE) decreases slightly from three to four or five frequencies",
            larger(three, four).and(larger(three, five)),
            format!("with one to five frequencies: {}", all.join(", ")),
        ),
        claim(
            PAPER,
            "one frequency is not enough: three leave a smaller error (BMAPE)",
            larger(one, three),
            format!(
                "one frequency {}, three {}; the prior's share in all of it is large",
                percent(one),
                percent(three)
            ),
        ),
        claim(
            PAPER,
            "three frequencies are enough for good point estimates (every posterior mean within 5 % of the truth)",
            part.rows.iter().any(|row| row.frequencies == 3 && good(row)),
            format!(
                "so are {} of five numbers of frequencies",
                part.rows.iter().filter(|row| good(row)).count(),
            ),
        ),
        claim(
            PAPER,
            "three frequencies are enough, the posterior's width taken into account (BMAPE within 5 % of that of five)",
            (three.value / five.value - 1.0).abs() <= CLOSE,
            format!("BMAPE with three {}, with five {}", percent(three), percent(five)),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lab::study::claims::Verdict;

    #[test]
    fn the_papers_own_table_3_does_not_come_nearer_with_every_frequency() {
        let claim = towards_the_truth();
        assert_eq!(claim.verdict, Verdict::Fails);
        assert!(
            claim.evidence.contains("2.9 %, 2.4 %, 2.6 %, 3.1 %"),
            "{}",
            claim.evidence
        );
    }
}
