//! Checks that file, command line and configuration agree on rates and times.

use super::asked::{Asked, channels_of};
use super::plan::Plan;
use super::{ImportError, Stamps, Timing, grid};
use crate::read::contents::rounded;
use crate::write::Layout;
use tirante_analysis::signal::record::{RodChannels, Timestamp};

/// Largest relative difference of two rates that count as equal.
const RATE_ERROR: f64 = 1e-3;
/// Rounding of a header's rate above which it is looked at for a round rate.
const FEW_DIGITS: f64 = 5e-6;
/// Chance that a round rate lies within the rounding by accident, at most.
const BY_CHANCE: f64 = 0.1;
/// Lowest rate of a motion \[Hz\].
const SLOWEST_HZ: f64 = 2.0;
/// Distances of round rates \[Hz\].
const ROUND_HZ: [f64; 16] = [
    1.0, 5.0, 10.0, 16.0, 32.0, 50.0, 64.0, 100.0, 128.0, 256.0, 500.0, 512.0, 1000.0, 1024.0, 2048.0, 5000.0,
];

impl Plan {
    /// Compares the channels with those that a configuration reads.
    pub(super) fn check(&self, rods: &[RodChannels], is_written: bool) -> Result<(), ImportError> {
        if rods.is_empty() {
            return Ok(());
        }
        let mut topics = Vec::new();
        let mut is_read = false;
        for (rod, channel) in channels_of(rods) {
            topics.push(channel.topic.as_str());
            for planned in self
                .channels
                .iter()
                .filter(|planned| planned.topic == channel.topic)
            {
                is_read = true;
                let refuse = |what: String| {
                    Err(ImportError::new(format!(
                        "channel {:?}, rod {rod}: {what}",
                        planned.topic
                    )))
                };
                let field = planned.field(self.encoding);
                if is_written && channel.field != field {
                    return refuse(format!(
                        "the samples are written into the field {field:?}, the configuration reads {:?}",
                        channel.field
                    ));
                }
                if let Some(fs_hz) = channel.fs_hz
                    && planned.says_rate
                    && !is_same_rate(fs_hz, planned.fs_hz)
                {
                    return refuse(format!(
                        "the file has {} Hz, the configuration says fs_hz = {fs_hz}",
                        rounded(planned.fs_hz)
                    ));
                }
                if is_written && channel.fs_hz.is_none() && matches!(planned.layout, Layout::Batch(_)) {
                    return refuse(format!(
                        "the configuration needs fs_hz = {:?} for it",
                        planned.fs_hz
                    ));
                }
            }
        }
        if is_read {
            return Ok(());
        }
        let have: Vec<&str> = self
            .channels
            .iter()
            .map(|channel| channel.topic.as_str())
            .collect();
        Err(ImportError::new(format!(
            "the configuration reads {}, the file gives {}: --channel SOURCE=TOPIC names a channel as the configuration does",
            topics.join(", "),
            have.join(", ")
        )))
    }
}

/// Units that the stamps of a motion may have, each with its rate, where nothing says the unit and in seconds the rate would be lower than
/// that of any motion.
pub(super) fn time_units(stamps: &Stamps) -> Option<String> {
    let fs_hz = 1e9 / grid::interval_ns(stamps).ok()?;
    let rates = [("s", 1.0), ("ms", 1e3), ("us", 1e6)]
        .map(|(unit, times)| format!("{unit}: {} Hz", rounded(fs_hz * times)));
    (!stamps.says_unit && !stamps.absolute && fs_hz < SLOWEST_HZ).then(|| rates.join(", "))
}

pub(super) fn no_start(told: &str) -> ImportError {
    ImportError::new(format!(
        "the file does not say when {told} began: --start 2026-03-01T06:00:00Z says it"
    ))
}

/// Offset from stamps to nanoseconds since 1970 \[ns\].
pub(super) fn base(stamps: &Stamps, asked: &Asked<'_>, told: &str) -> Result<i64, ImportError> {
    let first = stamps.nanos.first().copied().unwrap_or_default();
    let start = asked.start.or(asked.start_else.filter(|_| !stamps.absolute));
    match (stamps.absolute, start) {
        (true, None) => Ok(0),
        (true, Some(start)) => Err(ImportError::new(format!(
            "{told} begins at {} by its stamps, at {start} by --start: leave --start out",
            Timestamp::from_nanos(first)
        ))),
        (false, Some(start)) => Ok(start.as_nanos().saturating_sub(first)),
        (false, None) => Err(no_start(told)),
    }
}

pub(super) fn is_same_rate(a: f64, b: f64) -> bool {
    (a / b - 1.0).abs() <= RATE_ERROR
}

/// Returns an error if the file contradicts a given rate.
pub(super) fn agree(fs_hz: f64, said: Option<f64>, told: &str) -> Result<(), ImportError> {
    match said {
        Some(said) if !is_same_rate(said, fs_hz) => Err(contradicted(fs_hz, said, told)),
        _ => Ok(()),
    }
}

fn contradicted(fs_hz: f64, said: f64, told: &str) -> ImportError {
    ImportError::new(format!(
        "{told} has {} Hz by the file, {said} Hz by --rate",
        rounded(fs_hz)
    ))
}

/// The round rate within the rounding of a written one, where chance would hardly put one there; `None` where there is none, or two.
fn round_rate(fs_hz: f64, rounding: f64) -> Option<f64> {
    let width_hz = 2.0 * fs_hz * rounding;
    let mut found = ROUND_HZ
        .iter()
        .filter(|step| width_hz <= BY_CHANCE * **step)
        .map(|step| (fs_hz / step).round() * step)
        .filter(|round| *round > 0.0 && (round / fs_hz - 1.0).abs() <= rounding);
    let first = found.next()?;
    found.all(|other| other == first).then_some(first)
}

/// Rate of samples without stamps \[Hz\].
pub(super) fn rate(
    timing: &Timing,
    said: Option<f64>,
    of_config: Option<f64>,
    told: &str,
) -> Result<f64, ImportError> {
    let Timing::Rate { fs_hz, rounding, .. } = timing else {
        return said.or(of_config).ok_or_else(|| {
            ImportError::new(format!(
                "the file does not say the sample rate of {told}: --rate HZ says it, or --time NAME which column or variable holds the stamps"
            ))
        });
    };
    let allowed = RATE_ERROR.max(*rounding);
    let is_near = |said: &f64| (said / fs_hz - 1.0).abs() <= allowed;
    match (said, of_config.filter(is_near)) {
        (Some(said), _) if !is_near(&said) => Err(contradicted(*fs_hz, said, told)),
        // A header of few digits agrees with the given rate, which is more exact.
        (Some(said), _) if *rounding > 0.0 => Ok(said),
        (None, Some(of_config)) if (of_config / fs_hz - 1.0).abs() <= *rounding => Ok(of_config),
        // A header of three digits makes 1024 Hz 1023.541 Hz, which is as much off as a tie rod changes in a year.
        _ if *rounding > FEW_DIGITS => round_rate(*fs_hz, *rounding).ok_or_else(|| {
            ImportError::new(format!(
                "the file writes the rate of {told} with so few digits ({} Hz give or take {}) that it is none: --rate HZ says it",
                rounded(*fs_hz),
                rounded(fs_hz * rounding)
            ))
        }),
        // A header of six digits makes 1024 Hz 1024.0004 Hz.
        _ if *rounding > 0.0 => {
            let interval_ns = 1e9 / fs_hz;
            Ok(1e9 / grid::simplest(interval_ns, interval_ns * rounding))
        }
        _ => Ok(*fs_hz),
    }
}
