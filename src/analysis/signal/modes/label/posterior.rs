//! All assignments with a probability worth counting.

use super::code::Code;
use super::evidence::{Fit, Scene};
use super::rod::{COORDINATES, Point};
use super::search::Grid;
use std::collections::BTreeSet;

/// Distance from the best (nats) within which an assignment is varied.
const VARIED_WITHIN: f64 = 7.5;
/// Most assignments fitted.
const MOST: usize = 160;
/// An assignment whose evidence is estimated this far below the best (nats) does not count: 1 in 22 000.
const COUNTED_WITHIN: f64 = 10.0;

/// The assignments of one record.
pub(super) struct Posterior {
    /// The fits, likeliest first.
    pub(super) fits: Vec<Fit>,
    /// Their probabilities.
    pub(super) probabilities: Vec<f64>,
    /// Probability that no peak is a mode of the rod.
    pub(super) no_rod: f64,
}

impl Posterior {
    /// Searches, fits and varies assignments.
    pub(super) fn of(scene: &Scene<'_>, grid: &Grid) -> Self {
        let mut exploration = Exploration {
            scene,
            seen: BTreeSet::new(),
            fits: Vec::new(),
        };
        exploration.suggest(grid);
        exploration.vary();
        let mut fits = exploration.fits;
        fits.sort_by(|a, b| {
            b.log_evidence
                .total_cmp(&a.log_evidence)
                .then(a.code.cmp(&b.code))
        });
        // A declared mode implies that there is a rod.
        let log_no_rod = match scene.declared {
            declared if declared != Code::default() => f64::NEG_INFINITY,
            _ => scene.log_no_rod(),
        };
        let top = fits
            .first()
            .map_or(log_no_rod, |best| best.log_evidence.max(log_no_rod));
        let weights: Vec<f64> = fits.iter().map(|fit| libm::exp(fit.log_evidence - top)).collect();
        let mut none = libm::exp(log_no_rod - top);
        // So does a request for the first mode alone, unless the peaks contradict it.
        if scene.is_first_seen && none < weights.iter().sum() {
            none = 0.0;
        }
        let total = weights.iter().sum::<f64>() + none;
        Self {
            fits,
            probabilities: weights.iter().map(|weight| weight / total).collect(),
            no_rod: none / total,
        }
    }

    /// Total probability of the assignments for which `holds` returns true.
    pub(super) fn probability(&self, holds: impl Fn(Code) -> bool) -> f64 {
        let counted = self.fits.iter().zip(&self.probabilities);
        counted.filter(|(fit, _)| holds(fit.code)).map(|(_, p)| p).sum()
    }
}

struct Exploration<'a> {
    scene: &'a Scene<'a>,
    seen: BTreeSet<Code>,
    fits: Vec<Fit>,
}

impl Exploration<'_> {
    fn try_code(&mut self, code: Code, start: &Point, is_near: bool) {
        if code != Code::default() && self.seen.insert(code) {
            self.fits.extend(
                self.scene
                    .fit(code, start, is_near)
                    .filter(|fit| fit.log_evidence.is_finite()),
            );
        }
    }

    fn suggest(&mut self, grid: &Grid) {
        let scene = self.scene;
        let declared: Vec<(usize, usize)> = scene.declared.pairs().collect();
        let suggestions = grid.suggestions(
            scene.peaks,
            scene.band,
            scene.spread(),
            Scene::log_foreign_rate(),
            &declared,
        );
        self.try_code(scene.declared, &[0.0; COORDINATES], false);
        for (i, suggestion) in suggestions.iter().enumerate() {
            // Parts of better suggestions are found by leaving orders out.
            if suggestions
                .iter()
                .take(i)
                .any(|better| better.code.contains(suggestion.code))
            {
                continue;
            }
            self.try_code(impose(suggestion.code, &declared), &suggestion.start, false);
        }
    }

    /// Varies the assignments by drops, additions, swaps and shifts of pairs, from the likeliest
    /// assignment on.
    fn vary(&mut self) {
        let mut varied = BTreeSet::new();
        while self.fits.len() < MOST {
            let best = self
                .fits
                .iter()
                .map(|fit| fit.log_evidence)
                .fold(f64::NEG_INFINITY, f64::max);
            let next = self
                .fits
                .iter()
                .filter(|fit| fit.log_evidence > best - VARIED_WITHIN && !varied.contains(&fit.code))
                .max_by(|a, b| {
                    a.log_evidence
                        .total_cmp(&b.log_evidence)
                        .then(b.code.cmp(&a.code))
                });
            let Some(fit) = next.cloned() else { break };
            varied.insert(fit.code);
            for (code, estimate) in self.scene.neighbours(&fit) {
                if estimate > best - COUNTED_WITHIN {
                    self.try_code(code, &fit.q, true);
                }
            }
            for up in [false, true] {
                if let Some(code) = fit.code.shifted(up) {
                    self.try_code(code, &fit.q, false);
                }
            }
        }
    }
}

/// Adds the declared pairs to an assignment and removes all that contradicts them.
fn impose(code: Code, declared: &[(usize, usize)]) -> Code {
    let mut imposed = code;
    for &(order, peak) in declared {
        if let Some(other) = imposed.order_of(peak) {
            imposed = imposed.with(other, None);
        }
        imposed = imposed.with(order, Some(peak));
    }
    imposed
}
