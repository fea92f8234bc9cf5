//! The prior of a support of which only the fixity is known: hinge, clamp, or anything between.

use rand::Rng;
use rand::RngExt;
use serde::Serialize;

/// A distribution of a rotational stiffness k by its fixity g = k / (k + 3 EI / l), which is 0 for a hinge and 1 for a clamp.
///
/// With v = F(k) = 1 / (1 + (3 EI / (k l))^(1 / ends)), v is uniform between its values at `low` and `high`: k is log-logistic of
/// median 3 EI / l and log scale `ends`, cut off. `ends = 1` is even in the fixity; above one, hinge and clamp gain weight (2 is
/// nearly the arc sine's law).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Fixity {
    /// Lowest fixity \[-\].
    pub low: f64,
    /// Highest fixity \[-\], below one.
    pub high: f64,
    /// Weight of the ends against the middle \[-\]; one is even.
    pub ends: f64,
    /// The stiffness of fixity one half: 3 EI / l at the centre of the other priors \[N m/rad\].
    pub unit_n_m: f64,
}

impl Fixity {
    /// Highest fixity a prior may reach: 3000 EI / l, beyond which no frequency distinguishes it from a
    /// clamp.
    pub const MOST: f64 = 0.999;

    /// Stiffness of a fixity \[N m/rad\].
    pub fn stiffness(&self, fixity: f64) -> f64 {
        self.unit_n_m * fixity / (1.0 - fixity)
    }

    /// Fixity of a stiffness \[-\].
    pub fn of(&self, stiffness: f64) -> f64 {
        if stiffness.is_infinite() {
            1.0
        } else {
            stiffness / (stiffness + self.unit_n_m)
        }
    }

    /// One draw \[N m/rad\].
    pub fn sample<R: Rng + ?Sized>(&self, generator: &mut R) -> f64 {
        self.at_share(generator.random())
    }

    /// Share of the prior below a stiffness; outside 0 to 1 beyond the ends.
    pub fn share(&self, stiffness: f64) -> f64 {
        let (from, to) = self.span();
        (self.bent(self.of(stiffness)) - from) / (to - from)
    }

    /// Stiffness below which a share of the prior lies \[N m/rad\].
    pub fn at_share(&self, share: f64) -> f64 {
        let (from, to) = self.span();
        let v = from + (to - from) * share;
        self.unit_n_m * libm::pow(v / (1.0 - v), self.ends)
    }

    /// The derivative of the share by the stiffness's natural logarithm.
    pub fn share_by_log(&self, stiffness: f64) -> f64 {
        let (from, to) = self.span();
        let v = self.bent(self.of(stiffness));
        v * (1.0 - v) / self.ends / (to - from)
    }

    /// Natural logarithm of the density up to a constant; minus infinity outside the support.
    pub fn log_density(&self, stiffness: f64) -> f64 {
        if !(stiffness >= 0.0 && stiffness.is_finite() && (0.0..=1.0).contains(&self.share(stiffness))) {
            return f64::NEG_INFINITY;
        }
        // At a hinge itself the density of an uneven prior is infinite: no nearer than this is looked at.
        let stiffness = stiffness.max(1e-12 * self.unit_n_m);
        libm::log(self.share_by_log(stiffness)) - libm::log(stiffness)
    }

    /// Mean and standard deviation \[N m/rad\], by the midpoint rule on shares.
    pub fn mean_and_sd(&self) -> (f64, f64) {
        self.moments(|share| self.at_share(share))
    }

    fn moments(&self, at: impl Fn(f64) -> f64) -> (f64, f64) {
        const POINTS: u32 = 4096;
        let values = || (0..POINTS).map(|i| at((f64::from(i) + 0.5) / f64::from(POINTS)));
        let mean = values().sum::<f64>() / f64::from(POINTS);
        let square = values().map(|value| (value - mean) * (value - mean)).sum::<f64>();
        (mean, (square / f64::from(POINTS)).sqrt())
    }

    /// Mean and standard deviation of the fixity itself \[-\].
    pub fn fixity_mean_and_sd(&self) -> (f64, f64) {
        self.moments(|share| self.of(self.at_share(share)))
    }

    /// Density in the fixity itself, up to a constant; where that of an uneven prior has no bound, the value a hundredth away.
    pub fn density_of_fixity(&self, fixity: f64) -> f64 {
        if !(self.low..=self.high).contains(&fixity) {
            return 0.0;
        }
        let fixity = fixity.clamp(0.01, 0.99);
        let v = self.bent(fixity);
        v * (1.0 - v) / (fixity * (1.0 - fixity))
    }

    /// Fault that keeps this from being a distribution; `None` if there is none.
    pub fn fault(&self) -> Option<&'static str> {
        let is_range = self.low >= 0.0 && self.high > self.low && self.high <= Self::MOST;
        if !is_range {
            return Some("a fixity needs 0 <= low < high <= 0.999");
        }
        let is_scale = self.unit_n_m > 0.0 && self.unit_n_m.is_finite();
        if !(is_scale && (0.1..=10.0).contains(&self.ends)) {
            return Some("a fixity needs a positive EI / l and 0.1 <= ends <= 10");
        }
        None
    }

    /// The uniform variable v of a fixity.
    fn bent(&self, fixity: f64) -> f64 {
        if self.ends == 1.0 {
            return fixity;
        }
        1.0 / (1.0 + libm::pow((1.0 - fixity) / fixity, 1.0 / self.ends))
    }

    fn span(&self) -> (f64, f64) {
        (self.bent(self.low), self.bent(self.high))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    const EVEN: Fixity = Fixity {
        low: 0.0,
        high: 0.99,
        ends: 1.0,
        unit_n_m: 2e5,
    };
    const UNEVEN: Fixity = Fixity {
        low: 0.05,
        high: 0.999,
        ends: 3.0,
        unit_n_m: 2e5,
    };

    #[test]
    fn a_half_is_three_bending_stiffnesses() {
        for prior in [EVEN, UNEVEN] {
            assert_eq!(prior.stiffness(0.5), 2e5);
            assert!((prior.of(2e5) - 0.5).abs() < 1e-15);
        }
        assert_eq!(EVEN.of(f64::INFINITY), 1.0);
    }

    #[test]
    fn shares_go_there_and_back() {
        for prior in [EVEN, UNEVEN] {
            for i in 0..=100 {
                let share = f64::from(i) / 100.0;
                let stiffness = prior.at_share(share);
                assert!(
                    (prior.share(stiffness) - share).abs() < 1e-12,
                    "{prior:?} {share}"
                );
                let fixity = prior.of(stiffness);
                assert!(fixity >= prior.low - 1e-12 && fixity <= prior.high + 1e-12);
            }
        }
    }

    /// An even prior has as many draws in every tenth of its fixities: 50 000 draws, so 5000 give or take 67.
    #[test]
    fn one_is_even_in_the_fixity() {
        let mut generator = random::stream(4, 0);
        let mut tenths = [0; 10];
        for _ in 0..50_000 {
            tenths[(EVEN.of(EVEN.sample(&mut generator)) / 0.099) as usize] += 1;
        }
        assert!(
            tenths.iter().all(|count| (4700..5300).contains(count)),
            "{tenths:?}"
        );
    }

    /// The density is the derivative of the share, up to one factor for all stiffnesses.
    #[test]
    fn the_density_is_the_slope_of_the_share() {
        for prior in [EVEN, UNEVEN] {
            let constants: Vec<f64> = [0.1, 0.3, 0.6, 0.9]
                .iter()
                .map(|&share| {
                    let stiffness = prior.at_share(share);
                    let step = 1e-5 * stiffness;
                    let slope =
                        (prior.share(stiffness + step) - prior.share(stiffness - step)) / (2.0 * step);
                    assert!((prior.share_by_log(stiffness) / (slope * stiffness) - 1.0).abs() < 1e-6);
                    prior.log_density(stiffness) - slope.ln()
                })
                .collect();
            assert!(constants.iter().all(|c| (c - constants[0]).abs() < 1e-6));
            assert_eq!(prior.log_density(prior.stiffness(0.9995)), f64::NEG_INFINITY);
            assert_eq!(prior.log_density(-1.0), f64::NEG_INFINITY);
        }
    }

    #[test]
    fn moments_are_those_of_draws() {
        let narrow = Fixity {
            low: 0.2,
            high: 0.7,
            ..EVEN
        };
        let (mean, sd) = narrow.mean_and_sd();
        let mut generator = random::stream(5, 0);
        let draws: Vec<f64> = (0..100_000).map(|_| narrow.sample(&mut generator)).collect();
        let drawn = draws.iter().sum::<f64>() / 1e5;
        assert!((drawn - mean).abs() < 4.0 * sd / 1e5f64.sqrt());
        let square = draws.iter().map(|k| (k - drawn).powi(2)).sum::<f64>() / 1e5;
        assert!((square.sqrt() / sd - 1.0).abs() < 0.02);
    }
}
