//! Two resonances closer than their widths: fitted together, to the series of their common band.
//!
//! The sum of two modes under white forces is followed by Kalman's filter with two states; its innovations give
//! the likelihood exactly, whatever the record's length. One mode is the same with the second force at zero, so
//! that the gain over it decides if there are two.

use super::likelihood::damping_log_prior;
use super::subband::{LEAST_SAMPLES, Pole, Subband};
use nalgebra::{DMatrix, DVector};
use rustfft::num_complex::Complex;

/// Parameters: frequency and ln damping of each, ln of the second force's power and of the noise over the first's.
const PARAMETERS: usize = 6;
/// Twice the log-likelihood gain of the best of some guesses above which they are improved.
const WORTH_TRYING: f64 = 1.0;
/// The same above which two modes are fitted.
const WORTH_CLIMBING: f64 = 7.0;
/// Twice the gain that makes two modes certain. Chi-square with three degrees of freedom exceeds it once in
/// six thousand.
const CERTAIN: f64 = 20.0;
/// Twice the gain above which two modes are likelier than one.
const OPEN: f64 = 9.0;
/// Twice the gain above which they are as likely: a neighbour that pulls the single fit by two standard errors seldom gains more.
const EVEN: f64 = 3.0;
/// Distance of the farther mode in units of the standard error added, where the mode may be either of two.
const FAR_SHARE: f64 = 1.5;
/// The same of the nearer mode where one and two are as likely: the standard deviation of an even choice is half the distance.
const NEAR_SHARE: f64 = 2.0;
/// Distance in half-power half-widths of the single fit beyond which a second mode that shows no peak of its own is not told: it
/// gives the labels one more candidate, and the single fit has little error from it.
const BESIDE: f64 = 6.0;
/// Least power of the weaker peak, as a share of the stronger one's.
const LEAST_SHARE: f64 = 0.01;
/// Squared relative change of the filter's gains below which they count as settled.
const SETTLED: f64 = 1e-12;
const ITERATIONS: usize = 25;

/// One of two modes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Member {
    /// Pole of the mode.
    pub pole: Pole,
    /// Standard error of its frequency \[Hz\].
    pub frequency_sd_hz: f64,
    /// Standard error of its ln damping.
    pub damping_log_sd: f64,
}

/// Verdict on a band to which one mode was fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Pair {
    /// One mode is enough.
    One,
    /// Perhaps there are two; the standard error \[Hz\] that this adds to the single fit's frequency.
    Open(f64),
    /// Two modes, in the order of the guess.
    Two {
        /// The modes.
        members: [Member; 2],
        /// The second's peak power over the first's.
        share: f64,
        /// Twice the log-likelihood gain over one mode.
        gain: f64,
    },
}

/// Judges a series that `single` was fitted to, with `noise` over the power of its innovations; `guess` are the poles
/// if two peaks were seen. Twice the log-likelihood gain is divided by `spread`, what gusts make it larger by.
pub fn pair(series: &Subband, single: Pole, noise: f64, guess: Option<[Pole; 2]>, spread: f64) -> Pair {
    if series.samples.len() < LEAST_SAMPLES || !(noise > 0.0 && noise.is_finite()) {
        return Pair::One;
    }
    let objective = |x: &[f64; PARAMETERS]| log_posterior(series, x);
    let gain_over = |value: f64, one: f64| 2.0 * (value - one) / spread;
    let one = best_single(series, single, noise.ln());
    let near = |pole: Pole| [pole.frequency_hz, pole.damping.ln()];
    let mut start: Option<(f64, [f64; PARAMETERS])> = None;
    let mut consider = |a: Pole, b: Pole, force: f64| {
        let [[fa, za], [fb, zb]] = [near(a), near(b)];
        let x = [
            fa,
            za,
            fb,
            zb,
            force,
            noise.ln() - 2.0 * (a.damping / single.damping).ln(),
        ];
        if let Some(value) = objective(&x).filter(|v| start.is_none_or(|(best, _)| *v > best)) {
            start = Some((value, x));
        }
    };
    match guess {
        Some([a, b]) => {
            for force in [-2.0, 0.0, 2.0] {
                consider(a, b, force);
            }
        }
        None => {
            let width = single.damping * single.frequency_hz;
            let at = |offset: f64, share: f64| Pole {
                frequency_hz: single.frequency_hz + offset * width,
                damping: share * single.damping,
            };
            for (apart, share) in [(0.6, 0.6), (1.0, 0.5), (1.6, 0.35)] {
                for force in [-1.5, 0.0, 1.5] {
                    consider(at(-apart, share), at(apart, share), force);
                }
            }
            for apart in [-6.0, -3.5, 3.5, 6.0] {
                consider(at(0.0, 1.0), at(apart, 1.0), -1.5);
            }
        }
    }
    let Some((value, x)) = start else { return Pair::One };
    let widths = [x[0] * x[1].exp(), x[2] * x[3].exp()];
    let step = [0.4 * widths[0], 0.35, 0.4 * widths[1], 0.35, 0.8, 0.5];
    let (value, x) = approach(&objective, value, x, step);
    let moved = |x: &[f64; PARAMETERS]| [x[0], x[2]].map(|f| (f - single.frequency_hz).abs());
    if guess.is_none() && gain_over(value, one) < WORTH_CLIMBING {
        if gain_over(value, one) < WORTH_TRYING {
            return Pair::One;
        }
        let (value, x) = approach(&objective, value, x, step.map(|s| 0.5 * s));
        let [a, b] = moved(&x);
        return if gain_over(value, one) > EVEN {
            Pair::Open(a.min(b) / NEAR_SHARE)
        } else {
            Pair::One
        };
    }
    let Some((x, value, covariance)) = climb(&objective, x) else {
        return Pair::One;
    };
    let gain = gain_over(value, one);
    let member = |f: usize, z: usize| {
        let variance = covariance[(z, z)];
        Member {
            pole: Pole {
                frequency_hz: x[f],
                damping: x[z].exp(),
            },
            // Student's t for a scale known as well as the damping, as for single modes.
            frequency_sd_hz: covariance[(f, f)].sqrt() * (1.0 + 0.6 * variance.min(0.5)),
            damping_log_sd: variance.sqrt(),
        }
    };
    let members = [member(0, 1), member(2, 3)];
    // Peak powers go with the force over the damped width squared.
    let width = |m: &Member| m.pole.damping * m.pole.frequency_hz;
    let share = x[4].exp() * (width(&members[0]) / width(&members[1])).powi(2);
    let sane = (LEAST_SHARE..1.0 / LEAST_SHARE).contains(&share)
        && members
            .iter()
            .all(|m| m.frequency_sd_hz.is_finite() && m.damping_log_sd < 1.0 && m.pole.damping < 0.1);
    let [a, b] = moved(&x);
    let apart = (x[0] - x[2]).abs() / (single.damping * single.frequency_hz);
    if guess.is_none() && apart > BESIDE {
        Pair::Open(a.min(b) / NEAR_SHARE)
    } else if gain > CERTAIN && sane {
        Pair::Two { members, share, gain }
    } else if gain > OPEN {
        Pair::Open(a.max(b) / FAR_SHARE)
    } else {
        Pair::One
    }
}

/// Log posterior of two modes: the filter's log likelihood, maximised over the level of all forces, and the
/// prior of single modes for the dampings.
fn log_posterior(series: &Subband, x: &[f64; PARAMETERS]) -> Option<f64> {
    let pole = |f: f64, z: f64| Pole {
        frequency_hz: f,
        damping: z.exp(),
    };
    let end = series.first_hz + series.rate_hz;
    let inside = |f: f64| f > series.first_hz && f < end;
    if !(inside(x[0]) && inside(x[2]) && x[1] < -1.5 && x[3] < -1.5 && x[4].abs() < 12.0 && x[5].abs() < 40.0)
    {
        return None;
    }
    let forces = [1.0, x[4].exp()];
    let value = filter(series, [pole(x[0], x[1]), pole(x[2], x[3])], forces, x[5].exp())?;
    Some(value + damping_log_prior(x[1]) + damping_log_prior(x[3]) - 0.5 * (x[4] / 4.0).powi(2))
}

/// Log likelihood of two modes with the given powers of force and noise, up to their common level.
fn filter(series: &Subband, poles: [Pole; 2], forces: [f64; 2], noise: f64) -> Option<f64> {
    let [a, b] = poles.map(|pole| series.factor(pole));
    let [aa, bb] = [a.norm_sqr(), b.norm_sqr()];
    let ab = a * b.conj();
    let (mut x, mut y) = (Complex::default(), Complex::default());
    let (mut pxx, mut pyy) = (forces[0] / (1.0 - aa), forces[1] / (1.0 - bb));
    let mut pxy: Complex<f64> = Complex::default();
    let (mut log_det, mut quad) = (0.0, 0.0);
    // The first sample holds the part that is flat across the band.
    let mut left = series.samples[1..].iter();
    let mut before = (Complex::default(), Complex::default());
    while let Some(value) = left.next() {
        x *= a;
        y *= b;
        pxx = aa * pxx + forces[0];
        pyy = bb * pyy + forces[1];
        pxy *= ab;
        let gx = pxy + pxx;
        let gy = pxy.conj() + pyy;
        let s = gx.re + gy.re + noise;
        let e = value - x - y;
        log_det += s.ln();
        quad += e.norm_sqr() / s;
        let gains = (gx / s, gy / s);
        x += gains.0 * e;
        y += gains.1 * e;
        pxx -= gx.norm_sqr() / s;
        pyy -= gy.norm_sqr() / s;
        pxy -= gx * gy.conj() / s;
        let moved = (gains.0 - before.0).norm_sqr() + (gains.1 - before.1).norm_sqr();
        before = gains;
        if moved < SETTLED {
            // The gains do not depend on the data and have come to rest.
            log_det += left.len() as f64 * s.ln();
            let mut rest = 0.0;
            for value in left.by_ref() {
                x *= a;
                y *= b;
                let e = value - x - y;
                rest += e.norm_sqr();
                x += gains.0 * e;
                y += gains.1 * e;
            }
            quad += rest / s;
        }
    }
    let value = -log_det - (series.samples.len() - 1) as f64 * quad.ln();
    value.is_finite().then_some(value)
}

/// Best value for one mode near `pole`.
fn best_single(series: &Subband, pole: Pole, noise: f64) -> f64 {
    let value = |x: &[f64; 3]| {
        let pole = Pole {
            frequency_hz: x[0],
            damping: x[1].exp(),
        };
        filter(series, [pole, pole], [1.0, 0.0], x[2].exp())
            .map_or(f64::NEG_INFINITY, |v| v + damping_log_prior(x[1]))
    };
    let x = [pole.frequency_hz, pole.damping.ln(), noise];
    let step = [0.2 * pole.damping * pole.frequency_hz, 0.2, 0.4];
    approach(&|x| Some(value(x)), value(&x), x, step).0
}

/// A better point near `x`, whose value is `best`: a few trials to either side along each parameter in turn.
fn approach<const N: usize>(
    objective: &impl Fn(&[f64; N]) -> Option<f64>,
    mut best: f64,
    mut x: [f64; N],
    mut step: [f64; N],
) -> (f64, [f64; N]) {
    for _ in 0..3 {
        for i in 0..N {
            for side in [1.0, -1.0] {
                let mut trial = x;
                trial[i] += side * step[i];
                if let Some(value) = objective(&trial).filter(|v| *v > best) {
                    (best, x) = (value, trial);
                    break;
                }
            }
        }
        step = step.map(|s| 0.5 * s);
    }
    (best, x)
}

/// Newton's method with second differences: the maximum near `at`, its value and the inverse curvature.
fn climb(
    objective: &impl Fn(&[f64; PARAMETERS]) -> Option<f64>,
    start: [f64; PARAMETERS],
) -> Option<([f64; PARAMETERS], f64, DMatrix<f64>)> {
    let mut at = start;
    let mut value = objective(&at)?;
    let width = |x: &[f64; PARAMETERS], f: usize| x[f] * x[f + 1].exp();
    for iteration in 0..ITERATIONS {
        let step = [0.05 * width(&at, 0), 0.05, 0.05 * width(&at, 2), 0.05, 0.1, 0.1];
        let offset = |i: usize, a: f64, j: usize, b: f64| {
            let mut x = at;
            x[i] += a * step[i];
            x[j] += b * step[j];
            objective(&x).unwrap_or(value - 20.0)
        };
        let mut gradient = DVector::zeros(PARAMETERS);
        let mut bend = DMatrix::zeros(PARAMETERS, PARAMETERS);
        for i in 0..PARAMETERS {
            let (up, down) = (offset(i, 1.0, i, 0.0), offset(i, -1.0, i, 0.0));
            gradient[i] = 0.5 * (up - down);
            bend[(i, i)] = 2.0 * value - up - down;
            for j in 0..i {
                let mixed = offset(i, 1.0, j, 1.0) - offset(i, 1.0, j, -1.0) - offset(i, -1.0, j, 1.0)
                    + offset(i, -1.0, j, -1.0);
                bend[(i, j)] = -0.25 * mixed;
                bend[(j, i)] = bend[(i, j)];
            }
        }
        let eigen = bend.symmetric_eigen();
        let largest = eigen.eigenvalues.amax();
        let along = eigen.eigenvectors.transpose() * &gradient;
        let scaled = DVector::from_fn(PARAMETERS, |i, _| {
            along[i]
                / eigen.eigenvalues[i]
                    .abs()
                    .max(1e-5 * largest)
                    .max(f64::MIN_POSITIVE)
        });
        let bowl = eigen.eigenvalues.iter().all(|&l| l > 1e-7 * largest);
        let done = 0.5 * along.dot(&scaled) < 0.02;
        if bowl && (done || iteration + 1 == ITERATIONS) {
            let inverse = &eigen.eigenvectors
                * DMatrix::from_diagonal(&eigen.eigenvalues.map(f64::recip))
                * eigen.eigenvectors.transpose();
            let covariance =
                DMatrix::from_fn(PARAMETERS, PARAMETERS, |i, j| inverse[(i, j)] * step[i] * step[j]);
            return Some((at, value, covariance));
        }
        let mut direction = &eigen.eigenvectors * scaled;
        // At most a width of either, and a factor of e.
        let most = direction
            .iter()
            .zip([20.0, 20.0, 20.0, 20.0, 20.0, 20.0])
            .map(|(d, limit): (&f64, f64)| d.abs() / limit)
            .fold(1.0, f64::max);
        direction /= most;
        for _ in 0..8 {
            let mut trial = at;
            for i in 0..PARAMETERS {
                trial[i] += direction[i] * step[i];
            }
            if let Some(better) = objective(&trial).filter(|&v| v > value) {
                (at, value) = (trial, better);
                break;
            }
            direction *= 0.35;
        }
    }
    None
}
