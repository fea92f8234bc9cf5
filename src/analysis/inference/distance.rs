//! The last step of the generative model, y = y_M + b + e, and the distance of every draw to the
//! observation: one pass over the tables that keeps the nearest.
//!
//! With b_n ~ N(0, (d_n y_Mn)^2) and e_n ~ N(0, s_n^2) independent, only the sum enters, so one
//! standard normal number z_n per draw and mode gives it: b_n + e_n = sqrt(s_n^2 + d_n^2 y_Mn^2) z_n.

use super::table::{NoiseTable, Table};
use super::{Distance, Noise, Observation};
use crate::numerics::random::BLOCK;
use crate::numerics::simd::{Kernel, vectorised};

/// Blocks of draws examined first, to bound the nearest share before the full pass.
const PILOT_BLOCKS: usize = 16;

/// Draws handled together; a group without a near draw costs one test.
const GROUP: usize = 16;

/// Terms of one observed mode in generative model and distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Term {
    /// Mode counted from zero.
    pub mode: usize,
    /// Observed frequency \[Hz\].
    pub observed: f32,
    /// Standard deviation of the measurement error \[Hz\].
    pub sd: f32,
    /// Relative standard deviation of the model discrepancy \[-\].
    pub discrepancy: f32,
    /// Factor of the difference before it is squared.
    pub weight: f32,
}

/// An observation with its error model and distance, to which draws are compared.
#[derive(Debug, Clone, PartialEq)]
pub struct Target {
    terms: Vec<Term>,
}

impl Target {
    /// `discrepancy` holds one entry per mode order from the first. `None` if a Mahalanobis distance
    /// is asked for and a mode has neither measurement error nor discrepancy.
    pub fn new(
        observation: &Observation,
        discrepancy: &[f64],
        noise: Noise,
        distance: Distance,
    ) -> Option<Self> {
        let terms = error_sds(observation, noise)
            .zip(observation.orders.iter().zip(&observation.frequency_hz))
            .map(|(sd, (&order, &frequency))| {
                let relative = discrepancy[order - 1];
                let weight = match distance {
                    Distance::Euclidean => 1.0,
                    Distance::Relative => 1.0 / frequency,
                    Distance::Mahalanobis => 1.0 / sd.hypot(relative * frequency),
                };
                weight.is_finite().then_some(Term {
                    mode: order - 1,
                    observed: frequency as f32,
                    sd: sd as f32,
                    discrepancy: relative as f32,
                    weight: weight as f32,
                })
            })
            .collect::<Option<_>>()?;
        Some(Self { terms })
    }

    /// The observed modes.
    pub fn terms(&self) -> &[Term] {
        &self.terms
    }

    /// Simulated frequency of one observed mode: model frequency plus discrepancy and error.
    #[inline]
    pub fn simulated(term: &Term, frequency: f32, z: f32) -> f32 {
        let scaled = term.discrepancy * frequency;
        frequency + (term.sd * term.sd + scaled * scaled).sqrt() * z
    }

    /// Squared distance of simulated frequencies, one per term.
    pub fn distance_squared(&self, simulated: impl Iterator<Item = f64>) -> f64 {
        self.terms
            .iter()
            .zip(simulated)
            .map(|(term, y)| ((y - f64::from(term.observed)) * f64::from(term.weight)).powi(2))
            .sum()
    }
}

/// The standard deviation of each observed mode's measurement error \[Hz\].
pub(super) fn error_sds(observation: &Observation, noise: Noise) -> impl Iterator<Item = f64> + '_ {
    observation.sd_hz.iter().map(move |&sd| match noise {
        Noise::Record => sd,
        Noise::Fixed(fixed) => fixed,
    })
}

/// A draw and its squared distance in one sortable number: the bits of the `f32` above the index. The
/// bits of non-negative numbers sort like their values; the index breaks ties.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Candidate(u64);

impl Candidate {
    #[inline]
    fn new(distance_squared: f32, draw: u32) -> Self {
        Self((u64::from(distance_squared.to_bits()) << 32) | u64::from(draw))
    }

    /// Index of the draw.
    pub fn draw(self) -> usize {
        (self.0 & 0xffff_ffff) as usize
    }

    /// Squared distance of the draw.
    pub fn distance_squared(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// All draws with a squared distance of at most `bound`, ascending by index.
pub fn within(
    target: &Target,
    table: &Table,
    noise: &NoiseTable,
    shift: usize,
    bound: f32,
) -> Vec<Candidate> {
    let mut found = Vec::new();
    scan(target, table, noise, shift, 0..table.blocks(), bound, &mut found);
    found
}

/// The `count` nearest draws (fewer if there are not enough valid ones), ascending by index; equal
/// distances are decided by the lower index.
///
/// A first look at some blocks bounds the wanted distance from above, by the sample
/// quantile five standard deviations beyond; should that miss, the pass is repeated without a bound.
pub fn nearest(
    target: &Target,
    table: &Table,
    noise: &NoiseTable,
    shift: usize,
    count: usize,
) -> Vec<Candidate> {
    let bound = pilot(target, table, noise, shift, count);
    let mut found = within(target, table, noise, shift, bound);
    if found.len() < count && bound < f32::MAX {
        found = within(target, table, noise, shift, f32::MAX);
    }
    if found.len() > count {
        let mut order = found.clone();
        let (_, &mut last, _) = order.select_nth_unstable(count - 1);
        found.retain(|&candidate| candidate <= last);
    }
    found
}

fn pilot(target: &Target, table: &Table, noise: &NoiseTable, shift: usize, count: usize) -> f32 {
    if table.blocks() < 4 {
        return f32::MAX;
    }
    let blocks = (table.blocks() / 4).clamp(1, PILOT_BLOCKS);
    let mut found = Vec::with_capacity(blocks * BLOCK);
    scan(target, table, noise, shift, 0..blocks, f32::MAX, &mut found);
    let expected = count as f64 / table.draws() as f64 * (blocks * BLOCK) as f64;
    let rank = (expected + 5.0 * expected.sqrt() + 5.0).ceil() as usize;
    if rank >= found.len() {
        return f32::MAX;
    }
    let (_, &mut bound, _) = found.select_nth_unstable(rank);
    bound.distance_squared()
}

fn scan(
    target: &Target,
    table: &Table,
    noise: &NoiseTable,
    shift: usize,
    blocks: std::ops::Range<usize>,
    bound: f32,
    found: &mut Vec<Candidate>,
) {
    match *target.terms.as_slice() {
        [a] => scan_modes([a], table, noise, shift, blocks, bound, found),
        [a, b] => scan_modes([a, b], table, noise, shift, blocks, bound, found),
        [a, b, c] => scan_modes([a, b, c], table, noise, shift, blocks, bound, found),
        [a, b, c, d] => scan_modes([a, b, c, d], table, noise, shift, blocks, bound, found),
        [a, b, c, d, e] => scan_modes([a, b, c, d, e], table, noise, shift, blocks, bound, found),
        _ => {}
    }
}

fn scan_modes<const M: usize>(
    terms: [Term; M],
    table: &Table,
    noise: &NoiseTable,
    shift: usize,
    blocks: std::ops::Range<usize>,
    bound: f32,
    found: &mut Vec<Candidate>,
) {
    if terms.iter().all(|term| term.discrepancy == 0.0) {
        scan_blocks::<M, true>(&terms, table, noise, shift, blocks, bound, found);
    } else {
        scan_blocks::<M, false>(&terms, table, noise, shift, blocks, bound, found);
    }
}

/// Scans blocks of draws. `PLAIN`: no mode has a discrepancy.
fn scan_blocks<const M: usize, const PLAIN: bool>(
    terms: &[Term; M],
    table: &Table,
    noise: &NoiseTable,
    shift: usize,
    blocks: std::ops::Range<usize>,
    bound: f32,
    found: &mut Vec<Candidate>,
) {
    for block in blocks {
        let input = Block {
            first: (block * BLOCK) as u32,
            frequency: terms.map(|term| table.block(block, term.mode)),
            z: terms.map(|term| noise.block(block, term.mode, shift)),
        };
        vectorised(ScanBlock::<M, PLAIN> {
            terms,
            input: &input,
            bound,
            found: &mut *found,
        });
    }
}

struct Block<'a, const M: usize> {
    first: u32,
    frequency: [&'a [f32]; M],
    z: [&'a [f32]; M],
}

/// Scans one block. The operations per element are the same at any vector width (no fused
/// multiply-add), so the bits do not depend on the processor.
#[inline(always)]
fn scan_block<const M: usize, const PLAIN: bool>(
    terms: &[Term; M],
    input: &Block<'_, M>,
    bound: f32,
    found: &mut Vec<Candidate>,
) {
    for start in (0..BLOCK).step_by(GROUP) {
        let mut squared = [0f32; GROUP];
        for ((term, frequency), z) in terms.iter().zip(input.frequency).zip(input.z) {
            let (frequency, z) = (&frequency[start..][..GROUP], &z[start..][..GROUP]);
            for i in 0..GROUP {
                let error = if PLAIN {
                    term.sd * z[i]
                } else {
                    let scaled = term.discrepancy * frequency[i];
                    (term.sd * term.sd + scaled * scaled).sqrt() * z[i]
                };
                let difference = ((frequency[i] - term.observed) + error) * term.weight;
                squared[i] += difference * difference;
            }
        }
        // Compares false for NaN: an invalid draw is never near.
        if squared.iter().fold(false, |any, &d| any | (d <= bound)) {
            for (i, &d) in squared.iter().enumerate() {
                if d <= bound {
                    found.push(Candidate::new(d, input.first + (start + i) as u32));
                }
            }
        }
    }
}

/// [`scan_block`] for [`vectorised`].
struct ScanBlock<'a, const M: usize, const PLAIN: bool> {
    terms: &'a [Term; M],
    input: &'a Block<'a, M>,
    bound: f32,
    found: &'a mut Vec<Candidate>,
}

impl<const M: usize, const PLAIN: bool> Kernel for ScanBlock<'_, M, PLAIN> {
    #[inline(always)]
    fn run(self) {
        scan_block::<M, PLAIN>(self.terms, self.input, self.bound, self.found);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inference::Tables;
    use crate::rod::beam::exact::Exact;
    use crate::rod::beam::forward::MAX_MODES;
    use crate::rod::prior::RodPrior;

    fn target(orders: &[usize], discrepancy: f64) -> Target {
        let all = [5.1, 10.4, 16.1, 22.3, 29.0];
        let observation = Observation {
            orders: orders.to_vec(),
            frequency_hz: orders.iter().map(|&n| all[n - 1]).collect(),
            sd_hz: vec![0.05; orders.len()],
        };
        let discrepancy = [discrepancy; MAX_MODES];
        Target::new(&observation, &discrepancy, Noise::Record, Distance::Relative).unwrap()
    }

    fn tables(draws: usize) -> (Table, NoiseTable) {
        let (tables, prior) = (Tables::new(3), RodPrior::todi());
        let model = Exact::new(*prior.parameterisation());
        (
            Table::draw(&prior, &model, MAX_MODES, draws, 3),
            tables.noise(draws, MAX_MODES),
        )
    }

    /// Reference: one draw after the other by the definition, then sorted.
    fn by_definition(target: &Target, table: &Table, noise: &NoiseTable, shift: usize) -> Vec<Candidate> {
        let mut all: Vec<Candidate> = (0..table.draws())
            .map(|draw| {
                let mut squared = 0f32;
                for term in target.terms() {
                    let frequency = table.frequency(draw, term.mode);
                    let z = noise.at(draw, term.mode, shift);
                    let error = if target.terms().iter().all(|t| t.discrepancy == 0.0) {
                        term.sd * z
                    } else {
                        let scaled = term.discrepancy * frequency;
                        (term.sd * term.sd + scaled * scaled).sqrt() * z
                    };
                    let difference = ((frequency - term.observed) + error) * term.weight;
                    squared += difference * difference;
                }
                Candidate::new(squared, draw as u32)
            })
            .collect();
        all.sort();
        all
    }

    /// Equal to the bit, for any modes, shift, share, and a table that ends within a block. On a
    /// processor with AVX2 this compares the wide pass with plain arithmetic.
    #[test]
    fn the_pass_finds_exactly_the_nearest() {
        for draws in [1000, 1025, 20_000] {
            let (table, noise) = tables(draws);
            for orders in [&[1][..], &[2, 5], &[1, 2, 3], &[1, 2, 3, 4, 5]] {
                for discrepancy in [0.0, 0.02] {
                    for shift in [0, 1, draws - 1, draws / 2 + 1] {
                        let target = target(orders, discrepancy);
                        let reference = by_definition(&target, &table, &noise, shift);
                        for count in [1, 57, draws / 2, draws] {
                            let mut wanted = reference[..count].to_vec();
                            wanted.sort_by_key(|candidate| candidate.draw());
                            assert_eq!(nearest(&target, &table, &noise, shift, count), wanted);
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn both_widths_give_the_same_bits() {
        let (table, noise) = tables(4096);
        let target = target(&[1, 3, 4], 0.01);
        let terms: [Term; 3] = target.terms().try_into().unwrap();
        for block in 0..table.blocks() {
            let input = Block {
                first: 0,
                frequency: terms.map(|term| table.block(block, term.mode)),
                z: terms.map(|term| noise.block(block, term.mode, 5)),
            };
            let (mut narrow, mut wide) = (Vec::new(), Vec::new());
            scan_block::<3, false>(&terms, &input, f32::MAX, &mut narrow);
            vectorised(ScanBlock::<3, false> {
                terms: &terms,
                input: &input,
                bound: f32::MAX,
                found: &mut wide,
            });
            assert_eq!(narrow, wide);
        }
    }

    #[test]
    fn equal_distances_are_decided_by_the_index() {
        assert!(Candidate::new(1.0, 7) < Candidate::new(1.0, 8));
        assert!(Candidate::new(0.5, 9) < Candidate::new(1.0, 0));
        assert_eq!(Candidate::new(0.25, 3).distance_squared(), 0.25);
        assert_eq!(Candidate::new(0.25, u32::MAX).draw(), u32::MAX as usize);
    }
}
