//! Summaries of weighted samples, their Monte Carlo error, and tests of calibration.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Weighted mean; weights sum to one.
pub fn mean(values: &[f64], weights: &[f64]) -> f64 {
    values.iter().zip(weights).map(|(x, w)| w * x).sum()
}

/// Weighted standard deviation, sum w (x - mean)^2 / (1 - sum w^2): the usual n - 1 for equal weights.
/// Zero for a single value.
pub fn sd(values: &[f64], weights: &[f64]) -> f64 {
    let centre = mean(values, weights);
    let (mut spread, mut concentration) = (0.0, 0.0);
    for (x, w) in values.iter().zip(weights) {
        spread += w * (x - centre) * (x - centre);
        concentration += w * w;
    }
    if concentration < 1.0 {
        (spread / (1.0 - concentration)).sqrt()
    } else {
        0.0
    }
}

/// Quantiles of a weighted sample: the value at cumulated weight c_i - w_i / 2 of the sorted sample is
/// the quantile of that share, linear in between (Hazen's rule for equal weights).
pub fn quantiles(values: &[f64], weights: &[f64], shares: &[f64]) -> Vec<f64> {
    let mut sorted: Vec<(f64, f64)> = values.iter().copied().zip(weights.iter().copied()).collect();
    sorted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut cumulated = 0.0;
    for (_, weight) in &mut sorted {
        let own = *weight;
        *weight = cumulated + 0.5 * own;
        cumulated += own;
    }
    shares
        .iter()
        .map(|&share| {
            let above = sorted.partition_point(|&(_, position)| position < share);
            match (
                above.checked_sub(1).and_then(|i| sorted.get(i)),
                sorted.get(above),
            ) {
                (Some(&(low, from)), Some(&(high, to))) if to > from => {
                    low + (high - low) * (share - from) / (to - from)
                }
                (_, Some(&(value, _))) | (Some(&(value, _)), None) => value,
                (None, None) => f64::NAN,
            }
        })
        .collect()
}

/// Effective sample size 1 / sum w^2 of weights that sum to one (Kish).
pub fn effective_sample_size(weights: &[f64]) -> f64 {
    1.0 / weights.iter().map(|w| w * w).sum::<f64>()
}

/// Monte Carlo standard error of the mean of an independent weighted sample:
/// sqrt(sum w^2 (x - mean)^2).
pub fn mean_error(values: &[f64], weights: &[f64]) -> f64 {
    let centre = mean(values, weights);
    let sum: f64 = values
        .iter()
        .zip(weights)
        .map(|(x, w)| (w * (x - centre)).powi(2))
        .sum();
    sum.sqrt()
}

/// Rank of the truth in a posterior: the posterior probability of smaller values plus half that of
/// equal ones, from 0 to 1. Uniform over repeated (truth, record) pairs drawn from prior and model if
/// the posterior is right (Cook, Gelman and Rubin 2006; Talts et al. 2018).
pub fn rank(truth: f64, values: &[f64], weights: &[f64]) -> f64 {
    values
        .iter()
        .zip(weights)
        .map(|(&x, &w)| match x.total_cmp(&truth) {
            std::cmp::Ordering::Less => w,
            std::cmp::Ordering::Equal => 0.5 * w,
            std::cmp::Ordering::Greater => 0.0,
        })
        .sum()
}

/// Two tests of uniformity on (0, 1).
#[derive(Debug, Clone, PartialEq)]
pub struct Uniformity {
    /// Counts per bin of equal width.
    pub histogram: Vec<usize>,
    /// Pearson's statistic of the histogram.
    pub chi_square: f64,
    /// Its probability under uniformity (bins - 1 degrees of freedom).
    pub chi_square_p: f64,
    /// Largest distance between empirical and uniform distribution function.
    pub kolmogorov_smirnov: f64,
    /// Its probability under uniformity.
    pub kolmogorov_smirnov_p: f64,
}

/// Tests ranks for uniformity with a histogram of `bins` bins and by Kolmogorov and Smirnov; `None`
/// for no ranks or fewer than two bins.
pub fn uniformity(ranks: &[f64], bins: usize) -> Option<Uniformity> {
    if ranks.is_empty() || bins < 2 {
        return None;
    }
    let count = ranks.len() as f64;
    let mut histogram = vec![0usize; bins];
    for &rank in ranks {
        histogram[((rank * bins as f64) as usize).min(bins - 1)] += 1;
    }
    let expected = count / bins as f64;
    let chi_square = histogram
        .iter()
        .map(|&n| (n as f64 - expected).powi(2) / expected)
        .sum();
    let mut sorted = ranks.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let kolmogorov_smirnov = sorted
        .iter()
        .enumerate()
        .map(|(i, &rank)| ((i + 1) as f64 / count - rank).max(rank - i as f64 / count))
        .fold(0.0, f64::max);
    Some(Uniformity {
        chi_square,
        chi_square_p: ChiSquared::new((bins - 1) as f64).ok()?.sf(chi_square),
        kolmogorov_smirnov,
        kolmogorov_smirnov_p: kolmogorov_p(kolmogorov_smirnov, count),
        histogram,
    })
}

/// Kolmogorov's limit 2 sum (-1)^(k-1) exp(-2 k^2 t^2) with Stephens' (1970) correction of t for
/// finite samples; good to about 1 % from ten values on.
fn kolmogorov_p(statistic: f64, count: f64) -> f64 {
    let t = statistic * (count.sqrt() + 0.12 + 0.11 / count.sqrt());
    if t < 0.2 {
        return 1.0;
    }
    let sum: f64 = (1..=100)
        .map(|k| {
            let k = f64::from(k);
            let sign = if k % 2.0 == 1.0 { 1.0 } else { -1.0 };
            sign * (-2.0 * k * k * t * t).exp()
        })
        .sum();
    (2.0 * sum).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn equal(count: usize) -> Vec<f64> {
        vec![1.0 / count as f64; count]
    }

    /// numpy 2.4: `np.quantile(x, shares, method="hazen")`, `x.std(ddof=1)`.
    #[test]
    fn equal_weights_give_the_textbook_figures() {
        let x = [3.0, 1.0, 4.0, 1.5, 9.0, 2.6, 5.3, 5.8, 9.7, 9.3];
        let found = quantiles(&x, &equal(10), &[0.025, 0.1, 0.5, 0.77, 0.975]);
        for (found, wanted) in found.iter().zip([1.0, 1.25, 4.65, 9.06, 9.7]) {
            assert!((found - wanted).abs() < 1e-12, "{found} {wanted}");
        }
        assert!((mean(&x, &equal(10)) - 5.12).abs() < 1e-12);
        assert!((sd(&x, &equal(10)) - 3.268978773596155).abs() < 1e-12);
        // For equal weights the error of the mean is that of independent draws (with n, not n - 1).
        let wanted = 3.268978773596155 * 0.9f64.sqrt() / 10f64.sqrt();
        assert!((mean_error(&x, &equal(10)) - wanted).abs() < 1e-12);
        assert!((effective_sample_size(&equal(10)) - 10.0).abs() < 1e-12);
    }

    #[test]
    fn weight_pulls() {
        let (x, w) = ([1.0, 2.0, 3.0], [0.25, 0.5, 0.25]);
        assert_eq!(mean(&x, &w), 2.0);
        assert_eq!(quantiles(&x, &w, &[0.125, 0.5, 0.3125]), [1.0, 2.0, 1.5]);
        assert!((effective_sample_size(&w) - 8.0 / 3.0).abs() < 1e-12);
        // Weight on one value alone.
        assert_eq!(sd(&x, &[0.0, 1.0, 0.0]), 0.0);
        assert_eq!(quantiles(&[7.0], &[1.0], &[0.025, 0.975]), [7.0, 7.0]);
        assert!(quantiles(&[], &[], &[0.5])[0].is_nan());
    }

    /// scipy 1.17: `kstest(u, "uniform")` (exact; the approximation is good to about 1 %), `chisquare`.
    #[test]
    fn uniformity_matches_scipy() {
        let golden = |n: usize, power: f64| -> Vec<f64> {
            (1..=n)
                .map(|i| (i as f64 * 0.618_033_988_749_894_9).fract().powf(power))
                .collect()
        };
        let test = uniformity(&golden(50, 1.4), 10).unwrap();
        assert_eq!(test.histogram, [9, 7, 5, 5, 4, 5, 3, 4, 5, 3]);
        assert!((test.chi_square - 6.0).abs() < 1e-12);
        assert!((test.chi_square_p - 0.7399182920946538).abs() < 1e-9);
        assert!((test.kolmogorov_smirnov - 0.14013299854531733).abs() < 1e-12);
        assert!((test.kolmogorov_smirnov_p - 0.2551).abs() < 0.01);
        let test = uniformity(&golden(200, 1.1), 10).unwrap();
        assert!((test.kolmogorov_smirnov - 0.03619605628252176).abs() < 1e-12);
        assert!((test.kolmogorov_smirnov_p - 0.9473).abs() < 0.01);
        assert!(uniformity(&[], 10).is_none() && uniformity(&[0.5], 1).is_none());
    }

    #[test]
    fn a_rank_is_the_share_below() {
        assert_eq!(rank(2.0, &[1.0, 2.0, 3.0], &[0.2, 0.5, 0.3]), 0.2 + 0.25);
        assert_eq!(rank(f64::INFINITY, &[1.0, 2.0], &[0.5, 0.5]), 1.0);
    }
}
