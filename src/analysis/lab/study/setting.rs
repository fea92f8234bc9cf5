//! The two settings of the study: as the paper prints them, and as its numbers require.

use super::paper;
use crate::rod::prior::RodPrior;
use serde::Serialize;

/// Choice where the paper is open or contradicts itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Setting {
    /// As in its text and Table 1.
    AsPrinted,
    /// As its tables require.
    AsInferred,
}

impl Setting {
    /// Both settings.
    pub const ALL: [Self; 2] = [Self::AsPrinted, Self::AsInferred];

    /// Name in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::AsPrinted => "as-printed",
            Self::AsInferred => "as-inferred",
        }
    }

    /// Meaning of the setting, in a sentence.
    pub fn about(self) -> &'static str {
        match self {
            Self::AsPrinted => {
                "density prior of mean 7500 kg/m\u{b3} (Table 1), the nearest 100 of 10 000 draws (alpha 0.01), error variance 1e-3 Hz\u{b2}"
            }
            Self::AsInferred => {
                "density prior of mean 7000 kg/m\u{b3} (Table 3), the nearest 500 of 10 000 draws (alpha 0.05), in MCMC an error variance of 1 Hz\u{b2} (section 3: standard normal)"
            }
        }
    }

    /// Prior of the rod for Table 2.
    pub fn prior(self) -> RodPrior {
        paper::prior(match self {
            Self::AsPrinted => 7500.0,
            Self::AsInferred => paper::TABLE_3_DENSITY,
        })
    }

    /// Share of the draws that ABC accepts.
    pub fn share(self) -> f64 {
        match self {
            Self::AsPrinted => 0.01,
            Self::AsInferred => 0.05,
        }
    }

    /// Standard deviation of the measurement error in the likelihood of MCMC \[Hz\]. ABC uses the printed one
    /// in both settings: it hardly matters beside the tolerance.
    pub fn likelihood_sd_hz(self) -> f64 {
        match self {
            Self::AsPrinted => paper::error_sd_hz(),
            Self::AsInferred => 1.0,
        }
    }
}
