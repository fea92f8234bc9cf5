//! Seeds and counter-based random streams: the same seed gives the same numbers at any thread count.

use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};
use sha2::{Digest, Sha256};

/// Draws that share one stream; work is split between threads at multiples of this number.
pub const BLOCK: usize = 1024;

/// A seed that depends on every part, in order: the first 64 bits of the SHA-256 of the
/// length-prefixed parts.
pub fn seed(parts: &[&[u8]]) -> u64 {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    let digest = hash.finalize();
    let mut first = [0u8; 8];
    first.copy_from_slice(&digest[..8]);
    u64::from_le_bytes(first)
}

/// Stream number `stream` of the generator seeded with `seed`; streams never overlap.
pub fn stream(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(stream);
    generator
}

/// `count` rows of normalised weights, by systematic resampling (Kitagawa 1996).
pub fn systematic(weights: &[f64], count: usize, generator: &mut ChaCha8Rng) -> Vec<usize> {
    let offset: f64 = generator.random();
    let mut rows = Vec::with_capacity(count);
    let (mut row, mut sum) = (0, weights.first().copied().unwrap_or(0.0));
    for i in 0..count {
        let place = (i as f64 + offset) / count as f64;
        while sum < place && row + 1 < weights.len() {
            row += 1;
            sum += weights[row];
        }
        rows.push(row);
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;

    #[test]
    fn parts_are_not_glued_together() {
        assert_ne!(seed(&[b"ab", b"c"]), seed(&[b"a", b"bc"]));
        assert_eq!(seed(&[b"ab", b"c"]), seed(&[b"ab", b"c"]));
    }

    #[test]
    fn streams_differ_and_repeat() {
        let first: u64 = stream(7, 0).random();
        assert_eq!(first, stream(7, 0).random::<u64>());
        assert_ne!(first, stream(7, 1).random::<u64>());
    }
}
