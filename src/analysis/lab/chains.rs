//! Draws of Markov chains and their convergence: split R-hat, effective sample size, autocorrelation.

use crate::inference::Marginal;
use crate::numerics::diagnostics;
use crate::rod::beam::{Parameterisation, Quantity};

/// Draws of several chains after their burn-in.
#[derive(Debug, Clone, PartialEq)]
pub struct Chains {
    /// Meaning of the entries of a draw.
    pub parameterisation: Parameterisation,
    /// Number of chains.
    pub chains: usize,
    /// Number of draws kept of each chain.
    pub kept: usize,
    /// Steps of a chain per draw kept.
    pub thin: usize,
    /// Parameter vectors, row-major (chains x kept x quantities), SI.
    pub draws: Vec<f64>,
    /// Share of the proposals accepted after the burn-in, per chain.
    pub acceptance: Vec<f64>,
    /// Seed of the streams.
    pub seed: u64,
}

impl Chains {
    /// Draws of one quantity, chain after chain; `None` if the section does not have it.
    pub fn values(&self, quantity: Quantity) -> Option<Vec<f64>> {
        let column = self.parameterisation.index(quantity)?;
        let width = self.parameterisation.len();
        Some(self.draws.iter().skip(column).step_by(width).copied().collect())
    }

    /// Split R-hat of one quantity.
    pub fn r_hat(&self, quantity: Quantity) -> Option<f64> {
        Some(split_r_hat(&self.values(quantity)?, self.kept))
    }

    /// Effective sample size of the mean of one quantity.
    pub fn ess(&self, quantity: Quantity) -> Option<f64> {
        Some(effective_sample_size(&self.values(quantity)?, self.kept))
    }

    /// Autocorrelation of one quantity at lags 0 to `lags`, each [`Chains::thin`] steps, averaged over the chains.
    pub fn autocorrelation(&self, quantity: Quantity, lags: usize) -> Option<Vec<f64>> {
        let values = self.values(quantity)?;
        let correlations = Correlations::new(&values, self.kept);
        Some(
            (0..=lags.min(self.kept.saturating_sub(1)))
                .map(|lag| correlations.within(lag))
                .collect(),
        )
    }

    /// Mean, spread and quantiles of one quantity; the error of the mean is that of as many independent draws
    /// as the effective sample size.
    pub fn marginal(&self, quantity: Quantity) -> Option<Marginal> {
        let values = self.values(quantity)?;
        let weights = vec![1.0 / values.len() as f64; values.len()];
        let mean = diagnostics::mean(&values, &weights);
        let sd = diagnostics::sd(&values, &weights);
        let quantiles = diagnostics::quantiles(&values, &weights, &[0.025, 0.5, 0.975]);
        Some(Marginal {
            mean,
            sd,
            cv: sd / mean,
            q025: quantiles[0],
            q50: quantiles[1],
            q975: quantiles[2],
            mean_error: sd / effective_sample_size(&values, self.kept).sqrt(),
        })
    }
}

/// Gelman and Rubin's R-hat over the halves of chains of `length` values each (Gelman et al., Bayesian Data
/// Analysis, 3rd ed., 11.4). One for chains that agree; NaN for fewer than four values per chain.
pub fn split_r_hat(values: &[f64], length: usize) -> f64 {
    let half = length / 2;
    if half < 2 {
        return f64::NAN;
    }
    // The middle value of an odd number belongs to neither half.
    let halves = values
        .chunks_exact(length)
        .flat_map(|chain| [&chain[..half], &chain[length - half..]]);
    let (means, variances): (Vec<f64>, Vec<f64>) = halves.map(moments).unzip();
    let within = moments(&variances).0;
    let between = moments(&means).1;
    if within > 0.0 {
        ((half - 1) as f64 / half as f64 + between / within).sqrt()
    } else if between > 0.0 {
        f64::INFINITY
    } else {
        1.0
    }
}

/// Effective sample size of the mean over chains of `length` values each: autocorrelations of all chains
/// together (disagreement between chains counts as correlation), summed by Geyer's initial monotone sequence
/// (1992; Gelman et al., 11.5). At most as many times larger than the number of values as chains that swing
/// about their mean can be; zero for chains that do not move.
pub fn effective_sample_size(values: &[f64], length: usize) -> f64 {
    let count = values.len() as f64;
    if length < 4 {
        return f64::NAN;
    }
    let correlations = Correlations::new(values, length);
    if correlations.total <= 0.0 {
        return 0.0;
    }
    let (mut sum, mut least) = (0.0, f64::INFINITY);
    for pair in 0..(length / 2) {
        let both = correlations.overall(2 * pair) + correlations.overall(2 * pair + 1);
        if both <= 0.0 {
            break;
        }
        least = both.min(least);
        sum += least;
    }
    let time = (2.0 * sum - 1.0).max(1.0 / count.log10());
    count / time
}

/// Mean, and variance with n - 1.
fn moments(values: &[f64]) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|x| (x - mean) * (x - mean)).sum();
    (mean, square / (count - 1.0))
}

/// Autocovariances of chains of equal length.
struct Correlations {
    /// Each chain less its own mean.
    centred: Vec<f64>,
    length: usize,
    /// Mean variance within the chains, with n - 1.
    within: f64,
    /// Pooled estimate of the variance, the spread of the chains' means included.
    total: f64,
}

impl Correlations {
    fn new(values: &[f64], length: usize) -> Self {
        let (means, variances): (Vec<f64>, Vec<f64>) = values.chunks_exact(length).map(moments).unzip();
        let centred = values
            .chunks_exact(length)
            .zip(&means)
            .flat_map(|(chain, mean)| chain.iter().map(move |x| x - mean));
        let within = variances.iter().sum::<f64>() / variances.len() as f64;
        let between = if means.len() > 1 { moments(&means).1 } else { 0.0 };
        Self {
            centred: centred.collect(),
            length,
            within,
            total: within * (length - 1) as f64 / length as f64 + between,
        }
    }

    /// Mean autocovariance at a lag.
    fn covariance(&self, lag: usize) -> f64 {
        let product = |chain: &[f64]| -> f64 {
            let pairs = chain.iter().zip(&chain[lag.min(chain.len())..]);
            pairs.map(|(a, b)| a * b).sum()
        };
        self.centred.chunks_exact(self.length).map(product).sum::<f64>() / self.centred.len() as f64
    }

    /// Autocorrelation within the chains.
    fn within(&self, lag: usize) -> f64 {
        self.covariance(lag) / self.covariance(0)
    }

    /// Autocorrelation with the chains' disagreement in it.
    fn overall(&self, lag: usize) -> f64 {
        1.0 - (self.within - self.covariance(lag)) / self.total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::random;
    use rand_distr::{Distribution, StandardNormal};

    /// Chains x_t = phi x_(t-1) + z_t, stationary from the start.
    fn autoregressive(phi: f64, chains: usize, length: usize) -> Vec<f64> {
        let mut values = Vec::new();
        for chain in 0..chains {
            let mut generator = random::stream(11, chain as u64);
            let mut normal = || -> f64 { StandardNormal.sample(&mut generator) };
            let mut x = normal() / (1.0 - phi * phi).sqrt();
            for _ in 0..length {
                values.push(x);
                x = phi * x + normal();
            }
        }
        values
    }

    #[test]
    fn the_effective_sample_size_is_that_of_an_autoregression() {
        for phi in [-0.5f64, 0.0, 0.5, 0.9] {
            let found = effective_sample_size(&autoregressive(phi, 8, 20_000), 20_000);
            let wanted = 160_000.0 * (1.0 - phi) / (1.0 + phi);
            assert!((found / wanted - 1.0).abs() < 0.08, "{phi} {found} {wanted}");
        }
    }

    #[test]
    fn chains_that_agree_have_r_hat_one_and_others_do_not() {
        let mut values = autoregressive(0.5, 4, 4000);
        assert!((split_r_hat(&values, 4000) - 1.0).abs() < 0.005);
        let alone = effective_sample_size(&values, 4000);
        // One chain elsewhere by a standard deviation: between / within = 1/3 of its square over eight halves.
        let sd = (1.0 / 0.75f64).sqrt();
        values[..4000].iter_mut().for_each(|x| *x += sd);
        assert!(split_r_hat(&values, 4000) > 1.08);
        assert!(effective_sample_size(&values, 4000) < 0.02 * alone);
        // A drift that all chains share is seen between their halves.
        let drift: Vec<f64> = (0..16_000).map(|i| (i % 4000) as f64).collect();
        assert!(split_r_hat(&drift, 4000) > 1.5);
    }

    #[test]
    fn autocorrelations_are_powers_and_chains_that_stand_still_are_worth_nothing() {
        let values = autoregressive(0.8, 4, 50_000);
        let correlations = Correlations::new(&values, 50_000);
        for lag in [0, 1, 3, 8] {
            assert!((correlations.within(lag) - 0.8f64.powi(lag as i32)).abs() < 0.03);
        }
        assert_eq!(effective_sample_size(&[2.0; 100], 50), 0.0);
        assert_eq!(split_r_hat(&[2.0; 100], 50), 1.0);
        assert!(split_r_hat(&[1.0; 3], 3).is_nan());
    }
}
