//! Why a record was refused, or what was noticed about one that was not: data, not errors.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The highest mode that a sample rate serves, as a share of it.
pub const UNDERSAMPLED: f64 = 0.45;

/// Why a record gives no frequencies or no force. Stored, counted and shown; never an error.
#[derive(Debug, Clone, PartialEq, Error, Serialize)]
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
    /// The signal does not move.
    #[error(
        "constant signal: every sample is {value:e}; check that the sensor measures, and that `field` names what moves"
    )]
    Constant {
        /// The value, SI.
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
        /// How many.
        count: usize,
    },
    /// A step in the signal, larger than the vibration.
    #[error(
        "a step of {height:e} at {time_s:.2} s, larger than the vibration around it, and no release of the rod: the sensor or its target moved, so split the recording there"
    )]
    Step {
        /// Height, SI.
        height: f64,
        /// Where, from the record's start \[s\].
        time_s: f64,
    },
    /// The stamps are not evenly spaced, or do not advance.
    #[error("{}", irregular(*jitter, *allowed))]
    Irregular {
        /// Scatter over the interval of messages; infinite if the stamps do not advance.
        jitter: f64,
        /// Largest allowed.
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
        ratio: f64,
        /// Where, from the record's start \[s\].
        time_s: f64,
    },
    /// Part of the record was damaged in the file.
    #[error(
        "damaged in the file, not read from there on: {detail}; copy it again from where it was recorded"
    )]
    Damaged {
        /// What the reader said.
        detail: String,
    },
    /// No peak stands above the noise.
    #[error(
        "no spectral peak stands above the noise between {low_hz:.2} and {high_hz:.2} Hz, where the prior expects the modes: look \
         for peaks elsewhere with `tirante spectrum`, record longer or nearer mid-span, or pull the rod and let it go"
    )]
    NoPeak {
        /// Lower end of the searched band \[Hz\].
        low_hz: f64,
        /// Upper end \[Hz\].
        high_hz: f64,
    },
    /// Peaks there are, but no assignment to mode orders is credible.
    #[error("cannot number the modes of {peaks} peak{}: {detail}", if *peaks == 1 { "" } else { "s" })]
    NoLabel {
        /// How many peaks.
        peaks: usize,
        /// What spoke against it.
        detail: String,
    },
    /// The parameters wanted lie outside what the emulator was trained on.
    #[error("outside the emulator: {detail}")]
    OutsideEmulator {
        /// What lies outside.
        detail: String,
    },
    /// No rod that the prior allows has such frequencies.
    #[error(
        "no rod that the prior allows has these frequencies: all of them lie at least {distance:.1} times as far out as the farthest \
         of thousands of its rods; check the free length, the unit and orders of the frequencies, section and material, or widen axial_force_n"
    )]
    OutsidePrior {
        /// Distance over that of the farthest draw.
        distance: f64,
    },
    /// Approximate Bayesian computation accepted too few draws.
    #[error(
        "{accepted} of {draws} draws accepted (epsilon {epsilon:.4e}), at least {needed} needed: raise abc.draws, or accept a \
         larger share or distance with abc.accept"
    )]
    NothingAccepted {
        /// Accepted draws.
        accepted: usize,
        /// All draws.
        draws: usize,
        /// The tolerance.
        epsilon: f64,
        /// Fewest accepted for a posterior.
        needed: usize,
    },
    /// Several channels share the rod's topic: nobody knows which of them is the rod's.
    #[error(
        "topic {topic} has several channels at once ({channels}): nothing says which is the rod's; give each sensor a topic of its own"
    )]
    SharedTopic {
        /// The topic.
        topic: String,
        /// The channels, for people.
        channels: String,
    },
    /// The analysis itself broke: a fault of the program, not of the record.
    #[error("the analysis broke, please report it: {detail}")]
    Broken {
        /// What the program said.
        detail: String,
    },
    /// Its analysis ended the program again and again, so it was not tried once more.
    #[error("not analysed: its analysis ended the program {deaths} times")]
    Quarantined {
        /// How often.
        deaths: u32,
    },
    /// Tests of the rod that give no posterior together with the record.
    #[error("tests of the rod: {detail}")]
    UnusableTest {
        /// Which, and why.
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
    /// The short name, as in JSON.
    pub fn code(&self) -> &'static str {
        match self {
            Self::TooShort { .. } => "too-short",
            Self::Missing { .. } => "missing",
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
            Self::NoLabel { .. } => "no-label",
            Self::OutsideEmulator { .. } => "outside-emulator",
            Self::OutsidePrior { .. } => "outside-prior",
            Self::NothingAccepted { .. } => "nothing-accepted",
            Self::SharedTopic { .. } => "shared-topic",
            Self::Broken { .. } => "broken",
            Self::Quarantined { .. } => "quarantined",
            Self::UnusableTest { .. } => "unusable-test",
        }
    }
}

/// What the checks noticed about a record without refusing it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "flag")]
pub enum Flag {
    /// The file has no checksums: its content could not be verified.
    Unverified,
    /// The record may have gone on: the file is cut short, still being written, or damaged from there on.
    Truncated,
    /// Missing samples were filled by interpolation.
    Filled {
        /// How many.
        samples: usize,
    },
    /// Duplicate or late samples were dropped.
    Dropped {
        /// How many.
        samples: usize,
    },
    /// Spikes were replaced by their neighbours' mean.
    Despiked {
        /// How many.
        samples: usize,
    },
    /// Some samples at the rails, fewer than refused.
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
    /// Messages were stamped off their time; their samples stand where they came in.
    LateStamps {
        /// How many.
        messages: usize,
        /// By how much the worst was late \[s\], negative if early.
        worst_s: f64,
    },
}

impl std::fmt::Display for Flag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unverified => write!(f, "unverified: no checksums in the file"),
            Self::Truncated => write!(f, "the file ends early"),
            Self::Filled { samples } => write!(f, "{samples} samples filled"),
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
