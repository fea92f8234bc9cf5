//! The likelihood of one resonance in a band of raw Fourier coefficients, exact for any record length.
//!
//! A lightly damped mode is `x = z + z*` with `dz/dt = s z + w`, `s = 2 pi (-zeta f + i f_d)`, `w` white.
//! Integrated over the record, its coefficients at the Fourier frequencies are
//!
//! ```text
//! J_k = (W_k + c) h_k + V_k,     h_k = 1 / (2 pi i f_k - s),     c = (z(0) - z(T)) / sqrt(T)
//! ```
//!
//! `W_k` and the noise `V_k` are independent from line to line, and everything a finite record does
//! to a resonance (leakage, the Fejer kernel of the debiased Whittle likelihood of Sykulski et al.
//! 2019, the correlation of its lines) is the one shared number `c`, as in the transient term of
//! Pintelon and Schoukens. For a stationary response `c` is jointly normal with the `W_k`,
//!
//! ```text
//! E|c|^2 = (q / (zeta w T)) (1 - Re e^(sT)),     E[W_k c*] = -(q / T) (1 - e^(s*T)) h_k*
//! ```
//!
//! so that the covariance of the band is a diagonal plus a matrix of rank two: the exact likelihood
//! costs one pass over the lines. After a pull or a blow, or from within a decay, `c` is unknown with a very wide
//! prior ([`Start::Free`]), and `W_k` stands for ambient excitation that goes on meanwhile.
//! All else that varies smoothly across the band (leakage of drift and of other modes, the mode's own
//! negative-frequency image) is `d_0 + d_1 x_k` with flat priors, integrated out.

use super::band::{Band, Block, LANES};
use super::logarithm::ln;
use super::softened::Softened;
use crate::numerics::simd::{Kernel, vectorised};
use rustfft::num_complex::Complex;
use std::f64::consts::{LN_2, TAU};

/// Number of smooth nuisance terms (constant, slope).
const SMOOTH: usize = 2;

/// Fewest lines for a likelihood.
const LEAST_LINES: f64 = 8.0;

/// State of the mode at the beginning of the record.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Start {
    /// The stationary response to the ambient force, as at any other moment.
    Stationary,
    /// Unknown: the record begins with or within a decay, on top of the ambient response.
    Free,
}

/// Parameters of one resonance, in the order of optimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// Undamped natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Natural logarithm of the damping ratio.
    pub log_damping: f64,
    /// Natural logarithm of the stationary peak's height over the noise floor (power).
    pub log_ratio: f64,
    /// Relative slope of the noise floor per half width of the band, between -1 and 1.
    pub slope: f64,
    /// Share by which a decay's frequency is lower at its beginning than at its end \[-\]; for a free start
    /// only, and estimated separately ([`super::softened`]).
    pub softening: f64,
}

impl Parameters {
    /// Optimised parameters as a vector.
    pub fn to_array(self) -> [f64; 4] {
        [self.frequency_hz, self.log_damping, self.log_ratio, self.slope]
    }

    /// Parameters from a vector and the softening.
    pub fn from_array([frequency_hz, log_damping, log_ratio, slope]: [f64; 4], softening: f64) -> Self {
        Self {
            frequency_hz,
            log_damping,
            log_ratio,
            slope,
            softening,
        }
    }
}

/// The likelihood at one set of parameters, maximised over the noise level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Value {
    /// Marginal log likelihood plus the log prior, up to a constant of the band.
    pub log_posterior: f64,
    /// Log likelihood maximised over the transient instead of integrated: for comparison with a sine or with
    /// noise alone.
    pub log_profile: f64,
    /// Noise floor in the band's middle, two-sided \[unit^2/Hz\].
    pub noise: f64,
    /// Sum of squares that gives the noise level.
    pub quad: f64,
    /// Amplitude of the transient, a factor on [`shape`].
    pub transient: Complex<f64>,
    /// Smooth terms across the band at their best, with the best transient: constant, and slope per half
    /// width.
    pub smooth: [Complex<f64>; SMOOTH],
}

/// The mode's response at `f`, 1 at its peak: `zeta f_n / (zeta f_n + i (f - f_d)) 2 f_d / (f + f_d)`,
/// the second factor that of the displacement's negative-frequency pole.
pub fn shape(frequency_hz: f64, damping: f64, f: f64) -> Complex<f64> {
    let damped = frequency_hz * (1.0 - damping * damping).max(0.0).sqrt();
    let gamma = damping * frequency_hz;
    let detuning = f - damped;
    let scale = gamma / (gamma * gamma + detuning * detuning) * (2.0 * damped / (f + damped));
    Complex::new(scale * gamma, -scale * detuning)
}

/// Prior of the damping ratio: log-normal, median 0.6 %, standard deviation 1.7 of the logarithm (a
/// factor of 5.5 up and down). It decides only where the record cannot.
const DAMPING_LOG_MEDIAN: f64 = -5.116;
const DAMPING_LOG_SD: f64 = 1.7;
const RATIO_LOG_MEDIAN: f64 = 6.0;
const RATIO_LOG_SD: f64 = 6.0;
/// Ambient response during a free decay, relative to the noise floor at the peak: its amplitude has a
/// half-Cauchy prior, so that a level too low to be seen is not excluded.
const DECAY_RATIO: f64 = 0.1;
const SLOPE_SD: f64 = 0.5;

/// Log prior density of ln damping, up to a constant.
pub(super) fn damping_log_prior(log_damping: f64) -> f64 {
    -0.5 * damping_deviate(log_damping).powi(2)
}

fn damping_deviate(log_damping: f64) -> f64 {
    (log_damping - DAMPING_LOG_MEDIAN) / DAMPING_LOG_SD
}

fn log_prior(p: &Parameters, start: Start) -> f64 {
    let a = damping_deviate(p.log_damping);
    let b = (p.log_ratio - RATIO_LOG_MEDIAN) / RATIO_LOG_SD;
    let c = p.slope / SLOPE_SD;
    let ratio = match start {
        Start::Stationary => -0.5 * b * b,
        Start::Free => 0.5 * p.log_ratio - (p.log_ratio.exp() / DECAY_RATIO).ln_1p(),
    };
    ratio - 0.5 * (a * a + c * c)
}

/// Weighted sums over the lines, from which the smooth terms are removed: rows are the smooth terms.
#[derive(Default, Clone, Copy)]
struct Moments {
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
    log_det: f64,
}

/// Evaluates the likelihood of a resonance; `None` where it is not defined (too few lines, damping
/// beyond 50 %, a frequency outside the band, rounding).
pub fn resonance(band: &Band, start: Start, p: &Parameters) -> Option<Value> {
    let damping = p.log_damping.exp();
    let inside = (p.frequency_hz - band.middle_hz).abs() < band.half_width_hz;
    if !(inside && damping < 0.5 && p.log_ratio < 60.0) {
        return None;
    }
    let ratio = p.log_ratio.exp();
    let damped = p.frequency_hz * (1.0 - damping * damping).sqrt();
    let gamma = damping * p.frequency_hz;
    let linear = Resonant { damped, gamma };
    let moments = if start == Start::Free && p.softening != 0.0 {
        let transient = Softened::new(p.frequency_hz, damping, p.softening, band.duration_s)?;
        gather::<TRANSIENT>(band, p.slope, ratio, Decay { transient, linear })?
    } else if start == Start::Free {
        gather::<TRANSIENT>(band, p.slope, ratio, linear)?
    } else {
        gather::<RANK_TWO>(band, p.slope, ratio, linear)?
    };
    let reduced = reduce(&moments).filter(|r| r.hh > 0.0)?;
    let lines = band.lines;
    // e^(sT)
    let decay = Complex::from_polar(
        (-TAU * gamma * band.duration_s).exp(),
        TAU * damped * band.duration_s,
    );
    let (log_det, quad, dof) = match start {
        Start::Stationary => {
            let u = ratio / (TAU * gamma * band.duration_s);
            let v = u * (1.0 - decay.re);
            let kappa = -u * (1.0 - decay.conj());
            let (g11, g12, g22) = (reduced.hh, reduced.hp, reduced.pp);
            // K = I + M G, M = [[v, kappa*], [kappa, 0]], G = [[g11, g12], [g12*, g22]].
            let k11 = 1.0 + v * g11 + kappa.conj() * g12.conj();
            let k12 = v * g12 + kappa.conj() * g22;
            let k21 = kappa * g11;
            let k22 = 1.0 + kappa * g12;
            let det = (k11 * k22 - k12 * k21).re;
            if det.is_nan() || det <= 0.0 {
                return None;
            }
            let (m1, m2) = (v * reduced.hj + kappa.conj() * reduced.pj, kappa * reduced.hj);
            let (y1, y2) = ((k22 * m1 - k12 * m2) / det, (k11 * m2 - k21 * m1) / det);
            let explained = (reduced.hj.conj() * y1 + reduced.pj.conj() * y2).re;
            (
                moments.log_det + reduced.log_det + det.ln(),
                reduced.jj - explained,
                lines - SMOOTH as f64,
            )
        }
        Start::Free => {
            let quad = reduced.jj - reduced.hj.norm_sqr() / reduced.hh;
            let dof = lines - SMOOTH as f64 - 1.0;
            // A transient as large as the band's largest ordinate, in units of the noise floor: a prior
            // so wide that only a shape which the smooth terms imitate feels it.
            let wide = band.largest * dof / quad.max(f64::MIN_POSITIVE);
            (
                moments.log_det + reduced.log_det + (wide * reduced.hh).ln_1p(),
                quad,
                dof,
            )
        }
    };
    let least = reduced.jj - reduced.hj.norm_sqr() / reduced.hh;
    if !(quad > 0.0 && least > 0.0 && dof > 0.0) {
        return None;
    }
    Some(Value {
        log_posterior: -log_det - dof * quad.ln() + log_prior(p, start),
        log_profile: -moments.log_det - lines * least.ln(),
        noise: quad / dof,
        quad,
        transient: reduced.hj / reduced.hh,
        smooth: reduced.smooth(reduced.hj / reduced.hh),
    })
}

/// Log likelihood (profile, comparable with [`Value::log_profile`]) of an undamped sine of frequency
/// `f` in noise of the given slope.
pub fn sine(band: &Band, frequency_hz: f64, slope: f64) -> Option<f64> {
    let sine = Sine {
        frequency_hz,
        half_line_hz: 0.5 / band.duration_s,
    };
    let moments = gather::<TRANSIENT>(band, slope, 0.0, sine)?;
    let reduced = reduce(&moments).filter(|r| r.hh > 0.0)?;
    let least = reduced.jj - reduced.hj.norm_sqr() / reduced.hh;
    (least > 0.0).then(|| -moments.log_det - band.lines * least.ln())
}

/// Log likelihood (profile) of noise of the given slope alone.
pub fn noise_only(band: &Band, slope: f64) -> Option<f64> {
    let moments = gather::<NOISE>(band, slope, 0.0, Nothing)?;
    let reduced = reduce(&moments)?;
    (reduced.jj > 0.0).then(|| -moments.log_det - band.lines * reduced.jj.ln())
}

/// Response of a source in the band.
trait Response {
    fn at(&self, f: &[f64; LANES]) -> Shape;
}

/// A response at some frequencies.
struct Shape {
    /// Real and imaginary part of the transient's shape.
    re: [f64; LANES],
    im: [f64; LANES],
    /// Power of the random response.
    power: [f64; LANES],
}

/// Response of a resonance: [`shape`]. The weight of its rank-two term is its real part.
struct Resonant {
    damped: f64,
    gamma: f64,
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
struct Decay {
    transient: Softened,
    linear: Resonant,
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
struct Sine {
    frequency_hz: f64,
    half_line_hz: f64,
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

struct Nothing;

impl Response for Nothing {
    #[inline(always)]
    fn at(&self, _: &[f64; LANES]) -> Shape {
        let [re, im, power] = [[0.0; LANES]; 3];
        Shape { re, im, power }
    }
}

/// One pass over the lines; the diagonal is `ratio |h|^2 + floor (1 + slope x)`, positive for a slope
/// within -1 to 1.
fn gather<const SHARED: u8>(band: &Band, slope: f64, ratio: f64, response: impl Response) -> Option<Moments> {
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
const NOISE: u8 = 0;
const TRANSIENT: u8 = 1;
const RANK_TWO: u8 = 2;

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
struct Reduced {
    hh: f64,
    hp: Complex<f64>,
    pp: f64,
    hj: Complex<f64>,
    pj: Complex<f64>,
    jj: f64,
    log_det: f64,
    /// Cholesky factor of the smooth terms' Gram matrix, and shape and data in its coordinates.
    factor: [f64; 3],
    h: [Complex<f64>; SMOOTH],
    j: [Complex<f64>; SMOOTH],
}

impl Reduced {
    /// Best smooth terms for a given transient.
    fn smooth(&self, transient: Complex<f64>) -> [Complex<f64>; SMOOTH] {
        let [l00, l10, l11] = self.factor;
        let left: [Complex<f64>; SMOOTH] = std::array::from_fn(|i| self.j[i] - self.h[i] * transient);
        let slope = left[1] / l11;
        [(left[0] - slope * l10) / l00, slope]
    }
}

fn reduce(m: &Moments) -> Option<Reduced> {
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
