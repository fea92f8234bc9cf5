//! Sums over the lines of a band, of which its likelihoods are made, in one pass, with the smooth terms projected out.

use super::band::{Band, Block, LANES};
use super::logarithm::ln;
use super::softened::Softened;
use crate::numerics::simd::{Kernel, vectorised};
use rustfft::num_complex::Complex;
use std::f64::consts::LN_2;

/// Number of smooth nuisance terms (constant, slope).
pub(super) const SMOOTH: usize = 2;

/// Fewest lines for a likelihood.
const LEAST_LINES: f64 = 8.0;

/// Weighted sums over the lines, from which the smooth terms are removed: rows are the smooth terms.
#[derive(Default, Clone, Copy)]
pub(super) struct Moments {
    hh: f64,
    hp: Complex<f64>,
    pp: f64,
    hj: Complex<f64>,
    pj: Complex<f64>,
    jj: f64,
    bb: [[f64; SMOOTH]; SMOOTH],
    bh: [Complex<f64>; SMOOTH],
    bp: [f64; SMOOTH],
    bj: [Complex<f64>; SMOOTH],
    pub(super) log_det: f64,
}

/// Response of a source in the band.
pub(super) trait Response {
    fn at(&self, f: &[f64; LANES]) -> Shape;
}

/// A response at some frequencies.
pub(super) struct Shape {
    /// Real and imaginary part of the transient's shape.
    re: [f64; LANES],
    im: [f64; LANES],
    /// Power of the random response.
    power: [f64; LANES],
}

/// Response of a resonance: [`shape`]. The weight of its rank-two term is its real part.
pub(super) struct Resonant {
    pub(super) damped: f64,
    pub(super) gamma: f64,
}

impl Response for Resonant {
    #[inline(always)]
    fn at(&self, f: &[f64; LANES]) -> Shape {
        let Self { damped, gamma } = *self;
        let [mut re, mut im, mut power] = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let detuning = f[l] - damped;
            let scale = gamma * 2.0 * damped / ((gamma * gamma + detuning * detuning) * (f[l] + damped));
            re[l] = scale * gamma;
            im[l] = -scale * detuning;
            power[l] = re[l] * re[l] + im[l] * im[l];
        }
        Shape { re, im, power }
    }
}

/// A softened decay, and the linear response to ambient excitation.
pub(super) struct Decay {
    pub(super) transient: Softened,
    pub(super) linear: Resonant,
}

impl Response for Decay {
    #[inline(always)]
    fn at(&self, f: &[f64; LANES]) -> Shape {
        let [re, im] = self.transient.at_each(f);
        Shape {
            re,
            im,
            ..self.linear.at(f)
        }
    }
}

/// sin(pi x) / (pi x) at the Fourier frequencies, up to a factor common to all lines.
pub(super) struct Sine {
    pub(super) frequency_hz: f64,
    pub(super) half_line_hz: f64,
}

impl Response for Sine {
    #[inline(always)]
    fn at(&self, f: &[f64; LANES]) -> Shape {
        let [re, mut im, mut power] = [[0.0; LANES]; 3];
        for l in 0..LANES {
            let offset = (f[l] - self.frequency_hz) / self.half_line_hz;
            let offset = if offset.abs() < 1e-6 { 1e-6 } else { offset };
            im[l] = -1.0 / offset;
            power[l] = im[l] * im[l];
        }
        Shape { re, im, power }
    }
}

pub(super) struct Nothing;

impl Response for Nothing {
    #[inline(always)]
    fn at(&self, _: &[f64; LANES]) -> Shape {
        let [re, im, power] = [[0.0; LANES]; 3];
        Shape { re, im, power }
    }
}

/// One pass over the lines; the diagonal is `ratio |h|^2 + floor (1 + slope x)`, positive for a slope
/// within -1 to 1.
pub(super) fn gather<const SHARED: u8>(
    band: &Band,
    slope: f64,
    ratio: f64,
    response: impl Response,
) -> Option<Moments> {
    if band.lines < LEAST_LINES || slope.abs() >= 1.0 {
        return None;
    }
    let mut sums = [[0.0; LANES]; SUMS];
    let mut product = Product::ONE;
    vectorised(Gather::<_, SHARED> {
        blocks: band.blocks(),
        slope,
        ratio,
        response,
        sums: &mut sums,
        product: &mut product,
    });
    let total = sums.map(|lanes| {
        let four: [f64; 4] = std::array::from_fn(|l| lanes[l] + lanes[l + 4]);
        (four[0] + four[2]) + (four[1] + four[3])
    });
    let pair = |i: usize| Complex::new(total[i], total[i + 1]);
    let m = Moments {
        hh: total[0],
        // The rank-two weight is the shape's real part.
        hp: pair(1).conj(),
        pp: total[1],
        hj: pair(3),
        pj: pair(5),
        jj: total[7],
        bb: [[total[8], 0.0], [total[9], total[10]]],
        bh: [pair(11), pair(13)],
        bp: [total[11], total[13]],
        bj: [pair(15), pair(17)],
        log_det: total[19] + product.ln(),
    };
    // Whatever a product makes of a diagonal that is no number, the sum of its inverses keeps it.
    (m.log_det.is_finite() && m.bb[0][0].is_finite()).then_some(m)
}

/// Sums of one pass.
const SUMS: usize = 20;

/// Unknowns that the lines of a band share beside the smooth terms: none; a transient; a transient that depends on the
/// force on the lines. Only the sums that this needs are added up, the others remain zero.
pub(super) const NOISE: u8 = 0;
pub(super) const TRANSIENT: u8 = 1;
pub(super) const RANK_TWO: u8 = 2;

/// The pass itself: [`LANES`] cells at once, with one set of sums per lane.
struct Gather<'a, R, const SHARED: u8> {
    blocks: &'a [Block],
    slope: f64,
    ratio: f64,
    response: R,
    sums: &'a mut [[f64; LANES]; SUMS],
    product: &'a mut Product,
}

impl<R: Response, const SHARED: u8> Kernel for Gather<'_, R, SHARED> {
    const MANY_SUMS: bool = true;

    #[inline(always)]
    fn run(self) {
        let Self {
            blocks,
            slope,
            ratio,
            response,
            sums: all_sums,
            product: whole_product,
        } = self;
        // Its own, so that the compiler sees that nothing else points there.
        let mut sums = [[0.0; LANES]; SUMS];
        let mut product = Product::ONE;
        for block in blocks {
            let shape = response.at(&block.frequency_hz);
            let mut diagonal = [0.0; LANES];
            for l in 0..LANES {
                let x = block.x[l];
                let (hr, hi) = (shape.re[l], shape.im[l]);
                let d = ratio * shape.power[l] + block.floor[l] * (1.0 + slope * x);
                diagonal[l] = d;
                let w = 1.0 / d;
                let wn = w * block.lines[l];
                let (wjr, wji) = (w * block.re[l], w * block.im[l]);
                if SHARED >= TRANSIENT {
                    let (whr, whi) = (wn * hr, wn * hi);
                    sums[0][l] += wn * (hr * hr + hi * hi);
                    sums[3][l] += hr * wjr + hi * wji;
                    sums[4][l] += hr * wji - hi * wjr;
                    sums[11][l] += whr;
                    sums[12][l] += whi;
                    sums[13][l] += whr * x;
                    sums[14][l] += whi * x;
                    if SHARED == RANK_TWO {
                        sums[1][l] += whr * hr;
                        sums[2][l] += whi * hr;
                        sums[5][l] += hr * wjr;
                        sums[6][l] += hr * wji;
                    }
                }
                sums[7][l] += w * block.power[l];
                sums[8][l] += wn;
                sums[9][l] += wn * x;
                sums[10][l] += wn * x * x;
                sums[15][l] += wjr;
                sums[16][l] += wji;
                sums[17][l] += wjr * x;
                sums[18][l] += wji * x;
            }
            if block.is_single {
                product.times(&diagonal, &block.lines);
            } else {
                for l in 0..LANES {
                    sums[19][l] += block.lines[l] * ln(diagonal[l]);
                }
            }
        }
        *all_sums = sums;
        *whole_product = product;
    }
}

/// A product of positive, normal numbers, one per lane: mantissas multiplied, exponents added up, so that its logarithm costs one
/// for all lines instead of one for each.
#[derive(Debug, Clone, Copy)]
struct Product {
    /// From 1 to 2.
    mantissa: [f64; LANES],
    exponent: [f64; LANES],
}

impl Product {
    const ONE: Self = Self {
        mantissa: [1.0; LANES],
        exponent: [0.0; LANES],
    };

    /// Multiplies the lanes that hold a line.
    #[inline(always)]
    fn times(&mut self, values: &[f64; LANES], lines: &[f64; LANES]) {
        const MANTISSA: u64 = (1 << 52) - 1;
        const ONE: u64 = 1.0f64.to_bits();
        /// 2^52: a double whose low bits count units.
        const UNITS: u64 = 0x4330_0000_0000_0000;
        const BIAS: f64 = 4_503_599_627_370_496.0 + 1023.0;
        for l in 0..LANES {
            let factor = if lines[l] == 0.0 { 1.0 } else { values[l] };
            let bits = (self.mantissa[l] * factor).to_bits();
            self.exponent[l] += f64::from_bits((bits >> 52) | UNITS) - BIAS;
            self.mantissa[l] = f64::from_bits((bits & MANTISSA) | ONE);
        }
    }

    /// Natural logarithm of the product of all lanes.
    fn ln(&self) -> f64 {
        let exponent: f64 = self.exponent.iter().sum();
        let mantissa: f64 = self.mantissa.iter().product();
        exponent * LN_2 + mantissa.ln()
    }
}

/// The sums with the smooth terms projected out, and the log determinant of that projection.
pub(super) struct Reduced {
    pub(super) hh: f64,
    pub(super) hp: Complex<f64>,
    pub(super) pp: f64,
    pub(super) hj: Complex<f64>,
    pub(super) pj: Complex<f64>,
    pub(super) jj: f64,
    pub(super) log_det: f64,
    /// Cholesky factor of the smooth terms' Gram matrix, and shape and data in its coordinates.
    factor: [f64; 3],
    h: [Complex<f64>; SMOOTH],
    j: [Complex<f64>; SMOOTH],
}

impl Reduced {
    /// Best smooth terms for a given transient.
    pub(super) fn smooth(&self, transient: Complex<f64>) -> [Complex<f64>; SMOOTH] {
        let [l00, l10, l11] = self.factor;
        let left: [Complex<f64>; SMOOTH] = std::array::from_fn(|i| self.j[i] - self.h[i] * transient);
        let slope = left[1] / l11;
        [(left[0] - slope * l10) / l00, slope]
    }
}

pub(super) fn reduce(m: &Moments) -> Option<Reduced> {
    // Cholesky factor of the smooth terms' Gram matrix.
    let l00 = m.bb[0][0].sqrt();
    let l10 = m.bb[1][0] / l00;
    let l11 = (m.bb[1][1] - l10 * l10).sqrt();
    if !(l00 > 0.0 && l11 > 0.0) {
        return None;
    }
    let solve = |b: [Complex<f64>; SMOOTH]| {
        let first = b[0] / l00;
        [first, (b[1] - first * l10) / l11]
    };
    let h = solve(m.bh);
    let p = solve([m.bp[0].into(), m.bp[1].into()]);
    let j = solve(m.bj);
    let dot =
        |a: &[Complex<f64>; SMOOTH], b: &[Complex<f64>; SMOOTH]| a[0].conj() * b[0] + a[1].conj() * b[1];
    Some(Reduced {
        hh: m.hh - dot(&h, &h).re,
        hp: m.hp - dot(&h, &p),
        pp: m.pp - dot(&p, &p).re,
        hj: m.hj - dot(&h, &j),
        pj: m.pj - dot(&p, &j),
        jj: m.jj - dot(&j, &j).re,
        log_det: 2.0 * (l00.ln() + l11.ln()),
        factor: [l00, l10, l11],
        h,
        j,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::simd::widths;
    use crate::signal::modes::band::Coefficients;

    #[test]
    fn wide_and_narrow_vectors_give_the_same_bits() {
        let lines = (0..203).map(|i| Complex::new((i as f64).sin(), (1.7 * i as f64).cos()));
        let coefficients = Coefficients {
            duration_s: 20.0,
            lines: lines.collect(),
        };
        let band = coefficients.band(1.0, 8.9, &[], |f| 0.1 * (f - 5.0).abs());
        let mut all = [([[0.0; LANES]; SUMS], Product::ONE); 3];
        let runs = widths();
        let count = runs.len();
        for (run, (sums, product)) in runs.into_iter().zip(&mut all) {
            run(Gather::<_, RANK_TWO> {
                blocks: band.blocks(),
                slope: 0.1,
                ratio: 300.0,
                response: Resonant {
                    damped: 5.0,
                    gamma: 0.02,
                },
                sums,
                product,
            });
        }
        let bits = all[..count].iter().map(|(sums, product)| {
            let product = [product.mantissa, product.exponent].map(|lanes| lanes.map(f64::to_bits));
            (sums.map(|lanes| lanes.map(f64::to_bits)), product)
        });
        assert!(bits.collect::<Vec<_>>().windows(2).all(|pair| pair[0] == pair[1]));
    }

    #[test]
    fn the_logarithm_of_a_product_is_the_sum_of_logarithms() {
        let mut product = Product::ONE;
        let mut sum = 0.0;
        for i in 0..4000 {
            let values: [f64; LANES] =
                std::array::from_fn(|l| (60.0 * (1.0 + (8 * i + l) as f64).sin()).exp());
            let mut lines = [1.0; LANES];
            lines[i % LANES] = 0.0;
            product.times(&values, &lines);
            sum += values
                .iter()
                .zip(lines)
                .map(|(value, line)| line * value.ln())
                .sum::<f64>();
        }
        // Half a unit in the last place for each of 500 factors of a lane's mantissa, and of 28 000 terms of a sum of 4e4.
        assert!((product.ln() - sum).abs() < 1e-9, "{} {sum}", product.ln());
    }

    /// Sums that a free start needs are the same whether the others are added up or not.
    #[test]
    fn fewer_sums_are_the_same_sums() {
        let lines = (0..203).map(|i| Complex::new((i as f64).sin(), (1.7 * i as f64).cos()));
        let coefficients = Coefficients {
            duration_s: 20.0,
            lines: lines.collect(),
        };
        let band = coefficients.band(1.0, 8.9, &[], |_| 0.0);
        let response = || Resonant {
            damped: 5.0,
            gamma: 0.02,
        };
        let few = gather::<TRANSIENT>(&band, 0.1, 300.0, response()).unwrap();
        let all = gather::<RANK_TWO>(&band, 0.1, 300.0, response()).unwrap();
        assert_eq!((few.hh, few.hj, few.bh), (all.hh, all.hj, all.bh));
        assert_eq!(
            (few.jj, few.bb, few.bj, few.log_det),
            (all.jj, all.bb, all.bj, all.log_det)
        );
        assert_eq!((few.hp, few.pj), (Complex::default(), Complex::default()));
        assert_ne!((all.hp, all.pj), (few.hp, few.pj));
    }
}
