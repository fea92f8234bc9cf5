//! One conjugate regression: normal-inverse-gamma knowledge of its coefficients and noise variance.
//!
//! For a row x and a response y with unit noise scale, y = x' c + e, e ~ N(0, s^2), c | s ~ N(m, s^2 P) and
//! s^2 ~ inverse gamma(a, b), the predictive law is Student's t with 2a degrees of freedom, location x'm and scale
//! sqrt(b / a (1 + x'P x)); the update is the recursive least-squares step (O'Hagan and Forster 2004, ch. 11).

use serde::{Deserialize, Serialize};

/// Coefficients of a regression.
pub(super) const WIDTH: usize = 4;
/// Entries of the upper triangle of their covariance.
const TRIANGLE: usize = WIDTH * (WIDTH + 1) / 2;
/// A member as a row of numbers: means, covariance, b, weight.
pub(super) type Numbers = [f64; WIDTH + TRIANGLE + 2];

/// What one regression knows; the shape a of its inverse gamma law is shared by all and kept outside.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "Numbers", into = "Numbers")]
pub(super) struct Member {
    /// Means of the coefficients.
    pub mean: [f64; WIDTH],
    /// Their covariance over the noise variance, the upper triangle by rows.
    pub cov: [f64; TRIANGLE],
    /// b of the noise variance's inverse gamma law.
    pub b: f64,
    /// Logarithm of the weight, the largest being zero.
    pub ln_weight: f64,
}

/// A response and its row, scaled so that the noise is white and of one variance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub response: f64,
    pub x: [f64; WIDTH],
}

impl From<Numbers> for Member {
    fn from(numbers: Numbers) -> Self {
        Self {
            mean: std::array::from_fn(|index| numbers[index]),
            cov: std::array::from_fn(|index| numbers[WIDTH + index]),
            b: numbers[WIDTH + TRIANGLE],
            ln_weight: numbers[WIDTH + TRIANGLE + 1],
        }
    }
}

impl From<Member> for Numbers {
    fn from(member: Member) -> Self {
        let mut numbers = [0.0; WIDTH + TRIANGLE + 2];
        numbers[..WIDTH].copy_from_slice(&member.mean);
        numbers[WIDTH..WIDTH + TRIANGLE].copy_from_slice(&member.cov);
        numbers[WIDTH + TRIANGLE] = member.b;
        numbers[WIDTH + TRIANGLE + 1] = member.ln_weight;
        numbers
    }
}

/// Where the entry of a row and a column stands in the upper triangle.
pub(super) const fn place(row: usize, column: usize) -> usize {
    let (row, column) = if row < column {
        (row, column)
    } else {
        (column, row)
    };
    row * WIDTH - row * (row + 1) / 2 + column
}

impl Member {
    /// No covariance at all.
    pub const NOTHING: [f64; TRIANGLE] = [0.0; TRIANGLE];

    /// x'm.
    pub fn location(&self, x: [f64; WIDTH]) -> f64 {
        x.iter().zip(&self.mean).map(|(x, mean)| x * mean).sum()
    }

    /// P x.
    fn along(&self, x: [f64; WIDTH]) -> [f64; WIDTH] {
        std::array::from_fn(|row| {
            (0..WIDTH)
                .map(|column| self.cov[place(row, column)] * x[column])
                .sum()
        })
    }

    /// x'P x.
    pub fn spread(&self, x: [f64; WIDTH]) -> f64 {
        let along = self.along(x);
        x.iter()
            .zip(along)
            .map(|(x, along)| x * along)
            .sum::<f64>()
            .max(0.0)
    }

    /// The response's distance from its location in predictive scales, and the scale.
    pub fn student(&self, row: &Row, a: f64) -> (f64, f64) {
        let scale = (self.b / a * (1.0 + self.spread(row.x))).sqrt();
        ((row.response - self.location(row.x)) / scale, scale)
    }

    /// Learns a row.
    pub fn learn(&mut self, row: &Row) {
        let along = self.along(row.x);
        let total = 1.0
            + row
                .x
                .iter()
                .zip(along)
                .map(|(x, along)| x * along)
                .sum::<f64>()
                .max(0.0);
        let error = row.response - self.location(row.x);
        for (mean, along) in self.mean.iter_mut().zip(along) {
            *mean += along / total * error;
        }
        for i in 0..WIDTH {
            for j in i..WIDTH {
                let entry = &mut self.cov[place(i, j)];
                *entry -= along[i] * along[j] / total;
                if i == j {
                    *entry = entry.max(0.0);
                }
            }
        }
        self.b += 0.5 * error * error / total;
    }
}
