//! The finite-element model of a beam: equal elements, assembled into a banded pencil `K v = mu M v`.
//!
//! Free are the rotations of both ends and displacement and rotation of each inner node, so a node
//! couples with the next through three sub-diagonals. Everything is divided by `EI / h^3 + N / h`. An end
//! rotation is scaled so that its spring leaves the diagonal as it was: any stiffness, infinite included,
//! then enters without spoiling the conditioning.

use super::Beam;
use super::element::{BENDING, GEOMETRIC, MASS, energies};
use std::f64::consts::PI;

/// Number of sub-diagonals of the pencil's matrices.
pub const BANDWIDTH: usize = 3;

/// A symmetric banded matrix: `column[j][d]` is the entry in row `j + d` and column `j`; as many zero
/// columns as the bandwidth follow the last.
pub type Band = Vec<[f64; BANDWIDTH + 1]>;

/// The assembled model.
#[derive(Debug, Clone)]
pub struct Assembly {
    /// Stiffness K.
    pub stiffness: Band,
    /// Mass M, in units of `m h`.
    pub mass: Band,
    /// Number of degrees of freedom.
    pub size: usize,
    bending: f64,
    tension: f64,
    /// Per end: scale of the rotation, and the spring's part of the scaled diagonal.
    ends: [(f64, f64); 2],
    unit: f64,
}

impl Assembly {
    /// `elements` equal elements of `beam`.
    pub fn new(beam: &Beam, elements: usize) -> Self {
        let h = beam.length_m / elements as f64;
        let (ei, n) = (beam.flexural_rigidity_n_m2, beam.axial_force_n);
        let scale = ei / (h * h * h) + n / h;
        let (bending, tension) = (ei / (h * h * h) / scale, n / h / scale);
        let corner = 4.0 * bending + tension * 4.0 / 30.0;
        let ends = beam.end_stiffness_n_m.map(|k| {
            let spring = k / (h * h * scale) / corner;
            let share = if spring.is_finite() {
                spring / (1.0 + spring)
            } else {
                1.0
            };
            (1.0 / (1.0 + spring).sqrt(), corner * share)
        });

        let mut k = [[0.0; 4]; 4];
        let mut m = [[0.0; 4]; 4];
        for i in 0..4 {
            for j in 0..4 {
                k[i][j] = bending * BENDING[i][j] + tension / 30.0 * GEOMETRIC[i][j];
                m[i][j] = MASS[i][j] / 420.0;
            }
        }
        let size = 2 * elements;
        let mut assembly = Self {
            stiffness: vec![[0.0; BANDWIDTH + 1]; size + BANDWIDTH],
            mass: vec![[0.0; BANDWIDTH + 1]; size + BANDWIDTH],
            size,
            bending,
            tension,
            ends,
            unit: scale / (beam.mass_per_length_kg_m * h),
        };
        for element in 0..elements {
            let (places, scales) = assembly.places(element);
            for i in 0..4 {
                for j in 0..4 {
                    if let (Some(row), Some(column)) = (places[i], places[j])
                        && row >= column
                    {
                        let scale = scales[i] * scales[j];
                        assembly.stiffness[column][row - column] += scale * k[i][j];
                        assembly.mass[column][row - column] += scale * m[i][j];
                    }
                }
            }
        }
        assembly.stiffness[0][0] += ends[0].1;
        assembly.stiffness[size - 1][0] += ends[1].1;
        assembly
    }

    /// Indices of an element's four degrees of freedom in the pencil (`None`: fixed by the support), and
    /// their scales.
    #[inline]
    fn places(&self, element: usize) -> ([Option<usize>; 4], [f64; 4]) {
        let last = self.size / 2 - 1;
        let first = (2 * element).checked_sub(1);
        let mut places = [
            first,
            Some(2 * element),
            Some(2 * element + 1),
            Some(2 * element + 2),
        ];
        let mut scales = [1.0; 4];
        if element == 0 {
            scales[1] = self.ends[0].0;
        }
        if element == last {
            (places[2], places[3]) = (None, Some(2 * element + 1));
            scales[3] = self.ends[1].0;
        }
        (places, scales)
    }

    /// The strain energies of the scaled displacement `v`: tension's part and all of `v' K v`.
    pub fn strain_energies(&self, v: &[f64]) -> (f64, f64) {
        let last = self.size / 2 - 1;
        let (mut bending, mut tension) = (0.0, 0.0);
        let mut add = |d: [f64; 4]| {
            let (b, t) = energies(d);
            bending += b;
            tension += t;
        };
        let (left, right) = (self.ends[0].0 * v[0], self.ends[1].0 * v[self.size - 1]);
        if last == 0 {
            add([0.0, left, 0.0, right]);
        } else {
            add([0.0, left, v[1], v[2]]);
            for d in v[1..self.size - 1].windows(4).step_by(2) {
                add([d[0], d[1], d[2], d[3]]);
            }
            add([v[self.size - 3], v[self.size - 2], 0.0, right]);
        }
        let springs = self.ends[0].1 * v[0] * v[0] + self.ends[1].1 * v[self.size - 1] * v[self.size - 1];
        let tension = self.tension * tension;
        (tension, self.bending * bending + springs + tension)
    }

    /// Square of the circular frequency \[1/s^2\] that belongs to the eigenvalue `mu`.
    pub fn circular_frequency_squared(&self, mu: f64) -> f64 {
        self.unit * mu
    }

    /// First guess for the eigenvalue after `mu`: half a wave more, by the dispersion of the continuous
    /// beam.
    pub fn following(&self, mu: f64) -> f64 {
        let (b, t) = (self.bending, self.tension);
        let square = 2.0 * mu / (t + (t * t + 4.0 * b * mu).sqrt());
        let square = (square.sqrt() + PI / (self.size / 2) as f64).powi(2);
        square * (b * square + t)
    }

    /// Writes the sine of `order` half waves, sampled at the nodes, into `v`.
    pub fn sine(&self, order: usize, v: &mut [f64]) {
        let angle = order as f64 * PI / (self.size / 2) as f64;
        let (step_sin, step_cos) = (libm::sin(angle), libm::cos(angle));
        let (mut sin, mut cos) = (0.0, 1.0);
        v[0] = angle;
        for node in v[1..self.size].chunks_mut(2) {
            (sin, cos) = (sin * step_cos + cos * step_sin, cos * step_cos - sin * step_sin);
            match node {
                [w, rotation] => (*w, *rotation) = (sin, angle * cos),
                rest => rest[0] = angle * cos,
            }
        }
    }
}
