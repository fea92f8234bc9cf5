//! Density of all data of a rod given its parameters.
//!
//! Every datum has an independent normal error. Some share a relative error besides: natural frequencies of one mode order the model's
//! discrepancy, with a mass on the rod or without, today or at another time; amplitude ratios of one pair of sensors their gain:
//! `y_i = y_Mi (1 + c) + e_i`, `c ~ N(0, d^2)`. Their covariance `diag(s_i^2) + d^2 y_M y_M'` is inverted in closed form. A ratio of the same
//! pair turned upside down has `-c`.

use super::Datum;
use super::datum::{SharedError, queries};
use crate::rod::prior::{Prior, RodPrior};
use crate::rod::query::Queries;
use nalgebra::{DMatrix, DVector};

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
    /// Per datum the group whose relative error it shares, and the sign with which; none if that error is zero.
    group_of: Vec<Option<(usize, f64)>>,
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
                let (group, sign, sd) = datum.shared(discrepancy)?;
                let known = groups.iter().position(|known| *known == group);
                let known = known.unwrap_or_else(|| {
                    groups.push(group);
                    shared.push(sd * sd);
                    groups.len() - 1
                });
                Some((known, sign))
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

    /// Indices of the parameters that are not fixed.
    pub(super) fn uncertain(&self) -> Vec<usize> {
        (0..self.priors.len())
            .filter(|&at| !self.priors[at].is_fixed())
            .collect()
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
        let shared = self.group_of[datum].map_or(0.0, |(group, _)| self.shared[group]);
        (variance(&self.data[datum]) + shared * answer * answer).sqrt()
    }

    /// Natural logarithm of the density of the data in `mask` up to a constant; minus infinity where the model has no answer.
    pub(super) fn log_density(&self, answers: &[f64], mask: &Mask) -> f64 {
        let (square, log_factors) = self.form(answers, mask);
        let sum = -0.5 * (square + log_factors);
        if sum.is_nan() { f64::NEG_INFINITY } else { sum }
    }

    /// Squared distance of the answers from the data in `mask`, in their errors with all that they share: chi-square of that many degrees
    /// of freedom if the answers are true.
    pub(super) fn square(&self, answers: &[f64], mask: &Mask) -> f64 {
        self.form(answers, mask).0
    }

    /// Quadratic form of the residuals with the inverse of their covariance, and the logarithm of its determinant without the data's
    /// own variances.
    fn form(&self, answers: &[f64], mask: &Mask) -> (f64, f64) {
        let mut sum = 0.0;
        // Per group: sum y r / v, sum y^2 / v.
        let mut groups = vec![(0.0, 0.0); self.shared.len()];
        for (i, (datum, &answer)) in self.data.iter().zip(answers).enumerate() {
            if !mask[i] {
                continue;
            }
            let (residual, variance) = (datum.value - answer, variance(datum));
            sum += residual * residual / variance;
            if let Some((group, sign)) = self.group_of[i] {
                groups[group].0 += sign * answer * residual / variance;
                groups[group].1 += answer * answer / variance;
            }
        }
        let mut log_factors = 0.0;
        for ((cross, square), squared) in groups.into_iter().zip(&self.shared) {
            let factor = 1.0 + squared * square;
            sum -= cross * cross * squared / factor;
            log_factors += libm::log(factor);
        }
        (sum, log_factors)
    }

    /// Information of the data in `mask` about coordinates in which the answers have these derivatives (a column a coordinate), and the
    /// slope of their log density: J' V^-1 J and J' V^-1 r, with the covariance V of residuals r at the answers.
    pub(super) fn information(
        &self,
        answers: &[f64],
        derivatives: &DMatrix<f64>,
        mask: &Mask,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let d = derivatives.ncols();
        let (mut information, mut slope) = (DMatrix::zeros(d, d), DVector::zeros(d));
        // Per group: sum y J / v, sum y r / v, sum y^2 / v.
        let mut groups = vec![(DVector::zeros(d), 0.0, 0.0); self.shared.len()];
        for (i, (datum, &answer)) in self.data.iter().zip(answers).enumerate() {
            if !mask[i] {
                continue;
            }
            let row = derivatives.row(i).transpose();
            let (residual, variance) = (datum.value - answer, variance(datum));
            information.ger(1.0 / variance, &row, &row, 1.0);
            slope.axpy(residual / variance, &row, 1.0);
            if let Some((group, sign)) = self.group_of[i] {
                let (along, cross, square) = &mut groups[group];
                along.axpy(sign * answer / variance, &row, 1.0);
                *cross += sign * answer * residual / variance;
                *square += answer * answer / variance;
            }
        }
        for ((along, cross, square), squared) in groups.iter().zip(&self.shared) {
            let factor = squared / (1.0 + squared * square);
            information.ger(-factor, along, along, 1.0);
            slope.axpy(-factor * cross, along, 1.0);
        }
        (information, slope)
    }

    /// Prediction of one datum by the others in `mask` given parameters: with what they tell of the error that it shares with them.
    /// Mean, standard deviation of what is left of the shared error, and that with the datum's own.
    pub(super) fn predicted(&self, datum: usize, answers: &[f64], mask: &Mask) -> (f64, f64, f64) {
        let answer = answers[datum];
        let own = variance(&self.data[datum]);
        let Some((group, sign)) = self.group_of[datum] else {
            return (answer, 0.0, own.sqrt());
        };
        let (mean, sd) = self.shared_given(group, answers, |i| mask[i] && i != datum);
        let left = answer.abs() * sd;
        (answer * (1.0 + sign * mean), left, own.sqrt().hypot(left))
    }

    /// Mean and standard deviation of the relative discrepancy of one mode given parameters and data.
    pub(super) fn discrepancy_given(&self, order: usize, answers: &[f64], mask: &Mask) -> (f64, f64) {
        let (sd, group) = self.orders.get(order - 1).copied().unwrap_or((0.0, None));
        let Some(group) = group else {
            // No datum tells of it.
            return (0.0, sd);
        };
        self.shared_given(group, answers, |i| mask[i])
    }

    /// Mean and standard deviation of a shared error given parameters and the data that count.
    fn shared_given(&self, group: usize, answers: &[f64], counts: impl Fn(usize) -> bool) -> (f64, f64) {
        let (mut cross, mut precision) = (0.0, 1.0 / self.shared[group]);
        for (i, (datum, &answer)) in self.data.iter().zip(answers).enumerate() {
            if let Some((own, sign)) = self.group_of[i]
                && own == group
                && counts(i)
            {
                cross += sign * answer * (datum.value - answer) / variance(datum);
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
    use crate::rod::query::Query;

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

    /// Ratios of a pair of sensors, the last two of them with the first sensor as reference instead.
    fn ratios() -> Problem {
        let ratio = |order, (at, reference_at): (f64, f64), value, sd| Datum {
            query: Query::AmplitudeRatio {
                order,
                at,
                reference_at,
            },
            value,
            sd,
            gain_sd: 0.05,
        };
        let data = vec![
            ratio(1, (0.1, 0.4), 0.33, 0.001),
            ratio(2, (0.1, 0.4), 1.02, 0.002),
            ratio(3, (0.4, 0.1), -0.71, 0.003),
        ];
        Problem::new(&RodPrior::todi(), &[0.0; 3], &[data]).unwrap()
    }

    #[test]
    fn a_pair_upside_down_has_the_same_gain_with_the_other_sign() {
        let problem = ratios();
        let y = [0.32, 1.0, -0.73];
        let sign = [1.0, 1.0, -1.0];
        let v = |y: [f64; 3]| {
            DMatrix::from_fn(3, 3, |i, j| {
                let own = if i == j {
                    [0.001f64, 0.002, 0.003][i].powi(2)
                } else {
                    0.0
                };
                own + 0.05 * 0.05 * sign[i] * sign[j] * y[i] * y[j]
            })
        };
        let r = DVector::from_fn(3, |i, _| [0.33, 1.02, -0.71][i] - y[i]);
        let expected = r.dot(&v(y).cholesky().unwrap().solve(&r));
        let found = problem.square(&y, &[true; 3]);
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        let j = DMatrix::from_row_slice(3, 2, &[0.1, -0.3, 0.5, 0.2, -0.4, 0.7]);
        let (information, slope) = problem.information(&y, &j, &[true; 3]);
        let root = v(y).cholesky().unwrap();
        let (expected, along) = (j.tr_mul(&root.solve(&j)), j.tr_mul(&root.solve(&r)));
        assert!((information - &expected).norm() < 1e-9 * expected.norm());
        assert!((slope - &along).norm() < 1e-9 * along.norm());
    }

    #[test]
    fn a_datum_is_predicted_with_the_gain_that_the_others_tell() {
        let problem = ratios();
        let y = [0.32, 1.0, -0.73];
        // Conditional normal of datum 2 given 0 and 1.
        let v = |i: usize, j: usize| {
            let own = if i == j {
                [0.001f64, 0.002, 0.003][i].powi(2)
            } else {
                0.0
            };
            let sign = if (i == 2) == (j == 2) { 1.0 } else { -1.0 };
            own + 0.05 * 0.05 * sign * y[i] * y[j]
        };
        let others = DMatrix::from_fn(2, 2, v).cholesky().unwrap();
        let cross = DVector::from_fn(2, |i, _| v(i, 2));
        let r = DVector::from_fn(2, |i, _| [0.33, 1.02][i] - y[i]);
        let mean = y[2] + cross.dot(&others.solve(&r));
        let sd = (v(2, 2) - cross.dot(&others.solve(&cross))).sqrt();
        let (found, left, with_own) = problem.predicted(2, &y, &[true; 3]);
        assert!(
            (found - mean).abs() < 1e-9 && (with_own - sd).abs() < 1e-9,
            "{found} {mean} {with_own} {sd}"
        );
        // An order less than the gain alone would leave.
        assert!(left < 0.1 * 0.05 * 0.73);
    }
}
