//! Figure 6: distances between two columns of Table 2, and between two runs of the *same* column.

use super::density::Grid;
use super::estimate::{Comparison, Estimate};
use super::paper::{self, INFERRED, Printed};
use super::setting::Setting;
use super::table2::{Column, Run, Sampler, Which};
use crate::rod::prior::RodPrior;
use serde::Serialize;

/// A comparison of two columns.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Case {
    /// Letter of the case in the paper.
    pub name: &'static str,
    /// The two columns compared, in words.
    pub about: String,
    /// Per inferred quantity.
    pub quantities: Vec<Apart>,
}

/// One quantity in two columns.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Apart {
    /// Kullback-Leibler divergence of the first from the second.
    pub divergence: Estimate,
    /// The same between two runs of the second column, by chance alone.
    pub chance: Estimate,
    /// Posterior mean of the first over that of the second.
    pub mean_ratio: Estimate,
    /// Coefficient of variation of the first over that of the second.
    pub cv_ratio: Estimate,
    /// The paper's ratio of means, from Table 2.
    pub paper_mean_ratio: Option<Printed>,
    /// The paper's ratio of coefficients of variation, from Table 2.
    pub paper_cv_ratio: Option<Printed>,
}

impl Case {
    /// Largest divergence over the quantities.
    pub fn largest_divergence(&self) -> f64 {
        let values = self.quantities.iter().map(|apart| apart.divergence.value);
        values.fold(0.0, f64::max)
    }

    /// Figures of the case, the ratios beside the paper's.
    pub fn comparisons(&self, setting: Setting) -> Vec<Comparison> {
        let part = format!("Figure 6, {}", setting.key());
        let mut all = Vec::new();
        for (apart, quantity) in self.quantities.iter().zip(&INFERRED) {
            let one = |statistic, paper, ours| {
                Comparison::new(&part, self.name, quantity.key(), statistic, paper, ours)
            };
            all.push(one("Kullback-Leibler divergence", None, apart.divergence));
            all.push(one("divergence of two runs", None, apart.chance));
            all.push(one("ratio of means", apart.paper_mean_ratio, apart.mean_ratio));
            all.push(one("ratio of CVs", apart.paper_cv_ratio, apart.cv_ratio));
        }
        all
    }
}

/// Cases A to D by the text of section 5.1.
const CASES: [(&str, [(Sampler, &str); 2]); 4] = [
    ("A", [(Sampler::Mcmc, "finite-elements"), (Sampler::Mcmc, "pce")]),
    ("B", [(Sampler::Abc, "finite-elements"), (Sampler::Abc, "pce")]),
    (
        "C",
        [
            (Sampler::Mcmc, "finite-elements"),
            (Sampler::Abc, "finite-elements"),
        ],
    ),
    ("D", [(Sampler::Mcmc, "pce"), (Sampler::Abc, "pce")]),
];

/// The four cases; fewer if a column is missing.
pub fn cases(prior: &RodPrior, columns: &[Column]) -> Vec<Case> {
    let find = |(sampler, model): (Sampler, &'static str)| {
        let which = Which { sampler, model };
        columns.iter().find(|column| column.which == which)
    };
    CASES
        .iter()
        .filter_map(|&(name, [first, second])| Some(case(prior, name, find(first)?, find(second)?)))
        .collect()
}

fn case(prior: &RodPrior, name: &'static str, first: &Column, second: &Column) -> Case {
    // Pairs of runs that share nothing.
    let pairs: Vec<(&Run, &Run)> = first.runs.iter().zip(&second.runs).collect();
    let printed = first.which.printed().zip(second.which.printed());
    let quantities = (0..INFERRED.len()).map(|i| {
        let grid = Grid::of(&prior.priors()[i]);
        let over = |of: &dyn Fn(&Run, &Run) -> f64| Estimate::of(pairs.iter().map(|(a, b)| of(a, b)));
        let chance = second.runs.chunks_exact(2).filter_map(|pair| match pair {
            [a, b] => Some(grid.divergence(&a.density[i], &b.density[i])),
            _ => None,
        });
        Apart {
            divergence: over(&|a, b| grid.divergence(&a.density[i], &b.density[i])),
            chance: Estimate::of(chance),
            mean_ratio: over(&|a, b| a.mean[i] / b.mean[i]),
            cv_ratio: over(&|a, b| a.cv[i] / b.cv[i]),
            paper_mean_ratio: printed.map(|(a, b)| ratio(a.mean[i], b.mean[i])),
            paper_cv_ratio: printed.map(|(a, b)| ratio(a.cv[i], b.cv[i])),
        }
    });
    Case {
        name,
        about: format!("{} against {}", first.which.name(), second.which.name()),
        quantities: quantities.collect(),
    }
}

/// Ratio of printed numbers; its "digit" covers the rounding of both.
fn ratio(a: Printed, b: Printed) -> Printed {
    let value = a.value / b.value;
    let digit = value * (a.digit / a.value).hypot(b.digit / b.value);
    Printed { value, digit }
}

/// Largest divergence that the paper allows in a case, if it gives one.
pub fn bound(name: &str) -> Option<f64> {
    let at = CASES.iter().position(|(case, _)| *case == name)?;
    Some(paper::DIVERGENCE_BOUNDS[at])
}
