//! Shares of a variance that sets of sources explain, by least squares on a weighted sample.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// A source of the force's variance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// Young's modulus.
    Modulus,
    /// Mass density.
    Density,
    /// Dimensions of the section.
    Section,
    /// Flexural rigidity, where it is given directly.
    Rigidity,
    /// Mass per length, where it is given directly.
    Mass,
    /// Both supports.
    Springs,
    /// Free length.
    Length,
    /// Errors of the frequencies, mostly their standard errors.
    Measurement,
    /// Errors of the frequencies, mostly the model's discrepancy.
    Discrepancy,
}

/// The terms of the regression: weighted columns of mean zero and norm one, group by group.
pub(super) struct Terms {
    pub(super) weights: Vec<f64>,
    columns: Vec<DVector<f64>>,
    /// Each source with the range of its columns.
    pub(super) sources: Vec<(Source, std::ops::Range<usize>)>,
}

impl Terms {
    pub(super) fn new(weights: Vec<f64>) -> Self {
        Self {
            weights,
            columns: Vec::new(),
            sources: Vec::new(),
        }
    }

    /// Scales values to weighted mean zero and norm one, rows times the root of their weight; `None` without
    /// spread.
    pub(super) fn whiten(&self, mut values: Vec<f64>) -> Option<DVector<f64>> {
        let mean: f64 = values.iter().zip(&self.weights).map(|(x, w)| w * x).sum();
        let scale = values.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        for (value, weight) in values.iter_mut().zip(&self.weights) {
            *value = (*value - mean) * weight.sqrt();
        }
        let column = DVector::from_vec(values);
        let norm = column.norm();
        // Below this the spread is the rounding of f32.
        (norm.is_finite() && norm > 1e-6 * scale).then(|| column / norm)
    }

    /// Adds a source by its values, and by their squares and products too if `is_curved`.
    pub(super) fn add(&mut self, source: Source, values: Vec<Vec<f64>>, is_curved: bool) {
        let start = self.columns.len();
        let mut centred = Vec::new();
        for mut value in values {
            let mean: f64 = value.iter().zip(&self.weights).map(|(x, w)| w * x).sum();
            value.iter_mut().for_each(|x| *x -= mean);
            if let Some(column) = self.whiten(value.clone()) {
                self.columns.push(column);
                centred.push(value);
            }
        }
        if is_curved {
            for i in 0..centred.len() {
                for j in i..centred.len() {
                    let product = centred[i].iter().zip(&centred[j]).map(|(a, b)| a * b).collect();
                    self.columns.extend(self.whiten(product));
                }
            }
        }
        if self.columns.len() > start {
            self.sources.push((source, start..self.columns.len()));
        }
    }

    /// R^2 of every set of sources, the set's members the bits of the index; corrected for the number of terms.
    pub(super) fn explained(&self, response: &DVector<f64>, ess: f64) -> Vec<f64> {
        let count = self.columns.len();
        let mut gram = DMatrix::zeros(count, count);
        for i in 0..count {
            for j in 0..=i {
                // A shade of ridge keeps columns that repeat each other solvable.
                let product = self.columns[i].dot(&self.columns[j]) + if i == j { 1e-9 } else { 0.0 };
                (gram[(i, j)], gram[(j, i)]) = (product, product);
            }
        }
        let right = DVector::from_fn(count, |i, _| self.columns[i].dot(response));
        (0..1usize << self.sources.len())
            .map(|set| {
                let members: Vec<usize> = self
                    .sources
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| set >> i & 1 == 1)
                    .flat_map(|(_, (_, range))| range.clone())
                    .collect();
                let part = DMatrix::from_fn(members.len(), members.len(), |i, j| {
                    gram[(members[i], members[j])]
                });
                let side = DVector::from_fn(members.len(), |i, _| right[members[i]]);
                let plain = part
                    .cholesky()
                    .map_or(0.0, |factor| factor.solve(&side).dot(&side));
                let freedom = (ess - 1.0 - members.len() as f64).max(1.0);
                (1.0 - (1.0 - plain) * (ess - 1.0) / freedom).clamp(0.0, 1.0)
            })
            .collect()
    }
}

/// The mean gain of one source over all orders in which the sources may come.
pub(super) fn shapley(explained: &[f64], count: usize, source: usize) -> f64 {
    let factorial = |n: usize| (1..=n).map(|k| k as f64).product::<f64>();
    (0..explained.len())
        .filter(|set| set >> source & 1 == 0)
        .map(|set| {
            let before = set.count_ones() as usize;
            let orders = factorial(before) * factorial(count - before - 1) / factorial(count);
            orders * (explained[set | 1 << source] - explained[set])
        })
        .sum::<f64>()
        .max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two sources that explain 0.6 and 0.3 alone and 0.8 together: the order in which they come matters, the
    /// mean over it does not.
    #[test]
    fn shares_divide_what_two_sources_have_in_common() {
        let explained = [0.0, 0.6, 0.3, 0.8];
        let [first, second] = [0, 1].map(|i| shapley(&explained, 2, i));
        assert!((first - 0.55).abs() < 1e-15 && (second - 0.25).abs() < 1e-15);
    }

    /// y = 2 a + b^2 + c with independent standard normals: the sources explain 4/7, 2/7 and 1/7, alone and together.
    #[test]
    fn independent_sources_explain_their_own_part() {
        use rand_distr::{Distribution, StandardNormal};
        let mut generator = crate::numerics::random::stream(8, 0);
        let count = 20_000;
        let mut columns = [vec![0.0; count], vec![0.0; count], vec![0.0; count]];
        columns
            .iter_mut()
            .flatten()
            .for_each(|x| *x = StandardNormal.sample(&mut generator));
        let [a, b, c] = columns;
        let mut terms = Terms::new(vec![1.0 / count as f64; count]);
        let y = (0..count).map(|i| 2.0 * a[i] + b[i] * b[i] + c[i]).collect();
        let response = terms.whiten(y).unwrap();
        terms.add(Source::Density, vec![a], true);
        terms.add(Source::Springs, vec![b], true);
        terms.add(Source::Measurement, vec![c], false);
        let explained = terms.explained(&response, count as f64);
        assert!((explained[7] - 1.0).abs() < 1e-6, "{explained:?}");
        // Of 20 000 values a share scatters by at most 0.006.
        for (i, wanted) in [4.0 / 7.0, 2.0 / 7.0, 1.0 / 7.0].into_iter().enumerate() {
            assert!((explained[1 << i] - wanted).abs() < 0.025, "{explained:?}");
            assert!(
                (shapley(&explained, 3, i) - wanted).abs() < 0.025,
                "{explained:?}"
            );
        }
    }
}
