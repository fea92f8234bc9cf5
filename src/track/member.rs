//! One conjugate regression: normal-inverse-gamma knowledge of intercept, slope, curvature and noise variance.
//!
//! For a row x and a response y with unit noise scale, y = x' c + e, e ~ N(0, s^2), c | s ~ N(m, s^2 P) and
//! s^2 ~ inverse gamma(a, b), the predictive law is Student's t with 2a degrees of freedom, location x'm and scale
//! sqrt(b / a (1 + x'P x)); the update is the recursive least-squares step (O'Hagan and Forster 2004, ch. 11).

use serde::{Deserialize, Serialize};

/// A member as a row of numbers: means, covariance, b, weight.
pub(super) type Numbers = [f64; 11];

/// What one regression knows; the shape a of its inverse gamma law is shared by all and kept outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "Numbers", into = "Numbers")]
pub(super) struct Member {
    /// Means of intercept, slope and curvature.
    pub mean: [f64; 3],
    /// Their covariance over the noise variance, the upper triangle by rows: 00, 01, 02, 11, 12, 22.
    pub cov: [f64; 6],
    /// b of the noise variance's inverse gamma law.
    pub b: f64,
    /// Logarithm of the weight, the largest being zero.
    pub ln_weight: f64,
}

/// A response and its row, scaled so that the noise is white and of one variance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub response: f64,
    pub x: [f64; 3],
}

impl From<Numbers> for Member {
    fn from([m0, m1, m2, p00, p01, p02, p11, p12, p22, b, ln_weight]: Numbers) -> Self {
        Self {
            mean: [m0, m1, m2],
            cov: [p00, p01, p02, p11, p12, p22],
            b,
            ln_weight,
        }
    }
}

impl From<Member> for Numbers {
    fn from(member: Member) -> Self {
        let Member {
            mean: [m0, m1, m2],
            cov: [p00, p01, p02, p11, p12, p22],
            b,
            ln_weight,
        } = member;
        [m0, m1, m2, p00, p01, p02, p11, p12, p22, b, ln_weight]
    }
}

impl Member {
    /// x'm.
    pub fn location(&self, x: [f64; 3]) -> f64 {
        x[0] * self.mean[0] + x[1] * self.mean[1] + x[2] * self.mean[2]
    }

    /// P x.
    fn along(&self, x: [f64; 3]) -> [f64; 3] {
        let [p00, p01, p02, p11, p12, p22] = self.cov;
        [
            p00 * x[0] + p01 * x[1] + p02 * x[2],
            p01 * x[0] + p11 * x[1] + p12 * x[2],
            p02 * x[0] + p12 * x[1] + p22 * x[2],
        ]
    }

    /// x'P x.
    pub fn spread(&self, x: [f64; 3]) -> f64 {
        let along = self.along(x);
        (x[0] * along[0] + x[1] * along[1] + x[2] * along[2]).max(0.0)
    }

    /// The response's distance from its location in predictive scales, and the scale.
    pub fn student(&self, row: &Row, a: f64) -> (f64, f64) {
        let scale = (self.b / a * (1.0 + self.spread(row.x))).sqrt();
        ((row.response - self.location(row.x)) / scale, scale)
    }

    /// Learns a row.
    pub fn learn(&mut self, row: &Row) {
        let along = self.along(row.x);
        let total = 1.0 + self.spread(row.x);
        let error = row.response - self.location(row.x);
        for (mean, along) in self.mean.iter_mut().zip(along) {
            *mean += along / total * error;
        }
        let [a0, a1, a2] = along;
        let [p00, p01, p02, p11, p12, p22] = self.cov;
        self.cov = [
            (p00 - a0 * a0 / total).max(0.0),
            p01 - a0 * a1 / total,
            p02 - a0 * a2 / total,
            (p11 - a1 * a1 / total).max(0.0),
            p12 - a1 * a2 / total,
            (p22 - a2 * a2 / total).max(0.0),
        ];
        self.b += 0.5 * error * error / total;
    }
}
