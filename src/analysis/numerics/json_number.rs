//! Reads numbers from JSON, which writes null for a number that is not finite.

use serde::{Deserialize, Deserializer};

/// Reads a number; null as not-a-number.
pub(crate) fn nan_if_null<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(input)?.unwrap_or(f64::NAN))
}
