//! Where an emulator trained on a design may be asked: the box of the design's points, and the values that the
//! prior holds fixed.

use super::design::{Axis, Design};
use crate::bayes::RodPrior;
use crate::beam::Quantity;
use crate::forward::OutsideRange;

/// The trained range of an emulator.
#[derive(Debug, Clone)]
pub struct Domain {
    /// The uncertain quantities with the design's points.
    pub axes: Vec<Axis>,
    /// The name in refusals.
    model: &'static str,
    quantities: &'static [Quantity],
    fixed: Vec<(usize, f64)>,
}

impl Domain {
    /// The box of a design.
    pub fn new(model: &'static str, prior: &RodPrior, design: &Design) -> Self {
        let all = prior.priors().iter().enumerate();
        let fixed = all
            .filter(|(_, prior)| prior.is_fixed())
            .map(|(i, prior)| (i, prior.centre()))
            .collect();
        Self {
            axes: design.axes.clone(),
            model,
            quantities: prior.parameterisation().quantities(),
            fixed,
        }
    }

    /// Refuses what lies outside the design's box, or differs in a quantity the prior holds fixed.
    pub fn check(&self, theta: &[f64]) -> Result<(), OutsideRange> {
        for axis in &self.axes {
            let value = theta[axis.germ.index];
            if !axis.holds(axis.germ.germ(value)) {
                let (low, high) = (axis.nodes[0], axis.nodes[axis.nodes.len() - 1]);
                return Err(OutsideRange {
                    model: self.model,
                    what: axis.germ.quantity.key(),
                    value,
                    low: axis.germ.value(low),
                    high: axis.germ.value(high),
                });
            }
        }
        let differs = |&&(index, fixed): &&(usize, f64)| theta[index] != fixed;
        self.fixed.iter().find(differs).map_or(Ok(()), |&(index, fixed)| {
            Err(OutsideRange {
                model: self.model,
                what: self.quantities[index].key(),
                value: theta[index],
                low: fixed,
                high: fixed,
            })
        })
    }

    /// Whether every quantity that the prior holds fixed has its value.
    #[inline]
    pub fn has_fixed(&self, theta: &[f64]) -> bool {
        self.fixed.iter().all(|&(index, value)| theta[index] == value)
    }
}
