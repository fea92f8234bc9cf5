//! Findings of a record besides its force: its peaks with their nature, the motion, the assignments of peaks
//! to modes. JSON lines, figures, pages and `spectrum` show the same.

use crate::identify::Measurement;
use crate::signal::modes::{Labels, Mode, Motion, MotionKind, Resonance};
use serde::{Deserialize, Serialize};

/// Largest damping ratio of a rod's vibration, support losses included; above it lie filtered noise or a
/// swaying stand.
const BROAD: f64 = 0.1;
/// Periods within the record below which a broad peak is slow drift.
const DRIFT_PERIODS: f64 = 40.0;
/// Highest order of a harmonic considered.
const MOST_TIMES: u32 = 20;
/// Largest tolerance of a harmonic as a share of its fundamental: 40 orders of chance agreement in a thousand.
const HARMONIC_TOLERANCE: f64 = 0.02;
/// Least log odds of the fit itself against a mode that make a peak doubtful: ten to one.
const DOUBT: f64 = 2.3;
/// Probability of an assignment from which the others are not shown beside a force.
pub const CERTAIN: f64 = 0.99;

/// Conflict in standard deviations from which a disagreement of model and data is reported.
pub const CONFLICT_SHOWN: f64 = 3.0;
/// Share of the prior's own records at least as far out, up to which the prior is reported as doubtful.
pub const PRIOR_TAIL_SHOWN: f64 = 0.01;
/// Ratio of the ends of a force's 95 % interval above which not even its order of magnitude is known, and the best value between
/// them is mostly the prior's.
pub const WIDE: f64 = 10.0;

/// Reason to doubt the force of a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Doubt {
    /// Model and data disagree.
    Conflict,
    /// Prior and data disagree.
    Prior,
    /// The orders of the modes are not certain.
    Orders,
    /// The interval spans more than an order of magnitude.
    Wide,
}

impl Doubt {
    /// Every kind of doubt.
    pub const ALL: [Self; 4] = [Self::Conflict, Self::Prior, Self::Orders, Self::Wide];

    /// Name in metrics and JSON.
    pub fn code(self) -> &'static str {
        match self {
            Self::Conflict => "conflict",
            Self::Prior => "prior",
            Self::Orders => "orders",
            Self::Wide => "wide",
        }
    }

    /// All doubts, the gravest first; figures missing in records of older programs raise none.
    /// `interval` has the ends of the record's own 95 % interval of the force.
    pub fn all(
        conflict: Option<f64>,
        prior_tail: Option<f64>,
        label_probability: Option<f64>,
        interval: Option<[f64; 2]>,
    ) -> Vec<Self> {
        let is_conflict = conflict.is_some_and(|score| score >= CONFLICT_SHOWN);
        let is_prior = !is_conflict && prior_tail.is_some_and(|tail| tail <= PRIOR_TAIL_SHOWN);
        let is_orders = label_probability.is_some_and(|probability| probability < CERTAIN);
        [
            (is_conflict, Self::Conflict),
            (is_prior, Self::Prior),
            (is_orders, Self::Orders),
            (interval.is_some_and(is_wide), Self::Wide),
        ]
        .into_iter()
        .filter_map(|(is, doubt)| is.then_some(doubt))
        .collect()
    }

    /// Mark before a force that has such doubts.
    pub fn mark(doubts: &[Self]) -> &'static str {
        match doubts {
            [] => "",
            doubts
                if doubts
                    .iter()
                    .any(|doubt| matches!(doubt, Self::Conflict | Self::Prior)) =>
            {
                "! "
            }
            _ => "? ",
        }
    }

    /// Doubt in words.
    pub fn said(self) -> &'static str {
        match self {
            Self::Conflict => {
                "model and data disagree: the force may be wrong by more than its interval says"
            }
            Self::Prior => {
                "hardly any rod of the prior has these frequencies: check length, section, material and expected force"
            }
            Self::Orders => "the orders of the modes are not certain: other orders give another force",
            Self::Wide => {
                "the interval spans more than a factor of ten: the record hardly tells the force; see what it hangs on"
            }
        }
    }
}

/// True for an interval that spans more than [`WIDE`], or both signs.
pub fn is_wide([low, high]: [f64; 2]) -> bool {
    low * high <= 0.0 || (high / low).max(low / high) > WIDE
}

/// Nature of a peak, as far as the record shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Nature {
    /// A mode of the rod, with its order.
    Mode,
    /// A resonance that may be a mode.
    Candidate,
    /// A resonance whose fit speaks against a mode.
    Doubtful,
    /// A pure sine: mains, a motor, a pump.
    Tone,
    /// A multiple of a tone, and a tone itself.
    Harmonic,
    /// Broader than any rod vibrates.
    Broad,
    /// Slow drift: broad, and at the low end of what the record resolves.
    Drift,
}

/// An integer multiple of another peak's frequency. The modes of a taut string are multiples too.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Multiple {
    /// Factor of the multiple, from 2.
    pub times: u32,
    /// Frequency of the other peak \[Hz\].
    pub frequency_hz: f64,
}

/// One peak of a spectrum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Peak {
    /// Frequency \[Hz\].
    pub frequency_hz: f64,
    /// Standard error of the frequency \[Hz\].
    pub sd_hz: f64,
    /// Damping ratio \[-\].
    pub damping: f64,
    /// Standard error of the damping ratio \[-\]; `None` if the record does not determine it, and from older programs.
    #[serde(default)]
    pub damping_sd: Option<f64>,
    /// Height of the fitted peak over the fitted noise floor \[dB\].
    pub level_db: f64,
    /// Nature of the peak.
    pub taken_for: Nature,
    /// Mode order, if it was given one.
    pub order: Option<usize>,
    /// The peak it is an integer multiple of, if there is one.
    pub multiple_of: Option<Multiple>,
}

/// One assignment of peaks to mode orders.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// The modes of the assignment, ascending in order.
    pub modes: Vec<Assigned>,
    /// Probability of the assignment.
    pub probability: f64,
    /// Force it implies \[N\], if computed.
    pub axial_force_n: Option<Quantiles>,
}

/// A peak as a mode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Assigned {
    /// Mode order, from 1.
    pub order: usize,
    /// Frequency \[Hz\].
    pub frequency_hz: f64,
}

/// Median and 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// 2.5 % quantile.
    pub q025: f64,
    /// Median.
    pub q50: f64,
    /// 97.5 % quantile.
    pub q975: f64,
}

/// Motion in one word, for tables.
pub fn motion_mark(motion: &Motion) -> &'static str {
    match motion.kind {
        MotionKind::Ambient => "ambient",
        MotionKind::FreeDecay => "decay",
        MotionKind::FreeDecays => "decays",
        MotionKind::Blow => "blow",
    }
}

/// A motion in words: `a free decay from 2.31 s`.
pub fn motion_said(motion: &Motion) -> String {
    const SHOWN: usize = 4;
    let (name, word) = match motion.kind {
        MotionKind::Ambient => ("ambient vibration", "from"),
        MotionKind::FreeDecay => ("a free decay", "from"),
        MotionKind::FreeDecays => ("several free decays", "from"),
        MotionKind::Blow => ("ambient vibration with blows", "at"),
    };
    let onsets = motion.onsets_s.iter().take(SHOWN);
    let shown: Vec<String> = onsets.map(|onset| format!("{onset:.2}")).collect();
    match motion.onsets_s.len().saturating_sub(SHOWN) {
        _ if shown.is_empty() => name.to_owned(),
        0 => format!("{name} {word} {} s", shown.join(", ")),
        more => format!("{name} {word} {} s and {more} more", shown.join(", ")),
    }
}

impl Candidate {
    /// Assignments considered, likeliest first.
    pub fn all(labels: &Labels) -> Vec<Self> {
        labels
            .candidates
            .iter()
            .map(|candidate| Self {
                modes: candidate
                    .modes
                    .iter()
                    .map(|&(order, frequency_hz)| Assigned { order, frequency_hz })
                    .collect(),
                probability: candidate.probability,
                axial_force_n: candidate
                    .axial_force_n
                    .map(|[q025, q50, q975]| Quantiles { q025, q50, q975 }),
            })
            .collect()
    }

    /// The assignment in words: `1 at 9.85, 3 at 30.2 Hz`.
    pub fn said(&self) -> String {
        let modes: Vec<String> = self
            .modes
            .iter()
            .map(|mode| format!("{} at {}", mode.order, hertz(mode.frequency_hz)))
            .collect();
        match modes.is_empty() {
            true => "no peak is a mode of the rod".to_owned(),
            false => format!("{} Hz", modes.join(", ")),
        }
    }
}

/// Peaks of a record with their nature, ascending in frequency; `modes` are the labelled ones.
pub fn peaks(measurement: &Measurement, modes: &[Mode]) -> Vec<Peak> {
    of_resonances(
        &measurement.resonances,
        modes,
        0.5 * measurement.spectrum.df_hz,
        measurement.duration_s,
    )
}

/// The peaks of some resonances; a mode is the nearest one within `near_hz` \[Hz\].
pub fn of_resonances(resonances: &[Resonance], modes: &[Mode], near_hz: f64, duration_s: f64) -> Vec<Peak> {
    let order = |i: usize| {
        let is_this = |mode: &&Mode| {
            nearest(resonances, mode.frequency_hz) == Some(i)
                && (mode.frequency_hz - resonances[i].frequency_hz).abs() < near_hz
        };
        modes.iter().find(is_this).map(|mode| mode.order)
    };
    (0..resonances.len())
        .map(|i| {
            let resonance = &resonances[i];
            let multiple = multiple(resonances, i, duration_s);
            let order = order(i);
            let is_multiple_of_tone = multiple.is_some_and(|(_, is_tone)| is_tone);
            Peak {
                frequency_hz: resonance.frequency_hz,
                sd_hz: significant(resonance.frequency_sd_hz),
                damping: significant(resonance.damping),
                damping_sd: Some(resonance.damping * resonance.damping_log_sd)
                    .filter(|sd| sd.is_finite())
                    .map(significant),
                level_db: rounded(10.0 * libm::log10(resonance.peak_to_noise.max(1e-30)), 100.0),
                taken_for: nature(resonance, order, is_multiple_of_tone, duration_s),
                order,
                multiple_of: multiple.map(|(multiple, _)| multiple),
            }
        })
        .collect()
}

/// The index of the resonance nearest to a frequency \[Hz\].
pub fn nearest(resonances: &[Resonance], frequency_hz: f64) -> Option<usize> {
    let distance = |i: &usize| (resonances[*i].frequency_hz - frequency_hz).abs();
    (0..resonances.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

fn nature(resonance: &Resonance, order: Option<usize>, is_multiple_of_tone: bool, duration_s: f64) -> Nature {
    if order.is_some() {
        Nature::Mode
    } else if resonance.line && is_multiple_of_tone {
        Nature::Harmonic
    } else if resonance.line {
        Nature::Tone
    } else if resonance.damping > BROAD && resonance.frequency_hz * duration_s < DRIFT_PERIODS {
        Nature::Drift
    } else if resonance.damping > BROAD {
        Nature::Broad
    } else if resonance.foreign_log_odds > DOUBT {
        Nature::Doubtful
    } else {
        Nature::Candidate
    }
}

/// Lowest resonance of which resonance `i` is an integer multiple within its errors, and true if that one is
/// a tone. Multiples of tones are searched first.
fn multiple(resonances: &[Resonance], i: usize, duration_s: f64) -> Option<(Multiple, bool)> {
    let one = &resonances[i];
    let of = |other: &Resonance| {
        let times = libm::round(one.frequency_hz / other.frequency_hz);
        if !(2.0..=f64::from(MOST_TIMES)).contains(&times) {
            return None;
        }
        // A peak is distinguished from its neighbours only to a fraction of the record's line width.
        let sd_hz = libm::hypot(one.frequency_sd_hz, times * other.frequency_sd_hz);
        let tolerance_hz = 3.0 * sd_hz + 0.1 / duration_s;
        let is_near = (one.frequency_hz - times * other.frequency_hz).abs() < tolerance_hz
            && tolerance_hz < HARMONIC_TOLERANCE * other.frequency_hz
            && other.damping < BROAD;
        is_near.then_some(Multiple {
            times: times as u32,
            frequency_hz: other.frequency_hz,
        })
    };
    let found = |is_tone: bool| {
        let fundamentals = resonances.iter().filter(|other| other.line == is_tone);
        fundamentals
            .filter_map(of)
            .next()
            .map(|multiple| (multiple, is_tone))
    };
    found(true).or_else(|| found(false))
}

/// Nature of a peak in words: `mode 2`, `candidate, 2 x 4.492`.
pub fn said(taken_for: Nature, order: Option<usize>, multiple_of: Option<Multiple>) -> String {
    let name = match (taken_for, order) {
        (Nature::Mode, Some(order)) => format!("mode {order}"),
        (nature, _) => nature.name().to_owned(),
    };
    match multiple_of {
        Some(Multiple { times, frequency_hz }) => format!("{name}, {times} x {}", hertz(frequency_hz)),
        None => name,
    }
}

impl Nature {
    /// Name for tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mode => "mode",
            Self::Candidate => "candidate",
            Self::Doubtful => "doubtful",
            Self::Tone => "tone",
            Self::Harmonic => "harmonic",
            Self::Broad => "broad",
            Self::Drift => "drift",
        }
    }
}

/// A frequency to four digits or millihertz.
pub fn hertz(frequency_hz: f64) -> String {
    match frequency_hz.abs() {
        size if size >= 1000.0 => format!("{frequency_hz:.1}"),
        size if size >= 100.0 => format!("{frequency_hz:.2}"),
        _ => format!("{frequency_hz:.3}"),
    }
}

/// About three digits, for people.
pub fn three_digits(value: f64) -> String {
    match value.abs() {
        size if size >= 100.0 => format!("{value:.0}"),
        size if size >= 10.0 => format!("{value:.1}"),
        size if size >= 1.0 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

/// Four significant digits, so that a line stays short.
fn significant(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let decimals = 3.0 - libm::floor(libm::log10(value.abs()));
    // An exact power of ten keeps printed numbers short.
    let scale = libm::pow(10.0, decimals.abs());
    match decimals >= 0.0 {
        true => (value * scale).round() / scale,
        false => (value / scale).round() * scale,
    }
}

fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit
}

#[cfg(test)]
mod tests;
