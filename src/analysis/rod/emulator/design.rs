//! The experimental design of the Hermite chaos: a tensor grid of Gauss points, `order + 1` per germ.
//!
//! A truncated normal is positive, but a low Gauss-Hermite point may stand for a value that is not (with a
//! coefficient of variation of 0.3 from order 6 on). Such a point is no rod. The germ then takes all its
//! points from the Gauss rule of the *truncated* normal instead: as many points, all of them physical, and
//! the right ones for the measure the prior really has. The paper's rod at order 5 is not affected.

use super::germ::Germ;
use crate::numerics::orthogonal::Recurrence;
use crate::rod::prior::RodPrior;

/// Design points of one germ.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// Germ of this axis.
    pub germ: Germ,
    /// Points, ascending.
    pub nodes: Vec<f64>,
    /// Quadrature weights of the points, of sum one.
    pub weights: Vec<f64>,
    /// True if the points are those of the truncated normal.
    pub truncated: bool,
}

impl Axis {
    /// True if a germ lies between the outermost points. Rounding on the way to the value and back must not
    /// exclude the points themselves.
    #[inline]
    pub fn holds(&self, z: f64) -> bool {
        z >= self.nodes[0] - 1e-9 && z <= self.nodes[self.nodes.len() - 1] + 1e-9
    }
}

/// The tensor grid; the last germ varies fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// One axis per germ.
    pub axes: Vec<Axis>,
    centre: Vec<f64>,
}

impl Design {
    /// The grid of `order + 1` points per germ.
    pub fn new(prior: &RodPrior, order: usize) -> Self {
        let points = order + 1;
        let axis = |germ: Germ| {
            let hermite = Recurrence::hermite(order).gauss(points);
            let truncated = germ.value(hermite.nodes[0]) <= 0.0;
            let rule = if truncated {
                Recurrence::truncated_normal(germ.lowest(), order).gauss(points)
            } else {
                hermite
            };
            Axis {
                germ,
                nodes: rule.nodes,
                weights: rule.weights,
                truncated,
            }
        };
        Self {
            axes: Germ::of(prior).into_iter().map(axis).collect(),
            centre: prior.centre(),
        }
    }

    /// Number of points; saturates.
    pub fn len(&self) -> usize {
        self.axes
            .iter()
            .fold(1, |product: usize, axis| product.saturating_mul(axis.nodes.len()))
    }

    /// True if there is no point; never, since a design has at least one.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Writes point `index` into `theta`.
    pub fn theta(&self, mut index: usize, theta: &mut [f64]) {
        theta.copy_from_slice(&self.centre);
        for axis in self.axes.iter().rev() {
            let count = axis.nodes.len();
            theta[axis.germ.index] = axis.germ.value(axis.nodes[index % count]);
            index /= count;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_design_is_46656_physical_gauss_hermite_points() {
        let design = Design::new(&RodPrior::todi(), 5);
        assert_eq!(design.len(), 46_656);
        assert!(design.axes.iter().all(|axis| !axis.truncated));
        let (mut first, mut last) = ([0.0; 7], [0.0; 7]);
        design.theta(0, &mut first);
        design.theta(46_655, &mut last);
        assert!((first[0] - (8e5 - 3.324_257_433_552_119 * 1.6e5)).abs() < 1e-6);
        assert!((last[5] - (4e5 + 3.324_257_433_552_119 * 1.2e5)).abs() < 1e-6);
        assert_eq!(last[6], 14.0);
    }

    #[test]
    fn points_that_would_be_no_rod_come_from_the_truncated_rule() {
        for order in [6, 8] {
            let design = Design::new(&RodPrior::todi(), order);
            let truncated: Vec<bool> = design.axes.iter().map(|axis| axis.truncated).collect();
            // Coefficients of variation 0.2, 0.3, 0.1, 0.1, 0.3, 0.3; lowest points -3.75 and -4.51.
            assert_eq!(truncated, [false, true, false, false, true, true]);
            for axis in &design.axes {
                assert_eq!(axis.nodes.len(), order + 1);
                assert!(axis.nodes.iter().all(|&z| axis.germ.value(z) > 0.0));
            }
        }
    }
}
