//! Statements of the paper, and earlier findings of independent checks, judged from the study's own figures
//! by the rules of [`super::verdict`].

mod beam_and_emulators;
mod columns;
mod figure_6;
mod known_rod;

use super::estimate::Comparison;
use super::paper::Printed;
use super::setting::Setting;
use super::table2::{Column, Sampler, Which};
use super::verdict::Verdict;
use super::{Part, Study};
use serde::Serialize;

/// A statement and its verdict.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Claim {
    /// Source of the statement.
    pub source: &'static str,
    /// The statement in words.
    pub statement: String,
    /// Verdict on the statement.
    pub verdict: Verdict,
    /// The figures behind the verdict.
    pub evidence: String,
}

const EARLIER: &str = "earlier checks";
const PAPER: &str = "the paper";
const OURS: &str = "this study";

fn claim(source: &'static str, statement: &str, verdict: impl Into<Verdict>, evidence: String) -> Claim {
    Claim {
        source,
        statement: statement.to_owned(),
        verdict: verdict.into(),
        evidence,
    }
}

/// Judges every statement; one whose figures are missing is left out.
pub fn judge(study: &Study) -> Vec<Claim> {
    let of = |setting: Setting| study.parts.iter().find(|part| part.setting == setting);
    let mut claims = Vec::new();
    if let (Some(printed), Some(inferred)) = (of(Setting::AsPrinted), of(Setting::AsInferred)) {
        claims.extend(columns::table_2(printed, inferred));
        claims.extend(columns::no_variance(study));
        claims.extend(figure_6::figure_6(inferred));
        claims.extend(known_rod::table_3(study));
        claims.extend(known_rod::enough(inferred));
    }
    claims.extend(known_rod::one_frequency());
    claims.push(known_rod::towards_the_truth());
    claims.extend(beam_and_emulators::chaos(study));
    claims.extend(beam_and_emulators::beam(study));
    claims.extend(beam_and_emulators::springs(study));
    claims
}

fn column(part: &Part, sampler: Sampler) -> Option<&Column> {
    let which = Which {
        sampler,
        model: "finite-elements",
    };
    part.columns.iter().find(|column| column.which == which)
}

/// Number of printed figures that agree, number of all, and the one furthest off.
fn agreement(comparisons: &[Comparison]) -> (usize, usize, String) {
    let printed: Vec<&Comparison> = comparisons.iter().filter(|c| c.deviation.is_some()).collect();
    let agree = printed.iter().filter(|c| c.disagrees() == Some(false)).count();
    let size = |c: &&&Comparison| c.deviation.map_or(0.0, f64::abs);
    let worst = printed.iter().max_by(|a, b| size(a).total_cmp(&size(b)));
    let worst = worst.map_or_else(String::new, |c| {
        format!(
            "{} of {} in {} is furthest off, {:+.1} standard errors",
            c.statistic,
            c.quantity,
            c.column,
            c.deviation.unwrap_or(f64::NAN)
        )
    });
    (agree, printed.len(), worst)
}

/// A figure of an earlier check, with the unit of its last digit.
fn printed_as(value: f64, digit: f64) -> Printed {
    Printed { value, digit }
}
