//! Numbers of records or modes that would decide for or against the axial force.

use super::evidence::Seen;
use super::kind::is_axial;
use super::response::{Alternatives, Modes};
use super::{Kind, MeanShift};
use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

/// Multiples of the present records that are considered, ascending.
const TIMES: [usize; 5] = [2, 4, 8, 16, 64];
/// Thinning of the particles for a forecast.
const STRIDE: usize = 4;

/// Measurements that would decide for or against the axial force.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Needed {
    /// About this many more records of the same modes.
    Records(usize),
    /// These further modes, each measured as well as the others.
    Modes(Vec<usize>),
}

impl Alternatives {
    /// Measurements that decide in both cases: if the expected shifts are those of the force, or of its best
    /// rival.
    pub(super) fn needed(&self, shift: &MeanShift, expected: &[Modes]) -> Vec<Needed> {
        let decides = |orders: &[usize], covariance: &DMatrix<f64>| {
            expected.iter().all(|expected| {
                let seen = Seen {
                    orders: orders.to_vec(),
                    shift: DVector::from_iterator(
                        orders.len(),
                        orders.iter().map(|order| expected[order - 1]),
                    ),
                    covariance: covariance.clone(),
                };
                self.weigh(&seen, STRIDE).is_some_and(|found| {
                    found
                        .iter()
                        .any(|one| one.kind == Kind::Force && is_axial(one.probability).is_some())
                })
            })
        };
        let mut needed = Vec::new();
        let after = |times: usize| &shift.falling / times as f64 + &shift.fixed;
        // The largest number decides if a search is worthwhile.
        if decides(&shift.orders, &after(TIMES[TIMES.len() - 1])) {
            let times = TIMES
                .into_iter()
                .find(|times| decides(&shift.orders, &after(*times)));
            needed.extend(times.map(|times| Needed::Records((times - 1) * shift.records)));
        }
        let more: Vec<usize> = (1..=self.modes)
            .filter(|order| !shift.orders.contains(order))
            .collect();
        if more.is_empty() {
            return needed;
        }
        let known = shift.orders.len();
        let orders: Vec<usize> = shift.orders.iter().chain(&more).copied().collect();
        let now = &shift.falling + &shift.fixed;
        let usual = now.trace() / known as f64;
        let covariance = DMatrix::from_fn(orders.len(), orders.len(), |a, b| {
            if a < known && b < known {
                now[(a, b)]
            } else if a == b {
                usual
            } else {
                0.0
            }
        });
        if decides(&orders, &covariance) {
            needed.push(Needed::Modes(more));
        }
        needed
    }
}
