//! Converts numbers of binary files to doubles.

use super::ImportError;
use std::io::Read;

/// Number of bytes read at once; a multiple of every number's size.
const BLOCK: usize = 3 << 14;

/// Kind of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    I8,
    U8,
    I16,
    U16,
    I24,
    I32,
    U32,
    I64,
    U64,
    F16,
    F32,
    F64,
}

/// An integer that a double cannot represent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Inexact;

impl std::fmt::Display for Inexact {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("holds whole numbers beyond 2^53, which a double cannot hold")
    }
}

impl Kind {
    /// Reads up to `count` numbers; returns how many there were.
    pub(super) fn read(
        self,
        mut from: impl Read,
        count: usize,
        is_little: bool,
        mut each: impl FnMut(f64),
    ) -> Result<usize, ImportError> {
        let mut left = count * self.size();
        let mut block = Vec::new();
        while left > 0 {
            block.clear();
            from.by_ref()
                .take(left.min(BLOCK) as u64)
                .read_to_end(&mut block)
                .map_err(|error| ImportError::unreadable(&error))?;
            if block.len() < left.min(BLOCK) {
                return Ok(count - (left - block.len()).div_ceil(self.size()));
            }
            left -= block.len();
            self.each(&block, is_little, &mut each)
                .map_err(|error| ImportError::new(error.to_string()))?;
        }
        Ok(count)
    }

    /// Size of one number \[bytes\].
    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 | Self::F16 => 2,
            Self::I24 => 3,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    /// Calls back with each number in `bytes`; an incomplete last one is ignored.
    ///
    /// # Errors
    /// A whole number that a double cannot hold.
    pub(super) fn each(
        self,
        bytes: &[u8],
        is_little: bool,
        mut each: impl FnMut(f64),
    ) -> Result<(), Inexact> {
        macro_rules! read {
            ($number:ty, $convert:expr) => {
                for chunk in bytes.chunks_exact(size_of::<$number>()) {
                    if let Ok(chunk) = chunk.try_into() {
                        let number = if is_little {
                            <$number>::from_le_bytes(chunk)
                        } else {
                            <$number>::from_be_bytes(chunk)
                        };
                        each($convert(number)?);
                    }
                }
            };
        }
        fn sure<T: Into<f64>>(number: T) -> Result<f64, Inexact> {
            Ok(number.into())
        }
        match self {
            Self::I8 => read!(i8, sure),
            Self::U8 => read!(u8, sure),
            Self::I16 => read!(i16, sure),
            Self::U16 => read!(u16, sure),
            Self::I24 => {
                for chunk in bytes.chunks_exact(3) {
                    if let [a, b, c] = *chunk {
                        let [a, b, c] = if is_little { [a, b, c] } else { [c, b, a] };
                        // Into the upper bytes, so that the sign comes along.
                        each(f64::from(i32::from_le_bytes([0, a, b, c]) >> 8));
                    }
                }
            }
            Self::I32 => read!(i32, sure),
            Self::U32 => read!(u32, sure),
            Self::F16 => read!(u16, |bits| Ok(half(bits))),
            Self::F32 => read!(f32, sure),
            Self::F64 => read!(f64, sure),
            Self::I64 => read!(i64, |number: i64| match number.unsigned_abs() <= 1 << 53 {
                true => Ok(number as f64),
                false => Err(Inexact),
            }),
            Self::U64 => read!(u64, |number: u64| match number <= 1 << 53 {
                true => Ok(number as f64),
                false => Err(Inexact),
            }),
        }
        Ok(())
    }
}

/// A 16-bit float of IEEE 754.
fn half(bits: u16) -> f64 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 0x1f), f64::from(bits & 0x3ff));
    sign * match exponent {
        0 => fraction * 2_f64.powi(-24),
        31 if fraction == 0.0 => f64::INFINITY,
        31 => f64::NAN,
        _ => (1024.0 + fraction) * 2_f64.powi(exponent - 25),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(kind: Kind, bytes: &[u8], is_little: bool) -> Result<Vec<f64>, Inexact> {
        let mut found = Vec::new();
        kind.each(bytes, is_little, |value| found.push(value))?;
        Ok(found)
    }

    #[test]
    fn both_byte_orders_and_odd_sizes() {
        assert_eq!(
            all(Kind::I24, &[1, 0, 0, 0xff, 0xff, 0xff, 9], true),
            Ok(vec![1.0, -1.0])
        );
        assert_eq!(
            all(Kind::I24, &[0, 0, 1, 0x80, 0, 0], false),
            Ok(vec![1.0, -8_388_608.0])
        );
        assert_eq!(all(Kind::I16, &[0x01, 0x02], false), Ok(vec![258.0]));
        assert_eq!(all(Kind::U8, &[255], true), Ok(vec![255.0]));
        assert_eq!(all(Kind::I64, &i64::MIN.to_le_bytes(), true), Err(Inexact));
        assert_eq!(
            all(Kind::U64, &(1_u64 << 53).to_be_bytes(), false),
            Ok(vec![9_007_199_254_740_992.0])
        );
    }

    #[test]
    fn halves_are_what_ieee_says() {
        for (bits, value) in [
            (0x3c00_u16, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0001, 5.960_464_477_539_063e-8),
            (0x0400, 6.103_515_625e-5),
            (0x3555, 0.333_251_953_125),
            (0x7c00, f64::INFINITY),
        ] {
            assert_eq!(all(Kind::F16, &bits.to_le_bytes(), true), Ok(vec![value]));
        }
        assert!(half(0x7e00).is_nan());
    }
}
