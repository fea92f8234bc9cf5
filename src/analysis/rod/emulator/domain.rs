//! Where an emulator trained on a design may be asked: the box of the design's points, and the values that the
//! prior holds fixed.

use super::design::{Axis, Design};
use super::expansion::LANES;
use crate::rod::beam::forward::{FEW, ForwardModel, MAX_MODES};
use crate::rod::beam::{OutsideRange, Quantity};
use crate::rod::prior::RodPrior;

/// The trained range of an emulator.
#[derive(Debug, Clone)]
pub struct Domain {
    /// Uncertain quantities with their design points.
    pub axes: Vec<Axis>,
    /// Name of the model in errors.
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

    /// Returns an error if `theta` lies outside the design's box, or differs in a quantity the prior holds
    /// fixed.
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

    /// True if every quantity that the prior holds fixed has its value.
    #[inline]
    pub fn has_fixed(&self, theta: &[f64]) -> bool {
        self.fixed.iter().all(|&(index, value)| theta[index] == value)
    }

    /// The germs of one point.
    pub fn germs(&self, theta: &[f64]) -> Vec<[f64; 1]> {
        let axes = self.axes.iter();
        axes.map(|axis| [axis.germ.germ(theta[axis.germ.index])])
            .collect()
    }

    /// [`ForwardModel::frequencies_of_many`] for `model`, whose range this is: `block` turns the germs of
    /// [`LANES`] points into frequencies, mode by mode; outside the range they become NaN.
    pub fn in_blocks(
        &self,
        model: &impl ForwardModel,
        (thetas, modes, out): (&[f64], usize, &mut [f64]),
        mut block: impl FnMut(&[[f64; LANES]], &mut [[f64; LANES]]),
    ) {
        let width = model.parameterisation().len();
        let mut rows = [[0.0; LANES]; MAX_MODES];
        let rows = &mut rows[..modes];
        let mut germs = vec![[0.0; LANES]; self.axes.len()];
        for (thetas, out) in thetas.chunks(LANES * width).zip(out.chunks_mut(LANES * modes)) {
            if thetas.len() / width < FEW {
                model.one_by_one(thetas, modes, out);
                continue;
            }
            for (l, theta) in thetas.chunks_exact(width).enumerate() {
                for (axis, z) in self.axes.iter().zip(&mut germs) {
                    z[l] = axis.germ.germ(theta[axis.germ.index]);
                }
            }
            block(&germs, rows);
            let points = thetas.chunks_exact(width).zip(out.chunks_exact_mut(modes));
            for (l, (theta, out)) in points.enumerate() {
                let mut axes = self.axes.iter().zip(&germs);
                let inside = axes.all(|(axis, z)| axis.holds(z[l])) && self.has_fixed(theta);
                for (out, row) in out.iter_mut().zip(rows.iter()) {
                    *out = if inside { row[l] } else { f64::NAN };
                }
            }
        }
    }
}
