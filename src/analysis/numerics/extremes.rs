//! Least and largest of many values.

/// Values compared side by side: one after another, each comparison would wait for the last.
const LANES: usize = 8;

/// The least and the largest of some values; NaN is passed over.
pub(crate) fn extremes(values: &[f64]) -> (f64, f64) {
    let (mut low, mut high) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
    let (rows, rest) = values.as_chunks::<LANES>();
    for row in rows {
        for lane in 0..LANES {
            low[lane] = lesser(low[lane], row[lane]);
            high[lane] = greater(high[lane], row[lane]);
        }
    }
    let low = low.iter().chain(rest).copied().fold(f64::INFINITY, lesser);
    let high = high.iter().chain(rest).copied().fold(f64::NEG_INFINITY, greater);
    (low, high)
}

/// The lesser of two; the first if the other is NaN.
#[inline(always)]
fn lesser(known: f64, value: f64) -> f64 {
    if value < known { value } else { known }
}

/// The greater of two; the first if the other is NaN.
#[inline(always)]
fn greater(known: f64, value: f64) -> f64 {
    if value > known { value } else { known }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_those_of_a_search_one_by_one() {
        for count in [0_i32, 1, 7, 8, 9, 41] {
            let values: Vec<f64> = (0..count).map(|i| f64::from(i * i * 7 % 23 - 11)).collect();
            let low = values.iter().copied().fold(f64::INFINITY, f64::min);
            let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            assert_eq!(extremes(&values), (low, high), "{count}");
        }
        assert_eq!(extremes(&[f64::NAN, 2.0, f64::NAN, -1.0]), (-1.0, 2.0));
    }
}
