//! Time stamps inside messages: nanoseconds, seconds, RFC 3339 text, or seconds and nanoseconds.

/// Nanoseconds from RFC 3339 text.
pub fn from_text(text: &str) -> Option<i64> {
    let time: jiff::Timestamp = text.parse().ok()?;
    i64::try_from(time.as_nanosecond()).ok()
}

/// Nanoseconds from seconds, rounded.
pub fn from_seconds(seconds: f64) -> Option<i64> {
    let nanos = (seconds * 1e9).round();
    // 2^63 is the first float beyond the range.
    (nanos.is_finite() && nanos.abs() < 9.2e18).then_some(nanos as i64)
}

/// Nanoseconds from whole seconds and nanoseconds.
pub fn from_parts(seconds: i64, nanos: i64) -> Option<i64> {
    if !(0..1_000_000_000).contains(&nanos) {
        return None;
    }
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}

/// Nanoseconds from a JSON number: an integer counts nanoseconds, anything else seconds. Decimal
/// seconds are read digit by digit, because a double in 2026 resolves only 240 ns.
pub fn from_number(text: &str) -> Option<i64> {
    if let Ok(nanos) = text.parse::<i64>() {
        return Some(nanos);
    }
    if text.contains(['e', 'E']) {
        return from_seconds(text.parse().ok()?);
    }
    let (whole, fraction) = text.split_once('.')?;
    let negative = whole.starts_with('-');
    let mut nanos = 0i64;
    for i in 0..9 {
        let digit = fraction.as_bytes().get(i).map_or(0, |b| i64::from(b - b'0'));
        nanos = nanos * 10 + digit;
    }
    let seconds: i64 = whole.parse().ok()?;
    let scaled = seconds.checked_mul(1_000_000_000)?;
    if negative {
        scaled.checked_sub(nanos)
    } else {
        scaled.checked_add(nanos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_of_saying_it() {
        let nanos = 1_772_344_800_123_456_789;
        assert_eq!(from_text("2026-03-01T06:00:00.123456789Z"), Some(nanos));
        assert_eq!(from_number("1772344800123456789"), Some(nanos));
        assert_eq!(from_number("1772344800.123456789"), Some(nanos));
        assert_eq!(from_number("-1.5"), Some(-1_500_000_000));
        assert_eq!(from_number("1.5e3"), Some(1_500_000_000_000));
        assert_eq!(from_parts(1_772_344_800, 123_456_789), Some(nanos));
        assert_eq!(from_seconds(2.5), Some(2_500_000_000));
    }

    #[test]
    fn out_of_range_is_none() {
        assert_eq!(from_seconds(f64::NAN), None);
        assert_eq!(from_seconds(1e300), None);
        assert_eq!(from_parts(i64::MAX, 0), None);
        assert_eq!(from_parts(0, 1_000_000_000), None);
        assert_eq!(from_number("99999999999999999999.5"), None);
        assert_eq!(from_text("yesterday"), None);
    }
}
