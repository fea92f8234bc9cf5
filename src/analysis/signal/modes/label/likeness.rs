//! Evidence of dampings: modes of one rod are damped about alike, foreign peaks each in their own way.
//!
//! With `x_i = ln zeta_i` measured to `v_i`, modes are normal about a value that they share, itself normal about the usual one,
//!
//! ```text
//! x_i ~ N(m, t^2 + v_i),   m ~ N(m0, s0^2),      foreign:  x_i ~ N(m0, s0^2 + t^2 + v_i),
//! ```
//!
//! so that one peak alone carries no evidence, whatever its damping, and several carry that of their
//! likeness. A support may damp one mode far more than the others: some rods have no such pattern, which
//! bounds what unlike dampings can take away.

use super::super::Resonance;

/// Usual damping ratio \[-\], and the scatter of resonances of any kind about it (standard deviation of ln
/// zeta).
const USUAL: f64 = 0.005;
const SPREAD: f64 = 1.0;
/// Scatter of ln zeta among the modes of one rod.
const WITHIN: f64 = 0.35;
/// Share of rods whose modes are no more alike than foreign peaks.
const UNLIKE: f64 = 0.1;
/// The same where there is no rod: often it is one other structure, whose modes are alike, too.
const UNLIKE_ELSEWHERE: f64 = 0.5;

/// Sums over peaks taken for modes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Likeness {
    /// Sum of `w_i = 1 / (t^2 + v_i)`.
    weight: f64,
    /// Sum of `w_i (x_i - m0)`.
    moment: f64,
    /// Log densities as modes about `m0` less those as foreign peaks.
    log_ratio: f64,
}

impl Likeness {
    /// Likeness of one peak by its damping; zero for a tone.
    pub(super) fn of(resonance: &Resonance) -> Self {
        let off = libm::log(resonance.damping / USUAL);
        let variance = resonance.damping_log_sd * resonance.damping_log_sd;
        if resonance.line || !(off.is_finite() && variance.is_finite()) {
            return Self::default();
        }
        let weight = 1.0 / (WITHIN * WITHIN + variance);
        let foreign = 1.0 / (SPREAD * SPREAD + variance);
        Self {
            weight,
            moment: weight * off,
            log_ratio: 0.5 * libm::log(weight / foreign) - 0.5 * off * off * (weight - foreign),
        }
    }

    /// Sum of both.
    pub(super) fn with(self, other: Self) -> Self {
        Self {
            weight: self.weight + other.weight,
            moment: self.moment + other.moment,
            log_ratio: self.log_ratio + other.log_ratio,
        }
    }

    /// Log density as modes of the rod, less that as unrelated peaks.
    pub(super) fn of_rod(self) -> f64 {
        self.log_gain(UNLIKE)
    }

    /// The same for the peaks of a record without the rod.
    pub(super) fn of_no_rod(self) -> f64 {
        self.log_gain(UNLIKE_ELSEWHERE)
    }

    fn log_gain(self, unlike: f64) -> f64 {
        let common = SPREAD * SPREAD - WITHIN * WITHIN;
        let gain = self.log_ratio + 0.5 * self.moment * self.moment / (self.weight + 1.0 / common)
            - 0.5 * libm::log(1.0 + common * self.weight);
        libm::log(unlike + (1.0 - unlike) * libm::exp(gain))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peak(damping: f64, damping_log_sd: f64) -> Likeness {
        Likeness::of(&Resonance {
            frequency_hz: 5.0,
            frequency_sd_hz: 0.01,
            damping,
            damping_log_sd,
            peak_to_noise: 1e3,
            evidence: 500.0,
            line: false,
            misfit: 0.0,
            foreign_log_odds: 0.0,
        })
    }

    #[test]
    fn one_peak_says_nothing_and_several_say_how_alike_they_are() {
        for damping in [3e-4, 5e-3, 4e-2] {
            // Rounding alone.
            assert!(peak(damping, 0.3).of_rod().abs() < 1e-12);
        }
        let gain = |dampings: &[f64], sd: f64| {
            let all = dampings.iter().map(|&damping| peak(damping, sd));
            all.fold(Likeness::default(), Likeness::with).of_rod()
        };
        assert!(gain(&[2e-3, 2.4e-3, 1.8e-3], 0.2) > 1.0);
        let unlike = gain(&[5e-4, 2e-2, 5e-3], 0.2);
        assert!(unlike < -1.0 && unlike >= libm::log(UNLIKE), "{unlike}");
        // Dampings with large errors decide little.
        assert!(gain(&[5e-4, 2e-2, 5e-3], 5.0).abs() < 0.1);
        // Two: the densities of a bivariate normal of correlation (s0^2 / (s0^2 + t^2)) at equal values.
        let (total, common) = (SPREAD * SPREAD, SPREAD * SPREAD - WITHIN * WITHIN);
        let determinant = total * total - common * common;
        let x = libm::log(0.01 / USUAL);
        let joint = -0.5 * libm::log(determinant) - x * x * (total - common) / determinant;
        let apart = -libm::log(total) - x * x / total;
        let expected = libm::log(UNLIKE + (1.0 - UNLIKE) * libm::exp(joint - apart));
        assert!((gain(&[0.01, 0.01], 0.0) - expected).abs() < 1e-12);
    }
}
