//! Distinguishes pure tones of machines from resonances.

/// Twice the log-likelihood gain over a pure sine that a resonance needs: two parameters more, and
/// chi-square(2) exceeds 9.2 in 1 % of sines.
const LEAST_OVER_SINE: f64 = 9.2;
/// Least damping of anything in a building; a peak with less is a pure tone.
const LEAST_DAMPING: f64 = 2e-4;
/// Log odds of being foreign for a peak whose damping is too small to decide.
const UNDECIDED_LOG_ODDS: f64 = 0.7;
/// Unevenness of the amplitude below which a peak may be a tone: noise 20 dB below one makes 1.02.
const TONE_UNEVENNESS: f64 = 1.25;

/// Verdict on a peak being the pure tone of a machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tone {
    /// A resonance.
    No,
    /// Undecided: the record is too short or too noisy.
    Undecided,
    /// A pure tone.
    Sure,
}

impl Tone {
    /// Log odds of being foreign: ten to one for a tone, since a record may be too short to show a mode's
    /// damping.
    pub fn log_odds(self) -> f64 {
        match self {
            Self::No => 0.0,
            Self::Undecided => UNDECIDED_LOG_ODDS,
            Self::Sure => std::f64::consts::LN_10,
        }
    }
}

/// The verdict on a peak from its log-likelihood gain over a sine (doubled), its log damping with standard
/// error, and the unevenness of its amplitude.
pub fn tone(over_sine: f64, log_damping: f64, log_sd: f64, unevenness: f64) -> Tone {
    let least = LEAST_DAMPING.ln();
    let decays = log_damping - 2.0 * log_sd > least && over_sine > LEAST_OVER_SINE;
    let steady = over_sine < LEAST_OVER_SINE || log_damping + log_sd < least;
    if decays {
        Tone::No
    } else if steady && unevenness < TONE_UNEVENNESS {
        Tone::Sure
    } else {
        Tone::Undecided
    }
}
