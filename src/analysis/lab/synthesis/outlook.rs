//! Delays of one rod's drift detector, by simulation at the level of force ratios: without frequencies.

use super::Change;
use super::oscillator::normal;
use super::site_years::{Fate, Moment, SiteYears};
use super::world::World;
use crate::numerics::random;
use crate::signal::record::Timestamp;
use crate::signal::record::time::{DAY_S, YEAR_D};
use crate::track::drift::Covariance;
use crate::track::drift::companions::InPeriod;
use crate::track::drift::{BankPrior, Companions, Detector, Filters, Regressors, Seen, Shape, ThermalPrior};

/// Days for which steps and ramps are followed after they begin.
pub const HORIZON_D: [usize; 2] = [60, 730];
/// Number of periods that the reference of ratios is the mean of.
const REFERENCE: usize = 30;
/// Fewest rods with which a detector compares a rod with the others.
const FEWEST: usize = 3;

/// A change to try.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tried {
    /// True if it grows with time.
    pub is_ramp: bool,
    /// Size as a share of the force: at once, or in a year.
    pub relative: f64,
}

/// A rod and its site, as far as the detector's delays depend on them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlook {
    /// World, with the rod's own slopes.
    pub world: World,
    /// Number of rods of the site.
    pub rods: usize,
    /// Standard error of a period's ratio.
    pub noise_sd: f64,
    /// Prior of the rod's thermal slope.
    pub thermal: ThermalPrior,
    /// Limit R of the alarm.
    pub limit: f64,
}

/// Result of one simulated site.
#[derive(Debug, Clone, PartialEq)]
pub struct Told {
    /// Days from each change to the record that raised the alarm; `None` beyond the horizon.
    pub delays_d: Vec<Option<f64>>,
    /// Smallest step detected within each of the times asked for, by the posterior before the change.
    pub steps: Vec<Option<f64>>,
    /// Smallest ramp detected, per year.
    pub ramps: Vec<Option<f64>>,
}

/// A prepared period.
struct Ready {
    day: f64,
    ratio: f64,
    columns: Vec<f64>,
    unread_k2: Option<Covariance>,
}

impl Outlook {
    /// Follows the first rod of site number `index` for `learned` days, then once more with each change.
    /// `within`: times for which the smallest change is wanted \[d\].
    pub fn follow(&self, learned: usize, changes: &[Tried], within: &[usize], index: u64, seed: u64) -> Told {
        let longest = HORIZON_D[usize::from(changes.iter().any(|change| change.is_ramp))];
        let days = learned + longest.max(within.iter().copied().max().unwrap_or(0)) + 1;
        let seed = random::seed(&[b"outlook", &seed.to_le_bytes(), &index.to_le_bytes()]);
        let periods = self.periods(days, seed);
        let mut detector = Detector::new(if self.rods < FEWEST {
            BankPrior::thermal(self.noise_sd, self.thermal)
        } else {
            BankPrior::thermal_and_peers(self.noise_sd, self.thermal)
        });
        let begin = learned as f64;
        let split = periods.partition_point(|period| period.day < begin);
        let (before, after) = periods.split_at(split);
        for period in before {
            self.step(&mut detector, period, 0.0);
        }
        let delays = changes.iter().map(|tried| {
            let mut detector = detector.clone();
            let change = self.change(*tried, begin);
            let horizon = begin + HORIZON_D[usize::from(tried.is_ramp)] as f64;
            let followed = after.iter().take_while(|period| period.day < horizon);
            for period in followed {
                self.step(&mut detector, period, change.after(period.day));
                if detector.statistic() > self.limit {
                    return Some(period.day - begin);
                }
            }
            None
        });
        let delays_d = delays.collect();
        let ahead: Vec<(f64, Vec<f64>)> = after
            .iter()
            .map(|period| (period.day, period.columns.clone()))
            .collect();
        let least = |shape: Shape| {
            let of = |&days: &usize| {
                let count = ahead.partition_point(|(day, _)| *day < begin + days as f64);
                detector.least_told(shape, &ahead[..count], self.limit)
            };
            within.iter().map(of).collect()
        };
        Told {
            steps: least(Shape::Small),
            ramps: least(Shape::Ramp),
            delays_d,
        }
    }

    fn step(&self, detector: &mut Detector, period: &Ready, change: f64) {
        detector.step(&Seen {
            day: period.day,
            began: period.day,
            measured: period.day,
            ratio: period.ratio + change,
            sd: self.noise_sd,
            columns: &period.columns,
            unread_k2: period.unread_k2.as_ref(),
        });
    }

    fn change(&self, tried: Tried, begin: f64) -> Change {
        let over_d = if tried.is_ramp { HORIZON_D[1] as f64 } else { 0.0 };
        let years = if tried.is_ramp { over_d / YEAR_D } else { 1.0 };
        Change {
            start_d: begin,
            over_d,
            relative: tried.relative * years,
        }
    }

    /// Periods of the first rod, with their columns.
    fn periods(&self, days: usize, seed: u64) -> Vec<Ready> {
        let midnight = Timestamp::from_nanos(0);
        let site = SiteYears::new(&self.world, self.rods, days, midnight, None, seed);
        let mut generator = random::stream(seed, 1);
        let ratios: Vec<Vec<Option<f64>>> = (site.rods.iter())
            .map(|moments| {
                let learned = moments
                    .iter()
                    .filter(|moment| moment.fate == Fate::Measured)
                    .take(REFERENCE);
                let forces: Vec<f64> = learned.map(Moment::force).collect();
                let reference = forces.iter().sum::<f64>() / forces.len().max(1) as f64;
                let ratio = |moment: &Moment| {
                    let error = self.noise_sd * normal(&mut generator);
                    (moment.fate == Fate::Measured).then(|| moment.force() / reference - 1.0 + error)
                };
                moments.iter().map(ratio).collect()
            })
            .collect();
        let mut filters = Filters::default();
        let mut readings = site.readings.iter().peekable();
        let names: Vec<String> = (1..self.rods).map(|rod| rod.to_string()).collect();
        let mut companions = Companions::default();
        let mut regressors: Option<Regressors> = None;
        let mut periods = Vec::new();
        for (index, moment) in site.rods[0].iter().enumerate() {
            let day = moment.start.seconds_since(midnight) / DAY_S;
            while let Some(reading) = readings.next_if(|reading| reading.time <= moment.start) {
                filters.push(reading.time.seconds_since(midnight) / DAY_S, reading.celsius);
            }
            let others = names.iter().zip(&ratios[1..]).map(|(name, own)| InPeriod {
                rod: name,
                ratio: own[index],
                drift: None,
                is_in_doubt: false,
            });
            let median = companions.take(others).ratio;
            let next =
                (readings.peek()).map(|next| (next.time.seconds_since(midnight) / DAY_S, next.celsius));
            let (Some(ratio), Some((filtered, unread_k2))) = (ratios[0][index], filters.known(day, next))
            else {
                continue;
            };
            let regressors = regressors.get_or_insert(Regressors {
                reference_c: filtered[filtered.len() - 1],
                origin: day,
            });
            let columns = if self.rods < FEWEST {
                regressors.thermal(day, &filtered)
            } else {
                let Some(median) = median else { continue };
                regressors.thermal_and_peers(day, &filtered, median)
            };
            periods.push(Ready {
                day,
                ratio,
                columns,
                unread_k2,
            });
        }
        periods
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outlook(rods: usize) -> Outlook {
        Outlook {
            world: World::named("benign", &mut random::stream(0, 0)).unwrap(),
            rods,
            noise_sd: 0.002,
            thermal: ThermalPrior {
                slope_mean_per_k: -0.005,
                slope_sd_per_k: 0.01,
                curvature_sd_per_k2: 1e-5,
                is_sparse: false,
            },
            limit: 3652.0,
        }
    }

    #[test]
    fn large_steps_are_told_at_the_second_record_and_none_is_told_of_nothing() {
        let tried = |relative| Tried {
            is_ramp: false,
            relative,
        };
        for rods in [1, 3] {
            for index in 0..4 {
                let told = outlook(rods).follow(60, &[tried(-0.05), tried(-1e-5)], &[4, 30], index, 1);
                let delay = told.delays_d[0].unwrap();
                // A missing record takes a day more, rarely two.
                assert!((1.0..4.6).contains(&delay), "{delay}");
                assert_eq!(told.delays_d[1], None);
                let (soon, later) = (told.steps[0].unwrap(), told.steps[1].unwrap());
                assert!(later < soon && soon < 0.05 && later > 0.001, "{soon} {later}");
            }
        }
        let again = outlook(3).follow(60, &[tried(-0.05)], &[30], 2, 1);
        assert_eq!(again, outlook(3).follow(60, &[tried(-0.05)], &[30], 2, 1));
    }
}
