//! From a spectrum to natural frequencies: refinement per peak, standard errors, mode orders.

mod apart;
pub mod band;
pub mod dispersion;
pub mod fit;
pub mod identify;
pub mod label;
pub mod likelihood;
mod logarithm;
mod maximum;
pub mod onsets;
pub mod pair;
pub mod parts;
pub mod posterior;
pub mod refine;
pub mod softened;
pub mod softening;
pub mod subband;
mod sums;
mod tone;
mod tone_beside;

pub use identify::{Evidence, ModalEstimate, ModalPlan, PeakSearch, Unidentified, searchable_hz};
pub use label::{LabelPlan, Labelling, Unlabelled};
pub use parts::Parts;
pub use refine::{Refinement, Search, refine};
pub use tone_beside::SteadyTone;

use serde::{Deserialize, Serialize};

/// One resonance found in a record, not yet given a mode order.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Resonance {
    /// Natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Standard error of the frequency \[Hz\].
    pub frequency_sd_hz: f64,
    /// Damping ratio \[-\].
    pub damping: f64,
    /// Standard error of the damping ratio's natural logarithm \[-\].
    pub damping_log_sd: f64,
    /// Height of the fitted peak over the fitted noise floor, as a power ratio \[-\].
    pub peak_to_noise: f64,
    /// Twice the gain in log likelihood over noise alone.
    pub evidence: f64,
    /// True if it is a pure tone: no measurable damping, and a steady amplitude. Its odds of being foreign
    /// include this.
    pub line: bool,
    /// Goodness of fit, as a standard normal deviate \[-\]: large if the response fits no stationary mode, 0
    /// if not tested.
    pub misfit: f64,
    /// Natural logarithm of the odds, from the fit itself, that this is no mode of any rod \[-\]; 0 is neutral.
    pub foreign_log_odds: f64,
}

/// Kind of motion recognised in a record.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MotionKind {
    /// A response to continuing forces: wind, traffic.
    Ambient,
    /// One free decay, from the first sample on or from an onset.
    FreeDecay,
    /// Several free decays.
    FreeDecays,
    /// An ambient response with a blow or a knock in it.
    Blow,
}

/// Motion recognised in a record, with its onsets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Kind of motion.
    pub kind: MotionKind,
    /// Onsets of decays and blows, from the record's first sample \[s\].
    pub onsets_s: Vec<f64>,
}

/// Probability of the mode orders, and other assignments of the peaks.
#[derive(Debug, Clone, PartialEq)]
pub struct Labels {
    /// Probability that all reported orders are right \[-\]; 0 if none are reported.
    pub probability: f64,
    /// Reported orders with their peaks' frequencies \[Hz\], ascending: also those above the orders that the
    /// force uses. Certain ones may remain where they were not enough for a force.
    pub told: Vec<(usize, f64)>,
    /// The likeliest assignments of peaks to orders, likeliest first.
    pub candidates: Vec<Candidate>,
}

/// One assignment of peaks to mode orders.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Candidate {
    /// Orders seen, ascending, with their peaks' frequencies \[Hz\].
    pub modes: Vec<(usize, f64)>,
    /// Its probability \[-\].
    pub probability: f64,
    /// Axial force it implies \[N\]: 2.5 %, 50 % and 97.5 % points.
    pub axial_force_n: Option<[f64; 3]>,
}

/// One natural frequency of a rod, measured in one record.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mode {
    /// Mode order, from 1.
    pub order: usize,
    /// Natural frequency \[Hz\].
    pub frequency_hz: f64,
    /// Standard error of the frequency \[Hz\].
    pub sd_hz: f64,
    /// Damping ratio \[-\], if it was measured.
    pub damping: Option<f64>,
}

impl Mode {
    /// The first natural frequencies of a rod, measured elsewhere, all with one standard error \[Hz\].
    pub fn first(frequencies_hz: &[f64], sd_hz: f64) -> Vec<Self> {
        let numbered = frequencies_hz.iter().enumerate();
        let mode = |(index, &frequency_hz)| Self {
            order: index + 1,
            frequency_hz,
            sd_hz,
            damping: None,
        };
        numbered.map(mode).collect()
    }
}

/// A band of frequencies in which peaks are ignored: mains hum, a bell motor, a pump.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Mask {
    /// Lower end \[Hz\].
    pub low_hz: f64,
    /// Upper end \[Hz\].
    pub high_hz: f64,
}

impl Mask {
    /// True if a frequency \[Hz\] lies in it.
    pub fn contains(&self, hz: f64) -> bool {
        (self.low_hz..=self.high_hz).contains(&hz)
    }
}

/// A range of frequencies in which a person declared one mode: its clearest peak there is that mode, even if
/// others fit better.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ModeWindow {
    /// Mode order, from 1.
    pub order: usize,
    /// Lower end \[Hz\].
    pub low_hz: f64,
    /// Upper end \[Hz\].
    pub high_hz: f64,
}

/// Natural frequencies searched for, and where.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModeSettings {
    /// Mode orders used, 1 to this number; at most [`crate::rod::beam::forward::MAX_MODES`]. With 1 the first mode is
    /// declared to be among the peaks, so that one peak is enough.
    pub count: usize,
    /// Bands in which peaks are ignored.
    pub masks: Vec<Mask>,
    /// Least joint probability of the reported orders; below it there is no force.
    pub least_probability: f64,
    /// Lowest and highest frequency of any mode \[Hz\]; `None`: from the prior.
    pub band_hz: Option<[f64; 2]>,
    /// Modes assigned by hand, one window per order, ascending.
    pub windows: Vec<ModeWindow>,
}

impl Default for ModeSettings {
    fn default() -> Self {
        Self {
            count: 3,
            masks: Vec::new(),
            least_probability: 0.95,
            band_hz: None,
            windows: Vec::new(),
        }
    }
}
