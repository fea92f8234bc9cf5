//! Numbers out of JSON, which writes null for those that are not finite.

use serde::{Deserialize, Deserializer};

/// A number, or not-a-number for null.
pub(crate) fn nan_if_null<'de, D: Deserializer<'de>>(input: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(input)?.unwrap_or(f64::NAN))
}
