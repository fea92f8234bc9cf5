//! Queue of received bytes: pushed at the end, taken at the front.

use std::io::{self, Read};

/// Bytes in the order of arrival.
#[derive(Debug, Default)]
pub struct Queue {
    bytes: Vec<u8>,
    /// Index of the first byte not taken yet.
    at: usize,
    /// Number of those bytes already searched without a line feed.
    looked: usize,
}

impl Queue {
    /// Puts bytes at the end.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.at > 0 {
            self.bytes.drain(..self.at);
            self.at = 0;
        }
        self.bytes.extend_from_slice(bytes);
    }

    /// The bytes not taken yet.
    pub fn rest(&self) -> &[u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// Takes a line, without its end; `None` while there is no complete one.
    pub fn line(&mut self) -> Option<Vec<u8>> {
        let rest = self.rest();
        let Some(found) = rest.iter().skip(self.looked).position(|byte| *byte == b'\n') else {
            self.looked = rest.len();
            return None;
        };
        let length = self.looked + found;
        let line = rest.get(..length).unwrap_or_default().to_vec();
        self.skip(length + 1);
        Some(line)
    }

    /// Takes all bytes.
    pub fn everything(&mut self) -> Vec<u8> {
        let all = self.rest().to_vec();
        self.skip(all.len());
        all
    }

    /// Leaves out bytes at the front.
    pub fn skip(&mut self, count: usize) {
        self.at = (self.at + count).min(self.bytes.len());
        self.looked = 0;
    }
}

/// An empty read means that there are no bytes now.
impl Read for Queue {
    fn read(&mut self, to: &mut [u8]) -> io::Result<usize> {
        let count = self.rest().read(to)?;
        self.skip(count);
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_come_whole_however_the_bytes_came() {
        let text = b"first\n\nsecond \r\nthe rest";
        for step in 1..text.len() {
            let mut queue = Queue::default();
            let mut lines = Vec::new();
            for part in text.chunks(step) {
                queue.push(part);
                lines.extend(std::iter::from_fn(|| queue.line()));
            }
            assert_eq!(lines, [b"first".to_vec(), b"".to_vec(), b"second \r".to_vec()]);
            assert_eq!(queue.everything(), b"the rest");
            assert!(queue.rest().is_empty());
        }
    }
}
