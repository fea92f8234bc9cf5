//! Density of all data of a rod given its parameters.
//!
//! Every datum has an independent normal error. Some share a relative error besides: natural frequencies of one mode order the model's
//! discrepancy, with a mass on the rod or without, today or at another time; amplitude ratios of one pair of sensors their gain:
//! `y_i = y_Mi (1 + c) + e_i`, `c ~ N(0, d^2)`. Their covariance `diag(s_i^2) + d^2 y_M y_M'` is inverted in closed form.

use super::Datum;
use super::datum::{SharedError, queries};
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
    /// Per datum the group whose relative error it shares; none if that error is zero.
    group_of: Vec<Option<usize>>,
    /// Squared relative standard deviation of each group's shared error.
    shared: Vec<f64>,
    /// Discrepancy of each mode order from the first, with its group.
    orders: Vec<(f64, Option<usize>)>,
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
        let data = moments.concat();
        let mut groups = Vec::new();
        let mut shared = Vec::new();
        let group_of = data
            .iter()
            .map(|datum| {
                let (group, sd) = datum.shared(discrepancy)?;
                let known = groups.iter().position(|known| *known == group);
                Some(known.unwrap_or_else(|| {
                    groups.push(group);
                    shared.push(sd * sd);
                    groups.len() - 1
                }))
            })
            .collect();
        let of_order = |(i, sd): (usize, &f64)| {
            let wanted = SharedError::Order(i + 1);
            (*sd, groups.iter().position(|group| *group == wanted))
        };
        Some(Self {
            priors,
            width,
            moments: moments
                .iter()
                .map(|data| queries(*prior.parameterisation(), data))
                .collect::<Option<_>>()?,
            orders: discrepancy.iter().enumerate().map(of_order).collect(),
            data,
            moment_of,
            group_of,
            shared,
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

    /// Standard deviation of one datum about its answer: its own error and the shared one.
    pub(super) fn spread(&self, datum: usize, answer: f64) -> f64 {
        let shared = self.group_of[datum].map_or(0.0, |group| self.shared[group]);
        (variance(&self.data[datum]) + shared * answer * answer).sqrt()
    }

    /// Natural logarithm of the density of the data in `mask` up to a constant; minus infinity where the model has no answer.
    pub(super) fn log_density(&self, answers: &[f64], mask: &Mask) -> f64 {
        let mut sum = 0.0;
        // Per group: sum y r / v, sum y^2 / v.
        let mut groups = vec![(0.0, 0.0); self.shared.len()];
        for (i, (datum, &answer)) in self.data.iter().zip(answers).enumerate() {
            if !mask[i] {
                continue;
            }
            let (residual, variance) = (datum.value - answer, variance(datum));
            sum -= 0.5 * residual * residual / variance;
            if let Some(group) = self.group_of[i] {
                groups[group].0 += answer * residual / variance;
                groups[group].1 += answer * answer / variance;
            }
        }
        for ((cross, square), squared) in groups.into_iter().zip(&self.shared) {
            let factor = 1.0 + squared * square;
            sum += 0.5 * (cross * cross * squared / factor - libm::log(factor));
        }
        if sum.is_nan() { f64::NEG_INFINITY } else { sum }
    }

    /// Mean and standard deviation of the relative discrepancy of one mode given parameters and data.
    pub(super) fn discrepancy_given(&self, order: usize, answers: &[f64], mask: &Mask) -> (f64, f64) {
        let (sd, group) = self.orders.get(order - 1).copied().unwrap_or((0.0, None));
        let Some(group) = group else {
            // No datum tells of it.
            return (0.0, sd);
        };
        let (mut cross, mut precision) = (0.0, 1.0 / self.shared[group]);
        for (i, (datum, &answer)) in self.data.iter().zip(answers).enumerate() {
            if mask[i] && self.group_of[i] == Some(group) {
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
