//! Regressors: filters of the temperature, curvature, transients, a yearly cycle, other rods.

use super::filters::FILTERS_D;
use crate::signal::record::time::YEAR_D;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Index of the filter whose square is the regressor of curvature.
const CURVED: usize = 1;
/// Time constants of the transients of slow filters after their start \[d\].
const TRANSIENTS_D: [f64; 2] = [10.0, 30.0];
/// Columns of the banks, from filters and from the median of the other rods' ratios.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Regressors {
    /// Reference temperature \[degC\].
    pub reference_c: f64,
    /// Origin of time of the yearly cycle and of the transients \[d\]: the first period.
    pub origin: f64,
}

impl Regressors {
    /// Columns of [`super::BankPrior::thermal`].
    pub fn thermal(&self, day: f64, filtered: &[f64; FILTERS_D.len()]) -> Vec<f64> {
        let mut columns: Vec<f64> = filtered
            .iter()
            .map(|celsius| celsius - self.reference_c)
            .collect();
        columns.push(columns[CURVED] * columns[CURVED]);
        let age = (day - self.origin).max(0.0);
        columns.extend(TRANSIENTS_D.map(|memory_d| libm::exp(-age / memory_d)));
        columns.extend(self.yearly(day));
        columns
    }

    /// Columns of [`super::BankPrior::thermal_and_peers`]; `median` is that of the other rods' N_t / N_0 - 1.
    pub fn thermal_and_peers(&self, day: f64, filtered: &[f64; FILTERS_D.len()], median: f64) -> Vec<f64> {
        let mut columns = self.thermal(day, filtered);
        columns.extend([median, median * median]);
        columns
    }

    /// Columns of [`super::BankPrior::peers`].
    pub fn peers(&self, day: f64, median: f64) -> Vec<f64> {
        let [cosine, sine] = self.yearly(day);
        vec![median, median * median, cosine, sine]
    }

    /// Columns of [`super::BankPrior::blind`].
    pub fn blind(&self, day: f64) -> Vec<f64> {
        self.yearly(day).to_vec()
    }

    /// A yearly cycle that is zero at the origin.
    fn yearly(&self, day: f64) -> [f64; 2] {
        let phase = TAU * (day - self.origin) / YEAR_D;
        [libm::cos(phase) - 1.0, libm::sin(phase)]
    }
}

/// Median of the ratios that are finite; `None` without any. For an even number, the mean of the two in the
/// middle.
pub fn median(ratios: impl Iterator<Item = f64>) -> Option<f64> {
    let mut sorted: Vec<f64> = ratios.filter(|ratio| ratio.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() {
        0 => None,
        odd if odd % 2 == 1 => Some(sorted[middle]),
        _ => Some(0.5 * (sorted[middle - 1] + sorted[middle])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_as_many_as_the_priors_expect() {
        use super::super::{BankPrior, ThermalPrior};
        let regressors = Regressors {
            reference_c: 12.0,
            origin: 100.0,
        };
        let thermal = ThermalPrior {
            slope_mean_per_k: -0.005,
            slope_sd_per_k: 0.01,
            curvature_sd_per_k2: 1e-5,
            is_sparse: false,
        };
        let filtered = [12.0, 14.0, 12.0, 12.0, 12.0, 12.0];
        let columns = regressors.thermal(100.0, &filtered);
        assert_eq!(columns.len(), BankPrior::thermal(0.002, thermal).columns.len());
        assert_eq!(columns, [0.0, 2.0, 0.0, 0.0, 0.0, 0.0, 4.0, 1.0, 1.0, 0.0, 0.0]);
        let both = BankPrior::thermal_and_peers(0.002, thermal).columns.len();
        assert_eq!(regressors.thermal_and_peers(100.0, &filtered, 0.1).len(), both);
        assert_eq!(
            regressors.peers(100.0, 0.1).len(),
            BankPrior::peers(0.002).columns.len()
        );
        assert_eq!(
            regressors.blind(100.0).len(),
            BankPrior::blind(0.002).columns.len()
        );
        for prior in [
            BankPrior::thermal(0.002, thermal),
            BankPrior::peers(0.002),
            BankPrior::blind(0.002),
        ] {
            let total: f64 = prior.members.iter().map(|member| member.probability).sum();
            assert!((total - 1.0).abs() < 1e-12, "{total}");
        }
    }

    #[test]
    fn the_median_of_what_is_there() {
        assert_eq!(median([].into_iter()), None);
        assert_eq!(median([3.0, f64::NAN, 1.0, 2.0].into_iter()), Some(2.0));
        assert_eq!(median([3.0, 1.0].into_iter()), Some(2.0));
    }
}
