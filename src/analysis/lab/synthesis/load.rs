//! Excitation of a rod besides a steady load: gusts, and knocks at random times.

use super::oscillator::normal;
use super::settings::{Gusts, Knocks};
use rand::{Rng, RngExt};

/// The ambient load's amplitude, sample by sample; its mean square is one.
///
/// ln a is an Ornstein-Uhlenbeck process of mean -sd^2, since E exp(2 x) = exp(2 mean + 2 sd^2).
#[derive(Debug, Clone)]
pub(super) struct Amplitude {
    memory: f64,
    innovation: f64,
    log: f64,
    mean: f64,
}

impl Amplitude {
    /// An amplitude from a stationary start.
    pub(super) fn new<R: Rng>(gusts: &Gusts, fs_hz: f64, generator: &mut R) -> Self {
        let memory = libm::exp(-1.0 / (gusts.correlation_s * fs_hz));
        Self {
            memory,
            innovation: gusts.log_sd * (1.0 - memory * memory).sqrt(),
            log: gusts.log_sd * normal(generator),
            mean: -gusts.log_sd * gusts.log_sd,
        }
    }

    /// The amplitude at the next sample.
    pub(super) fn next<R: Rng>(&mut self, generator: &mut R) -> f64 {
        let amplitude = libm::exp(self.mean + self.log);
        self.log = self.memory * self.log + self.innovation * normal(generator);
        amplitude
    }
}

/// Times \[s\] and sizes, relative to the median, of the knocks of a record.
pub(super) fn knocks<R: Rng>(knocks: &Knocks, duration_s: f64, generator: &mut R) -> Vec<(f64, f64)> {
    let mut found = Vec::new();
    let mut time = 0.0;
    loop {
        // 1 - u lies above 0: the logarithm is finite.
        time -= knocks.every_s * libm::log(1.0 - generator.random::<f64>());
        if time >= duration_s {
            return found;
        }
        let sign = if generator.random::<bool>() { 1.0 } else { -1.0 };
        found.push((time, sign * libm::exp(knocks.log_sd * normal(generator))));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;

    #[test]
    fn amplitudes_have_the_spread_and_the_memory_asked_for() {
        let gusts = Gusts {
            log_sd: 0.6,
            correlation_s: 5.0,
        };
        let mut generator = random::stream(1, 0);
        let mut amplitude = Amplitude::new(&gusts, 10.0, &mut generator);
        let logs: Vec<f64> = (0..400_000)
            .map(|_| amplitude.next(&mut generator).ln())
            .collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        let covariance = |lag: usize| {
            let pairs = logs.iter().zip(&logs[lag..]);
            pairs.map(|(a, b)| (a - mean) * (b - mean)).sum::<f64>() / (logs.len() - lag) as f64
        };
        // 40 000 s hold 4000 independent values: sd of the mean 0.01, of the variance 2 %.
        assert!((mean + 0.36).abs() < 0.04, "{mean}");
        assert!((covariance(0) / 0.36 - 1.0).abs() < 0.08);
        assert!((covariance(50) / covariance(0) - (-1.0f64).exp()).abs() < 0.06);
        let square = logs.iter().map(|log| (2.0 * log).exp()).sum::<f64>() / logs.len() as f64;
        assert!((square - 1.0).abs() < 0.12, "{square}");
    }

    #[test]
    fn knocks_come_at_their_rate_and_of_both_signs() {
        let settings = Knocks {
            every_s: 20.0,
            at: 0.3,
            deflection_m: 1e-3,
            log_sd: 0.3,
        };
        let found = knocks(&settings, 20_000.0, &mut random::stream(2, 0));
        // Poisson: 1000 with sd 32.
        assert!((880..1120).contains(&found.len()), "{}", found.len());
        let up = found.iter().filter(|(_, size)| *size > 0.0).count();
        assert!((0.42..0.58).contains(&(up as f64 / found.len() as f64)));
        assert!(found.windows(2).all(|pair| pair[0].0 < pair[1].0) && found[0].0 > 0.0);
    }
}
