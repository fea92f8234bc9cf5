//! Density of all data of a rod given its parameters.
//!
//! Every datum has an independent normal error. Natural frequencies of one mode order share the model's discrepancy besides, with a
//! mass on the rod or without, today or at another time: `y_i = y_Mi (1 + c) + e_i`, `c ~ N(0, d^2)`. Their covariance
//! `diag(s_i^2) + d^2 y_M y_M'` is inverted in closed form.

use super::Datum;
use super::datum::queries;
use crate::rod::prior::{Prior, RodPrior};
use crate::rod::query::Queries;

/// Least standard error, as a share of the value: a density needs a width.
const LEAST_ERROR: f64 = 1e-9;

/// Prior and data of one rod, ready to be sampled.
///
/// A parameter vector is that of the rod at the first moment, followed by the axial forces of the other moments.
pub(super) struct Problem {
    pub(super) priors: Vec<Prior>,
    /// Number of entries of a rod's own parameter vector.
    pub(super) width: usize,
    moments: Vec<Queries>,
    pub(super) data: Vec<Datum>,
    /// Moment of each datum.
    pub(super) moment_of: Vec<usize>,
    /// Squared relative discrepancy per mode order from the first.
    discrepancy: Vec<f64>,
}

/// Data that take part; the others only get an answer.
pub(super) type Mask = [bool];

impl Problem {
    /// `None` if a query does not fit this section; [`Datum::check`] gives the reason.
    pub(super) fn new(prior: &RodPrior, discrepancy: &[f64], moments: &[Vec<Datum>]) -> Option<Self> {
        let mut priors = prior.priors().to_vec();
        let force = *priors.first()?;
        let width = priors.len();
        priors.extend(moments.iter().skip(1).map(|_| force));
        let moment_of = moments
            .iter()
            .enumerate()
            .flat_map(|(moment, data)| data.iter().map(move |_| moment))
            .collect();
        Some(Self {
            priors,
            width,
            moments: moments
                .iter()
                .map(|data| queries(*prior.parameterisation(), data))
                .collect::<Option<_>>()?,
            data: moments.concat(),
            moment_of,
            discrepancy: discrepancy.iter().map(|d| d * d).collect(),
        })
    }

    /// Answers of the model to all data; NaN in all of them if it has none.
    pub(super) fn answer(&self, theta: &[f64], out: &mut [f64]) {
        let mut own = theta[..self.width].to_vec();
        let mut start = 0;
        let mut good = true;
        for (moment, queries) in self.moments.iter().enumerate() {
            if moment > 0 {
                own[0] = theta[self.width + moment - 1];
            }
            let end = start + queries.all().len();
            good &= queries.answers(&own, &mut out[start..end]).is_ok();
            start = end;
        }
        if !good || out.iter().any(|y| !y.is_finite()) {
            out.fill(f64::NAN);
        }
    }

    fn squared_discrepancy(&self, datum: &Datum) -> Option<(usize, f64)> {
        let order = datum.discrepant_order()?;
        let squared = self.discrepancy.get(order - 1).or(self.discrepancy.last());
        Some((order, squared.copied().unwrap_or(0.0)))
    }

    /// Standard deviation of one datum about its answer: error and discrepancy.
    pub(super) fn spread(&self, datum: usize, answer: f64) -> f64 {
        let one = &self.data[datum];
        let shared = self.squared_discrepancy(one).map_or(0.0, |(_, d)| d);
        (variance(one) + shared * answer * answer).sqrt()
    }

    /// Natural logarithm of the density of the data in `mask` up to a constant; minus infinity where the model has no answer.
    pub(super) fn log_density(&self, answers: &[f64], mask: &Mask) -> f64 {
        let mut sum = 0.0;
        // Per order: sum y r / v, sum y^2 / v, and the discrepancy.
        let mut modes = [(0.0, 0.0, 0.0); crate::rod::beam::forward::MAX_MODES];
        for ((datum, &answer), &counts) in self.data.iter().zip(answers).zip(mask) {
            if !counts {
                continue;
            }
            let (residual, variance) = (datum.value - answer, variance(datum));
            sum -= 0.5 * residual * residual / variance;
            if let Some((order, squared)) = self.squared_discrepancy(datum)
                && squared > 0.0
            {
                let mode = &mut modes[order - 1];
                mode.0 += answer * residual / variance;
                mode.1 += answer * answer / variance;
                mode.2 = squared;
            }
        }
        for (cross, square, squared) in modes {
            if squared > 0.0 {
                let factor = 1.0 + squared * square;
                sum += 0.5 * (cross * cross * squared / factor - libm::log(factor));
            }
        }
        if sum.is_nan() { f64::NEG_INFINITY } else { sum }
    }

    /// Mean and standard deviation of the relative discrepancy of one mode given parameters and data.
    pub(super) fn discrepancy_given(&self, order: usize, answers: &[f64], mask: &Mask) -> (f64, f64) {
        let squared = self.discrepancy.get(order - 1).copied().unwrap_or(0.0);
        if squared == 0.0 {
            return (0.0, 0.0);
        }
        let (mut cross, mut precision) = (0.0, 1.0 / squared);
        for ((datum, &answer), &counts) in self.data.iter().zip(answers).zip(mask) {
            if counts && datum.discrepant_order() == Some(order) {
                cross += answer * (datum.value - answer) / variance(datum);
                precision += answer * answer / variance(datum);
            }
        }
        (cross / precision, precision.sqrt().recip())
    }
}

fn variance(datum: &Datum) -> f64 {
    datum.sd.max(LEAST_ERROR * datum.value.abs()).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn it_is_the_normal_density_with_a_shared_discrepancy() {
        // Mode 1 at two moments, mode 2 at one; covariance written out.
        let moments = vec![
            vec![Datum::frequency(1, 4.5, 0.01), Datum::frequency(2, 9.4, 0.02)],
            vec![Datum::frequency(1, 4.4, 0.015)],
        ];
        let problem = Problem::new(&RodPrior::todi(), &[0.01, 0.02], &moments).unwrap();
        let direct = |y: [f64; 3]| {
            let shared = [0.01, 0.02, 0.01];
            let order = [1, 2, 1];
            let sd = [0.01, 0.02, 0.015];
            let v = DMatrix::from_fn(3, 3, |i, j| {
                let diagonal = if i == j { sd[i] * sd[i] } else { 0.0 };
                let both = if order[i] == order[j] {
                    shared[i] * shared[j] * y[i] * y[j]
                } else {
                    0.0
                };
                diagonal + both
            });
            let r = DVector::from_fn(3, |i, _| [4.5, 9.4, 4.4][i] - y[i]);
            let root = v.cholesky().unwrap();
            -0.5 * (r.dot(&root.solve(&r)) + root.determinant().ln())
        };
        let (a, b) = ([4.48, 9.5, 4.41], [4.7, 9.1, 4.5]);
        let mask = vec![true; 3];
        let found = problem.log_density(&a, &mask) - problem.log_density(&b, &mask);
        assert!((found - (direct(a) - direct(b))).abs() < 1e-9);
        // Its posterior, against the same by a grid.
        let (mean, sd) = problem.discrepancy_given(1, &a, &mask);
        let (mut mass, mut first, mut second) = (0.0, 0.0, 0.0);
        for i in -4000..=4000 {
            let c = f64::from(i) * 1e-5;
            let terms = [
                (4.5 - a[0] * (1.0 + c)) / 0.01,
                (4.4 - a[2] * (1.0 + c)) / 0.015,
                c / 0.01,
            ];
            let weight = (-0.5 * terms.iter().map(|t| t * t).sum::<f64>()).exp();
            (mass, first, second) = (mass + weight, first + weight * c, second + weight * c * c);
        }
        let centre = first / mass;
        assert!((mean - centre).abs() < 1e-8 && (sd - (second / mass - centre * centre).sqrt()).abs() < 1e-7);
    }
}
