//! Assignments of peaks to mode orders as numbers.

use super::visibility::Orders;
use crate::rod::beam::forward::MAX_ORDERS;

/// Assignment packed into four bits an order, from the first: the number of its peak counted from 1, or
/// 0 for an order not seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub(super) struct Code(pub(super) u64);

impl Code {
    /// Peak of an order, if it is seen.
    #[inline]
    pub(super) fn peak_of(self, order: usize) -> Option<usize> {
        ((self.0 >> (4 * (order - 1)) & 15) as usize).checked_sub(1)
    }

    /// This assignment with `peak` as `order`, or with the order not seen.
    #[inline]
    pub(super) fn with(self, order: usize, peak: Option<usize>) -> Self {
        let at = 4 * (order - 1);
        let peak = peak.map_or(0, |peak| peak as u64 + 1);
        Self(self.0 & !(15 << at) | peak << at)
    }

    /// Pairs of order and peak, ascending.
    pub(super) fn pairs(self) -> impl Iterator<Item = (usize, usize)> {
        (1..=MAX_ORDERS).filter_map(move |order| Some((order, self.peak_of(order)?)))
    }

    /// Order of a peak, if it is a mode.
    pub(super) fn order_of(self, peak: usize) -> Option<usize> {
        self.pairs().find(|&(_, p)| p == peak).map(|(order, _)| order)
    }

    /// Set of the orders seen.
    pub(super) fn orders(self) -> Orders {
        self.pairs().fold(0, |set, (order, _)| set | 1 << (order - 1))
    }

    /// True if peaks rise with the orders.
    pub(super) fn is_ascending(self) -> bool {
        let mut last = None;
        self.pairs().all(|(_, peak)| {
            let rises = last.is_none_or(|last| peak > last);
            last = Some(peak);
            rises
        })
    }

    /// True if every pair of `other` is in this assignment too.
    pub(super) fn contains(self, other: Self) -> bool {
        other
            .pairs()
            .all(|(order, peak)| self.peak_of(order) == Some(peak))
    }

    /// True if some peak of `other` has another order here.
    pub(super) fn contradicts(self, other: Self) -> bool {
        other
            .pairs()
            .any(|(order, peak)| self.order_of(peak).is_some_and(|own| own != order))
    }

    /// All orders one higher or one lower; `None` if one would leave the range.
    pub(super) fn shifted(self, up: bool) -> Option<Self> {
        let top = 15 << (4 * (MAX_ORDERS - 1));
        match up {
            true if self.0 & top != 0 => None,
            false if self.0 & 15 != 0 => None,
            true => Some(Self(self.0 << 4)),
            false => Some(Self(self.0 >> 4)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_go_in_and_come_out() {
        let code = Code::default()
            .with(1, Some(0))
            .with(3, Some(14))
            .with(12, Some(2));
        assert_eq!(code.pairs().collect::<Vec<_>>(), [(1, 0), (3, 14), (12, 2)]);
        assert_eq!(code.orders(), 0b1000_0000_0101);
        assert!(!code.is_ascending());
        let code = code.with(12, None);
        assert!(code.is_ascending() && code.order_of(14) == Some(3));
        let shifted = code.shifted(true).unwrap();
        assert_eq!(shifted.pairs().collect::<Vec<_>>(), [(2, 0), (4, 14)]);
        assert!(shifted.contradicts(code) && !code.contradicts(code));
        assert_eq!(shifted.shifted(false), Some(code));
        assert_eq!(code.shifted(false), None);
        assert_eq!(Code::default().with(12, Some(0)).shifted(true), None);
        assert!(code.contains(Code::default().with(3, Some(14))));
        assert!(!code.contains(shifted));
    }
}
