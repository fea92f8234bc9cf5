//! Columns that rise evenly: stamps without a name, or a count of the rows.

use super::{ImportError, Signal, Timing, is_time_name};
use crate::read::contents::rounded;

/// Number of rows from which a rise is no accident.
const ENOUGH: usize = 8;
/// Largest distance from a straight line of an even rise, in steps. Stamps of few digits lie off by up to
/// their last digit, which is no more than a step, or they would repeat.
const UNEVEN: f64 = 1.0;
/// Largest relative difference of two rates that count as equal.
const RATE_ERROR: f64 = 1e-3;

/// An even rise.
pub(super) struct Ramp {
    step: f64,
    /// Largest relative error of the step: stamps of few digits do not give it better.
    tolerance: f64,
}

/// Rise of a column, if it rises evenly.
pub(super) fn ramp(values: &[f64]) -> Option<Ramp> {
    let (first, last) = (*values.first()?, *values.last()?);
    let step = (last - first) / (values.len().checked_sub(1)? as f64);
    if values.len() < ENOUGH || !(step.is_finite() && step > 0.0) {
        return None;
    }
    let off = |(index, value): (usize, &f64)| (value - first - index as f64 * step).abs();
    let farthest = values.iter().enumerate().map(off).fold(0.0, f64::max);
    let rises = values.windows(2).all(|pair| pair[1] > pair[0]);
    (rises && farthest <= UNEVEN * step).then(|| Ramp {
        step,
        tolerance: RATE_ERROR.max(2.0 * farthest / (last - first)),
    })
}

/// True if a channel without stamps is called the time, or rises evenly as time does.
pub(super) fn is_time(signal: &Signal) -> bool {
    signal.timing == Timing::Unknown && (is_time_name(&signal.name) || ramp(&signal.values).is_some())
}

/// Returns an error if a column of the file contradicts the rate. A count of the rows contradicts nothing.
pub(super) fn agree<'s>(
    signals: impl IntoIterator<Item = &'s Signal>,
    rate_hz: f64,
) -> Result<(), ImportError> {
    for signal in signals
        .into_iter()
        .filter(|signal| signal.timing == Timing::Unknown)
    {
        let Some(Ramp { step, tolerance }) = ramp(&signal.values) else {
            continue;
        };
        let is_count = signal.values.iter().all(|value| value.fract() == 0.0) && step == 1.0;
        let is_said = [1.0, 1e3, 1e6, 1e9, 1.0 / 60.0, 1.0 / 3600.0, 1.0 / 86_400.0]
            .iter()
            .any(|units| (units / step / rate_hz - 1.0).abs() <= tolerance);
        if !is_count && !is_said {
            return Err(ImportError::new(format!(
                "{} rises evenly by {}, which is {} Hz if it is a time in seconds, but --rate says {rate_hz} Hz: if it is the \
                 time, say --rate {}; --channel says which column is the motion",
                super::asked::told(signal),
                rounded(step),
                rounded(1.0 / step),
                rounded(1.0 / step)
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column(values: Vec<f64>) -> Vec<Signal> {
        vec![Signal {
            name: "x".into(),
            number: 1,
            unit: None,
            timing: Timing::Unknown,
            values,
        }]
    }

    #[test]
    fn an_even_rise_speaks_of_its_rate() {
        let rising = |step: f64| column((0..50).map(|i| 3.0 + f64::from(i) * step).collect());
        let refused = agree(&rising(0.005), 100.0).unwrap_err().to_string();
        assert!(
            refused.contains("say --rate 200") && refused.contains("100 Hz"),
            "{refused}"
        );
        // The same in milliseconds, and a count of rows.
        assert_eq!(agree(&rising(0.005), 200.0), Ok(()));
        assert_eq!(agree(&rising(5.0), 200.0), Ok(()));
        assert_eq!(agree(&rising(1.0), 200.0), Ok(()));
        assert!(agree(&rising(2.0), 200.0).is_err());
        assert_eq!(agree(&rising(0.005 / 86_400.0), 200.0), Ok(()));
    }

    #[test]
    fn a_signal_is_no_rise() {
        let motion: Vec<f64> = (0..50).map(|i| (f64::from(i) * 0.3).sin()).collect();
        assert!(ramp(&motion).is_none());
        let bent: Vec<f64> = (0..50).map(|i| f64::from(i * i)).collect();
        assert!(ramp(&bent).is_none());
        assert!(ramp(&[0.0, 1.0, 2.0]).is_none());
        // Written to the millisecond: 300 Hz.
        let coarse = column((0..50).map(|i| (f64::from(i) / 0.3).round() / 1e3).collect());
        assert_eq!(agree(&coarse, 300.0), Ok(()));
        assert!(agree(&coarse, 250.0).is_err());
    }
}
