//! Maps of a prior's support to the real line, for methods that must not leave the support: regression
//! adjustment, Markov chains, random walks.

use crate::rod::prior::Prior;

impl Prior {
    /// Share of the distribution below a value, for the families that end on both sides; `None` for the others.
    pub(crate) fn share(&self, value: f64) -> Option<f64> {
        match *self {
            Self::Uniform { low, high } => Some((value - low) / (high - low)),
            Self::LogUniform { low, high } => Some(libm::log(value / low) / libm::log(high / low)),
            Self::Fixity(fixity) => Some(fixity.share(value)),
            _ => None,
        }
    }

    /// Value below which a share of the distribution lies, for the same families.
    pub(crate) fn at_share(&self, share: f64) -> Option<f64> {
        match *self {
            Self::Uniform { low, high } => Some(low + (high - low) * share),
            Self::LogUniform { low, high } => Some(low * libm::exp(libm::log(high / low) * share)),
            Self::Fixity(fixity) => Some(fixity.at_share(share)),
            _ => None,
        }
    }

    /// Maps a value to the real line: the logarithm, or the logit of the share between the ends of the
    /// support.
    pub fn to_line(&self, value: f64) -> f64 {
        match self.share(value) {
            Some(share) => {
                // Tables round to f32, which may reach an end of the support.
                let share = share.clamp(1e-7, 1.0 - 1e-7);
                libm::log(share / (1.0 - share))
            }
            None => libm::log(value),
        }
    }

    /// Maps a place on the real line back to a value; inside the support for every number.
    pub fn from_line(&self, place: f64) -> f64 {
        let share = || 1.0 / (1.0 + libm::exp(-place));
        match *self {
            Self::Uniform { low, high } => low + (high - low) / (1.0 + libm::exp(-place)),
            Self::LogUniform { low, high } => {
                (low * libm::exp(libm::log(high / low) * share())).clamp(low, high)
            }
            Self::Fixity(fixity) => fixity.at_share(share()),
            _ => libm::exp(place),
        }
    }

    /// Coordinate in which a random walk moves: the value itself, or the real line for families that span
    /// decades.
    pub fn to_walk(&self, value: f64) -> f64 {
        match self {
            Self::LogUniform { .. } | Self::Fixity(_) => self.to_line(value),
            _ => value,
        }
    }

    /// Value at a place of a random walk.
    pub fn from_walk(&self, place: f64) -> f64 {
        match self {
            Self::LogUniform { .. } | Self::Fixity(_) => self.from_line(place),
            _ => place,
        }
    }

    /// Natural logarithm of the density in the coordinate of a random walk, up to a constant.
    pub fn log_density_of_walk(&self, value: f64) -> f64 {
        match self {
            Self::LogUniform { .. } | Self::Fixity(_) => self.log_density_on_line(value, self.to_line(value)),
            _ => self.log_density(value),
        }
    }

    /// Natural logarithm of the density on the real line up to a constant, where `value` lies at `place`.
    pub fn log_density_on_line(&self, value: f64, place: f64) -> f64 {
        match *self {
            Self::Uniform { low, high } => libm::log((value - low) * (high - value)),
            // The share is uniform: the logistic density.
            Self::LogUniform { .. } | Self::Fixity(_) => {
                -place.abs() - 2.0 * libm::log1p(libm::exp(-place.abs()))
            }
            _ => self.log_density(value) + place,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rod::fixity::Fixity;

    /// Every family maps to the real line and back, and its density there integrates to a constant times its
    /// own.
    #[test]
    fn the_real_line_and_back() {
        let priors = [
            Prior::TruncatedNormal { mean: 2.0, sd: 0.5 },
            Prior::LogNormal {
                median: 2.0,
                log_sd: 0.4,
            },
            Prior::Uniform { low: 1.0, high: 4.0 },
            Prior::LogUniform { low: 0.5, high: 4.0 },
            Prior::Fixity(Fixity {
                low: 0.0,
                high: 0.99,
                ends: 3.0,
                unit_n_m: 2.0,
            }),
        ];
        for prior in priors {
            let mut constants = Vec::new();
            for value in [1.2, 2.0, 3.1] {
                let place = prior.to_line(value);
                assert!((prior.from_line(place) - value).abs() < 1e-9, "{prior:?}");
                let slope = (prior.from_line(place + 1e-5) - prior.from_line(place - 1e-5)) / 2e-5;
                constants
                    .push(prior.log_density_on_line(value, place) - prior.log_density(value) - slope.ln());
            }
            assert!(
                constants.iter().all(|c| (c - constants[0]).abs() < 1e-6),
                "{prior:?} {constants:?}"
            );
        }
    }
}
