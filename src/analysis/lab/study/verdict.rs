//! Verdicts on statements: three rules, the same for every statement.
//!
//! * A printed figure *comes out* if it lies within three standard errors of one run of ours ([`DISAGREE`]); a
//!   bound holds if one run of ours may lie within it.
//! * A figure is *about* or *close to* another if it rounds to it or differs by at most 5 %
//!   ([`CLOSE`](super::estimate::CLOSE)); so is what counts as little.
//! * Of two figures one is *larger* if it is so by three standard errors of our means; else the statement is open.

use super::estimate::{DISAGREE, Estimate};
use serde::Serialize;

/// Verdict on a statement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// The statement holds.
    Holds,
    /// The statement does not hold.
    Fails,
    /// Our figures cannot decide.
    Open,
}

impl Verdict {
    /// Verdict in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Holds => "holds",
            Self::Fails => "does not hold",
            Self::Open => "open",
        }
    }

    /// Verdict on a statement of two parts.
    pub fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Fails, _) | (_, Self::Fails) => Self::Fails,
            (Self::Holds, Self::Holds) => Self::Holds,
            _ => Self::Open,
        }
    }
}

impl From<bool> for Verdict {
    fn from(holds: bool) -> Self {
        if holds { Self::Holds } else { Self::Fails }
    }
}

/// Verdict on `difference`, of standard error `error`, being above zero.
pub fn positive(difference: f64, error: f64) -> Verdict {
    if difference > DISAGREE * error {
        Verdict::Holds
    } else if difference < -DISAGREE * error {
        Verdict::Fails
    } else {
        Verdict::Open
    }
}

/// Verdict on the first being larger.
pub fn larger(a: &Estimate, b: &Estimate) -> Verdict {
    positive(a.value - b.value, a.error_of_mean().hypot(b.error_of_mean()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_within_its_error_leaves_a_statement_open() {
        let estimate = |value: f64, error: f64| Estimate {
            value,
            error,
            runs: 4,
        };
        let zero = estimate(0.0, 0.0);
        assert_eq!(larger(&estimate(1.6, 1.0), &zero), Verdict::Holds);
        assert_eq!(larger(&estimate(1.4, 1.0), &zero), Verdict::Open);
        assert_eq!(larger(&estimate(-1.6, 1.0), &zero), Verdict::Fails);
        assert_eq!(larger(&estimate(f64::NAN, 1.0), &zero), Verdict::Open);
        assert_eq!(Verdict::Holds.and(Verdict::Open), Verdict::Open);
        assert_eq!(Verdict::Open.and(Verdict::Fails), Verdict::Fails);
    }
}
