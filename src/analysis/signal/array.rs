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

    /// What the sensors tell of a mode; `None` where none sees it, or the record is too short.
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
mod tests {
    use super::*;
    use crate::numerics::random;
    use crate::signal::record::{RodId, Timestamp};
    use rand_distr::{Distribution, StandardNormal};

    const MODES: [(f64, f64, f64); 3] = [(4.5, 1.0, 0.6), (9.3, 0.5, -0.8), (13.9, 0.3, 0.25)];

    /// Decays of three modes with amplitudes at two sensors, in noise.
    fn decays(seed: u64, noise: f64) -> [Record; 2] {
        let mut generator = random::stream(seed, 0);
        let phases: Vec<f64> = (0..3).map(|n| 0.7 * n as f64 + seed as f64).collect();
        [0, 1].map(|sensor| {
            let samples = (0..12_000)
                .map(|i| {
                    let t = f64::from(i) / 200.0;
                    let z: f64 = StandardNormal.sample(&mut generator);
                    let motion = MODES.iter().zip(&phases).map(|((f, amplitude, ratio), phase)| {
                        let w = 2.0 * PI * f;
                        let seen = if sensor == 0 { 1.0 } else { *ratio };
                        seen * amplitude * libm::exp(-0.002 * w * t) * libm::sin(w * t + phase)
                    });
                    motion.sum::<f64>() + noise * z
                })
                .collect();
            Record {
                rod: RodId("a".to_owned()),
                start: Timestamp::from_nanos(0),
                fs_hz: 200.0,
                samples,
                temperature_c: None,
                readings: Vec::new(),
                excitation: None,
                clock_sd: 0.0,
                flags: Vec::new(),
            }
        })
    }

    /// Pulls of modes at multiples of `f1` Hz, the lower the stronger, with amplitudes at sensors; `phase` in degrees turns all but
    /// the first.
    fn pulls(
        (f1, duration_s, damping): (f64, f64, f64),
        amplitudes: &[[f64; 3]],
        (noise, phase): (f64, f64),
        seed: u64,
    ) -> Vec<Record> {
        let mut generator = random::stream(seed, 1);
        let [first, _] = decays(seed, 0.0);
        amplitudes
            .iter()
            .enumerate()
            .map(|(sensor, seen)| {
                let turned = if sensor == 0 { 0.0 } else { phase.to_radians() };
                let samples = (0..(200.0 * duration_s) as usize)
                    .map(|i| {
                        let t = i as f64 / 200.0;
                        let z: f64 = StandardNormal.sample(&mut generator);
                        let motion = seen
                            .iter()
                            .zip([1.0, 0.5, 0.3])
                            .enumerate()
                            .map(|(k, (seen, a))| {
                                let w = 2.0 * PI * f1 * (k + 1) as f64;
                                let phase = seed as f64 + 0.7 * k as f64 + turned;
                                seen * a * libm::exp(-damping * w * t) * libm::sin(w * t + phase)
                            });
                        motion.sum::<f64>() + noise * z
                    })
                    .collect();
                Record {
                    samples,
                    ..first.clone()
                }
            })
            .collect()
    }

    /// Mode of such pulls.
    fn multiple(order: usize, (f1, _, damping): (f64, f64, f64)) -> Mode {
        Mode {
            order,
            frequency_hz: f1 * order as f64,
            sd_hz: 1e-3,
            damping: Some(damping),
        }
    }

    #[test]
    fn neighbouring_modes_are_not_taken_for_noise() {
        // Bands that a short record or much damping make as wide as modes are apart.
        for how in [(1.5, 20.0, 0.003), (4.5, 600.0, 0.012)] {
            let wanted = [0.6, 0.8, -0.6];
            let mut scores = Vec::new();
            for seed in 0..20 {
                let records = pulls(how, &[[1.0; 3], wanted], (0.01, 0.0), seed);
                let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
                for (order, wanted) in (1..).zip(wanted) {
                    let ratio = array.sight(&multiple(order, how)).unwrap().unwrap().ratios[0];
                    // A tenth of a percent of noise at each end of a ratio, and twice the standard error that none falls below.
                    assert!(
                        (ratio.value / wanted - 1.0).abs() < 0.06,
                        "{how:?} seed {seed} mode {order}: {ratio:?}"
                    );
                    scores.push(((ratio.value - wanted) / ratio.sd).powi(2));
                }
            }
            let square = scores.iter().sum::<f64>() / scores.len() as f64;
            assert!(square < 1.5, "{how:?}: {square}");
        }
    }

    #[test]
    fn a_phase_is_seen_in_a_short_record_too() {
        // Forty windows: what is out of phase, counted as noise, was thought to explain itself.
        let how = (4.5, 10.0, 0.003);
        for phase in [65.0, 89.0, 130.0] {
            let records = pulls(how, &[[1.0; 3], [0.6, 0.8, -0.6]], (0.01, phase), 1);
            let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
            let (sensor, why) = array.sight(&multiple(1, how)).unwrap_err();
            assert_eq!(sensor, 1);
            let Unsynchronised::Phase { degrees, .. } = why else {
                panic!("{why}")
            };
            assert!((degrees - phase).abs() < 5.0, "{degrees} {phase}");
        }
        // Five degrees, a filter's: within the limits, and the amplitude is not the worse for it.
        let records = pulls(how, &[[1.0; 3], [0.6, 0.8, -0.6]], (0.01, 5.0), 1);
        let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
        let ratio = array.sight(&multiple(1, how)).unwrap().unwrap().ratios[0];
        assert!((ratio.value - 0.6).abs() < 3.0 * ratio.sd, "{ratio:?}");
    }

    #[test]
    fn the_lead_is_never_the_one_out_of_phase() {
        // The lead near a node of mode 2: the other is what it is compared with, and what has to go.
        let how = (4.5, 60.0, 0.003);
        let mut refused = 0;
        for seed in 0..20 {
            let records = pulls(how, &[[1.0, 0.2, 1.0], [0.6, 5.0, -0.6]], (0.3, 90.0), seed);
            let (array, _) = Array::new(&[(&records[0], 0), (&records[1], 0)]);
            // Some are not clear enough to tell.
            if let Err((sensor, why)) = array.sight(&multiple(2, how)) {
                assert_eq!(sensor, 1, "{why}");
                let Unsynchronised::Phase { degrees, .. } = why else {
                    panic!("{why}")
                };
                assert!((degrees - 90.0).abs() < 45.0, "{why}");
                refused += 1;
            }
        }
        // About four standard errors, which is the limit: some are above it.
        assert!(refused >= 3, "{refused}");
    }

    #[test]
    fn ratios_over_one_reference_are_worth_no_more_than_they_are() {
        // The mean of three equal ratios over one noisy reference: its error is the reference's, whatever their number.
        let how = (4.5, 60.0, 0.003);
        let (mut square, mut told, mut runs) = (0.0, 0.0, 0.0);
        for seed in 0..40 {
            let mut records = pulls(how, &[[1.0; 3]; 4], (0.01, 0.0), seed);
            let [noisy] = &pulls(how, &[[1.0; 3]], (0.3, 0.0), seed)[..] else {
                panic!()
            };
            records[0] = noisy.clone();
            let all: Vec<(&Record, i32)> = records.iter().map(|record| (record, 0)).collect();
            let (array, _) = Array::new(&all);
            let ratios = array.sight(&multiple(1, how)).unwrap().unwrap().ratios;
            assert_eq!(ratios.len(), 3);
            let precision: f64 = ratios.iter().map(|ratio| ratio.sd.powi(-2)).sum();
            let mean: f64 = ratios
                .iter()
                .map(|ratio| ratio.value * ratio.sd.powi(-2))
                .sum::<f64>()
                / precision;
            square += (mean - 1.0).powi(2);
            told += 1.0 / precision;
            runs += 1.0;
        }
        // Forty runs: 1 +- 0.22 if the variance told is right; 3 where they count as independent.
        assert!(square / told < 1.9, "{} runs: {}", runs, square / told);
    }

    fn mode(order: usize) -> Mode {
        Mode {
            order,
            frequency_hz: MODES[order - 1].0,
            sd_hz: 1e-3,
            damping: Some(0.002),
        }
    }

    #[test]
    fn ratios_have_their_sign_and_standard_error() {
        let mut scores = Vec::new();
        for seed in 0..40 {
            let [a, b] = decays(seed, 0.1);
            let (array, refused) = Array::new(&[(&a, 0), (&b, 0)]);
            assert!(refused.is_empty());
            for order in 1..=3 {
                let sight = array.sight(&mode(order)).unwrap().unwrap();
                let ratio = sight.ratios[0];
                assert_eq!((ratio.sensor, ratio.reference), (1, 0));
                scores.push((ratio.value - MODES[order - 1].2) / ratio.sd);
            }
        }
        let count = scores.len() as f64;
        let mean = scores.iter().sum::<f64>() / count;
        let square = scores.iter().map(|z| z * z).sum::<f64>() / count;
        // 120 scores: mean 0 +- 0.09, mean square 1 +- 0.13; four standard errors.
        assert!(mean.abs() < 0.37, "{mean}");
        assert!((0.5..1.5).contains(&square), "{square}");
    }

    #[test]
    fn another_rate_time_or_clock_is_refused() {
        let [a, b] = decays(1, 0.05);
        let rate = Record {
            fs_hz: 250.0,
            ..b.clone()
        };
        let late = Record {
            start: Timestamp::from_nanos(40_000_000_000),
            ..b.clone()
        };
        let (array, refused) = Array::new(&[(&a, 0), (&rate, 0), (&late, 0)]);
        assert_eq!(array.len(), 1);
        assert!(
            matches!(refused[0], (1, Unsynchronised::Rate { .. })),
            "{refused:?}"
        );
        assert!(
            matches!(refused[1], (2, Unsynchronised::Apart { .. })),
            "{refused:?}"
        );
        // Stamps that are wrong by 30 ms: 49 degrees of the first mode.
        let skewed = Record {
            start: Timestamp::from_nanos(30_000_000),
            ..b.clone()
        };
        let (array, refused) = Array::new(&[(&a, 0), (&skewed, 0)]);
        assert!(refused.is_empty());
        let (sensor, why) = array.sight(&mode(1)).unwrap_err();
        assert_eq!(sensor, 1);
        assert!(why.to_string().contains("degrees out of phase"), "{why}");
        // A start between two samples is no such fault.
        let between = Record {
            start: Timestamp::from_nanos(2_000_000),
            ..b
        };
        let (array, _) = Array::new(&[(&a, 0), (&between, 0)]);
        assert!(array.sensors[1].delay_s > 0.0019);
    }

    #[test]
    fn the_combination_sees_a_mode_better_than_either_sensor() {
        let [a, b] = decays(3, 0.3);
        let (array, _) = Array::new(&[(&a, 0), (&b, 0)]);
        let sight = array.sight(&mode(2)).unwrap().unwrap();
        let both = array.combined(&a, &sight.weights);
        let clarity = |record: &Record| {
            let (alone, _) = Array::new(&[(record, 0)]);
            View::of(&alone.sensors[0], 200.0, 9.3, 0.12).clarity()
        };
        // Signal over noise of equal noise adds: 1 + 0.8^2 of the first alone, to the noise's own scatter.
        let gain = clarity(&both) / clarity(&a);
        assert!((1.3..2.1).contains(&gain), "{gain}");
    }
}
