//! Faults between a rod and a recording: the sensor, the clock, the transport.

use super::oscillator::normal;
use super::settings::FaultKind;
use crate::signal::record::Timestamp;
use rand::{Rng, RngExt};

/// One message of a simulated recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    /// Time of the first sample, as stamped.
    pub stamp: Timestamp,
    /// The samples, SI; NaN is a missing one.
    pub samples: Vec<f64>,
}

/// Applies the sensor's faults. `resolution_m` does not matter here: rails and spikes are electric.
pub(super) fn spoil_samples<R: Rng>(
    faults: &[FaultKind],
    fs_hz: f64,
    samples: &mut [f64],
    generator: &mut R,
) {
    let count = samples.len();
    for fault in faults {
        match *fault {
            FaultKind::Nan { at_s, length_s } => samples[within(at_s, length_s, fs_hz, count)].fill(f64::NAN),
            FaultKind::Held { at_s, length_s } => {
                let held = within(at_s, length_s, fs_hz, count);
                let last = samples[held.start.saturating_sub(1).min(count.saturating_sub(1))];
                samples[held].fill(last);
            }
            FaultKind::Spikes { per_hour, height_m } => {
                let probability = per_hour / (3600.0 * fs_hz);
                for sample in samples.iter_mut() {
                    if generator.random::<f64>() < probability {
                        *sample += if generator.random::<bool>() {
                            height_m
                        } else {
                            -height_m
                        };
                    }
                }
            }
            FaultKind::Clipped { level_m } => {
                for sample in samples.iter_mut() {
                    *sample = sample.clamp(-level_m, level_m);
                }
            }
            FaultKind::Step { at_s, height_m } => {
                for sample in &mut samples[within(at_s, f64::INFINITY, fs_hz, count)] {
                    *sample += height_m;
                }
            }
            FaultKind::Scaled { factor } => {
                for sample in samples.iter_mut() {
                    *sample *= factor;
                }
            }
            FaultKind::Dropout { .. }
            | FaultKind::ClockStep { .. }
            | FaultKind::Late { .. }
            | FaultKind::Jitter { .. }
            | FaultKind::Duplicates { .. }
            | FaultKind::OutOfOrder { .. }
            | FaultKind::Lost { .. } => {}
        }
    }
}

/// Applies the faults of stamps and transport to the messages of one record that starts at `start`.
pub(super) fn spoil_messages<R: Rng>(
    faults: &[FaultKind],
    fs_hz: f64,
    start: Timestamp,
    messages: &mut Vec<Message>,
    generator: &mut R,
) {
    for fault in faults {
        match *fault {
            FaultKind::Dropout { at_s, length_s } => messages.retain(|message| {
                let begin = message.stamp.seconds_since(start);
                let end = begin + message.samples.len() as f64 / fs_hz;
                end <= at_s || begin >= at_s + length_s
            }),
            FaultKind::ClockStep { at_s, step_s } => {
                for message in messages.iter_mut() {
                    if message.stamp.seconds_since(start) >= at_s {
                        message.stamp = message.stamp.plus_seconds(step_s);
                    }
                }
            }
            FaultKind::Late { at_s, late_s } => {
                // Half a nanosecond is the rounding of a stamp.
                let holds = |message: &&mut Message| {
                    let begin = message.stamp.seconds_since(start);
                    let end = begin + message.samples.len() as f64 / fs_hz;
                    begin <= at_s + 1e-9 && at_s + 1e-9 < end
                };
                if let Some(message) = messages.iter_mut().find(holds) {
                    message.stamp = message.stamp.plus_seconds(late_s);
                }
            }
            FaultKind::Jitter { sd_s } => {
                for message in messages.iter_mut() {
                    message.stamp = message.stamp.plus_seconds(sd_s * normal(generator));
                }
            }
            FaultKind::Duplicates { share } => {
                let mut doubled = Vec::with_capacity(messages.len());
                for message in messages.drain(..) {
                    if generator.random::<f64>() < share {
                        doubled.push(message.clone());
                    }
                    doubled.push(message);
                }
                *messages = doubled;
            }
            FaultKind::OutOfOrder { share } => {
                let mut i = 0;
                while i + 1 < messages.len() {
                    if generator.random::<f64>() < share {
                        messages.swap(i, i + 1);
                        i += 1;
                    }
                    i += 1;
                }
            }
            FaultKind::Lost { share } => messages.retain(|_| generator.random::<f64>() >= share),
            FaultKind::Nan { .. }
            | FaultKind::Held { .. }
            | FaultKind::Spikes { .. }
            | FaultKind::Clipped { .. }
            | FaultKind::Step { .. }
            | FaultKind::Scaled { .. } => {}
        }
    }
}

/// Index range of the samples from `at_s` for `length_s`, cut to the record.
fn within(at_s: f64, length_s: f64, fs_hz: f64, count: usize) -> std::ops::Range<usize> {
    let sample = |seconds: f64| ((seconds * fs_hz).ceil().max(0.0) as usize).min(count);
    sample(at_s)..sample(at_s + length_s)
}
