//! An optional large value, in text formats as postcard in base64 after the number of its layout.
//!
//! As JSON a bank of filters is a megabyte of digits, which are slow to write and slower to read. A value of
//! another layout reads as `None`: a drift watch is then rebuilt from the periods.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::de::{DeserializeOwned, Error as _};
use serde::ser::Error as _;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::{Arc, Weak};

/// Version of the layout, changed whenever a packed field is added, removed or moved.
const LAYOUT: &str = "12:";

/// An optional value that is packed in text formats. Its copies share it until one of them changes.
#[derive(Debug, Clone, PartialEq)]
pub struct Packed<T>(Option<Arc<T>>);

/// Remembers a [`Packed`] value without keeping it.
#[derive(Debug, Clone)]
pub struct Receipt<T>(Option<Weak<T>>);

impl<T> Default for Packed<T> {
    fn default() -> Self {
        Self(None)
    }
}

impl<T> Packed<T> {
    /// Packs a value.
    pub fn new(value: T) -> Self {
        Self(Some(Arc::new(value)))
    }

    /// Returns the value.
    pub fn get(&self) -> Option<&T> {
        self.0.as_deref()
    }

    /// Returns the value to be changed.
    pub fn get_mut(&mut self) -> Option<&mut T>
    where
        T: Clone,
    {
        self.0.as_mut().map(Arc::make_mut)
    }

    /// Returns the value to be changed, made first if there is none.
    pub fn get_or_insert_with(&mut self, make: impl FnOnce() -> T) -> &mut T
    where
        T: Clone,
    {
        Arc::make_mut(self.0.get_or_insert_with(|| Arc::new(make())))
    }

    /// Returns a receipt that [`is_as_of`](Self::is_as_of) later compares with the value.
    pub fn receipt(&self) -> Receipt<T> {
        Receipt(self.0.as_ref().map(Arc::downgrade))
    }

    /// True if the value has not changed since the receipt. [`Arc::make_mut`] moves a value that has a receipt, and a receipt
    /// keeps its address from being used again.
    pub fn is_as_of(&self, receipt: &Receipt<T>) -> bool {
        match (&self.0, &receipt.0) {
            (None, None) => true,
            (Some(value), Some(known)) => std::ptr::eq(Arc::as_ptr(value), known.as_ptr()),
            _ => false,
        }
    }

    /// Returns the value as JSON. Postcard keeps every bit of a number, finite or not, so that it need not be read back.
    ///
    /// # Errors
    /// The value cannot be serialized, or holds a number that is none.
    pub fn json(&self) -> Result<String, postcard::Error>
    where
        T: Serialize + PartialEq,
    {
        // A number, a colon and base64 need no escapes.
        let Some(value) = self.get() else {
            return Ok("null".to_owned());
        };
        #[allow(clippy::eq_op, reason = "NaN differs from itself")]
        if *value != *value {
            return Err(postcard::Error::SerdeSerCustom);
        }
        let mut json = "\"".to_owned();
        pack(value, &mut json)?;
        json.push('"');
        Ok(json)
    }
}

/// Appends a value to a text.
fn pack<T: Serialize>(value: &T, text: &mut String) -> Result<(), postcard::Error> {
    let bytes = postcard::to_stdvec(value)?;
    text.reserve(LAYOUT.len() + 2 + bytes.len() / 3 * 4 + 4);
    text.push_str(LAYOUT);
    STANDARD.encode_string(bytes, text);
    Ok(())
}

impl<T: Serialize> Serialize for Packed<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Some(value) = self.get().filter(|_| serializer.is_human_readable()) else {
            return self.get().serialize(serializer);
        };
        let mut text = String::new();
        pack(value, &mut text).map_err(S::Error::custom)?;
        serializer.serialize_some(&text)
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Packed<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        if !deserializer.is_human_readable() {
            return Option::deserialize(deserializer).map(|value: Option<T>| Self(value.map(Arc::new)));
        }
        let text: Option<String> = Option::deserialize(deserializer)?;
        let Some(packed) = text.as_deref().and_then(|text| text.strip_prefix(LAYOUT)) else {
            return Ok(Self(None));
        };
        let bytes = STANDARD.decode(packed).map_err(D::Error::custom)?;
        let value = postcard::from_bytes(&bytes).map_err(D::Error::custom)?;
        Ok(Self::new(value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_packed_is_unpacked_and_another_layout_is_nothing() {
        let kept = Packed::new(vec![1.0 / 3.0, -0.0, 1e-300]);
        let text = serde_json::to_string(&kept).unwrap();
        assert_eq!(kept.json().unwrap(), text);
        assert_eq!(Packed::<Vec<f64>>::default().json().unwrap(), "null");
        assert!(Packed::new(vec![f64::NAN]).json().is_err());
        let read = |text: &str| serde_json::from_str::<Packed<Vec<f64>>>(text);
        assert_eq!(read(&text).unwrap(), kept);
        let bytes = postcard::to_stdvec(&kept).unwrap();
        assert_eq!(postcard::from_bytes::<Packed<Vec<f64>>>(&bytes).unwrap(), kept);
        assert_eq!(read(&text.replace(LAYOUT, "0:")).unwrap(), Packed(None));
        assert_eq!(read("null").unwrap(), Packed(None));
        assert!(read(&text.replace(LAYOUT, &format!("{LAYOUT}!"))).is_err());
    }
    #[test]
    fn a_receipt_tells_every_change() {
        let mut value = Packed::new(vec![1.0]);
        let receipt = value.receipt();
        assert!(value.is_as_of(&receipt) && value.clone().is_as_of(&receipt));
        value.get_mut().unwrap().push(2.0);
        assert!(!value.is_as_of(&receipt));
        let receipt = value.receipt();
        value.get_or_insert_with(Vec::new).pop();
        assert!(!value.is_as_of(&receipt) && value.get() == Some(&vec![1.0]));
        // The address of a dropped value is not used again while its receipt exists.
        let receipt = value.receipt();
        value = Packed::default();
        assert!(!value.is_as_of(&receipt) && value.is_as_of(&value.receipt()));
        for _ in 0..100 {
            value = Packed::default();
            value.get_or_insert_with(|| vec![1.0]);
            assert!(!value.is_as_of(&receipt));
        }
    }
}
