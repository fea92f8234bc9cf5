//! One conjugate regression: normal-inverse-gamma knowledge of intercept, slope and noise variance.
//!
//! For a row x and a response y with unit noise scale, y = x' c + e, e ~ N(0, s^2), c | s ~ N(m, s^2 P) and
//! s^2 ~ inverse gamma(a, b), the predictive law is Student's t with 2a degrees of freedom, location x'm and scale
//! sqrt(b / a (1 + x'P x)); the update is the recursive least-squares step (O'Hagan and Forster 2004, ch. 11).

use serde::{Deserialize, Serialize};

/// What one regression knows; the shape a of its inverse gamma law is shared by all and kept outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f64; 7]", into = "[f64; 7]")]
pub(super) struct Member {
    /// Means of intercept and slope.
    pub mean: [f64; 2],
    /// Their covariance over the noise variance: intercept, both, slope.
    pub cov: [f64; 3],
    /// b of the noise variance's inverse gamma law.
    pub b: f64,
    /// Logarithm of the weight, the largest being zero.
    pub ln_weight: f64,
}

/// A response and its row, scaled so that the noise is white and of one variance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub response: f64,
    pub x: [f64; 2],
}

impl From<[f64; 7]> for Member {
    fn from([m0, m1, p00, p01, p11, b, ln_weight]: [f64; 7]) -> Self {
        Self {
            mean: [m0, m1],
            cov: [p00, p01, p11],
            b,
            ln_weight,
        }
    }
}

impl From<Member> for [f64; 7] {
    fn from(member: Member) -> Self {
        let Member {
            mean: [m0, m1],
            cov: [p00, p01, p11],
            b,
            ln_weight,
        } = member;
        [m0, m1, p00, p01, p11, b, ln_weight]
    }
}

impl Member {
    /// x'm.
    pub fn location(&self, x: [f64; 2]) -> f64 {
        x[0] * self.mean[0] + x[1] * self.mean[1]
    }

    /// x'P x.
    pub fn spread(&self, x: [f64; 2]) -> f64 {
        let [p00, p01, p11] = self.cov;
        (x[0] * x[0] * p00 + 2.0 * x[0] * x[1] * p01 + x[1] * x[1] * p11).max(0.0)
    }

    /// The response's distance from its location in predictive scales, and the scale.
    pub fn student(&self, row: &Row, a: f64) -> (f64, f64) {
        let scale = (self.b / a * (1.0 + self.spread(row.x))).sqrt();
        ((row.response - self.location(row.x)) / scale, scale)
    }

    /// Learns a row.
    pub fn learn(&mut self, row: &Row) {
        let [p00, p01, p11] = self.cov;
        let along = [p00 * row.x[0] + p01 * row.x[1], p01 * row.x[0] + p11 * row.x[1]];
        let total = 1.0 + self.spread(row.x);
        let error = row.response - self.location(row.x);
        self.mean[0] += along[0] / total * error;
        self.mean[1] += along[1] / total * error;
        self.cov = [
            (p00 - along[0] * along[0] / total).max(0.0),
            p01 - along[0] * along[1] / total,
            (p11 - along[1] * along[1] / total).max(0.0),
        ];
        self.b += 0.5 * error * error / total;
    }
}
