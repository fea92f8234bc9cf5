//! The two-node beam element: Hermite shapes, consistent mass, geometric stiffness.
//!
//! Degrees of freedom are `(w_1, h theta_1, w_2, h theta_2)` with the element length h, so that all
//! share one unit. Matrices as in Przemieniecki, Theory of Matrix Structural Analysis (1968).

/// Bending stiffness in units of `EI / h^3`.
pub const BENDING: [[f64; 4]; 4] = [
    [12.0, 6.0, -12.0, 6.0],
    [6.0, 4.0, -6.0, 2.0],
    [-12.0, -6.0, 12.0, -6.0],
    [6.0, 2.0, -6.0, 4.0],
];

/// Geometric stiffness in units of `N / (30 h)`.
pub const GEOMETRIC: [[f64; 4]; 4] = [
    [36.0, 3.0, -36.0, 3.0],
    [3.0, 4.0, -3.0, -1.0],
    [-36.0, -3.0, 36.0, -3.0],
    [3.0, -1.0, -3.0, 4.0],
];

/// Consistent mass in units of `m h / 420`.
pub const MASS: [[f64; 4]; 4] = [
    [156.0, 22.0, 54.0, -13.0],
    [22.0, 4.0, 13.0, -3.0],
    [54.0, 13.0, 156.0, -22.0],
    [-13.0, -3.0, -22.0, 4.0],
];

/// `d' K d` for bending (unit `EI / h^3`) and for tension (unit `N / h`) of the displacement `d`,
/// written in the rotations from the chord, whose squares do not cancel as the matrix entries do.
#[inline]
pub fn energies(d: [f64; 4]) -> (f64, f64) {
    let chord = d[2] - d[0];
    let (a, b) = (d[1] - chord, d[3] - chord);
    let bending = 4.0 * (a * a + a * b + b * b);
    let tension = chord * chord + (2.0 * (a * a + b * b) - a * b) / 15.0;
    (bending, tension)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn form(matrix: &[[f64; 4]; 4], d: [f64; 4]) -> f64 {
        (0..4)
            .map(|i| (0..4).map(|j| d[i] * matrix[i][j] * d[j]).sum::<f64>())
            .sum()
    }

    #[test]
    fn energies_are_the_quadratic_forms() {
        for d in [[0.3, -1.2, 0.7, 2.5], [1.0, 0.0, 1.0, 0.0], [0.0, 1.0, 1.0, 1.0]] {
            let (bending, tension) = energies(d);
            // Sums of a dozen terms of order 30.
            assert!((bending - form(&BENDING, d)).abs() < 1e-13);
            assert!((tension - form(&GEOMETRIC, d) / 30.0).abs() < 1e-14);
        }
    }

    #[test]
    fn rigid_motion_costs_nothing_and_weighs_m_h() {
        assert_eq!(energies([1.0, 0.0, 1.0, 0.0]), (0.0, 0.0));
        assert_eq!(form(&MASS, [1.0, 0.0, 1.0, 0.0]), 420.0);
        // A rotation about the middle: m h^3 / 12 in these units.
        assert!((form(&MASS, [-0.5, 1.0, 0.5, 1.0]) - 35.0).abs() < 1e-13);
    }
}
