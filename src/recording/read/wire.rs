//! Fields of an MCAP record, read from untrusted bytes.

use std::collections::BTreeMap;

/// Remaining bytes of a record.
#[derive(Debug, Clone, Copy)]
pub struct Fields<'a>(pub &'a [u8]);

impl<'a> Fields<'a> {
    /// The next `count` bytes, or the reason why there are none.
    pub fn bytes(&mut self, count: u64) -> Result<&'a [u8], &'static str> {
        let count = usize::try_from(count).map_err(|_| "a record ends too early")?;
        let (head, rest) = self.0.split_at_checked(count).ok_or("a record ends too early")?;
        self.0 = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], &'static str> {
        let (head, rest) = self.0.split_first_chunk::<N>().ok_or("a record ends too early")?;
        self.0 = rest;
        Ok(*head)
    }

    /// An 8-bit number.
    pub fn u8(&mut self) -> Result<u8, &'static str> {
        Ok(u8::from_le_bytes(self.array()?))
    }

    /// A 16-bit number.
    pub fn u16(&mut self) -> Result<u16, &'static str> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    /// A 32-bit number.
    pub fn u32(&mut self) -> Result<u32, &'static str> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    /// A 64-bit number.
    pub fn u64(&mut self) -> Result<u64, &'static str> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    /// A text.
    pub fn text(&mut self) -> Result<&'a str, &'static str> {
        let count = self.u32()?;
        let bytes = self.bytes(u64::from(count))?;
        std::str::from_utf8(bytes).map_err(|_| "a name is not UTF-8")
    }

    /// A map of texts.
    pub fn map(&mut self) -> Result<BTreeMap<&'a str, &'a str>, &'static str> {
        let count = self.u32()?;
        let mut inner = Fields(self.bytes(u64::from(count))?);
        let mut map = BTreeMap::new();
        while !inner.0.is_empty() {
            if map.insert(inner.text()?, inner.text()?).is_some() {
                return Err("a map has a key twice");
            }
        }
        Ok(map)
    }

    /// The next record inside a chunk: opcode and content; `None` at the end.
    pub fn record(&mut self) -> Result<Option<(u8, Fields<'a>)>, &'static str> {
        if self.0.is_empty() {
            return Ok(None);
        }
        let opcode = self.u8()?;
        let length = self.u64()?;
        Ok(Some((opcode, Fields(self.bytes(length)?))))
    }
}
