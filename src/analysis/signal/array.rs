//! Several sensors of one rod: their records side by side, modal amplitudes against each other, and for each mode the combination of
//! records that sees it best.
//!
//! In a narrow band about a mode every sensor sees the same motion, times its modal amplitude: `z_c(t) = rho_c z_r(t) + e_c(t)`, with `z` the
//! record times `exp(-i omega t)` under a Gaussian window that slides. The ratio `rho` is real, positive or negative, since the damping is
//! low: another phase means another clock. The window keeps other modes out but for the first moments after an onset, which are left out.

use super::modes::Mode;
use super::record::Record;
use std::f64::consts::PI;
use thiserror::Error;

/// Largest relative difference of two sample rates that stamps may bring about.
const SAME_RATE: f64 = 1e-3;
/// Least common part of two records.
const COMMON: f64 = 0.5;
/// Width of the band about a mode, as a multiple of the mode's half width `zeta f`, and at least so many times the resolution `1 / T`.
const BAND: (f64, f64) = (6.0, 6.0);
/// Band of a mode whose damping is not known: `f` times this.
const USUAL_DAMPING: f64 = 0.003;
/// Distance of the bands on both sides where noise is measured, in widths.
const ASIDE: f64 = 5.0;
/// Widest band, over the frequency by the order: modes lie about that far apart, so noise is measured half-way between two of them.
const WIDEST: f64 = 0.5 / ASIDE;
/// Windows left out at both ends, in standard deviations of the window: beyond, a tail of 1e-3 is cut.
const EDGE: f64 = 3.0;
/// Windows per standard deviation of the window.
const STEPS: f64 = 2.0;
/// Sums over all lags j of the correlation `exp(-(j / STEPS)^2 / 4)` of noise between windows, and of its square.
const CORRELATED: (f64, f64) = (7.089_8, 5.013_3);
/// Fewest independent windows of a ratio.
const FEWEST: f64 = 4.0;
/// Least energy over that of the noise of one window, of the sensor that others are compared with.
const CLEAR: f64 = 20.0;
/// Largest deviation of a phase from 0 or 180 degrees \[rad\], and standard errors that it takes to be one.
const PHASE: (f64, f64) = (0.2, 4.0);
/// Least relative standard error of a ratio: the mode's own tail where noise is measured, and what windows leave of other modes.
const LEAST: f64 = 5e-3;
/// Standard errors that a ratio must be away from zero in one mode at least, for the sensor to see the rod at all.
const SEEN: f64 = 4.0;

/// Reason why two records cannot be put side by side.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum Unsynchronised {
    /// Their sample rates differ.
    #[error(
        "sampled at {other_hz:.4} Hz, the first sensor at {first_hz:.4} Hz: sensors must share one sample rate"
    )]
    Rate {
        /// Rate of the first sensor \[Hz\].
        first_hz: f64,
        /// Rate of this one \[Hz\].
        other_hz: f64,
    },
    /// They were not measured at the same time.
    #[error(
        "only {:.0} % of the first sensor's record have a sample of this one: they must run together, and their stamps must come of one clock",
        share * 100.0
    )]
    Apart {
        /// Common share of the first record \[-\].
        share: f64,
    },
    /// The phase between them is not that of a mode.
    #[error(
        "mode {order} is {degrees:.0} degrees out of phase with the first sensor, where 0 or 180 are possible: another clock, or a filter in one of them"
    )]
    Phase {
        /// Order of the mode.
        order: usize,
        /// Phase, from -180 to 180 \[degree\].
        degrees: f64,
    },
    /// It shows nothing but noise.
    #[error(
        "shows none of the modes that the first sensor shows, only noise: a cable that is off, a laser that looks past the rod, or a \
         dead channel"
    )]
    Silent,
}

/// Records side by side: the same number of samples, from the same time on.
#[derive(Debug, Clone)]
pub struct Array {
    fs_hz: f64,
    sensors: Vec<Sensor>,
}

#[derive(Debug, Clone)]
struct Sensor {
    samples: Vec<f64>,
    /// Time of its samples after those of the first, less than half an interval \[s\].
    delay_s: f64,
    /// Derivatives by time that its quantity is away from the first's: 1 for a velocity beside a displacement.
    derivative: i32,
}

/// Modal amplitude at one sensor over that at another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ratio {
    /// Mode order, from 1.
    pub order: usize,
    /// Index of the sensor.
    pub sensor: usize,
    /// Index of the sensor that it is compared with.
    pub reference: usize,
    /// Ratio with its sign, in the sensors' units.
    pub value: f64,
    /// Standard error, without that of the sensors' gains.
    pub sd: f64,
}

impl Ratio {
    /// True if the sensor sees the mode: its amplitude is not that of noise.
    pub fn is_seen(&self) -> bool {
        self.value.abs() >= SEEN * self.sd
    }
}

/// Findings of the sensors on one mode.
#[derive(Debug, Clone, PartialEq)]
pub struct Sight {
    /// Ratios of amplitudes, of every sensor that sees the mode clearly enough but the reference.
    pub ratios: Vec<Ratio>,
    /// Weights of the samples in the combination that sees the mode best, per sensor.
    pub weights: Vec<f64>,
}

impl Array {
    /// Puts records beside the first, each with the derivatives by time that its quantity is away from the first's; a reason for each
    /// that cannot be.
    pub fn new(records: &[(&Record, i32)]) -> (Self, Vec<(usize, Unsynchronised)>) {
        let Some((first, _)) = records.first() else {
            return (
                Self {
                    fs_hz: f64::NAN,
                    sensors: Vec::new(),
                },
                Vec::new(),
            );
        };
        let mut refused = Vec::new();
        let mut spans = Vec::new();
        let (mut begin, mut end) = (0, first.samples.len() as i64);
        for (i, (record, _)) in records.iter().enumerate() {
            match shift(first, record) {
                Ok((shift, delay_s)) => {
                    spans.push((i, shift, delay_s));
                    begin = begin.max(shift);
                    end = end.min(shift + record.samples.len() as i64);
                }
                Err(why) => refused.push((i, why)),
            }
        }
        // Each has half of the first; all together may have less, where the first sensor alone is left.
        if end - begin < (COMMON * first.samples.len() as f64) as i64 {
            let share = (end - begin).max(0) as f64 / first.samples.len().max(1) as f64;
            refused.extend(
                spans
                    .drain(1..)
                    .map(|(i, ..)| (i, Unsynchronised::Apart { share })),
            );
            (begin, end) = (0, first.samples.len() as i64);
        }
        let sensors = spans
            .into_iter()
            .filter_map(|(i, shift, delay_s)| {
                let range = usize::try_from(begin - shift).ok()?..usize::try_from(end - shift).ok()?;
                Some(Sensor {
                    samples: records[i].0.samples.get(range)?.to_vec(),
                    delay_s,
                    derivative: records[i].1,
                })
            })
            .collect();
        refused.sort_by_key(|(i, _)| *i);
        let fs_hz = first.fs_hz;
        (Self { fs_hz, sensors }, refused)
    }

    /// Number of sensors.
    pub fn len(&self) -> usize {
        self.sensors.len()
    }

    /// True without sensors.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Without one of the sensors.
    pub fn remove(&mut self, sensor: usize) {
        self.sensors.remove(sensor);
    }

    /// A record of the combination with such weights, with everything else of `first`'s.
    pub fn combined(&self, first: &Record, weights: &[f64]) -> Record {
        let count = self.sensors.first().map_or(0, |sensor| sensor.samples.len());
        let mut samples = vec![0.0; count];
        for (sensor, weight) in self.sensors.iter().zip(weights) {
            for (sum, x) in samples.iter_mut().zip(&sensor.samples) {
                *sum += weight * x;
            }
        }
        Record {
            samples,
            ..first.clone()
        }
    }

    /// Findings of the sensors about a mode; `None` where none sees it, or the record is too short.
    ///
    /// # Errors
    /// The sensor whose phase no mode has.
    pub fn sight(&self, mode: &Mode) -> Result<Option<Sight>, (usize, Unsynchronised)> {
        let count = self.sensors.first().map_or(0, |sensor| sensor.samples.len());
        let duration_s = count as f64 / self.fs_hz;
        let damping = mode.damping.unwrap_or(USUAL_DAMPING);
        let band_hz = (BAND.0 * damping * mode.frequency_hz)
            .max(BAND.1 / duration_s)
            .min(WIDEST * mode.frequency_hz / mode.order.max(1) as f64);
        let views: Vec<View> = self
            .sensors
            .iter()
            .map(|sensor| View::of(sensor, self.fs_hz, mode.frequency_hz, band_hz))
            .collect();
        let windows = views.first().map_or(0, |view| view.motion.len());
        if (windows as f64) < FEWEST * CORRELATED.1 {
            return Ok(None);
        }
        let clearest = (0..views.len()).max_by(|&a, &b| views[a].clarity().total_cmp(&views[b].clarity()));
        // The first as long as it sees the mode: then all modes share one gain per pair.
        let reference = match views.first().is_some_and(|view| view.clarity() >= CLEAR) {
            true => 0,
            false => clearest.unwrap_or(0),
        };
        let base = &views[reference];
        if base.clarity() < CLEAR {
            return Ok(None);
        }
        let mut sight = Sight {
            ratios: Vec::new(),
            weights: vec![0.0; views.len()],
        };
        let factor = (2.0 * PI * mode.frequency_hz).powi(self.sensors[reference].derivative);
        sight.weights[reference] = 1.0 / base.noise / factor;
        // The reference's noise is in all ratios over it. They enter as independent, each with so many times its variance:
        // 1 1' <= n I.
        let ratios = (views.len() - 1) as f64;
        for (i, view) in views.iter().enumerate().filter(|(i, _)| *i != reference) {
            let (re, im) = product(&base.motion, &view.motion);
            let (value, imaginary) = (re / base.signal(), im / base.signal());
            // Of the complex regression: a phase must not hide in what is taken for noise.
            let residual: f64 = base
                .motion
                .iter()
                .zip(&view.motion)
                .map(|(r, c)| {
                    let (re, im) = (value * r.0 - imaginary * r.1, value * r.1 + imaginary * r.0);
                    (c.0 - re).powi(2) + (c.1 - im).powi(2)
                })
                .sum::<f64>()
                / windows as f64;
            let of_variance = CORRELATED.0 / (2.0 * base.signal());
            let variance = residual * of_variance;
            let sd = variance.sqrt();
            if imaginary.abs() > PHASE.1 * sd && imaginary.abs() > PHASE.0 * value.abs() {
                let (order, degrees) = (mode.order, im.atan2(re).to_degrees());
                // The lead gave the modes: it is the other that has to go.
                return Err(match i {
                    0 => (
                        reference,
                        Unsynchronised::Phase {
                            order,
                            degrees: -degrees,
                        },
                    ),
                    _ => (i, Unsynchronised::Phase { order, degrees }),
                });
            }
            let of_reference = (value * value * base.noise * of_variance).min(variance);
            // What a phase within the limits takes from the amplitude.
            let aside = (imaginary * imaginary - variance).max(0.0).sqrt();
            let sd = (variance + (ratios - 1.0) * of_reference)
                .sqrt()
                .hypot(LEAST * ratios.sqrt() * value)
                .hypot(value.hypot(aside) - value.abs());
            // In the time domain quantities combine that are in phase: derivatives an even number apart.
            let sensor = &self.sensors[i];
            let apart = sensor.derivative - self.sensors[reference].derivative;
            let factor = (2.0 * PI * mode.frequency_hz).powi(sensor.derivative);
            sight.weights[i] = match apart.rem_euclid(4) {
                0 => value / view.noise / factor,
                2 => -value / view.noise / factor,
                _ => 0.0,
            };
            // A sensor at a node tells as much as any other: that the amplitude there is small.
            sight.ratios.push(Ratio {
                order: mode.order,
                sensor: i,
                reference,
                value,
                sd,
            });
        }
        Ok(Some(sight))
    }
}

/// Samples of the first before the other's first, and the rest of its time \[s\].
fn shift(first: &Record, other: &Record) -> Result<(i64, f64), Unsynchronised> {
    if (other.fs_hz / first.fs_hz - 1.0).abs() > SAME_RATE {
        return Err(Unsynchronised::Rate {
            first_hz: first.fs_hz,
            other_hz: other.fs_hz,
        });
    }
    let after = other.start.seconds_since(first.start) * first.fs_hz;
    let count = first.samples.len() as f64;
    let share = ((after + other.samples.len() as f64).min(count) - after.max(0.0)) / count.max(1.0);
    if share < COMMON {
        return Err(Unsynchronised::Apart {
            share: share.max(0.0),
        });
    }
    let whole = after.round();
    Ok((whole as i64, (after - whole) / first.fs_hz))
}

/// One sensor's motion in the band of a mode, window by window, and its noise.
struct View {
    motion: Vec<(f64, f64)>,
    /// Mean square of the motion in the bands on both sides.
    noise: f64,
}

impl View {
    fn of(sensor: &Sensor, fs_hz: f64, frequency_hz: f64, band_hz: f64) -> Self {
        let motion = demodulated(sensor, fs_hz, frequency_hz, band_hz);
        let aside = [-ASIDE, ASIDE].map(|side| {
            let motion = demodulated(sensor, fs_hz, frequency_hz + side * band_hz, band_hz);
            energy(&motion) / motion.len().max(1) as f64
        });
        Self {
            motion,
            // The quieter side: on the other there may be something else. A sensor without noise counts as one with very little.
            noise: aside[0].min(aside[1]).max(f64::MIN_POSITIVE),
        }
    }

    /// Energy of the motion without the noise's.
    fn signal(&self) -> f64 {
        let total = energy(&self.motion);
        (total - self.motion.len() as f64 * self.noise).max(0.01 * total)
    }

    /// Energy of the motion over that of the noise of one independent window: of a decay it does not matter how long the record goes on.
    fn clarity(&self) -> f64 {
        (energy(&self.motion) / self.noise - self.motion.len() as f64) / CORRELATED.1
    }
}

fn energy(motion: &[(f64, f64)]) -> f64 {
    motion.iter().map(|(re, im)| re * re + im * im).sum()
}

/// Sum of `conj(a) b`.
fn product(a: &[(f64, f64)], b: &[(f64, f64)]) -> (f64, f64) {
    a.iter().zip(b).fold((0.0, 0.0), |(re, im), (a, b)| {
        (re + a.0 * b.0 + a.1 * b.1, im + a.0 * b.1 - a.1 * b.0)
    })
}

/// The samples times `exp(-i omega t)` under sliding Gaussian windows, whose response is `exp(-(f - f0)^2 / (2 band^2))`.
fn demodulated(sensor: &Sensor, fs_hz: f64, frequency_hz: f64, band_hz: f64) -> Vec<(f64, f64)> {
    let width = fs_hz / (2.0 * PI * band_hz);
    let reach = (EDGE * width).ceil() as usize;
    let step = (width / STEPS).round().max(1.0) as usize;
    let kernel: Vec<f64> = (0..=2 * reach)
        .map(|i| libm::exp(-0.5 * ((i as f64 - reach as f64) / width).powi(2)))
        .collect();
    let omega = 2.0 * PI * frequency_hz;
    // exp(-i omega t) / (i omega)^k.
    let (quarter, scale) = (
        f64::from(sensor.derivative) * 0.5 * PI,
        omega.powi(-sensor.derivative),
    );
    let turned: Vec<(f64, f64)> = sensor
        .samples
        .iter()
        .enumerate()
        .map(|(i, x)| {
            let (sin, cos) = libm::sincos(omega * (i as f64 / fs_hz + sensor.delay_s) + quarter);
            (scale * x * cos, -scale * x * sin)
        })
        .collect();
    (0..)
        .map(|i| i * step)
        .map_while(|from| turned.get(from..=from + 2 * reach))
        .map(|span| {
            span.iter()
                .zip(&kernel)
                .fold((0.0, 0.0), |(re, im), (z, g)| (re + g * z.0, im + g * z.1))
        })
        .collect()
}

#[cfg(test)]
mod tests;
