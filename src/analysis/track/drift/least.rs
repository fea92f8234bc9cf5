//! Smallest change that would be detected by a given day, by the present posterior.
//!
//! The error of a change that begins now does not depend on ratios to come, only on when they come and on their columns: it is the
//! covariance of an onset particle, run ahead. With its standard deviation s, the prior's S and the particle's share q of births, a
//! change of z s has evidence q s / S exp(z^2 / 2), so that
//!
//! ```text
//! z = sqrt(2 ln(A S / (q s)))
//! ```

use super::detector::{Detector, Shape};
use super::passage::Passage;
use super::row::{Row, Seen};

/// Fewest periods for a step: one alone may be a wild reading.
const FEWEST: usize = 2;

impl Detector {
    /// Smallest change detected with the last of the periods `ahead` (day and columns), if it begins with the
    /// first: a share of the force; per year for a ramp. `limit`: R of the alarm. `None` if no period can be
    /// used, or a step has fewer than two.
    pub fn least_told(&self, shape: Shape, ahead: &[(f64, Vec<f64>)], limit: f64) -> Option<f64> {
        let (first, _) = ahead.first()?;
        if ahead.len() < FEWEST {
            return None;
        }
        let mut bank = self.null.with_change(shape.size());
        let mut last = bank.day;
        for (day, columns) in ahead {
            let seen = Seen {
                day: *day,
                began: *day,
                measured: *day,
                ratio: 0.0,
                sd: self.prior().stated_sd,
                columns,
                unread_k2: None,
            };
            let mut row = Row::new(self.prior(), &seen)?;
            let passage = Passage::new(self.prior(), last, *day);
            bank.advance(&passage);
            bank.narrow(row.with_onset(shape.regressor(day - first)));
            last = bank.day;
        }
        let sd = bank.change().1;
        let evidence = limit * shape.size() / (shape.share() * sd);
        let least = sd * (2.0 * libm::log(evidence.max(1.0))).sqrt();
        least.is_finite().then_some(least)
    }
}

#[cfg(test)]
mod tests {
    use super::super::BankPrior;
    use super::*;
    use crate::numerics::random;

    const LIMIT: f64 = 3652.0;
    const NOISE: f64 = 0.002;

    fn columns(day: f64) -> Vec<f64> {
        let median = 0.01 * (day / 9.0).sin();
        vec![
            median,
            median * median,
            (day / 58.0).cos() - 1.0,
            (day / 58.0).sin(),
        ]
    }

    /// Number of 40 simulated futures in which a change is detected by the end of `ahead`, and the size
    /// promised; futures are drawn from the bank's own law, so that coefficients and fluctuation are as
    /// uncertain as it assumes.
    fn told(shape: Shape, periods: u32, factor: f64) -> (usize, f64) {
        let mut start = Detector::new(BankPrior::peers(NOISE));
        for day in 0..120 {
            let mut generator = random::stream(8, day);
            let noise: f64 = rand_distr::Distribution::sample(&rand_distr::StandardNormal, &mut generator);
            let day = day as f64;
            let columns = columns(day);
            let ratio = 0.8 * columns[0] + NOISE * noise;
            start.step(&Seen {
                day,
                began: day,
                measured: day,
                ratio,
                sd: NOISE,
                columns: &columns,
                unread_k2: None,
            });
        }
        let ahead: Vec<(f64, Vec<f64>)> = (120..120 + periods)
            .map(f64::from)
            .map(|day| (day, columns(day)))
            .collect();
        let least = start.least_told(shape, &ahead, LIMIT).unwrap();
        let found = (0..40).filter(|&future| {
            let mut generator = random::stream(9, future);
            let (mut truth, mut seen) = (start.clone(), start.clone());
            let mut is_told = false;
            for (day, columns) in &ahead {
                let period = |ratio| Seen {
                    day: *day,
                    began: *day,
                    measured: *day,
                    ratio,
                    sd: NOISE,
                    columns,
                    unread_k2: None,
                };
                let ratio = truth.draw(&period(0.0), &mut generator).unwrap();
                truth.step(&period(ratio));
                let change = factor * least * shape.regressor(day - 120.0);
                seen.step(&period(ratio - change));
                is_told |= seen.statistic() > LIMIT;
            }
            is_told
        });
        (found.count(), least)
    }

    #[test]
    fn the_least_change_is_what_half_of_the_futures_tell() {
        for (shape, periods) in [(Shape::Small, 5), (Shape::Small, 30), (Shape::Ramp, 90)] {
            let (more, least) = told(shape, periods, 1.5);
            let (fewer, _) = told(shape, periods, 0.5);
            // Half of the least has z / 2 standard deviations of evidence, one and a half 3 z / 2, with z near 5.
            assert!(
                more >= 34 && fewer <= 8,
                "{shape:?} {periods}: {fewer} and {more} of 40 at {least}"
            );
        }
    }

    #[test]
    fn time_narrows_what_is_told_and_one_period_tells_nothing() {
        let mut detector = Detector::new(BankPrior::peers(NOISE));
        for day in 0..60 {
            let columns = columns(f64::from(day));
            detector.step(&Seen {
                day: f64::from(day),
                began: f64::from(day),
                measured: f64::from(day),
                ratio: 0.8 * columns[0],
                sd: NOISE,
                columns: &columns,
                unread_k2: None,
            });
        }
        let ahead = |periods: u32| -> Vec<(f64, Vec<f64>)> {
            (60..60 + periods)
                .map(f64::from)
                .map(|day| (day, columns(day)))
                .collect()
        };
        let of = |shape, periods| detector.least_told(shape, &ahead(periods), LIMIT);
        assert_eq!((of(Shape::Small, 0), of(Shape::Small, 1)), (None, None));
        for shape in [Shape::Small, Shape::Ramp] {
            let least = [5, 20, 60].map(|periods| of(shape, periods).unwrap());
            assert!(
                least[0] > least[1] && least[1] > least[2] && least[2] > 0.0,
                "{shape:?}: {least:?}"
            );
        }
        assert_eq!(
            detector.least_told(Shape::Small, &[(60.0, vec![0.0]), (61.0, vec![0.0])], LIMIT),
            None
        );
    }
}
