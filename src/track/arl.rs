//! Average run lengths of one-sided and two-sided CUSUM charts from the integral equation.
//!
//! The chart C = max(0, C + r - k), alarm above h, with r ~ N(mu, 1), has from C = z the mean run length
//!
//! ```text
//! L(z) = 1 + L(0) Phi(k - z - mu) + int_0^h L(x) phi(x - z + k - mu) dx
//! ```
//!
//! (Page, Biometrika 41, 1954), a Fredholm equation of the second kind with an atom at zero. A Gauss-Legendre
//! rule makes it a Markov chain on zero and the nodes, which is solved by eliminating states with sums of
//! probabilities alone (Grassmann, Taksar and Heyman, Operations Research 33, 1985): no difference of nearly
//! equal numbers appears, so that run lengths of 1e7 are as good as short ones.

use crate::emulator::basis::{Gauss, Recurrence};
use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Density of the standard normal.
pub(super) fn density(x: f64) -> f64 {
    libm::exp(-0.5 * x * x) / (2.0 * PI).sqrt()
}

/// P(Z < x) of the standard normal.
pub(super) fn distribution(x: f64) -> f64 {
    0.5 * libm::erfc(-x * FRAC_1_SQRT_2)
}

/// Nodes that resolve a kernel of unit width over an interval of length `h` to rounding.
pub(super) fn nodes_for(h: f64) -> usize {
    24 + (3.0 * h).ceil() as usize
}

/// The Gauss-Legendre rule on -1 to 1, weights of sum one.
pub(super) fn legendre(points: usize) -> Gauss {
    Recurrence::legendre(points).gauss(points)
}

/// Average run length of the one-sided chart C = max(0, C + r - k), alarm above h, r ~ N(`shift`, 1), from zero.
pub fn one_sided(k: f64, h: f64, shift: f64) -> f64 {
    with_rule(&legendre(nodes_for(h)), k, h, shift)
}

/// Average run length of the two-sided chart: 1 / L = 1 / L+ + 1 / L- (exact for equal sides: one side alarms
/// only while the other is at zero; van Dobben de Bruyn, 1968).
pub fn two_sided(k: f64, h: f64, shift: f64) -> f64 {
    let rule = legendre(nodes_for(h));
    1.0 / (1.0 / with_rule(&rule, k, h, shift) + 1.0 / with_rule(&rule, k, h, -shift))
}

/// The limit h that gives the two-sided chart the mean run length `arl` without a shift; zero if even that gives more.
pub fn limit(k: f64, arl: f64) -> f64 {
    // Siegmund's approximation (1985), L = (exp(2 k b) - 2 k b - 1) / (2 k^2) with b = h + 1.166, tells where to look.
    let wanted = 2.0 * arl;
    let guess = (libm::log(1.0 + 2.0 * k * k * wanted) / (2.0 * k)).min(wanted.sqrt());
    let rule = legendre(nodes_for(1.5 * guess));
    let excess = |h: f64| libm::log(with_rule(&rule, k, h, 0.0) / wanted);
    if excess(0.0) >= 0.0 {
        return 0.0;
    }
    let mut high = guess.max(1.0);
    while excess(high) < 0.0 {
        high *= 1.25;
    }
    root(excess, 0.0, high, 1e-10)
}

/// The zero of an increasing function between `low`, where it is negative, and `high`, where it is not, to a relative
/// `tolerance`: regula falsi, a stale end halved (Illinois).
pub(super) fn root(f: impl Fn(f64) -> f64, mut low: f64, mut high: f64, tolerance: f64) -> f64 {
    let (mut at_low, mut at_high) = (f(low), f(high));
    let mut middle = high;
    for _ in 0..100 {
        let next = (low * at_high - high * at_low) / (at_high - at_low);
        if !next.is_finite() || (next - middle).abs() <= tolerance * high.abs() {
            break;
        }
        let last_was_low = middle == low;
        middle = next;
        let value = f(middle);
        if value < 0.0 {
            (low, at_low) = (middle, value);
            if last_was_low {
                at_high *= 0.5;
            }
        } else {
            (high, at_high) = (middle, value);
            if !last_was_low {
                at_low *= 0.5;
            }
        }
    }
    middle
}

/// The mean run length with a given rule.
fn with_rule(rule: &Gauss, k: f64, h: f64, shift: f64) -> f64 {
    let states = rule.nodes.len() + 1;
    // State 0 is the atom, the others are the nodes.
    let at: Vec<f64> = std::iter::once(0.0)
        .chain(rule.nodes.iter().map(|node| 0.5 * h * (node + 1.0)))
        .collect();
    let mut moves: Vec<Vec<f64>> = at
        .iter()
        .map(|z| {
            let jump = |(x, weight): (&f64, &f64)| h * weight * density(x - z + k - shift);
            std::iter::once(distribution(k - z - shift))
                .chain(at[1..].iter().zip(&rule.weights).map(jump))
                .collect()
        })
        .collect();
    let mut alarm: Vec<f64> = at.iter().map(|z| distribution(z + shift - k - h)).collect();
    let mut time = vec![1.0; states];
    for last in (1..states).rev() {
        let (before, after) = moves.split_at_mut(last);
        let from = &after[0][..last];
        let leaving = alarm[last] + from.iter().sum::<f64>();
        for (state, row) in before.iter_mut().enumerate() {
            let share = row[last] / leaving;
            alarm[state] += share * alarm[last];
            time[state] += share * time[last];
            for (to, by) in row[..last].iter_mut().zip(from) {
                *to += share * by;
            }
        }
    }
    time[0] / alarm[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_published_run_lengths_to_all_shown_digits() {
        let rounded = |x: f64, digits: i32| (x * 10f64.powi(digits)).round() / 10f64.powi(digits);
        assert_eq!(rounded(one_sided(0.5, 4.0, 0.0), 2), 335.37);
        assert_eq!(rounded(two_sided(0.5, 4.0, 0.0), 1), 167.7);
        assert_eq!(rounded(one_sided(0.5, 5.0, 0.0), 1), 930.9);
        assert_eq!(rounded(two_sided(0.5, 5.0, 0.0), 1), 465.4);
        // Montgomery, Introduction to Statistical Quality Control, table 9.3: two-sided, k = 1/2.
        for (shift, h4, h5, digits) in [
            (0.25, 74.2, 139.0, 1),
            (0.5, 26.6, 38.0, 1),
            (0.75, 13.3, 17.0, 1),
            (1.0, 8.38, 10.4, 2),
            (1.5, 4.75, 5.75, 2),
            (2.0, 3.34, 4.01, 2),
            (2.5, 2.62, 3.11, 2),
            (3.0, 2.19, 2.57, 2),
            (4.0, 1.71, 2.01, 2),
        ] {
            assert_eq!(rounded(two_sided(0.5, 4.0, shift), digits), h4, "{shift}");
            let coarser = if h5 >= 100.0 {
                0
            } else if h5 >= 10.0 {
                1
            } else {
                digits
            };
            assert_eq!(rounded(two_sided(0.5, 5.0, shift), coarser), h5, "{shift}");
        }
    }

    /// Brook and Evans (1972): the chart on a lattice of cells as a Markov chain, its mean run length extrapolated to
    /// cells of no width from two lattices (error of order w^2). Solved by plain elimination: shares nothing with the
    /// integral equation but the normal distribution.
    fn markov_chain(k: f64, h: f64, shift: f64) -> f64 {
        let length = |cells: usize| {
            let width = 2.0 * h / (2 * cells - 1) as f64;
            let step = |from: usize, to: usize| {
                let centre = (to as f64 - from as f64) * width + k - shift;
                let below = if to == 0 {
                    0.0
                } else {
                    distribution(centre - 0.5 * width)
                };
                distribution(centre + 0.5 * width) - below
            };
            let mut matrix = nalgebra::DMatrix::from_fn(cells, cells, |i, j| -step(i, j));
            for i in 0..cells {
                matrix[(i, i)] += 1.0;
            }
            let ones = nalgebra::DVector::from_element(cells, 1.0);
            matrix.lu().solve(&ones).unwrap()[0]
        };
        let (coarse, fine) = (length(100), length(200));
        let ratio = (399.0f64 / 199.0).powi(2);
        (ratio * fine - coarse) / (ratio - 1.0)
    }

    #[test]
    fn agrees_with_a_markov_chain_on_a_lattice() {
        for (k, h, shift) in [
            (0.05, 10.0, 0.0),
            (0.1, 15.0, 0.0),
            (0.2, 12.0, 0.0),
            (0.25, 8.01, 0.0),
            (0.25, 8.01, 0.5),
            (0.5, 6.5, 0.0),
            (0.75, 3.34, 0.0),
            (1.0, 2.52, 0.0),
            (0.5, 4.0, -0.3),
            (0.2, 12.0, 1.3),
        ] {
            let (equation, chain) = (one_sided(k, h, shift), markov_chain(k, h, shift));
            // What the extrapolation leaves is of order w^4, w up to 0.15.
            assert!(
                (equation / chain - 1.0).abs() < 3e-4,
                "{k} {h} {shift}: {equation} {chain}"
            );
        }
    }

    #[test]
    fn does_not_depend_on_the_nodes() {
        for (k, h) in [(0.05, 40.0), (0.2, 30.0), (0.5, 12.0), (1.5, 5.0)] {
            let more = with_rule(&legendre(2 * nodes_for(h)), k, h, 0.0);
            assert!(
                (one_sided(k, h, 0.0) / more - 1.0).abs() < 1e-10,
                "{k} {h} {more}"
            );
        }
    }

    #[test]
    fn the_limit_gives_the_run_length_back() {
        for (k, arl) in [
            (0.05, 500.0),
            (0.2, 3652.0),
            (0.5, 465.4),
            (0.5, 1e7),
            (0.1, 1e6),
            (2.0, 1e7),
        ] {
            let h = limit(k, arl);
            assert!((two_sided(k, h, 0.0) / arl - 1.0).abs() < 1e-8, "{k} {arl}: {h}");
        }
        assert_eq!(limit(0.05, 0.5), 0.0);
    }
}
