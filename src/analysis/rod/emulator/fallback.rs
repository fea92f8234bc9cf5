//! The one place that decides what happens outside an emulator's range: the exact model answers.
//!
//! Inference draws from the whole prior, and its tails leave any box of training points. Refusing such draws
//! would cut the prior; extrapolating would invent frequencies. The exact model costs under a microsecond,
//! so it answers, and only parameters that describe no beam are refused.

use crate::rod::beam::forward::ForwardModel;
use crate::rod::beam::{Exact, OutsideRange, Parameterisation};

/// An emulator inside its trained range, the exact model outside.
#[derive(Debug, Clone)]
pub struct OrExact<M> {
    emulator: M,
    exact: Exact,
}

impl<M: ForwardModel> OrExact<M> {
    /// `emulator` inside its range, the exact model outside.
    pub fn new(emulator: M) -> Self {
        let exact = Exact::new(*emulator.parameterisation());
        Self { emulator, exact }
    }

    /// The emulator itself.
    pub fn emulator(&self) -> &M {
        &self.emulator
    }
}

impl<M: ForwardModel> ForwardModel for OrExact<M> {
    fn name(&self) -> &'static str {
        self.emulator.name()
    }

    fn parameterisation(&self) -> &Parameterisation {
        self.emulator.parameterisation()
    }

    fn modes(&self) -> usize {
        self.emulator.modes()
    }

    fn frequencies(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        match self.emulator.frequencies(theta, out) {
            Err(_) => self.exact.frequencies(theta, out),
            done => done,
        }
    }

    fn log_slopes(&self, theta: &[f64], out: &mut [f64]) -> Result<(), OutsideRange> {
        match self.emulator.log_slopes(theta, out) {
            Err(_) => self.exact.log_slopes(theta, out),
            done => done,
        }
    }

    fn frequencies_of_many(&self, thetas: &[f64], modes: usize, out: &mut [f64]) {
        self.emulator.frequencies_of_many(thetas, modes, out);
        let width = self.parameterisation().len();
        for (theta, row) in thetas.chunks_exact(width).zip(out.chunks_exact_mut(modes)) {
            if row.iter().any(|f| f.is_nan()) {
                self.exact.frequencies_of_many(theta, modes, row);
            }
        }
    }
}
