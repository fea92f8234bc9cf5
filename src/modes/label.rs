//! Which resonance is which mode: the joint fit of all peaks to the pattern a rod's model predicts.
//!
//! Every assignment of resonances to mode orders (a mode may be missing, a peak may be foreign) gets
//! its posterior probability under draws of the rod's prior predictive frequencies:
//!
//! ```text
//! P(a) ~ 1/S sum_s prod_(n seen) p_d k(ln f_a(n) - ln y_n^s) / c  prod_(n missing) (1 - p_d)
//! ```
//!
//! with detection probability `p_d`, foreign peaks of density `c` per unit of ln f, and a kernel `k`
//! as wide as standard error and model discrepancy together. A mode is reported when its peak holds
//! 60 % of the probability over all assignments and no more than 10 % lies with rivals (the same peak
//! as another mode, another peak as this mode); nothing is reported unless the odds against all
//! peaks being foreign are 100 to 1.
//!
//! One clear mode alone, among the orders used (at least 1 and 2), is never enough: with a tolerance of
//! 3 % the odds that it is not foreign stay below 100 however well the rod is known, and nothing would
//! speak against it if it were.

use super::{Mode, ModeSettings, Resonance};
use crate::forward::MAX_MODES;
use crate::record::Rejection;
use statrs::distribution::{ContinuousCDF, Normal};
use std::collections::BTreeMap;
use std::f64::consts::TAU;

const GOLDEN_RATIO: f64 = 1.618_033_988_749_895;

/// Probability that a mode within the band shows a peak; a sensor at a node does not see it.
const DETECTION: f64 = 0.7;
/// Least relative tolerance of the model's frequencies per mode: the paper's own rod has
/// f3 / f1 = 2.950 where hinged ends force 3 or more.
const LEAST_TOLERANCE: f64 = 0.03;
/// Share and width (in tolerances) of the kernel's wide part: the discrepancy is itself a guess.
const WIDE_SHARE: f64 = 0.15;
const WIDE: f64 = 3.0;
/// The kernel ends at this many tolerances.
const CUT: f64 = 7.5;
/// Every so many-th draw doubts the prior: all its frequencies are shifted together, by this standard
/// deviation of the logarithm (30 %, a factor of 1.8 in force). Ratios then decide where the level was
/// guessed badly; without it, two strong low peaks were called foreign and modes 3 and 4 called 2 and 3.
const DOUBT_EVERY: usize = 4;
const DOUBT_LOG_SD: f64 = 0.3;
/// Least odds that at least one peak is a mode of the rod.
const LEAST_ODDS: f64 = 100.0;
/// Least probability of a reported mode's peak; the rest is that it is foreign, or the rivals'.
const LEAST_PROBABILITY: f64 = 0.6;
/// Most probability of rivals: the same peak as another mode, or another peak as the same mode.
const MOST_RIVAL: f64 = 0.1;
/// Most resonances considered, those of the strongest evidence.
const MOST_PEAKS: usize = 30;
/// Fewest draws a pattern is made from.
const LEAST_DRAWS: usize = 100;

/// The natural frequencies a rod may have: draws from its prior through its forward model.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern {
    modes: usize,
    /// Natural logarithms, row-major (draws x modes), every [`DOUBT_EVERY`]th draw shifted.
    log_frequency: Vec<f64>,
    low_hz: f64,
    high_hz: f64,
    first_high_hz: f64,
}

impl Pattern {
    /// From prior predictive frequencies \[Hz\], row-major with `modes` columns (orders 1 to `modes`;
    /// better more orders than are used, so that a higher one is not taken for a lower). Rows that
    /// are not positive and finite are left out; `None` if fewer than 100 remain.
    pub fn new(frequencies: &[f64], modes: usize) -> Option<Self> {
        if !(1..=MAX_MODES).contains(&modes) {
            return None;
        }
        let log_frequency: Vec<f64> = frequencies
            .chunks_exact(modes)
            .filter(|row| row.iter().all(|f| f.is_finite() && *f > 0.0))
            .flat_map(|row| row.iter().map(|f| f.ln()))
            .collect();
        let draws = log_frequency.len() / modes;
        if draws < LEAST_DRAWS {
            return None;
        }
        let quantile = |mode: usize, share: f64| {
            let mut column: Vec<f64> = log_frequency.iter().skip(mode).step_by(modes).copied().collect();
            let at = (share * (draws - 1) as f64).round() as usize;
            let (_, value, _) = column.select_nth_unstable_by(at, f64::total_cmp);
            value.exp()
        };
        let (low_hz, high_hz) = (quantile(0, 0.0) * 0.85, quantile(modes - 1, 0.999) * 1.1);
        let first_high_hz = quantile(0, 0.999);
        let mut log_frequency = log_frequency;
        let doubted = log_frequency.chunks_exact_mut(modes).step_by(DOUBT_EVERY);
        let normal = Normal::standard();
        for (i, draw) in doubted.enumerate() {
            // Additive recurrence: evenly spread whatever the number of draws.
            let share = (0.5 + i as f64 * GOLDEN_RATIO).fract().clamp(1e-6, 1.0 - 1e-6);
            let shift = DOUBT_LOG_SD * normal.inverse_cdf(share);
            draw.iter_mut().for_each(|log| *log += shift);
        }
        Some(Self {
            modes,
            low_hz,
            high_hz,
            first_high_hz,
            log_frequency,
        })
    }

    /// Orders it holds.
    pub fn modes(&self) -> usize {
        self.modes
    }

    /// The band in which the rod's peaks are looked for \[Hz\], somewhat wider than the draws.
    pub fn band_hz(&self) -> (f64, f64) {
        (self.low_hz, self.high_hz)
    }

    /// The highest frequency the first mode is expected to have \[Hz\].
    pub fn first_mode_below_hz(&self) -> f64 {
        self.first_high_hz
    }
}

/// The labelled modes of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Labelling {
    /// Ascending in order.
    pub modes: Vec<Mode>,
    /// Probability of each mode's peak over all assignments, in the same order.
    pub probability: Vec<f64>,
    /// Odds that at least one peak is a mode of the rod.
    pub odds: f64,
}

/// Assigns resonances (ascending in frequency) to mode orders.
///
/// `discrepancy` is the model's relative standard deviation per order, as in the analysis settings;
/// orders beyond its end use the last entry, and none is taken below 3 %. Lines and resonances in
/// masked bands are ignored.
pub fn label(
    resonances: &[Resonance],
    pattern: &Pattern,
    settings: &ModeSettings,
    discrepancy: &[f64],
) -> Result<Labelling, Rejection> {
    let mut peaks: Vec<&Resonance> = resonances
        .iter()
        .filter(|r| {
            !r.line
                && !settings
                    .masks
                    .iter()
                    .any(|m| (m.low_hz..=m.high_hz).contains(&r.frequency_hz))
        })
        .collect();
    peaks.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    peaks.truncate(MOST_PEAKS);
    peaks.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
    let refused = |detail: String| Rejection::NoLabel {
        peaks: resonances.len(),
        detail,
    };
    if peaks.is_empty() {
        return Err(refused("all are pure lines or masked".into()));
    }
    let weights = assignments(&peaks, pattern, discrepancy);
    let total: f64 = weights.values().sum();
    let none = weights
        .get(&NOTHING)
        .copied()
        .unwrap_or(0.0)
        .max(f64::MIN_POSITIVE);
    let odds = (total - none) / none;
    if odds < LEAST_ODDS {
        let (low, high) = pattern.band_hz();
        return Err(refused(format!(
            "odds {odds:.1} that any of the {} resonances from {low:.2} to {high:.2} Hz belongs to the rod, {LEAST_ODDS} needed",
            peaks.len()
        )));
    }
    let mut labelling = Labelling {
        modes: Vec::new(),
        probability: Vec::new(),
        odds,
    };
    for order in 1..=settings.count.max(2).min(pattern.modes) {
        let share = |holds: &dyn Fn(Code) -> bool| -> f64 {
            weights
                .iter()
                .filter(|&(&code, _)| holds(code))
                .map(|(_, weight)| weight / total)
                .sum()
        };
        let best = (0..peaks.len())
            .map(|peak| (peak, share(&|code| peak_of(code, order) == Some(peak))))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((peak, probability)) = best else { continue };
        let rival = share(&|code| {
            (1..=pattern.modes).any(|n| peak_of(code, n).is_some_and(|p| (p == peak) != (n == order)))
        });
        if probability >= LEAST_PROBABILITY && rival <= MOST_RIVAL {
            labelling.modes.push(Mode {
                order,
                frequency_hz: peaks[peak].frequency_hz,
                sd_hz: peaks[peak].frequency_sd_hz,
                damping: Some(peaks[peak].damping),
            });
            labelling.probability.push(probability);
        }
    }
    if let [
        Mode {
            order, frequency_hz, ..
        },
    ] = labelling.modes[..]
    {
        return Err(refused(format!(
            "only one is clear, {frequency_hz:.2} Hz as mode {order}, and one peak alone proves nothing"
        )));
    }
    labelling.modes.retain(|mode| mode.order <= settings.count);
    labelling.probability.truncate(labelling.modes.len());
    if labelling.modes.is_empty() {
        return Err(refused(format!(
            "the likeliest are {}",
            describe(&weights, total, &peaks)
        )));
    }
    Ok(labelling)
}

/// An assignment: five bits an order, the peak's number from 1, or 0 for a missing mode.
type Code = u32;
const NOTHING: Code = 0;

fn peak_of(code: Code, order: usize) -> Option<usize> {
    (((code >> (5 * (order - 1))) & 31) as usize).checked_sub(1)
}

/// The unnormalised probability of every assignment that some draw supports.
fn assignments(peaks: &[&Resonance], pattern: &Pattern, discrepancy: &[f64]) -> BTreeMap<Code, f64> {
    let modes = pattern.modes;
    // One foreign peak in the band, or as many as there are more than the modes usually used.
    let foreign = peaks.len().saturating_sub(2).max(1) as f64 / (pattern.high_hz / pattern.low_hz).ln();
    let log_peak: Vec<f64> = peaks.iter().map(|r| r.frequency_hz.ln()).collect();
    let tolerance = |order: usize, r: &Resonance| {
        let stated = discrepancy
            .get(order)
            .or(discrepancy.last())
            .copied()
            .unwrap_or(0.0);
        stated
            .max(LEAST_TOLERANCE)
            .hypot(r.frequency_sd_hz / r.frequency_hz)
    };
    let tolerances: Vec<f64> = (0..modes)
        .flat_map(|order| peaks.iter().map(move |r| tolerance(order, r)))
        .collect();
    // Assignments of the first orders are nodes of a tree: reached many thousand times, found by index.
    let mut tree = Tree::new(peaks.len());
    let mut partial: Vec<Partial> = Vec::new();
    let mut next = Vec::new();
    for draw in pattern.log_frequency.chunks_exact(modes) {
        partial.clear();
        partial.push(Partial {
            node: Tree::ROOT,
            peaks_taken: 0,
            weight: 1.0,
        });
        for (order, &log_mode) in draw.iter().enumerate() {
            next.clear();
            next.extend(partial.iter().map(|&before| Partial {
                node: tree.child(before.node, 0),
                weight: before.weight * (1.0 - DETECTION),
                ..before
            }));
            for (peak, &log) in log_peak.iter().enumerate() {
                let tolerance = tolerances[order * peaks.len() + peak];
                let distance = (log - log_mode) / tolerance;
                if distance.abs() > CUT {
                    continue;
                }
                let gain = DETECTION * kernel(distance) / (tolerance * foreign);
                // Peaks ascend with the orders: only above every peak already taken.
                for before in partial.iter().filter(|before| before.peaks_taken <= peak) {
                    next.push(Partial {
                        node: tree.child(before.node, peak + 1),
                        peaks_taken: peak + 1,
                        weight: before.weight * gain,
                    });
                }
            }
            std::mem::swap(&mut partial, &mut next);
        }
        for last in &partial {
            tree.weights[last.node] += last.weight;
        }
    }
    tree.leaves(modes)
}

/// An assignment of the first few orders under one draw.
#[derive(Clone, Copy)]
struct Partial {
    node: usize,
    /// The highest peak taken, counted from 1.
    peaks_taken: usize,
    weight: f64,
}

/// Assignments by their first orders: the children of a node say what becomes of the next order (0
/// missing, else the peak's number).
struct Tree {
    choices: usize,
    children: Vec<usize>,
    weights: Vec<f64>,
}

impl Tree {
    const ROOT: usize = 0;

    fn new(peaks: usize) -> Self {
        let choices = peaks + 1;
        Self {
            choices,
            children: vec![0; choices],
            weights: vec![0.0],
        }
    }

    fn child(&mut self, node: usize, choice: usize) -> usize {
        let slot = node * self.choices + choice;
        if self.children[slot] == 0 {
            self.children[slot] = self.weights.len();
            self.weights.push(0.0);
            self.children.resize(self.children.len() + self.choices, 0);
        }
        self.children[slot]
    }

    /// The weights of the nodes at `depth`, all there are.
    fn leaves(&self, depth: usize) -> BTreeMap<Code, f64> {
        let mut level = vec![(Self::ROOT, NOTHING)];
        for order in 0..depth {
            let below = level.iter().flat_map(|&(node, code)| {
                (0..self.choices).filter_map(move |choice| {
                    let child = self.children[node * self.choices + choice];
                    (child != 0).then_some((child, code | ((choice as Code) << (5 * order))))
                })
            });
            level = below.collect();
        }
        level
            .into_iter()
            .map(|(node, code)| (code, self.weights[node]))
            .collect()
    }
}

fn kernel(distance: f64) -> f64 {
    // exp(-z^2 / 2) is the ninth power of exp(-(z / 3)^2 / 2).
    const { assert!(WIDE == 3.0) };
    let wide = (-distance * distance / 18.0).exp();
    let third = wide * wide * wide;
    ((1.0 - WIDE_SHARE) * (third * third * third) + WIDE_SHARE / WIDE * wide) / TAU.sqrt()
}

fn describe(weights: &BTreeMap<Code, f64>, total: f64, peaks: &[&Resonance]) -> String {
    let mut best: Vec<(Code, f64)> = weights.iter().map(|(&code, &weight)| (code, weight)).collect();
    best.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let one = |&(code, weight): &(Code, f64)| {
        let parts: Vec<String> = (1..=MAX_MODES)
            .filter_map(|order| {
                peak_of(code, order).map(|p| format!("{order} at {:.2} Hz", peaks[p].frequency_hz))
            })
            .collect();
        format!("({}; {:.0} %)", parts.join(", "), 100.0 * weight / total)
    };
    best.iter().take(2).map(one).collect::<Vec<_>>().join(" or ")
}
