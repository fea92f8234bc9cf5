//! Filter banks in a text format: postcard in base64, behind the number of the layout.
//!
//! As JSON a bank is a megabyte of digits, which are slow to write and slower to read. What is of another layout reads as nothing:
//! the watch is then made again from the periods.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::de::{DeserializeOwned, Error as _};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Changes whenever a field of what is packed comes, goes or moves.
const LAYOUT: &str = "1:";

pub(crate) fn serialize<T: Serialize, S: Serializer>(
    value: &Option<T>,
    serializer: S,
) -> Result<S::Ok, S::Error> {
    let Some(value) = value else {
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

pub(crate) fn deserialize<'de, T: DeserializeOwned, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<T>, D::Error> {
    if !deserializer.is_human_readable() {
        return Option::deserialize(deserializer);
    }
    let text: Option<String> = Option::deserialize(deserializer)?;
    let Some(packed) = text.as_deref().and_then(|text| text.strip_prefix(LAYOUT)) else {
        return Ok(None);
    };
    let bytes = STANDARD.decode(packed).map_err(D::Error::custom)?;
    postcard::from_bytes(&bytes).map(Some).map_err(D::Error::custom)
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Kept {
        #[serde(default, with = "super")]
        numbers: Option<Vec<f64>>,
    }

    #[test]
    fn what_is_packed_is_unpacked_and_another_layout_is_nothing() {
        let kept = Kept {
            numbers: Some(vec![1.0 / 3.0, -0.0, 1e-300]),
        };
        let text = serde_json::to_string(&kept).unwrap();
        assert_eq!(serde_json::from_str::<Kept>(&text).unwrap(), kept);
        let bytes = postcard::to_stdvec(&kept).unwrap();
        assert_eq!(postcard::from_bytes::<Kept>(&bytes).unwrap(), kept);
        let other = text.replace("1:", "0:");
        assert_eq!(serde_json::from_str::<Kept>(&other).unwrap().numbers, None);
        assert_eq!(serde_json::from_str::<Kept>("{}").unwrap().numbers, None);
        let damaged = text.replace("1:", "1:!");
        assert!(serde_json::from_str::<Kept>(&damaged).is_err());
    }
}
