//! Prior probabilities of the orders that a sensor sees, averaged over its possible places.

use crate::rod::beam::forward::MAX_ORDERS;
use std::f64::consts::PI;
use std::sync::LazyLock;

/// Share of sensors at mid-span; the rest lie anywhere between 4 % and 50 % of the span.
const AT_MID_SPAN: f64 = 0.27;
const PLACES: usize = 12;
const NEAREST_END: f64 = 0.04;
/// A mode is seen with the probability `0.92 S^2 / (S^2 + 0.12^2)`, `S = |sin n pi x|`, within these limits.
const MOST_SEEN: f64 = 0.92;
const HALF_SEEN: f64 = 0.12;
const LIMITS: (f64, f64) = (0.01, 0.97);
/// Probabilities of the last order that is clear of the noise; above it little is seen.
const LAST: [f64; MAX_ORDERS] = [
    0.05, 0.10, 0.15, 0.15, 0.12, 0.10, 0.08, 0.07, 0.06, 0.05, 0.04, 0.03,
];
const SEEN_ABOVE: f64 = 0.02;

/// Share of records in which every order up to the last is seen or not at random, each with probability 1/2:
/// peaks lost to a mask, taken for lines or lost in noise. Without it orders 2, 6 and 8 alone were labelled
/// 1, 5 and 7 with certainty.
const ANY: f64 = 0.1;

/// Orders as a set of bits: bit 0 is the first.
pub(super) type Orders = u16;

/// Prior probability of every set of visible orders, once per number of orders the band holds.
struct Table {
    /// `by_orders[n][set]` for sets of the first n orders.
    by_orders: Vec<Vec<f64>>,
}

static TABLE: LazyLock<Table> = LazyLock::new(Table::new);

impl Table {
    fn new() -> Self {
        let mut all = vec![0.0; 1 << MAX_ORDERS];
        let mut sets = Vec::with_capacity(all.len());
        for place in 0..PLACES + 2 {
            let step = (0.5 - NEAREST_END) / PLACES as f64;
            let (x, weight) = match place {
                0 => (0.0, ANY),
                1 => (0.5, (1.0 - ANY) * AT_MID_SPAN),
                _ => (
                    NEAREST_END + (place as f64 - 1.5) * step,
                    (1.0 - ANY) * (1.0 - AT_MID_SPAN) / PLACES as f64,
                ),
            };
            for last in 1..=MAX_ORDERS {
                sets.clear();
                sets.push(weight * LAST[last - 1]);
                for order in 1..=MAX_ORDERS {
                    let shape = libm::sin(order as f64 * PI * x);
                    let square = shape * shape;
                    let seen = match place {
                        _ if order > last => SEEN_ABOVE,
                        0 => 0.5,
                        _ => {
                            (MOST_SEEN * square / (square + HALF_SEEN * HALF_SEEN)).clamp(LIMITS.0, LIMITS.1)
                        }
                    };
                    for i in 0..sets.len() {
                        let before: f64 = sets[i];
                        sets.push(before * seen);
                        sets[i] = before * (1.0 - seen);
                    }
                }
                for (sum, p) in all.iter_mut().zip(&sets) {
                    *sum += p;
                }
            }
        }
        let mut by_orders = vec![all];
        for orders in (0..MAX_ORDERS).rev() {
            let above = &by_orders[0];
            let half = (0..1usize << orders).map(|set| above[set] + above[set | 1 << orders]);
            by_orders.insert(0, half.collect());
        }
        Self { by_orders }
    }
}

/// Natural logarithm of the probability that exactly the orders `seen` are visible among the first
/// `within`; the orders `hidden` (outside the band or masked) do not count.
pub(super) fn log_probability(seen: Orders, within: usize, hidden: Orders) -> f64 {
    let within = within.clamp(1, MAX_ORDERS);
    let inside = ((1u32 << within) - 1) as Orders;
    let table = &TABLE.by_orders[within];
    let (seen, hidden) = (seen & inside, hidden & inside & !seen);
    let mut sum = 0.0;
    // Every subset of the hidden orders, the empty one last.
    let mut subset = hidden;
    loop {
        sum += table[usize::from(seen | subset)];
        if subset == 0 {
            break;
        }
        subset = (subset - 1) & hidden;
    }
    libm::log(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sets_of_any_number_of_orders_share_all_the_probability() {
        for within in [1, 5, MAX_ORDERS] {
            let total: f64 = (0..1u32 << within)
                .map(|set| log_probability(set as Orders, within, 0).exp())
                .sum();
            // 4096 roundings.
            assert!((total - 1.0).abs() < 1e-12, "{within}: {total}");
        }
    }

    #[test]
    fn a_mode_out_of_sight_takes_nothing_away() {
        let seen = 0b101;
        let either = log_probability(seen, 4, 0).exp() + log_probability(0b111, 4, 0).exp();
        assert!((log_probability(seen, 4, 0b010).exp() / either - 1.0).abs() < 1e-12);
        // Odd orders alone are a sensor at mid-span; two even ones alone are hardly any sensor.
        assert!(log_probability(0b10101, 5, 0) > log_probability(0b01010, 5, 0) + 3.0);
    }
}
