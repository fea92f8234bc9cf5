//! Beams and dense finite elements that the closed forms are tested against.

use super::Beam;
use super::element::{BENDING, GEOMETRIC, MASS};
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use std::f64::consts::PI;

/// A rod of 14 m with the stiffness and mass of the paper's.
pub(crate) fn beam(axial_force_n: f64, end_stiffness_n_m: [f64; 2]) -> Beam {
    Beam {
        length_m: 14.0,
        flexural_rigidity_n_m2: 4e5,
        mass_per_length_kg_m: 37.0,
        axial_force_n,
        end_stiffness_n_m,
    }
}

/// From slack to taut, hinged to clamped, unlike ends.
pub(crate) fn cases() -> [Beam; 6] {
    [
        beam(8e5, [4e5, 4e5]),
        beam(8e5, [0.0, 2e6]),
        beam(2e3, [1e7, 1e3]),
        beam(4e6, [0.0, 0.0]),
        beam(50.0, [3e4, 0.0]),
        beam(3e5, [1e8, 1e8]),
    ]
}

/// Stiffness and mass, dense: displacement and rotation times h at every node, both ends held.
pub(crate) struct Elements {
    stiffness: DMatrix<f64>,
    mass: DMatrix<f64>,
    count: usize,
    h: f64,
}

/// A mode of the elements: rows as in [`Elements`].
pub(crate) struct DenseMode {
    vector: DVector<f64>,
    count: usize,
    h: f64,
}

impl Elements {
    pub(crate) fn new(beam: &Beam, count: usize) -> Self {
        let h = beam.length_m / count as f64;
        let size = 2 * (count + 1);
        let (mut k, mut m) = (DMatrix::zeros(size, size), DMatrix::zeros(size, size));
        for element in 0..count {
            for i in 0..4 {
                for j in 0..4 {
                    let place = (2 * element + i, 2 * element + j);
                    k[place] += beam.flexural_rigidity_n_m2 / h.powi(3) * BENDING[i][j]
                        + beam.axial_force_n / (30.0 * h) * GEOMETRIC[i][j];
                    m[place] += beam.mass_per_length_kg_m * h / 420.0 * MASS[i][j];
                }
            }
        }
        k[(1, 1)] += beam.end_stiffness_n_m[0] / (h * h);
        k[(size - 1, size - 1)] += beam.end_stiffness_n_m[1] / (h * h);
        let held = [0, 2 * count];
        Self {
            stiffness: k.remove_columns_at(&held).remove_rows_at(&held),
            mass: m.remove_columns_at(&held).remove_rows_at(&held),
            count,
            h,
        }
    }

    /// Deflection at a node under a force at another; places are shares of the length.
    pub(crate) fn deflection(&self, force_n: f64, at: f64, read_at: f64) -> f64 {
        let mut load = DVector::zeros(self.stiffness.nrows());
        load[row(self.count, at)] = force_n;
        self.stiffness.clone().cholesky().unwrap().solve(&load)[row(self.count, read_at)]
    }

    /// Frequencies with a mass at a node, ascending.
    pub(crate) fn frequencies(&self, mass_kg: f64, at: f64) -> Vec<f64> {
        let mut mass = self.mass.clone();
        let row = row(self.count, at);
        mass[(row, row)] += mass_kg;
        let squares = eigen(&self.stiffness, &mass).0;
        squares.iter().map(|s| s.max(0.0).sqrt() / (2.0 * PI)).collect()
    }

    /// The first mode shapes.
    pub(crate) fn modes(&self, count: usize) -> Vec<DenseMode> {
        let (_, vectors) = eigen(&self.stiffness, &self.mass);
        let mode = |vector: DVector<f64>| DenseMode {
            vector,
            count: self.count,
            h: self.h,
        };
        vectors.into_iter().take(count).map(mode).collect()
    }
}

impl DenseMode {
    /// Deflection at a node.
    pub(crate) fn at(&self, share: f64) -> f64 {
        self.vector[row(self.count, share)]
    }

    /// Curvature at a node, from the slopes of its neighbours: an error of `(n pi h / l)^2 / 6`.
    pub(crate) fn curvature(&self, share: f64) -> f64 {
        let row = row(self.count, share);
        (self.vector[row + 3] - self.vector[row - 1]) / (2.0 * self.h * self.h)
    }
}

/// Row of the deflection at a node.
fn row(count: usize, share: f64) -> usize {
    2 * (share * count as f64).round() as usize - 1
}

/// Eigenvalues of the pencil, ascending, with their vectors.
fn eigen(stiffness: &DMatrix<f64>, mass: &DMatrix<f64>) -> (Vec<f64>, Vec<DVector<f64>>) {
    let root = mass.clone().cholesky().unwrap().l();
    let half = root.solve_lower_triangular(stiffness).unwrap();
    let found = SymmetricEigen::new(root.solve_lower_triangular(&half.transpose()).unwrap());
    let mut places: Vec<usize> = (0..found.eigenvalues.len()).collect();
    places.sort_by(|&a, &b| found.eigenvalues[a].total_cmp(&found.eigenvalues[b]));
    let vector = |&place: &usize| {
        let column = found.eigenvectors.column(place).into_owned();
        root.transpose().solve_upper_triangular(&column).unwrap()
    };
    (
        places.iter().map(|&place| found.eigenvalues[place]).collect(),
        places.iter().map(vector).collect(),
    )
}
