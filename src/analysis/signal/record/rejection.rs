//! Reasons why a record was refused, and faults noticed about one that was not: data, not errors.

use crate::numerics::json_number::nan_if_null;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Highest frequency usable at a sample rate, as a share of the rate.
pub const UNDERSAMPLED: f64 = 0.45;

/// Reason why a record gives no frequencies or no force. Stored, counted and shown; never an error.
#[derive(Debug, Clone, PartialEq, Error, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "reason")]
pub enum Rejection {
    /// Too short to resolve the modes.
    #[error(
        "{duration_s:.2} s long, at least {needed_s:.2} s needed: record longer, or lower min_duration_s"
    )]
    TooShort {
        /// Length \[s\].
        duration_s: f64,
        /// Shortest length \[s\].
        needed_s: f64,
    },
    /// Too many samples missing or not finite.
    #[error("{}", missing(*share, *allowed))]
    Missing {
        /// Share of the samples.
        share: f64,
        /// Largest share allowed.
        allowed: f64,
    },
    /// The sensor gave one value far outside the motion too often: the error code of a lost target.
    #[error("{}", error_code(*value, *runs, *time_s, *share, *allowed))]
    ErrorCode {
        /// The value, SI.
        #[serde(deserialize_with = "nan_if_null")]
        value: f64,
        /// Number of runs of it.
        runs: usize,
        /// Begin of the first, from the record's start \[s\].
        time_s: f64,
        /// Share of the samples at error codes.
        share: f64,
        /// Largest share allowed.
        allowed: f64,
    },
    /// The signal does not move.
    #[error(
        "constant signal: every sample is {value:e}; check that the sensor measures, and that `field` names what moves"
    )]
    Constant {
        /// Constant value of the samples, SI.
        #[serde(deserialize_with = "nan_if_null")]
        value: f64,
    },
    /// The sensor repeated its last value too often.
    #[error("{:.1} % of the samples repeat the one before while the signal moves, at most {:.1} % allowed: log at the rate at which the sensor measures, or raise max_held", share * 100.0, allowed * 100.0)]
    Held {
        /// Share of the samples.
        share: f64,
        /// Largest share allowed.
        allowed: f64,
    },
    /// The sensor was at its rails.
    #[error("{:.2} % of the samples are clipped, at most {:.2} % allowed: widen the sensor's range, excite the rod less, or raise max_clipped", share * 100.0, allowed * 100.0)]
    Clipped {
        /// Share of the samples.
        share: f64,
        /// Largest share allowed.
        allowed: f64,
    },
    /// Isolated spikes carry too much of the signal.
    #[error(
        "{count} spikes that no motion follows carry most of the signal's energy: check the sensor's cable and target"
    )]
    Spikes {
        /// Number of spikes.
        count: usize,
    },
    /// A step in the signal, larger than the vibration.
    #[error(
        "a step of {height:.2e} (in the SI unit of the channel) at {time_s:.2} s, larger than the vibration around it, and no release of the rod: the sensor or its target moved, so split the recording there"
    )]
    Step {
        /// Height, SI.
        #[serde(deserialize_with = "nan_if_null")]
        height: f64,
        /// Time, from the record's start \[s\].
        time_s: f64,
    },
    /// The stamps are not evenly spaced, or do not advance.
    #[error("{}", irregular(*jitter, *allowed))]
    Irregular {
        /// Scatter over the interval of messages; infinite if the stamps do not advance.
        #[serde(deserialize_with = "nan_if_null")]
        jitter: f64,
        /// Largest jitter allowed.
        allowed: f64,
    },
    /// The declared rate is not the measured one.
    #[error(
        "declared {declared_hz} Hz, the stamps say {measured_hz:.4} Hz: correct fs_hz, or let `time` name better stamps"
    )]
    Rate {
        /// Declared sample rate \[Hz\].
        declared_hz: f64,
        /// Measured sample rate \[Hz\].
        #[serde(deserialize_with = "nan_if_null")]
        measured_hz: f64,
    },
    /// The sample rate is too low for the band of the modes.
    #[error(
        "sampled at {fs_hz:.2} Hz, the lowest mode is expected up to {needed_hz:.2} Hz: sample at {:.0} Hz or more, or narrow \
         the prior of axial_force_n from above",
        needed_hz / UNDERSAMPLED + 0.5
    )]
    Undersampled {
        /// Sample rate \[Hz\].
        fs_hz: f64,
        /// Highest frequency the first mode may have \[Hz\].
        needed_hz: f64,
    },
    /// No free decay begins in the whole stretch.
    #[error(
        "no onset of a free decay in {duration_s:.1} s, and none under way at its start: lower onset_ratio, or let cut = \"auto\" recognise the motion"
    )]
    NoOnset {
        /// Length searched \[s\].
        duration_s: f64,
    },
    /// The vibration level jumps and stays: a changed unit, range or sensor.
    #[error(
        "the level and the noise with it change {ratio:.0}-fold at {time_s:.2} s and stay: unit, range or sensor changed, so split the recording there"
    )]
    Level {
        /// Larger over smaller level.
        #[serde(deserialize_with = "nan_if_null")]
        ratio: f64,
        /// Time, from the record's start \[s\].
        time_s: f64,
    },
    /// Part of the record was damaged in the file.
    #[error(
        "damaged in the file, not read from there on: {detail}; copy it again from where it was recorded"
    )]
    Damaged {
        /// Error text of the reader.
        detail: String,
    },
    /// No peak is above the noise.
    #[error(
        "no spectral peak stands above the noise between {low_hz:.2} and {high_hz:.2} Hz, where the prior expects the modes and the \
         sample rate shows them: look for peaks elsewhere with `tirante spectrum`, record longer or nearer mid-span, or pull the rod and let it go"
    )]
    NoPeak {
        /// Lower end of the searched band \[Hz\].
        low_hz: f64,
        /// Upper end \[Hz\].
        high_hz: f64,
    },
    /// The band asked for lies outside what the record can show.
    #[error(
        "nothing of the band {low_hz} to {high_hz} Hz is left: this record shows {lowest_hz:.2} to {highest_hz:.2} Hz"
    )]
    NoBand {
        /// Lower end of the band \[Hz\].
        low_hz: f64,
        /// Upper end \[Hz\].
        high_hz: f64,
        /// Lowest frequency with enough periods \[Hz\].
        lowest_hz: f64,
        /// Highest frequency with enough samples a period \[Hz\].
        highest_hz: f64,
    },
    /// There are peaks, but no assignment to mode orders is credible.
    #[error("cannot number the modes of {peaks} peak{}: {detail}", if *peaks == 1 { "" } else { "s" })]
    NoLabel {
        /// Number of peaks.
        peaks: usize,
        /// Reason, for people.
        detail: String,
    },
    /// The parameters lie outside the emulator's trained range.
    #[error("outside the emulator: {detail}")]
    OutsideEmulator {
        /// Quantity outside the range, for people.
        detail: String,
    },
    /// No rod that the prior allows has such frequencies.
    #[error(
        "no rod that the prior allows has these frequencies: all of them lie beyond the farthest of thousands of its rods, at least \
         {distance:.2} times as far out; check the free length, the unit and orders of the frequencies, section and material, or widen axial_force_n"
    )]
    OutsidePrior {
        /// Distance over that of the farthest draw \[-\].
        #[serde(deserialize_with = "nan_if_null")]
        distance: f64,
    },
    /// Approximate Bayesian computation accepted too few draws.
    #[error(
        "{accepted} of {draws} draws accepted (epsilon {epsilon:.4e}), at least {needed} needed: raise abc.draws, or accept a \
         larger share or distance with abc.accept"
    )]
    NothingAccepted {
        /// Number of accepted draws.
        accepted: usize,
        /// Number of draws.
        draws: usize,
        /// Tolerance used.
        #[serde(deserialize_with = "nan_if_null")]
        epsilon: f64,
        /// Fewest accepted for a posterior.
        needed: usize,
    },
    /// Several channels share the rod's topic, so that the rod's channel is ambiguous.
    #[error(
        "topic {topic} has several channels at once ({channels}): nothing says which is the rod's; give each sensor a topic of its own"
    )]
    SharedTopic {
        /// MCAP topic.
        topic: String,
        /// Names of the channels, for people.
        channels: String,
    },
    /// The analysis panicked: a fault of the program, not of the record.
    #[error("the analysis broke, please report it: {detail}")]
    Broken {
        /// Panic message.
        detail: String,
    },
    /// Its analysis crashed the program, also in a process of its own, so it is not tried again.
    #[error("not analysed: its analysis ended the program {deaths} times")]
    Quarantined {
        /// Number of crashes.
        deaths: u32,
    },
    /// It came when the moment of the rod's other sensors had closed without it.
    #[error(
        "came when the moment of the rod's other sensors had closed without it: this sensor was more than reorder_window_h (a minute at \
         least) behind them, or is in a file of its own; send the sensors of a rod side by side, or write them into one recording"
    )]
    LateSensor,
    /// Tests of the rod that give no posterior together with the record.
    #[error("tests of the rod: {detail}")]
    UnusableTest {
        /// The tests, with the reason.
        detail: String,
    },
}

fn missing(share: f64, allowed: f64) -> String {
    if share >= 1.0 {
        return "no message gave a finite sample: check that `field` names a number of the message, and `unit`".to_owned();
    }
    format!(
        "{:.1} % of the samples are missing or not finite, at most {:.1} % allowed: mend what loses them, or raise max_missing",
        share * 100.0,
        allowed * 100.0
    )
}

fn error_code(value: f64, runs: usize, time_s: f64, share: f64, allowed: f64) -> String {
    let often = match runs {
        1 => format!("in one run, at {time_s:.2} s"),
        _ => format!("in {runs} runs, the first at {time_s:.2} s"),
    };
    let limit = match share > allowed {
        true => format!("at most {:.1} % allowed", allowed * 100.0),
        false => "what lies between is shorter than min_duration_s".to_owned(),
    };
    let key = match share > allowed {
        true => "raise max_missing",
        false => "raise max_gap_s, up to which holes are filled",
    };
    format!(
        "{:.1} % of the samples are exactly {value:e} (in the SI unit of the channel), far outside all others, {often}: the error code of a \
         sensor that has lost its target; {limit}: aim it again or mend its target, or {key}",
        share * 100.0
    )
}

fn irregular(jitter: f64, allowed: f64) -> String {
    if !jitter.is_finite() {
        return "irregular sampling: the stamps do not advance; let `time` name those of the sensor"
            .to_owned();
    }
    format!(
        "irregular sampling: the stamps lie {:.0} % of an interval (rms) off an even grid, uneven intervals adding up; at most {:.0} % allowed: let `time` name the sensor's own stamps, send arrays of samples, or raise max_jitter",
        jitter * 100.0,
        allowed * 100.0
    )
}

impl Rejection {
    /// Short name, as in JSON.
    pub fn code(&self) -> &'static str {
        match self {
            Self::TooShort { .. } => "too-short",
            Self::Missing { .. } => "missing",
            Self::ErrorCode { .. } => "error-code",
            Self::Constant { .. } => "constant",
            Self::Held { .. } => "held",
            Self::Clipped { .. } => "clipped",
            Self::Spikes { .. } => "spikes",
            Self::Step { .. } => "step",
            Self::Irregular { .. } => "irregular",
            Self::Rate { .. } => "rate",
            Self::Undersampled { .. } => "undersampled",
            Self::NoOnset { .. } => "no-onset",
            Self::Level { .. } => "level",
            Self::Damaged { .. } => "damaged",
            Self::NoPeak { .. } => "no-peak",
            Self::NoBand { .. } => "no-band",
            Self::NoLabel { .. } => "no-label",
            Self::OutsideEmulator { .. } => "outside-emulator",
            Self::OutsidePrior { .. } => "outside-prior",
            Self::NothingAccepted { .. } => "nothing-accepted",
            Self::SharedTopic { .. } => "shared-topic",
            Self::Broken { .. } => "broken",
            Self::Quarantined { .. } => "quarantined",
            Self::LateSensor => "late-sensor",
            Self::UnusableTest { .. } => "unusable-test",
        }
    }
}

/// Fault of a record noticed by the checks without refusing it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "flag")]
pub enum Flag {
    /// The file has no checksums: its content could not be verified.
    Unverified,
    /// The record may be incomplete: the file is cut short, still being written, or damaged from there
    /// on.
    Truncated,
    /// Missing samples were filled by interpolation.
    Filled {
        /// Number of samples.
        samples: usize,
    },
    /// The sensor gave one value far outside the motion, the error code of a lost target: those samples are missing ones.
    ErrorCode {
        /// The value, SI.
        #[serde(deserialize_with = "nan_if_null")]
        value: f64,
        /// Number of runs of it, in the record and beside it.
        runs: usize,
        /// Number of samples.
        samples: usize,
    },
    /// Duplicate or late samples were dropped.
    Dropped {
        /// Number of samples.
        samples: usize,
    },
    /// Spikes were replaced by their neighbours' mean.
    Despiked {
        /// Number of samples.
        samples: usize,
    },
    /// Some samples are at the rails, fewer than refused.
    Clipped {
        /// Share of the samples.
        share: f64,
    },
    /// The sensor repeated its last value, less often than refused.
    Held {
        /// Share of the samples.
        share: f64,
    },
    /// The stamps jitter noticeably.
    Jitter {
        /// Scatter over interval.
        jitter: f64,
    },
    /// Messages had wrong stamps; their samples keep their order of arrival.
    LateStamps {
        /// Number of messages.
        messages: usize,
        /// Largest delay \[s\], negative if early.
        worst_s: f64,
    },
}

impl std::fmt::Display for Flag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unverified => write!(f, "unverified: no checksums in the file"),
            Self::Truncated => write!(f, "the file ends early"),
            Self::Filled { samples } => write!(f, "{samples} samples filled"),
            Self::ErrorCode { value, runs, samples } => {
                let plural = if *runs == 1 { "" } else { "s" };
                write!(
                    f,
                    "the sensor lost its target: {samples} samples in {runs} run{plural} at {value:e} (SI), taken as missing"
                )
            }
            Self::Dropped { samples } => write!(f, "{samples} samples dropped"),
            Self::Despiked { samples } => write!(f, "{samples} spikes removed"),
            Self::Clipped { share } => write!(f, "{:.2} % clipped", share * 100.0),
            Self::Held { share } => write!(f, "{:.1} % held", share * 100.0),
            Self::Jitter { jitter } => write!(f, "stamps jitter by {:.0} %", jitter * 100.0),
            Self::LateStamps { messages, worst_s } => {
                let plural = if *messages == 1 { "" } else { "s" };
                write!(
                    f,
                    "{messages} message{plural} stamped off their time, at worst by {worst_s:.3e} s"
                )
            }
        }
    }
}
