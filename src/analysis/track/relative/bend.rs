//! The bend that wrong static parameters give the relative force: the drift watch must allow for it.

use super::{Shift, mean_and_slope};
use nalgebra::{DMatrix, DVector};

/// The bend of the force ratio that one standard deviation of the static parameters makes: `square` x^2 + `cube` x^3 for
/// x = N_t / N_0 - 1.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Bend {
    /// Coefficient of the square.
    pub square: f64,
    /// Coefficient of the cube.
    pub cube: f64,
}

/// Changes u at which the bend of the ratio is evaluated.
const BEND_AT: [f64; 8] = [-0.45, -0.35, -0.25, -0.12, 0.12, 0.2, 0.28, 0.35];

impl Shift {
    /// The bend of N_t / N_0 - 1 that the particles leave open. If one particle is the rod, the mean of all, every mode counting
    /// alike, reads y(x) instead of x; the residual of y to its best straight line through zero, over a range
    /// of changes, has one principal component over the particles, and the bend is that component with its
    /// standard deviation, as a square and a cube of x.
    pub fn bend(&self) -> Bend {
        *self.bend.get_or_init(|| self.find_bend())
    }

    fn find_bend(&self) -> Bend {
        let means: Vec<(f64, Vec<(f64, f64)>)> = BEND_AT
            .iter()
            .map(|u| {
                (
                    *u,
                    self.means.iter().map(|mean| mean_and_slope(mean, *u)).collect(),
                )
            })
            .collect();
        let x = DVector::from_iterator(BEND_AT.len(), BEND_AT.iter().map(|u| libm::expm1(*u)));
        let rows: Vec<DVector<f64>> = (0..self.log_forces.len())
            .map(|place| {
                let read = means.iter().map(|(u, means)| {
                    let information: f64 = means.iter().map(|(_, slope)| slope * slope).sum();
                    let off = means.iter().enumerate().map(|(mode, (value, slope))| {
                        slope * (self.polynomials.shift(place, mode, *u) - value)
                    });
                    libm::expm1(u + off.sum::<f64>() / information)
                });
                let y = DVector::from_iterator(BEND_AT.len(), read);
                let gain = y.dot(&x) / x.dot(&x);
                y - &x * gain
            })
            .collect();
        let count = rows.len().max(1) as f64;
        let mut scatter = DMatrix::zeros(x.len(), x.len());
        let mean = rows.iter().fold(DVector::zeros(x.len()), |sum, row| sum + row) / count;
        for row in &rows {
            let off = row - &mean;
            scatter += &off * off.transpose() / count;
        }
        let eigen = scatter.symmetric_eigen();
        let largest = eigen.eigenvalues.imax();
        let component = eigen.eigenvectors.column(largest) * eigen.eigenvalues[largest].max(0.0).sqrt();
        // Least squares in x^2 and x^3, beside a line.
        let columns = DMatrix::from_fn(x.len(), 3, |row, column| x[row].powi(column as i32 + 1));
        let fitted = (columns.transpose() * &columns)
            .cholesky()
            .map(|normal| normal.solve(&(columns.transpose() * component)));
        fitted.map_or_else(Bend::default, |fitted| Bend {
            square: fitted[1],
            cube: fitted[2],
        })
    }
}
