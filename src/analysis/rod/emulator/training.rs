//! Model solves on the design of the Hermite chaos, and the expansions fitted to them.

use super::design::Design;
use super::expansion::Expansion;
use super::fit::{Weighting, coefficients};
use crate::numerics::orthogonal::total_degree;
use crate::rod::beam::forward::{ForwardModel, MAX_MODES};
use crate::rod::beam::{FiniteElements, OutsideRange};
use crate::rod::prior::RodPrior;
use rayon::prelude::*;
use thiserror::Error;

/// Most design points solved.
pub const MAX_POINTS: usize = 4_000_000;
/// Highest total order.
pub const MAX_ORDER: usize = 12;
/// Design points solved between two reports of progress.
const BLOCK: usize = 256;

/// Reason why no chaos can be fitted.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FitError {
    /// Every quantity is fixed.
    #[error(
        "the chaos expands uncertain quantities, but every one is fixed; use the exact or the reduced model"
    )]
    NothingUncertain,
    /// The order is outside the range that can be fitted.
    #[error("chaos order {order}; it must lie between 1 and {MAX_ORDER}")]
    Order {
        /// Order asked for.
        order: usize,
    },
    /// The tensor grid is too large.
    #[error(
        "order {order} with {germs} uncertain quantities needs {points} model solves, at most {MAX_POINTS} are made; lower the order or fix a quantity"
    )]
    TooLarge {
        /// Order asked for.
        order: usize,
        /// Number of uncertain quantities.
        germs: usize,
        /// Number of points of the grid.
        points: usize,
    },
    /// The forward model has no answer at a design point.
    #[error("a design point is no rod: {0}")]
    Model(#[from] OutsideRange),
}

/// Frequencies on the design points, to be fitted.
#[derive(Debug, Clone)]
pub struct Training {
    /// Design the frequencies belong to.
    pub design: Design,
    /// Total order of the chaos to be fitted.
    pub order: usize,
    /// Per mode, one frequency \[Hz\] per design point.
    pub values: Vec<Vec<f64>>,
}

impl Training {
    /// Solves the finite-element model on the whole design, in parallel; `solved` is called with the
    /// number of points newly done and the total.
    pub fn solve(
        prior: &RodPrior,
        order: usize,
        elements: usize,
        solved: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Self, FitError> {
        if order == 0 || order > MAX_ORDER {
            return Err(FitError::Order { order });
        }
        let design = Design::new(prior, order);
        let (germs, points) = (design.axes.len(), design.len());
        if germs == 0 {
            return Err(FitError::NothingUncertain);
        }
        if points > MAX_POINTS {
            return Err(FitError::TooLarge { order, germs, points });
        }
        let model = FiniteElements::new(*prior.parameterisation(), elements);
        let mut rows = vec![[0.0; MAX_MODES]; points];
        rows.par_chunks_mut(BLOCK)
            .enumerate()
            .try_for_each(|(block, rows)| {
                let mut theta = vec![0.0; prior.parameterisation().len()];
                for (i, row) in rows.iter_mut().enumerate() {
                    design.theta(block * BLOCK + i, &mut theta);
                    model.frequencies(&theta, row)?;
                }
                solved(rows.len(), points);
                Ok::<(), OutsideRange>(())
            })?;
        let values = (0..MAX_MODES)
            .map(|mode| rows.iter().map(|row| row[mode]).collect())
            .collect();
        Ok(Self {
            design,
            order,
            values,
        })
    }

    /// Fits the expansions of the first `modes` modes by least squares.
    pub fn fit(&self, modes: usize, weighting: Weighting) -> Vec<Expansion> {
        let (outer, inner) = split(self.design.axes.len(), self.order);
        let count = self.order + 1;
        let place =
            |a: &[usize], b: &[usize]| a.iter().chain(b).fold(0, |place, &degree| place * count + degree);
        let one = |values: &Vec<f64>| {
            let tensor = coefficients(&self.design, self.order, values.clone(), weighting);
            let rows: Vec<Vec<f64>> = outer
                .iter()
                .map(|a| {
                    let left = self.order - a.iter().sum::<usize>();
                    let partners = inner.iter().take_while(|b| b.iter().sum::<usize>() <= left);
                    partners.map(|b| tensor[place(a, b)]).collect()
                })
                .collect();
            Expansion::new(rows.iter().map(Vec::as_slice))
        };
        self.values[..modes].iter().map(one).collect()
    }
}

/// The multi-indices of the first and of the second half of the germs.
pub(super) fn split(germs: usize, order: usize) -> (Vec<Vec<usize>>, Vec<Vec<usize>>) {
    let inner = germs / 2;
    (total_degree(germs - inner, order), total_degree(inner, order))
}
