//! Something large that may be there, in a text format as postcard in base64, behind the number of its layout.
//!
//! As JSON a bank of filters is a megabyte of digits, which are slow to write and slower to read. What is of another layout reads as
//! nothing: a drift watch is then made again from the periods.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::de::{DeserializeOwned, Error as _};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::ops::{Deref, DerefMut};

/// Changes whenever a field of what is packed comes, goes or moves.
const LAYOUT: &str = "1:";

/// An optional value that is packed in text formats.
#[derive(Debug, Clone, PartialEq)]
pub struct Packed<T>(pub Option<T>);

impl<T> Default for Packed<T> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T> Deref for Packed<T> {
    type Target = Option<T>;

    fn deref(&self) -> &Option<T> {
        &self.0
    }
}

impl<T> DerefMut for Packed<T> {
    fn deref_mut(&mut self) -> &mut Option<T> {
        &mut self.0
    }
}

impl<T: Serialize> Serialize for Packed<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Some(value) = &self.0 else {
            return serializer.serialize_none();
        };
        if !serializer.is_human_readable() {
            return serializer.serialize_some(value);
        }
        let bytes = postcard::to_stdvec(value).map_err(S::Error::custom)?;
        let mut text = LAYOUT.to_owned();
        STANDARD.encode_string(bytes, &mut text);
        serializer.serialize_some(&text)
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Packed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !deserializer.is_human_readable() {
            return Option::deserialize(deserializer).map(Self);
        }
        let text: Option<String> = Option::deserialize(deserializer)?;
        let Some(packed) = text.as_deref().and_then(|text| text.strip_prefix(LAYOUT)) else {
            return Ok(Self(None));
        };
        let bytes = STANDARD.decode(packed).map_err(D::Error::custom)?;
        let value = postcard::from_bytes(&bytes).map_err(D::Error::custom)?;
        Ok(Self(Some(value)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_packed_is_unpacked_and_another_layout_is_nothing() {
        let kept = Packed(Some(vec![1.0 / 3.0, -0.0, 1e-300]));
        let text = serde_json::to_string(&kept).unwrap();
        let read = |text: &str| serde_json::from_str::<Packed<Vec<f64>>>(text);
        assert_eq!(read(&text).unwrap(), kept);
        let bytes = postcard::to_stdvec(&kept).unwrap();
        assert_eq!(postcard::from_bytes::<Packed<Vec<f64>>>(&bytes).unwrap(), kept);
        assert_eq!(read(&text.replace("1:", "0:")).unwrap(), Packed(None));
        assert_eq!(read("null").unwrap(), Packed(None));
        assert!(read(&text.replace("1:", "1:!")).is_err());
    }
}
