//! The map from a rod's parameters to its natural frequencies, by any forward model.

use super::{OutsideRange, Parameterisation};

/// Most mode orders that an emulator serves and that a force is inferred from.
pub const MAX_MODES: usize = 5;

/// Most mode orders of labels and of simulated records.
pub const MAX_ORDERS: usize = 12;

/// Fewest points worth evaluating as a block.
pub const FEW: usize = 5;

/// A model of the natural frequencies of a rod (finite elements, exact, chaos expansions ...).
///
/// `theta` holds one value per quantity of [`ForwardModel::parameterisation`], in its order, SI.
pub trait ForwardModel: Send + Sync {
    /// Name of the model as users type it: `exact`, `finite-elements`, `reduced`, `pce`.
    fn name(&self) -> &'static str;

    /// Meaning of the entries of `theta`.
    fn parameterisation(&self) -> &Parameterisation;

    /// Number of mode orders it can give, from the first.
    fn modes(&self) -> usize;

    /// The first `out.len()` natural frequencies \[Hz\], ascending; `out.len() <= self.modes()`.
    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange>;

    /// The slopes `d ln f_n / d ln N` of the first `out.len()` modes: the relative change of each frequency
    /// per relative change of axial force. Central differences by default.
    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        // Truncation and the rounding of a frequency good to 1e-14 balance near this step, at 1e-9.
        let step = 1e-4f64;
        let mut moved = theta.to_vec();
        let mut below = [0.0; MAX_MODES];
        let below = &mut below[..out.len()];
        // The axial force comes first in every parameterisation.
        moved[0] = theta[0] * (-step).exp();
        self.frequencies(&moved, below)?;
        moved[0] = theta[0] * step.exp();
        self.frequencies(&moved, out)?;
        for (above, &below) in out.iter_mut().zip(below.iter()) {
            *above = (*above / below).ln() / (2.0 * step);
        }
        Ok(())
    }

    /// Frequencies of many parameter vectors: `thetas` row-major (points x quantities), `out`
    /// row-major (points x modes). A point outside the model's range gets NaN in its whole row.
    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        self.one_by_one(thetas, modes, out);
    }

    /// Default of [`ForwardModel::frequencies_of_many`], one call per point: for models without anything
    /// better, and for the few points that do not fill a block.
    fn one_by_one(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        let width = self.parameterisation().len();
        for (theta, row) in thetas.chunks_exact(width).zip(out.chunks_exact_mut(modes)) {
            if self.frequencies(theta, row).is_err() {
                row.fill(f64::NAN);
            }
        }
    }
}
