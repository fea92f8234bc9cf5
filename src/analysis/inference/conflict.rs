//! The conflict score: distance of observed frequencies from everything that a tensioned beam on rotational
//! springs can produce, whatever its prior.
//!
//! By dimensional analysis f_n = c n G_n(lambda, s_l, s_r) with any scale c > 0 (design 4.2). The score is
//!
//! ```text
//! min over c, lambda, s_l, s_r of sqrt( sum_n ((f_n - c n G_n) / sd_n)^2 ),
//! ```
//!
//! in standard deviations: zero for frequencies that the model reproduces, and for a right model with noise
//! at most the root of a chi-square with as many degrees of freedom as modes. The search is global: the best
//! patterns of a fixed grid, each refined by Levenberg's method on exact frequencies.

use super::pattern::{LINES, Point, TENSIONS, at, grid, grid_tension, pattern};
use crate::numerics::simd::{Kernel, vectorised};
use crate::rod::beam::forward::MAX_MODES;
use serde::Serialize;
use std::fmt;

/// Least standard deviation as a share of the frequency: the search does not resolve smaller ones.
const SMALLEST_RELATIVE_SD: f64 = 1e-6;

/// Most starting points refined.
const STARTS: usize = 5;

/// Most steps of a refinement.
const STEPS: usize = 25;
/// Squared distance at which a search ends: a hundredth of a standard deviation.
const NEGLIGIBLE: f64 = 1e-4;
/// Relative gain of a step below which a refinement ends.
const LEAST_GAIN: f64 = 1e-5;
/// A refinement that has come down to the best known distance, but for this share, ends sooner: below [`GAIN_BESIDE`].
const BESIDE: f64 = 1e-3;
const GAIN_BESIDE: f64 = 1e-2;

/// Distance of an observation from everything the model can produce.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Conflict {
    /// The distance, in standard deviations of measurement and discrepancy together.
    pub score: f64,
    /// The nearest frequencies the model can produce, one per observed mode \[Hz\].
    pub nearest_hz: Vec<f64>,
    /// (observed - nearest) / sd, one per observed mode.
    pub residuals: Vec<f64>,
    /// Ratio of frequencies furthest outside the range of any such beam, if one is.
    pub violation: Option<Violation>,
    /// Share of the *prior's* simulated records that lie as far out as this one or further, from 1 (in
    /// their middle) to 1 / (number of draws used). Small with a small score: the beam is fine, the prior is
    /// not.
    pub prior_tail: f64,
    /// Distance of the frequencies, each by itself, from the mean of the prior's records in ln f, as a multiple of the farthest of
    /// 4096 of them on the same side; of the least distant frequency.
    pub prior_distance: f64,
    /// True if no rod of the prior has any of the frequencies: each lies beyond the farthest of the 4096 by more than a normal tail
    /// does in a million records.
    pub is_outside_prior: bool,
}

impl Conflict {
    /// Solves the grid that every score of the first `modes` starts from, once per process; without this call the first score
    /// does it.
    pub fn prepare(modes: usize) {
        (0..modes.min(MAX_MODES)).for_each(|mode| {
            grid(mode);
        });
    }
}

/// A ratio of two observed frequencies that no tensioned beam on rotational springs has.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Violation {
    /// The higher mode order.
    pub higher: usize,
    /// The lower mode order.
    pub lower: usize,
    /// Observed ratio of their frequencies.
    pub ratio: f64,
    /// Smallest ratio: the string's.
    pub smallest: f64,
    /// Largest ratio: the hinged beam's without tension.
    pub largest: f64,
    /// Distance outside that range, in standard deviations of the ratio.
    pub deviations: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            higher,
            lower,
            ratio,
            smallest,
            largest,
            ..
        } = self;
        write!(
            f,
            "f{higher}/f{lower} = {ratio:.3}, a tensioned beam on rotational springs has {smallest:.3} to {largest:.3}"
        )
    }
}

/// Best fit of the model to an observation.
pub(super) struct Nearest {
    pub score: f64,
    pub nearest_hz: Vec<f64>,
    pub residuals: Vec<f64>,
}

/// The nearest reproducible frequencies; `orders` within 1 to [`MAX_MODES`], all of one length.
pub(super) fn nearest(orders: &[usize], frequency_hz: &[f64], sd_hz: &[f64]) -> Nearest {
    let data = Data {
        orders,
        frequency_hz,
        sd_hz: &floored(frequency_hz, sd_hz),
    };
    let mut best: Option<Fit> = None;
    for start in data.starts() {
        let known = best.map_or(f64::INFINITY, |best: Fit| best.squared);
        if known < NEGLIGIBLE {
            break;
        }
        let fit = refine(&data, start, known);
        if best.is_none() || fit.squared < known {
            best = Some(fit);
        }
    }
    let best = best.unwrap_or_default();
    let residuals = best.residuals[..orders.len()].to_vec();
    Nearest {
        score: best.squared.sqrt(),
        nearest_hz: (0..orders.len())
            .map(|i| frequency_hz[i] - residuals[i] * data.sd_hz[i])
            .collect(),
        residuals,
    }
}

/// The observed ratio furthest outside `m/n <= f_m/f_n <= (m/n)^2`, in its standard deviations.
///
/// The lower end is the string; bending and end fixity raise higher modes more than lower ones. The
/// upper end is the untensioned hinged beam; tension and fixity raise lower modes more.
pub(super) fn violation(orders: &[usize], frequency_hz: &[f64], sd_hz: &[f64]) -> Option<Violation> {
    let sd_hz = floored(frequency_hz, sd_hz);
    let relative = |i: usize| sd_hz[i] / frequency_hz[i];
    let pairs = (0..orders.len()).flat_map(|high| (0..high).map(move |low| (high, low)));
    pairs
        .filter_map(|(high, low)| {
            let smallest = orders[high] as f64 / orders[low] as f64;
            let largest = smallest * smallest;
            let ratio = frequency_hz[high] / frequency_hz[low];
            let outside = (smallest - ratio).max(ratio - largest);
            (outside > 0.0).then(|| Violation {
                higher: orders[high],
                lower: orders[low],
                ratio,
                smallest,
                largest,
                deviations: outside / (ratio * relative(high).hypot(relative(low))),
            })
        })
        .max_by(|a, b| a.deviations.total_cmp(&b.deviations))
}

fn floored(frequency_hz: &[f64], sd_hz: &[f64]) -> Vec<f64> {
    sd_hz
        .iter()
        .zip(frequency_hz)
        .map(|(sd, f)| sd.max(SMALLEST_RELATIVE_SD * f))
        .collect()
}

struct Data<'a> {
    orders: &'a [usize],
    frequency_hz: &'a [f64],
    sd_hz: &'a [f64],
}

/// Residuals at a point with the best scale.
#[derive(Debug, Clone, Copy, Default)]
struct Fit {
    squared: f64,
    residuals: [f64; MAX_MODES],
    wavenumbers: [f64; MAX_MODES],
}

impl Data<'_> {
    /// Fits the best scale c = sum f g / sd^2 / sum g^2 / sd^2, with its residuals.
    fn fit(&self, [pattern, wavenumbers]: [[f64; MAX_MODES]; 2]) -> Fit {
        let (mut fg, mut gg) = (0.0, 0.0);
        for ((&order, f), sd) in self.orders.iter().zip(self.frequency_hz).zip(self.sd_hz) {
            let g = pattern[order - 1] / sd;
            fg += f / sd * g;
            gg += g * g;
        }
        let scale = fg / gg;
        let mut fit = Fit {
            wavenumbers,
            ..Fit::default()
        };
        for (i, ((&order, f), sd)) in self
            .orders
            .iter()
            .zip(self.frequency_hz)
            .zip(self.sd_hz)
            .enumerate()
        {
            fit.residuals[i] = (f - scale * pattern[order - 1]) / sd;
            fit.squared += fit.residuals[i] * fit.residuals[i];
        }
        fit
    }

    /// Starting points of the refinements: the best place of each of the best lines, no two of them
    /// neighbours.
    fn starts(&self) -> Vec<Point> {
        let mut nearest = vec![(f64::INFINITY, 0.0); LINES.len()];
        vectorised(AlongLines {
            data: self,
            nearest: &mut nearest,
        });
        let mut ranked: Vec<(f64, usize, Point)> = nearest
            .into_iter()
            .enumerate()
            .map(|(i, (squared, position))| (squared, i, at(LINES[i], grid_tension(position))))
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut chosen: Vec<usize> = Vec::new();
        for &(_, line, _) in &ranked {
            let apart = |&other: &usize| {
                let (a, b) = (LINES[line], LINES[other]);
                a[0].abs_diff(b[0]).max(a[1].abs_diff(b[1])) > 2
            };
            if chosen.len() < STARTS && chosen.iter().all(apart) {
                chosen.push(line);
            }
        }
        let place = |line: &usize| ranked.iter().find(|(_, i, _)| i == line).map(|found| found.2);
        chosen.iter().filter_map(place).collect()
    }

    /// Smallest squared distance to the chords between a line's neighbouring patterns, and its
    /// position on the line. On a chord c (a + t (b - a)) the best c and c t follow linearly.
    #[inline(always)]
    fn along(&self, line: usize) -> (f64, f64) {
        let [mut aa, mut ad, mut dd, mut fa, mut fd] = [[0.0; TENSIONS - 1]; 5];
        let mut ff = 0.0;
        for ((&order, frequency), sd) in self.orders.iter().zip(self.frequency_hz).zip(self.sd_hz) {
            let f = frequency / sd;
            ff += f * f;
            let pattern = grid(order - 1)[line].map(|value| value / sd);
            for i in 0..TENSIONS - 1 {
                let (a, d) = (pattern[i], pattern[i + 1] - pattern[i]);
                aa[i] += a * a;
                ad[i] += a * d;
                dd[i] += d * d;
                fa[i] += f * a;
                fd[i] += f * d;
            }
        }
        let (mut squared, mut shares) = ([0.0; TENSIONS - 1], [0.0; TENSIONS - 1]);
        for i in 0..TENSIONS - 1 {
            let free = (fd[i] * aa[i] - fa[i] * ad[i]) / (fa[i] * dd[i] - fd[i] * ad[i]);
            let t = if free.is_finite() {
                free.clamp(0.0, 1.0)
            } else {
                0.0
            };
            let (fg, gg) = (fa[i] + t * fd[i], aa[i] + 2.0 * t * ad[i] + t * t * dd[i]);
            (squared[i], shares[i]) = (ff - fg * fg / gg, t);
        }
        let mut best = (f64::INFINITY, 0.0);
        for (i, (squared, share)) in squared.into_iter().zip(shares).enumerate() {
            if squared < best.0 {
                best = (squared, i as f64 + share);
            }
        }
        best
    }

    /// The fit at a point, sooner with the wavenumbers of one close to it.
    fn at(&self, point: Point, near: &[f64; MAX_MODES]) -> Fit {
        self.fit(pattern(self.orders.iter().map(|order| order - 1), point, near))
    }
}

/// [`Data::along`] of every line.
struct AlongLines<'a> {
    data: &'a Data<'a>,
    nearest: &'a mut [(f64, f64)],
}

impl Kernel for AlongLines<'_> {
    #[inline(always)]
    fn run(self) {
        for (line, nearest) in self.nearest.iter_mut().enumerate() {
            *nearest = self.data.along(line);
        }
    }
}

/// Levenberg's method inside the unit cube, the scale eliminated; a coordinate at a face is fixed while the
/// descent points out of the cube. `known` is the least squared distance found before.
fn refine(data: &Data<'_>, start: Point, known: f64) -> Fit {
    let mut point = start;
    let mut fit = data.at(point, &[0.0; MAX_MODES]);
    let mut damping = 1e-3;
    for _ in 0..STEPS {
        if fit.squared < NEGLIGIBLE {
            break;
        }
        let jacobian: [[f64; MAX_MODES]; 3] = std::array::from_fn(|axis| {
            let mut moved = point;
            let step = if point[axis] > 0.5 { -1e-6 } else { 1e-6 };
            moved[axis] += step;
            let there = data.at(moved, &fit.wavenumbers);
            std::array::from_fn(|i| (there.residuals[i] - fit.residuals[i]) / step)
        });
        let dot =
            |a: &[f64; MAX_MODES], b: &[f64; MAX_MODES]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let gradient = jacobian.map(|column| dot(&column, &fit.residuals));
        let held: [bool; 3] = std::array::from_fn(|axis| {
            (point[axis] <= 0.0 && gradient[axis] > 0.0) || (point[axis] >= 1.0 && gradient[axis] < 0.0)
        });
        let before = fit.squared;
        let mut improved = false;
        // One damping for all axes: directions without curvature then get nearly no step, where
        // Marquardt's scaling would send them across the cube.
        let steepest = jacobian
            .iter()
            .map(|column| dot(column, column))
            .fold(1e-12, f64::max);
        for _ in 0..8 {
            let normal = nalgebra::Matrix3::from_fn(|i, j| match (held[i] || held[j], i == j) {
                (true, true) => 1.0,
                (true, false) => 0.0,
                (false, diagonal) => {
                    dot(&jacobian[i], &jacobian[j]) + if diagonal { damping * steepest } else { 0.0 }
                }
            });
            let right = nalgebra::Vector3::from_fn(|i, _| if held[i] { 0.0 } else { -gradient[i] });
            let Some(step) = normal.lu().solve(&right) else {
                damping *= 10.0;
                continue;
            };
            let trial: Point = std::array::from_fn(|axis| (point[axis] + step[axis]).clamp(0.0, 1.0));
            let there = data.at(trial, &fit.wavenumbers);
            if there.squared < fit.squared {
                (point, fit) = (trial, there);
                damping = (damping * 0.2).max(1e-12);
                improved = true;
                break;
            }
            damping *= 10.0;
        }
        let is_known = (known..(1.0 + BESIDE) * known).contains(&fit.squared);
        let least = if is_known { GAIN_BESIDE } else { LEAST_GAIN };
        if !improved || before - fit.squared < least * before {
            break;
        }
    }
    fit
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ratios_stay_between_string_and_hinged_beam() {
        let mut extremes = [(f64::INFINITY, 0f64); MAX_MODES * MAX_MODES];
        let points = (0..LINES.len()).flat_map(|line| (0..TENSIONS).map(move |i| (line, i)));
        for (line, i) in points {
            let pattern: [f64; MAX_MODES] = std::array::from_fn(|mode| grid(mode)[line][i]);
            for high in 1..MAX_MODES {
                for low in 0..high {
                    let ratio = pattern[high] / pattern[low];
                    let (least, most) = &mut extremes[high * MAX_MODES + low];
                    *least = least.min(ratio);
                    *most = most.max(ratio);
                }
            }
        }
        for high in 1..MAX_MODES {
            for low in 0..high {
                let (least, most) = extremes[high * MAX_MODES + low];
                let string = (high + 1) as f64 / (low + 1) as f64;
                // Both ends belong to the grid: hit, and never passed by more than rounding.
                assert!((least / string - 1.0).abs() < 1e-6, "{high} {low}: {least}");
                assert!(most <= string * string * (1.0 + 1e-12));
                assert!(most > string * string * (1.0 - 1e-3), "{high} {low}: {most}");
            }
        }
    }

    fn rod(generator: &mut impl rand::Rng) -> [f64; MAX_MODES] {
        use rand::RngExt;
        let point = [generator.random(), generator.random(), generator.random()];
        pattern(0..MAX_MODES, point, &[0.0; MAX_MODES])[0].map(|g| 4.5 * g)
    }

    /// Any subset of at least one mode.
    fn subsets() -> impl Iterator<Item = Vec<usize>> {
        (1..1usize << MAX_MODES).map(|bits| (1..=MAX_MODES).filter(|n| bits >> (n - 1) & 1 == 1).collect())
    }

    fn of(orders: &[usize], all: &[f64; MAX_MODES]) -> Vec<f64> {
        orders.iter().map(|&order| all[order - 1]).collect()
    }

    #[test]
    fn what_the_model_produces_is_no_conflict() {
        let mut generator = crate::numerics::random::stream(3, 0);
        for _ in 0..30 {
            let all = rod(&mut generator);
            for orders in subsets() {
                let f = of(&orders, &all);
                // A clean record: 2 mHz at 4.5 Hz, the same share of higher modes.
                let sd: Vec<f64> = f.iter().map(|f| 5e-4 * f).collect();
                let near = nearest(&orders, &f, &sd);
                // A tenth of a standard deviation is nothing; worst are beams with nearly no tension.
                assert!(near.score < 0.1, "{orders:?} {f:?}: {}", near.score);
            }
        }
    }

    #[test]
    fn noise_alone_stays_below_its_own_length() {
        use rand_distr::{Distribution, StandardNormal};
        let mut generator = crate::numerics::random::stream(4, 0);
        for _ in 0..100 {
            let all = rod(&mut generator);
            let z: [f64; MAX_MODES] = std::array::from_fn(|_| StandardNormal.sample(&mut generator));
            let noisy: [f64; MAX_MODES] = std::array::from_fn(|i| all[i] + 2e-3 * z[i]);
            let near = nearest(&[1, 2, 3, 4, 5], &noisy, &[2e-3; 5]);
            let length: f64 = z.iter().map(|z| z * z).sum::<f64>().sqrt();
            assert!(near.score <= length + 0.02, "{} > {length}", near.score);
        }
    }

    /// Against a search that shares only the patterns: random points, then ever smaller random steps.
    #[test]
    fn the_search_finds_what_a_random_search_finds() {
        use rand::RngExt;
        let mut generator = crate::numerics::random::stream(5, 0);
        for orders in [vec![1, 2, 3], vec![1, 3], vec![2, 3, 5], vec![1, 2, 3, 4, 5]] {
            for case in 0..6 {
                // Distorted by up to 5 %: mostly not reproducible.
                let distorted =
                    rod(&mut generator).map(|f| f * (1.0 + 0.1 * (generator.random::<f64>() - 0.5)));
                let f = of(&orders, &distorted);
                let sd = vec![5e-3; f.len()];
                let data = Data {
                    orders: &orders,
                    frequency_hz: &f,
                    sd_hz: &sd,
                };
                let mut best = (f64::INFINITY, [0.0; 3]);
                for trial in 0..6000 {
                    let reach = if trial < 1500 {
                        1.0
                    } else {
                        0.3 * 0.998f64.powi(trial - 1500)
                    };
                    let point = best.1.map(|x: f64| match trial < 1500 {
                        true => generator.random(),
                        false => (x + reach * (2.0 * generator.random::<f64>() - 1.0)).clamp(0.0, 1.0),
                    });
                    let squared = data.at(point, &[0.0; MAX_MODES]).squared;
                    if squared < best.0 {
                        best = (squared, point);
                    }
                }
                let found = nearest(&orders, &f, &sd).score;
                let reference = best.0.sqrt();
                assert!(
                    found <= 1.001 * reference + 0.02,
                    "{orders:?} {case}: {found} > {reference}"
                );
            }
        }
    }

    #[test]
    fn the_rod_of_todi_conflicts_by_its_third_over_its_first_frequency() {
        let f = [4.492, 9.288, 13.252];
        let near = nearest(&[1, 2, 3], &f, &[1e-3f64.sqrt(); 3]);
        // The string (c = sum n f / sum n^2) is at 11.92; bending may only help a little.
        assert!((10.0..=11.93).contains(&near.score), "{}", near.score);
        let violation = violation(&[1, 2, 3], &f, &[1e-3f64.sqrt(); 3]).unwrap();
        assert_eq!((violation.higher, violation.lower), (3, 2));
        assert_eq!(nearest(&[1, 2], &f[..2], &[0.03; 2]).score.round(), 0.0);
    }
}
