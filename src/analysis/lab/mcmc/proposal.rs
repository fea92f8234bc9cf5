//! The proposal that the burn-in learns from a group of chains.

use super::Lanes;

/// Share of proposals to be accepted (Roberts, Gelman and Gilks 1997).
const ACCEPTANCE: f64 = 0.234;

/// The proposal that the burn-in learns.
pub(super) struct Adapted {
    mean: Vec<f64>,
    covariance: Vec<f64>,
    log_size: f64,
}

impl Adapted {
    pub(super) fn new(unknowns: usize) -> Self {
        let mut covariance = vec![0.0; unknowns * unknowns];
        (0..unknowns).for_each(|i| covariance[i * unknowns + i] = 1e-4);
        Self {
            mean: Vec::new(),
            covariance,
            log_size: libm::log(2.38 / (unknowns as f64).sqrt()),
        }
    }

    /// Moves by `rate` towards mean and covariance of the `count` chains, and towards the wanted acceptance.
    pub(super) fn follow(&mut self, places: &[Lanes], count: usize, accepted: f64, rate: f64) {
        let unknowns = places.len();
        let average = |lanes: &Lanes| lanes[..count].iter().sum::<f64>() / count as f64;
        if self.mean.is_empty() {
            self.mean = places.iter().map(average).collect();
        }
        for i in 0..unknowns {
            for j in 0..=i {
                let (a, b) = (self.mean[i], self.mean[j]);
                let square: f64 = (0..count).map(|l| (places[i][l] - a) * (places[j][l] - b)).sum();
                let entry = &mut self.covariance[i * unknowns + j];
                *entry += rate * (square / count as f64 - *entry);
            }
        }
        for (mean, lanes) in self.mean.iter_mut().zip(places) {
            *mean += rate * (average(lanes) - *mean);
        }
        self.log_size += rate * (accepted - ACCEPTANCE);
    }

    /// Lower triangular root of the covariance times the size, row by row without the zeros.
    pub(super) fn root(&self) -> Vec<f64> {
        let n = self
            .mean
            .len()
            .max((self.covariance.len() as f64).sqrt() as usize);
        let mut full = vec![0.0; n * n];
        let mut packed = Vec::with_capacity(n * (n + 1) / 2);
        for i in 0..n {
            for j in 0..=i {
                let sum: f64 = (0..j).map(|k| full[i * n + k] * full[j * n + k]).sum();
                let rest = self.covariance[i * n + j] - sum;
                full[i * n + j] = if i == j {
                    // Rounding must not make a direction impossible.
                    rest.max(1e-14).sqrt()
                } else {
                    rest / full[j * n + j]
                };
                packed.push(libm::exp(self.log_size) * full[i * n + j]);
            }
        }
        packed
    }
}

#[cfg(test)]
mod tests {
    use super::super::GROUP;
    use super::*;

    #[test]
    fn the_proposal_is_learned_from_the_chains() {
        // Places on a line with slope two: the root's second row must be twice the first.
        let mut adapted = Adapted::new(2);
        for step in 0..2000 {
            let x = (f64::from(step) * 0.7).sin();
            let places = [[x; GROUP], [2.0 * x; GROUP]];
            adapted.follow(&places, GROUP, ACCEPTANCE, 1.0 / f64::from(step + 2).powf(0.7));
        }
        let root = adapted.root();
        assert!((root[1] / root[0] - 2.0).abs() < 0.02 && root[2] < 0.1 * root[0]);
        // The sine's standard deviation, times the size for two unknowns.
        assert!((root[0] / (0.5f64.sqrt() * 2.38 / 2f64.sqrt()) - 1.0).abs() < 0.2);
    }
}
