//! Change from a level: the part of a period that its columns do not explain, against the mean of earlier
//! periods.

use super::bank::total;
use super::block::Sums;
use super::detector::{Detector, ln_sum};
use super::prior::Fluctuation;
use super::row::{COLUMNS, Seen};

/// Least share of the average of a bank that counts.
const NEGLIGIBLE: f64 = 1e-6;

impl Detector {
    /// Change from a level and its standard deviation. `seen` holds ratio and columns less their means over `periods` periods
    /// in `span_d` days:
    ///
    /// ```text
    /// c = (y - y_0) - (X - X_0) b,    var c = q + sigma^2 (R + r + r2 + x'P x + (1 + r s(tau) + r2 s(tau2)) / level)
    /// ```
    ///
    /// with R as the last period was calm or rough, averaged over the members of the null bank and of the onset particles, with the odds of
    /// one onset in `limit` periods, and of a ramp that goes on since before the first period: a change must not be learned as something the columns do. The fluctuation counts with its whole variance: what lasts for
    /// days only is no change. `None` for a period that cannot be used.
    pub fn change_from_level(
        &self,
        seen: &Seen,
        limit: f64,
        periods: f64,
        span_d: f64,
    ) -> Option<(f64, f64)> {
        let row = self.row(seen)?;
        let x = &row.x;
        let width = x.len();
        let mut along = vec![0.0; width];
        along[COLUMNS..width - 2].copy_from_slice(&x[COLUMNS..width - 2]);
        let levels: Vec<f64> = self
            .prior
            .members
            .iter()
            .map(|fluctuation| {
                let level = periods.recip() + averaged(fluctuation, span_d);
                fluctuation.variance + fluctuation.slow_variance + level
            })
            .collect();
        let (mean, sd) = self.average(limit, &along, &levels, [row.error, row.unread]);
        Some((seen.ratio - mean, sd))
    }

    /// Slope of the ratio with a constant temperature: the sum of the first `filters` coefficients, and its
    /// standard deviation.
    pub fn slope(&self, limit: f64, filters: usize) -> (f64, f64) {
        let width = self.prior.columns.len() + 4;
        let mut along = vec![0.0; width];
        along[COLUMNS..COLUMNS + filters.min(self.prior.columns.len())].fill(1.0);
        self.average(limit, &along, &vec![0.0; self.prior.members.len()], [0.0; 2])
    }

    /// Mean of x'b over the columns and the standard deviation of x'b + e, over null bank, standing ramp and onset particles; var e = sigma^2 `own`, by
    /// the index of a member, and `noise`, white and unread.
    fn average(&self, limit: f64, x: &[f64], own: &[f64], noise: [f64; 2]) -> (f64, f64) {
        let null = libm::log(limit.max(1.0));
        let changes = self.particles.iter().chain(&self.standing);
        let changes = changes.map(|particle| (&particle.bank, particle.ln_part()));
        let all = changes.chain([(&self.null, null)]);
        let whole = ln_sum(all.clone().map(|(_, weight)| weight));
        let banks = all
            .map(|(bank, weight)| (bank, libm::exp(weight - whole)))
            .filter(|(_, share)| *share > NEGLIGIBLE);
        let mut sums = Sums::default();
        banks.for_each(|(bank, share)| bank.add_columns(x, own, noise, share, &mut sums));
        let [weight, mean, square, variance] =
            [sums.weight, sums.mean, sums.square, sums.variance].map(total);
        let mean = mean / weight;
        let between = (square / weight - mean * mean).max(0.0);
        (mean, (variance / weight + between).sqrt())
    }
}

/// Variance of a fluctuation's mean over `span_d` days, in noise variances.
fn averaged(fluctuation: &Fluctuation, span_d: f64) -> f64 {
    let of = |variance: f64, memory_d: f64| {
        let share = memory_d / span_d.max(f64::MIN_POSITIVE);
        // An Ornstein-Uhlenbeck process averaged over its span; for a span far below its memory it is constant.
        if share > 1e3 {
            variance
        } else {
            variance * 2.0 * share * (1.0 + share * libm::expm1(-1.0 / share))
        }
    };
    of(fluctuation.variance, fluctuation.memory_d) + of(fluctuation.slow_variance, fluctuation.slow_memory_d)
}
