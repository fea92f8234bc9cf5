//! Numbers of JSON as text, rounded correctly.

/// Reads a number of the common form `-?digits.digits` with at most 15 digits, and its end; `None` for any
/// other text.
#[inline(always)]
pub(super) fn plain(bytes: &[u8], start: usize) -> Option<(f64, usize)> {
    let rest = bytes.get(start..)?;
    let (negative, rest) = match rest {
        [b'-', rest @ ..] => (true, rest),
        _ => (false, rest),
    };
    let mut mantissa = 0u64;
    let whole = digits(rest, &mut mantissa);
    let fraction = match rest.get(whole) {
        Some(b'.') => digits(&rest[whole + 1..], &mut mantissa),
        _ => return None,
    };
    let length = whole + 1 + fraction;
    let sound = fraction > 0 && (whole == 1 || (whole > 1 && rest[0] != b'0'));
    if !sound || whole + fraction > 15 || matches!(rest.get(length), Some(b'e' | b'E')) {
        return None;
    }
    let value = mantissa as f64 / POWERS[fraction];
    Some((
        if negative { -value } else { value },
        start + usize::from(negative) + length,
    ))
}

/// Appends the digits at the start to a number, wrapping; returns their number.
#[inline(always)]
pub(super) fn digits(bytes: &[u8], number: &mut u64) -> usize {
    let mut count = 0;
    for byte in bytes {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            break;
        }
        *number = number.wrapping_mul(10).wrapping_add(u64::from(digit));
        count += 1;
    }
    count
}

pub(super) struct Number {
    pub negative: bool,
    pub exact: bool,
    pub mantissa: u64,
    pub exponent: i64,
    pub start: usize,
    pub end: usize,
}

impl Number {
    /// The nearest float. Mantissa and power of ten are exact floats in the common case, so that one
    /// operation rounds once (Clinger 1990); the standard library does the rest.
    #[inline]
    pub fn value(&self, text: &str) -> f64 {
        if !self.exact {
            let digits = text.get(self.start..self.end).unwrap_or_default();
            return digits.parse().unwrap_or(f64::NAN);
        }
        let mantissa = self.mantissa as f64;
        let power = POWERS[self.exponent.unsigned_abs() as usize];
        let value = if self.exponent < 0 {
            mantissa / power
        } else {
            mantissa * power
        };
        if self.negative { -value } else { value }
    }
}

/// The powers of ten that are exact floats.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];
