//! Candidates: the assignments that a coarse grid of rods suggests.
//!
//! The grid spans dimensionless tension, both ends and the level of all frequencies. Its spectra are rounded
//! to bins of ln f once per rod; a record fills the bins with the gain of a mode there over a foreign peak,
//! and a node's score is a sum of look-ups.

use super::code::Code;
use super::peak::Peak;
use super::rod::{FORCE, LEFT, NO_GUESSES, Point, RIGHT, Rod};
use crate::rod::beam::forward::MAX_ORDERS;
use std::f64::consts::TAU;

/// Width of a bin of ln f.
const BIN: f64 = 0.0025;
/// Step of ln tension, and the most steps.
const TENSION_STEP: f64 = 0.1;
const MOST_TENSIONS: f64 = 100.0;
/// Least ln of the dimensionless tension: nothing changes below.
const LEAST_LOG_TENSION: f64 = -2.0;
/// Coordinates of the ends: four values stand for a wide distribution, two or one for a narrow one.
const ENDS: [f64; 4] = [-1.25, -0.35, 0.35, 1.25];
const TWO_ENDS: [f64; 2] = [-0.7, 0.7];
/// Reach of the level, in standard deviations, and its steps.
const LEVEL_REACH: f64 = 3.0;
const LEVEL_STEP_SD: f64 = 0.5;
const LEVEL_STEP: f64 = 0.025;
/// Nodes further below the centre in log prior than this \[nats\] are left out.
const MOST_PENALTY: f64 = 5.5;
/// The same for the level alone where the range of the modes is concerned: two standard deviations.
const RANGE_PENALTY: f64 = 2.0;
/// Scatter of a mode about its node, beside its own error: grid and model together.
const SCATTER: f64 = 0.022;
/// Least gain of a hit, and cost of a miss \[nats\].
const MISS: f32 = 0.7;
/// Most bins of a band: twenty-two powers of e.
const MOST_BINS: i32 = 20_000;
/// Candidates kept, and the largest score difference to the best of them.
const KEPT: usize = 24;
const KEPT_WITHIN: f32 = 14.0;

/// The coarse grid of one rod.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    /// ln f in bins at the level's mean.
    spectra: Vec<[i32; MAX_ORDERS]>,
    nodes: Vec<Node>,
    /// The lowest and highest ln f that a mode is expected to have.
    range: (f64, f64),
    /// The highest ln f of a first mode.
    first_high: f64,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    spectrum: u32,
    shift: i32,
    /// Level, force, left and right end.
    at: [f32; 4],
    penalty: f32,
}

/// A suggestion: an assignment and a point near which it may fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Suggestion {
    pub(super) code: Code,
    pub(super) start: Point,
    pub(super) score: f32,
}

impl Grid {
    pub(super) fn new(rod: &Rod) -> Self {
        let level_sd = rod.level.1;
        let (slenderness, by_level, _) = rod.slenderness;
        let reach = (2.0 * MOST_PENALTY).sqrt();
        let lowest = rod.force.at(-reach).0 + slenderness;
        let highest = rod.force.at(reach).0 + slenderness;
        let centre = rod.force.at(0.0).0 + slenderness;
        let lowest = lowest
            .max(LEAST_LOG_TENSION.min(centre))
            .min(highest - TENSION_STEP);
        let step = TENSION_STEP.max((highest - lowest) / MOST_TENSIONS);
        let tensions = ((highest - lowest) / step).ceil() as usize + 1;
        let (left, right) = (end_values(rod, 0), end_values(rod, 1));
        let is_symmetric = rod.ends[0].at(0.5).0 == rod.ends[1].at(0.5).0
            && rod.ends[0].at(-0.5).0 == rod.ends[1].at(-0.5).0;
        let level_step = (LEVEL_STEP_SD * level_sd)
            .clamp(1e-6, LEVEL_STEP)
            .max(level_sd / 8.0);
        let levels = (LEVEL_REACH * level_sd / level_step).ceil() as i32;
        let mut grid = Self {
            spectra: Vec::with_capacity(tensions * left.len() * right.len()),
            nodes: Vec::new(),
            range: (f64::INFINITY, f64::NEG_INFINITY),
            first_high: f64::NEG_INFINITY,
        };
        for i in 0..tensions {
            let log_tension = lowest + i as f64 * step;
            let mut guesses = NO_GUESSES;
            for (a, &q_left) in left.iter().enumerate() {
                for (b, &q_right) in right.iter().enumerate() {
                    if is_symmetric && b < a {
                        continue;
                    }
                    // Of the level's mean: the tension is then the force's alone.
                    let mut q = [0.0; 5];
                    q[FORCE] = rod.force.inverse(log_tension - slenderness);
                    (q[LEFT], q[RIGHT]) = (q_left, q_right);
                    let place = rod.at(&q);
                    let logs: [f64; MAX_ORDERS] =
                        std::array::from_fn(|n| place.log_frequency(n + 1, &mut guesses).0);
                    let spectrum = grid.spectra.len() as u32;
                    grid.spectra.push(logs.map(|log| (log / BIN).round() as i32));
                    for l in -levels..=levels {
                        let q_level = f64::from(l) * level_step / level_sd;
                        let log_force = log_tension - slenderness - by_level * q_level;
                        let q_force = rod.force.inverse(log_force);
                        let penalty = 0.5 * (q_level * q_level + q_force * q_force);
                        if penalty > MOST_PENALTY {
                            continue;
                        }
                        let shift = level_sd * q_level;
                        grid.nodes.push(Node {
                            spectrum,
                            shift: (shift / BIN).round() as i32,
                            at: [q_level as f32, q_force as f32, q_left as f32, q_right as f32],
                            penalty: penalty as f32,
                        });
                        let (low, high) = rod.log_force_range;
                        let is_believed = log_force >= low && log_force <= high;
                        if is_believed && 0.5 * q_level * q_level <= RANGE_PENALTY {
                            grid.range.0 = grid.range.0.min(logs[0] + shift);
                            grid.range.1 = grid.range.1.max(logs[MAX_ORDERS - 1] + shift);
                            grid.first_high = grid.first_high.max(logs[0] + shift);
                        }
                    }
                }
            }
        }
        if grid.range.0 > grid.range.1 {
            grid.range_of_nearest(rod);
        }
        // The likeliest first: few of the others then need a closer look.
        grid.nodes.sort_by(|a, b| a.penalty.total_cmp(&b.penalty));
        grid
    }

    /// Takes the range from the nodes nearest to the force's own, where that is known better than the grid is fine.
    fn range_of_nearest(&mut self, rod: &Rod) {
        let (low, high) = rod.log_force_range;
        let away = |node: &Node| {
            let log_force = rod.force.at(f64::from(node.at[1])).0;
            (low - log_force).max(log_force - high).max(0.0)
        };
        let Some(nearest) = self.nodes.iter().map(away).min_by(f64::total_cmp) else {
            return;
        };
        for node in self
            .nodes
            .iter()
            .filter(|node| away(node) <= nearest + TENSION_STEP)
        {
            let spectrum = &self.spectra[node.spectrum as usize];
            let log = |order: usize| f64::from(spectrum[order - 1] + node.shift) * BIN;
            self.range.0 = self.range.0.min(log(1));
            self.range.1 = self.range.1.max(log(MAX_ORDERS));
            self.first_high = self.first_high.max(log(1));
        }
    }

    /// The band in which modes may lie, in ln f, and the highest ln f of a first mode.
    pub(super) fn range(&self) -> ((f64, f64), f64) {
        (self.range, self.first_high)
    }

    /// The likeliest assignments of `peaks` between `band` (ln f), best first; `log_least` is the log cost of
    /// a foreign peak beside its density, `spread` the relative model discrepancy.
    pub(super) fn suggestions(
        &self,
        peaks: &[Peak],
        band: (f64, f64),
        spread: f64,
        log_foreign_rate: f64,
        declared: &[(usize, usize)],
    ) -> Vec<Suggestion> {
        let table = Gains::new(peaks, band, spread, log_foreign_rate);
        let declared: Vec<(usize, i32)> = declared
            .iter()
            .map(|&(order, peak)| (order, (peaks[peak].log_hz / BIN).round() as i32))
            .collect();
        let least_hits = peaks.len().min(2);
        let mut kept: Vec<Suggestion> = Vec::with_capacity(KEPT + 1);
        let (mut limit, mut top) = (f32::NEG_INFINITY, f32::NEG_INFINITY);
        for node in &self.nodes {
            let spectrum = &self.spectra[node.spectrum as usize];
            let mut prior = -node.penalty;
            for &(order, bin) in &declared {
                let off = f64::from(spectrum[order - 1] + node.shift - bin) * BIN / SCATTER;
                prior -= (0.5 * off * off).min(40.0) as f32;
            }
            let shift = node.shift - table.first;
            if table.most(spectrum, shift) + prior <= limit {
                continue;
            }
            let (best, code) = table.best(spectrum, shift, least_hits);
            let best = best + prior;
            if best <= limit {
                continue;
            }
            let [level, force, left, right] = node.at.map(f64::from);
            let suggestion = Suggestion {
                code,
                start: [level, 0.0, force, left, right],
                score: best,
            };
            match kept.iter_mut().find(|other| other.code == code) {
                Some(other) if other.score >= best => {}
                Some(other) => *other = suggestion,
                None => kept.push(suggestion),
            }
            top = top.max(best);
            limit = limit.max(top - KEPT_WITHIN);
            if kept.len() > KEPT {
                let worst = worst(&kept);
                kept.swap_remove(worst);
            }
            if kept.len() == KEPT {
                limit = limit.max(kept[worst(&kept)].score);
            }
        }
        kept.retain(|suggestion| suggestion.score >= limit);
        kept.sort_by(|a, b| b.score.total_cmp(&a.score).then(a.code.cmp(&b.code)));
        kept
    }
}

fn worst(kept: &[Suggestion]) -> usize {
    let lower = |a: &(usize, &Suggestion), b: &(usize, &Suggestion)| a.1.score.total_cmp(&b.1.score);
    kept.iter().enumerate().min_by(lower).map_or(0, |(i, _)| i)
}

/// Coordinates of an end, fewer where it is known well.
fn end_values(rod: &Rod, end: usize) -> &'static [f64] {
    let of_end = &rod.ends[end];
    let width = of_end.at(1.25).0 - of_end.at(-1.25).0;
    match width {
        _ if width < 0.05 => &[0.0],
        _ if width < 0.25 => &TWO_ENDS,
        _ => &ENDS,
    }
}

/// Per bin of ln f, the gain of a mode there over a foreign peak or the cost of a miss, and the peak.
struct Gains {
    first: i32,
    /// Ends with a bin for all that lies outside the band: neither gain nor cost.
    gains: Vec<f32>,
    peaks: Vec<u8>,
}

impl Gains {
    fn new(peaks: &[Peak], band: (f64, f64), spread: f64, log_foreign_rate: f64) -> Self {
        let first = (band.0 / BIN).round() as i32;
        let count = ((band.1 / BIN).round() as i32 - first + 1).clamp(1, MOST_BINS);
        let mut table = Self {
            first,
            gains: vec![-MISS; count as usize + 1],
            peaks: vec![u8::MAX; count as usize],
        };
        table.gains[count as usize] = 0.0;
        for (i, peak) in peaks.iter().enumerate() {
            let variance = SCATTER * SCATTER + peak.relative_sd * peak.relative_sd + spread * spread;
            let foreign = peak.log_foreign + peak.log_beside + peak.log_struck + log_foreign_rate;
            let top = -0.5 * libm::log(TAU * variance) - foreign;
            let reach = (2.0 * variance * (top + f64::from(MISS)).max(0.0)).sqrt();
            let low = ((peak.log_hz - reach) / BIN).ceil() as i32 - first;
            let high = ((peak.log_hz + reach) / BIN).floor() as i32 - first;
            for bin in low.max(0)..=high.min(count - 1) {
                let off = f64::from(bin + first) * BIN - peak.log_hz;
                let gain = (top - 0.5 * off * off / variance) as f32;
                let slot = bin as usize;
                if gain > table.gains[slot] {
                    (table.gains[slot], table.peaks[slot]) = (gain, i as u8);
                }
            }
        }
        table
    }

    /// The bin of an order, or that for all outside the band.
    #[inline]
    fn slot(&self, bin: i32) -> usize {
        // A bin below the band is negative and wraps round.
        (bin as u32 as usize).min(self.peaks.len())
    }

    /// Upper bound of the score of the first orders; lets one peak serve two orders.
    #[inline]
    fn most(&self, spectrum: &[i32; MAX_ORDERS], shift: i32) -> f32 {
        let (mut sum, mut best) = (0.0f32, 0.0f32);
        for bin in spectrum {
            let bin = bin + shift;
            // The orders ascend: all that follow lie above the band.
            if bin >= self.peaks.len() as i32 {
                break;
            }
            sum += self.gains[self.slot(bin)];
            best = best.max(sum);
        }
        best
    }

    /// Best-scoring assignment of the first orders to peaks.
    fn best(&self, spectrum: &[i32; MAX_ORDERS], shift: i32, least_hits: usize) -> (f32, Code) {
        let (mut best, mut code) = (f32::NEG_INFINITY, Code::default());
        let (mut sum, mut running, mut hits, mut last) = (0.0, Code::default(), 0, u8::MAX);
        for (n, bin) in spectrum.iter().enumerate() {
            let slot = self.slot(bin + shift);
            match self.peaks.get(slot) {
                None => {}
                Some(&peak) if peak != u8::MAX && peak != last => {
                    sum += self.gains[slot];
                    last = peak;
                    running = running.with(n + 1, Some(usize::from(peak)));
                    hits += 1;
                    if sum > best && hits >= least_hits {
                        (best, code) = (sum, running);
                    }
                }
                Some(_) => sum -= MISS,
            }
        }
        (best, code)
    }
}
