//! What the paper says, and what independent checks of it had found before: which of it holds, judged from the
//! study's own figures.

use super::cases::{self, Case};
use super::estimate::{Comparison, DISAGREE, Estimate};
use super::paper::{self, INFERRED};
use super::setting::Setting;
use super::table2::{Column, Sampler, Which};
use super::{Part, Study, table3};
use crate::beam::Exact;
use crate::forward::ForwardModel;
use serde::Serialize;

/// Whether a statement holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It does.
    Holds,
    /// It does not.
    Fails,
}

/// A statement and what came of it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Claim {
    /// Who says so.
    pub source: &'static str,
    /// What is said.
    pub statement: String,
    /// Whether it holds.
    pub verdict: Verdict,
    /// The figures behind the verdict.
    pub evidence: String,
}

const EARLIER: &str = "earlier checks";
const PAPER: &str = "the paper";

fn claim(source: &'static str, statement: &str, holds: bool, evidence: String) -> Claim {
    Claim {
        source,
        statement: statement.to_owned(),
        verdict: if holds { Verdict::Holds } else { Verdict::Fails },
        evidence,
    }
}

/// Judges every statement; one whose figures are missing is left out.
pub fn judge(study: &Study) -> Vec<Claim> {
    let of = |setting: Setting| study.parts.iter().find(|part| part.setting == setting);
    let mut claims = Vec::new();
    if let (Some(printed), Some(inferred)) = (of(Setting::AsPrinted), of(Setting::AsInferred)) {
        claims.extend(table_2(printed, inferred));
        claims.extend(figure_6(inferred));
        claims.extend(table_3(study));
        claims.extend(enough(inferred));
    }
    claims.extend(one_frequency());
    claims.extend(chaos(study));
    claims.extend(beam(study));
    claims.extend(springs(study));
    claims
}

fn column(part: &Part, sampler: Sampler) -> Option<&Column> {
    let which = Which {
        sampler,
        model: "finite-elements",
    };
    part.columns.iter().find(|column| column.which == which)
}

/// How many printed figures agree, of how many, and the one furthest off.
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

fn table_2(printed: &Part, inferred: &Part) -> Vec<Claim> {
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
            (n.value / 559e3 - 1.0).abs() < 0.01
                && (cv.value - 0.19).abs() < 0.01
                && (e.value / 1.15e11 - 1.0).abs() < 0.03,
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
        claims.push(claim(
            EARLIER,
            "MCMC with an error variance of 1e-3 cannot give Table 2",
            e.value < 0.1 * paper::MCMC.mean[1].value,
            format!(
                "its posterior has E = {:.1e} Pa, no iron, and N = {:.0} kN: the rod becomes a string because the data ask for less than one",
                e.value,
                1e-3 * n.value
            ),
        ));
    }
    claims.extend(unit_variance(inferred));
    claims
}

/// How near MCMC comes with a unit error variance.
fn unit_variance(part: &Part) -> Option<Claim> {
    let chains = part
        .columns
        .iter()
        .filter(|column| column.which.sampler == Sampler::Mcmc);
    let (mut mean, mut cv, mut comparisons) = (0.0f64, 0.0f64, Vec::new());
    for column in chains {
        let Some(printed) = column.which.printed() else {
            continue;
        };
        for i in 0..INFERRED.len() {
            let off = |ours: Estimate, paper: f64| (ours.value / paper - 1.0).abs();
            mean = mean.max(off(column.estimate(|run| run.mean[i]), printed.mean[i].value));
            cv = cv.max(off(column.estimate(|run| run.cv[i]), printed.cv[i].value));
        }
        comparisons.extend(column.comparisons(part.setting));
    }
    let (agree, all, worst) = agreement(&comparisons);
    let evidence = format!(
        "both MCMC columns: means within {:.1} %, CVs within {:.0} %; {agree} of {all} figures within {DISAGREE} standard errors of a chain that mixes; {worst}",
        100.0 * mean,
        100.0 * cv
    );
    let statement = "with a unit error variance MCMC comes close (means within 10 %, CVs within 25 %)";
    (all > 0).then(|| claim(EARLIER, statement, mean < 0.1 && cv < 0.25, evidence))
}

fn figure_6(part: &Part) -> Vec<Claim> {
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
            force.value > 0.2,
            format!(
                "N: {:.3} \u{b1} {:.3}; largest {:.3}. A chain that mixes and an ABC with the same data do not differ that much",
                force.value,
                force.error,
                c.largest_divergence()
            ),
        ),
        claim(
            PAPER,
            "section 5.1: ABC is less sensitive to the emulator than MCMC (case B against A)",
            a.largest_divergence() > b.largest_divergence()
                && a.largest_divergence() > 3.0 * chance(a).max(1e-12),
            format!(
                "divergence by the emulator: MCMC {:.4}, of two runs on the same model {:.4}; ABC {:.4}, of two runs {:.4}",
                a.largest_divergence(),
                chance(a),
                b.largest_divergence(),
                chance(b)
            ),
        ),
    ]
}

fn table_3(study: &Study) -> Vec<Claim> {
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
        "Table 3 (density prior 7000) comes out for three, four and five frequencies",
        holds,
        evidence.join("; "),
    )]
}

/// Whether the row of one frequency can belong to the rod of the others: one frequency is all it knows, and a
/// posterior's means must give it back.
fn one_frequency() -> Option<Claim> {
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
        (printed / truth - 1.0).abs() < 0.02,
        format!(
            "its means give a first frequency of {printed:.3} Hz, the true parameters {truth:.3} Hz; the real record has {:.3} Hz. Likeliest reason: that row was run on other data, perhaps the real record",
            paper::OBSERVED_HZ[0]
        ),
    ))
}

fn enough(part: &Part) -> Vec<Claim> {
    let bmape: Vec<Estimate> = part.rows.iter().map(|row| row.bmape).collect();
    let [one, _, three, four, five] = bmape[..] else {
        return Vec::new();
    };
    let percent = |e: &Estimate| format!("{:.2} \u{b1} {:.2} %", 100.0 * e.value, 100.0 * e.error);
    let all: Vec<String> = bmape.iter().map(percent).collect();
    vec![
        claim(
            PAPER,
            "figure 8: the error (BMAPE) decreases slightly from three to four or five frequencies",
            four.value < three.value && five.value < three.value,
            format!("with one to five frequencies: {}", all.join(", ")),
        ),
        claim(
            PAPER,
            "one frequency is not enough, three are",
            one.value > three.value + 2.0 * one.error_of_mean().hypot(three.error_of_mean()),
            format!(
                "one frequency {}, three {}; the prior's share in all of it is large",
                percent(&one),
                percent(&three)
            ),
        ),
    ]
}

fn chaos(study: &Study) -> Vec<Claim> {
    let Some((report, grid)) = study
        .emulators
        .iter()
        .find_map(|report| Some((report, report.grid.as_ref()?)))
    else {
        return Vec::new();
    };
    let variances: Vec<f64> = grid.iter().take(3).map(|g| g.variance_hz2).collect();
    let tails: Vec<f64> = report.modes.iter().take(3).map(|m| m.value_hz.max).collect();
    let near = |value: f64, wanted: f64| (value / wanted).ln().abs() < 0.35;
    let shown = |values: &[f64]| {
        let all: Vec<String> = values.iter().map(|v| format!("{v:.1e}")).collect();
        all.join(", ")
    };
    let largest = variances.iter().copied().fold(0.0, f64::max);
    vec![
        claim(
            EARLIER,
            "the order-5 chaos has grid error variances of about 6e-6, 3e-5, 1e-4 Hz\u{b2} and tail errors near 0.1 Hz",
            variances
                .iter()
                .zip([6e-6, 3e-5, 1e-4])
                .all(|(&v, wanted)| near(v, wanted))
                && tails.iter().any(|t| near(*t, 0.1)),
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
                    .all(|(t, printed)| *t < 1.5 * printed),
            format!(
                "grid variances {} Hz\u{b2}, largest errors {} Hz; the likeliest reason is where the paper looked for tails: its points are not said",
                shown(&variances),
                shown(&tails)
            ),
        ),
    ]
}

fn beam(study: &Study) -> Vec<Claim> {
    let ratios = study.springs.frequency_hz.iter().map(|f| f[2] / f[0]);
    let smallest = ratios.fold(f64::INFINITY, f64::min);
    let posterior = study.parts.iter().flat_map(|part| &part.checks);
    let smallest = posterior
        .map(|check| check.smallest_ratio)
        .fold(smallest, f64::min);
    let conflict = study.assumptions.first().map_or(f64::NAN, |a| a.conflict);
    vec![claim(
        EARLIER,
        "no tensioned beam on rotational springs has f3/f1 below 3; the observed 2.950 cannot come from the model",
        smallest >= 3.0 - 1e-9 && conflict > 4.0,
        format!(
            "smallest f3/f1 over every posterior {smallest:.4}; the record lies {conflict:.1} standard deviations (31.6 mHz) from the nearest such beam"
        ),
    )]
}

fn springs(study: &Study) -> Vec<Claim> {
    let total = |spring: bool| {
        let all = study.sensitivity.iter();
        let one = all.filter(|s| (s.quantity.key().starts_with("spring")) == spring);
        one.map(|s| s.total).fold(0.0, f64::max)
    };
    let (hinged, clamped) = (study.springs.hinged_hz, study.springs.clamped_hz);
    vec![claim(
        PAPER,
        "section 4.2: the frequencies are little sensitive to the springs, which cannot be learned",
        total(true) < 0.05,
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

/// Why Table 3 may disagree with one frequency, and with more, in a sentence.
pub fn likeliest_reason_of_table_3(frequencies: usize) -> &'static str {
    if frequencies == 1 {
        "Likeliest reason: that row was run on other data, perhaps the real record: its means give a first frequency near that record's, 13 % below the true rod's."
    } else {
        "Likeliest reason: the share accepted, which the paper does not say for this table."
    }
}

/// Why a column of Table 2 may disagree, in a sentence.
pub fn likeliest_reason(setting: Setting, sampler: Sampler) -> &'static str {
    match (setting, sampler) {
        (Setting::AsPrinted, Sampler::Mcmc) => {
            "Likeliest reason: the likelihood that was run had a larger error than the one printed. With a variance of 1e-3 Hz\u{b2} the record, which no beam of the model can produce, drives E to zero."
        }
        (Setting::AsPrinted, _) => {
            "Likeliest reason: more draws were accepted than alpha = 0.01 allows, and the density prior was Table 3's; with 5 % and 7000 kg/m\u{b3} the column comes out. E falls as the tolerance shrinks, since the data ask for a string."
        }
        (Setting::AsInferred, Sampler::Mcmc) => {
            "Likeliest reason: chains too short of independent draws. The paper's two MCMC columns differ by 5 % in N and 3 % in density where elements and chaos give one posterior, and no error variance between 0.01 and 2.25 Hz\u{b2} gives either column (docs/study.md)."
        }
        (Setting::AsInferred, _) => "Likeliest reason: not known.",
    }
}
