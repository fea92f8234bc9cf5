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

use super::band::Band;
use super::softened::Softened;
use super::sums::{Decay, NOISE, Nothing, RANK_TWO, Resonant, SMOOTH, Sine, TRANSIENT, gather, reduce};
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

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
