//! Two two-sided CUSUM charts, one for steps and one for slow ramps, that share one false-alarm budget.

use super::AlarmSettings;
use super::arl;
use super::lattice::{FINE, Lattice, NEAR};
use serde::{Deserialize, Serialize};

/// Residuals beyond this count as this: one wild period alone never raises an alarm.
pub const CLAMP: f64 = 5.0;

/// One chart's constants.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Chart {
    /// Reference value, in standard deviations.
    pub k: f64,
    /// Decision limit, in standard deviations.
    pub h: f64,
}

/// Both charts with the false-alarm rate they keep together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Design {
    /// For steps, for ramps.
    pub charts: [Chart; 2],
    /// Mean number of periods between false alarms of both charts, both sides.
    pub arl0_periods: f64,
}

/// The mean Gregorian year \[s\].
pub const YEAR_S: f64 = 365.2425 * 86_400.0;

impl Design {
    /// The charts as set, for periods of `period_s`.
    pub fn of(alarm: &AlarmSettings, period_s: f64) -> Self {
        Self::new([alarm.step_k, alarm.ramp_k], alarm.arl0_years * YEAR_S / period_s)
    }

    /// The limits h for reference values `k` that give both charts together, both sides, the wanted mean run length
    /// (periods) from zero, half of the alarms each: both charts alone have the same mean run length A.
    ///
    /// The charts see the same residual, so their alarms often coincide and A is less than twice the wanted length; the
    /// mean run length of both together comes from their joint integral equation.
    pub fn new(k: [f64; 2], arl0_periods: f64) -> Self {
        let gap = (k[0] - k[1]).abs();
        let at = |alone: f64| {
            k.map(|k| Chart {
                k,
                h: arl::limit(k, alone),
            })
        };
        let alone = if gap == 0.0 {
            arl0_periods
        } else {
            // Charts nearer than the lattice resolves share more alarms than this says: h errs to the safe side.
            let apart = if gap < NEAR {
                k.map(|own| if own == k[0].max(k[1]) { own + NEAR } else { own })
            } else {
                k
            };
            let together = |log_alone: f64| {
                let alone = libm::exp(log_alone);
                let charts = apart.map(|k| Chart {
                    k,
                    h: arl::limit(k, alone),
                });
                libm::log(0.5 * Lattice::new(charts, FINE).mean_run_length() / arl0_periods)
            };
            let log_wanted = libm::log(arl0_periods);
            libm::exp(arl::root(
                together,
                log_wanted,
                log_wanted + std::f64::consts::LN_2,
                1e-7,
            ))
        };
        Self {
            charts: at(alone),
            arl0_periods,
        }
    }
}

/// Which side of a chart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// More force.
    Up,
    /// Less force.
    Down,
}

/// An alarm of a chart.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Signal {
    /// Which chart: 0 for steps, 1 for ramps.
    pub chart: usize,
    /// Which side.
    pub side: Side,
    /// The first period since the side last stood at zero.
    pub since: i64,
}

/// The running statistics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Charts {
    design: Design,
    /// \[chart\]\[0 up, 1 down\].
    statistic: [[f64; 2]; 2],
    /// First period since the side last stood at zero.
    since: [[Option<i64>; 2]; 2],
}

impl Charts {
    /// All at zero.
    pub fn new(design: Design) -> Self {
        Self {
            design,
            statistic: [[0.0; 2]; 2],
            since: [[None; 2]; 2],
        }
    }

    /// Takes the residual of a period; the signal of the side furthest above its limit, as a ratio, if any is above.
    ///
    /// The residual counts as at most [`CLAMP`]; one that is not a number leaves the charts as they are. A statistic
    /// grows to twice its limit (and at least [`CLAMP`]) at most, so that a chart comes down again once its cause is gone.
    pub fn update(&mut self, period: i64, residual: f64) -> Option<Signal> {
        if residual.is_nan() {
            return self.signal();
        }
        let residual = residual.clamp(-CLAMP, CLAMP);
        for (i, chart) in self.design.charts.iter().enumerate() {
            for (j, toward) in [residual, -residual].into_iter().enumerate() {
                let statistic =
                    (self.statistic[i][j] + toward - chart.k).clamp(0.0, (2.0 * chart.h).max(CLAMP));
                self.statistic[i][j] = statistic;
                self.since[i][j] = (statistic > 0.0).then(|| self.since[i][j].unwrap_or(period));
            }
        }
        self.signal()
    }

    /// The side furthest above its limit, as a ratio, if any is above.
    pub fn signal(&self) -> Option<Signal> {
        let mut furthest = None;
        let mut ratio = 1.0;
        for (i, chart) in self.design.charts.iter().enumerate() {
            for (j, side) in [Side::Up, Side::Down].into_iter().enumerate() {
                let own = self.statistic[i][j] / chart.h;
                if let Some(since) = self.since[i][j].filter(|_| own > ratio) {
                    ratio = own;
                    furthest = Some(Signal {
                        chart: i,
                        side,
                        since,
                    });
                }
            }
        }
        furthest
    }

    /// How far the highest side stands, as a ratio to its limit: an alarm above one.
    pub fn excess(&self) -> f64 {
        let ratios = (self.design.charts.iter().zip(&self.statistic))
            .flat_map(|(chart, sides)| sides.map(|side| side / chart.h));
        ratios.fold(0.0, f64::max)
    }

    /// The statistics: \[chart\]\[0 up, 1 down\].
    pub fn statistic(&self) -> [[f64; 2]; 2] {
        self.statistic
    }

    /// Goes on with other limits, the statistics as they are.
    pub fn go_by(&mut self, design: Design) {
        self.design = design;
    }

    /// Back to zero.
    pub fn reset(&mut self) {
        *self = Self::new(self.design);
    }

    /// Whether every side is below half its limit: what raised an alarm is over.
    pub fn is_calm(&self) -> bool {
        self.excess() < 0.5
    }

    /// The constants.
    pub fn design(&self) -> &Design {
        &self.design
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random;
    use rand_distr::{Distribution, StandardNormal};

    /// Mean run length of the real charts under N(0, 1), and its standard error.
    fn simulated(design: &Design, runs: u64, seed: u64) -> (f64, f64) {
        let (mut sum, mut squares) = (0.0, 0.0);
        for run in 0..runs {
            let mut generator = random::stream(seed, run);
            let mut charts = Charts::new(*design);
            let mut t = 1;
            while charts.update(t, StandardNormal.sample(&mut generator)).is_none() {
                t += 1;
            }
            let length = t as f64;
            sum += length;
            squares += length * length;
        }
        let mean = sum / runs as f64;
        (mean, ((squares / runs as f64 - mean * mean) / runs as f64).sqrt())
    }

    #[test]
    fn both_charts_together_have_the_stated_mean_run_length() {
        for k in [[0.5, 0.2], [0.2, 0.5], [1.0, 0.05], [0.5, 0.5], [0.5, 0.4]] {
            let design = Design::new(k, 200.0);
            let (mean, error) = simulated(&design, 20_000, 11);
            assert!((mean - 200.0).abs() < 4.0 * error, "{k:?}: {mean} +- {error}");
        }
        // Charts too near to be told apart keep more than they promise, by no more than a tenth.
        let (mean, error) = simulated(&Design::new([0.5, 0.49], 200.0), 20_000, 11);
        assert!(mean > 200.0 - 4.0 * error && mean < 220.0 + 4.0 * error, "{mean}");
    }

    #[test]
    #[ignore = "campaign: 7e8 periods, 1 minute; cargo test --lib chart:: -- --ignored --nocapture"]
    fn the_default_charts_alarm_once_in_ten_years() {
        for k in [[0.5, 0.2], [0.5, 0.1]] {
            let design = Design::new(k, 3652.42);
            let (mean, error) = simulated(&design, 100_000, 13);
            println!(
                "{k:?} {:?}: {mean:.1} +- {error:.1} periods, stated 3652.42",
                design.charts
            );
            assert!((mean - 3652.42).abs() < 4.0 * error, "{k:?}: {mean} +- {error}");
        }
    }

    #[test]
    fn each_chart_has_the_same_mean_run_length_between_one_and_two_times_the_joint_one() {
        let design = Design::new([0.5, 0.2], 3652.0);
        let alone = design.charts.map(|chart| arl::two_sided(chart.k, chart.h, 0.0));
        assert!((alone[0] / alone[1] - 1.0).abs() < 1e-6, "{alone:?}");
        assert!(alone[0] > 3652.0 && alone[0] < 2.0 * 3652.0, "{alone:?}");
    }

    fn charts() -> Charts {
        let charts = [Chart { k: 0.5, h: 4.0 }, Chart { k: 0.2, h: 8.0 }];
        Charts::new(Design {
            charts,
            arl0_periods: 100.0,
        })
    }

    #[test]
    fn one_wild_period_alone_raises_nothing() {
        let design = Design::new([0.5, 0.2], 3652.0);
        let mut charts = Charts::new(design);
        assert_eq!(charts.update(1, -1e9), None);
        assert_eq!(charts.statistic(), [[0.0, 4.5], [0.0, 4.8]]);
        let signal = charts.update(2, f64::NEG_INFINITY).unwrap();
        assert_eq!(
            signal,
            Signal {
                chart: 0,
                side: Side::Down,
                since: 1
            }
        );
    }

    #[test]
    fn the_onset_is_the_first_period_since_zero() {
        let mut charts = charts();
        charts.update(10, 1.0);
        assert_eq!(charts.since[0], [Some(10), None]);
        charts.update(11, -3.0);
        assert_eq!(charts.since, [[None, Some(11)], [None, Some(11)]]);
        for period in 12..15 {
            charts.update(period, -2.0);
        }
        // 2.5 + 3 x 1.5 = 7 above 4; 2.8 + 3 x 1.8 = 8.2 just above 8.
        assert_eq!(
            charts.signal(),
            Some(Signal {
                chart: 0,
                side: Side::Down,
                since: 11
            })
        );
    }

    #[test]
    fn what_is_not_a_number_changes_nothing() {
        let mut charts = charts();
        charts.update(1, 2.0);
        let before = charts.clone();
        assert_eq!(charts.update(2, f64::NAN), None);
        assert_eq!(charts, before);
    }

    #[test]
    fn a_chart_comes_down_once_its_cause_is_gone() {
        let mut charts = charts();
        for period in 0..1000 {
            charts.update(period, 3.0);
        }
        assert_eq!(charts.statistic(), [[8.0, 0.0], [16.0, 0.0]]);
        assert_eq!(charts.excess(), 2.0);
        let cleared = (1000..2000).find(|&period| {
            charts.update(period, 0.0);
            charts.is_calm()
        });
        // 16 -> 4 at 0.2 a period.
        assert_eq!(cleared, Some(1060));
    }
}
