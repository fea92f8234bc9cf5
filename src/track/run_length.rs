//! The run-length distribution of both charts together, for any path of the residuals' mean.

use super::chart::{Charts, Design, Side};
use super::lattice::{COARSE, Lattice};
use crate::random;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use serde::Serialize;

/// Simulated runs behind a delay: its median is good to about 1 % of the delays' spread.
const RUNS: u64 = 4000;
/// The probability with which a detectable change is found.
pub const FOUND: f64 = 0.9;

/// P(no alarm up to and including period t), t = 1.., of both charts, both sides, from zero, when r_t ~
/// N(`mean(t)`, `sd(t)`^2) independently.
///
/// The law of both charts of one side is carried forward on the lattice of the integral equation; the two sides count as
/// independent. The clamp is left out: it matters for means beyond about three
/// (use [`delays`] there).
pub fn survival(
    design: &Design,
    periods: usize,
    mean: impl Fn(usize) -> f64,
    sd: impl Fn(usize) -> f64,
) -> Vec<f64> {
    let lattice = Lattice::new(design.charts, COARSE);
    let side = |sign: f64| {
        let mut state = lattice.start();
        let mut kernel = None;
        let mut made_for = (f64::NAN, f64::NAN);
        let mut least = 1.0f64;
        let mut survivors = Vec::with_capacity(periods);
        for t in 1..=periods {
            let law = (sign * mean(t), sd(t));
            let kernel = match &mut kernel {
                Some(kernel) if law == made_for => &*kernel,
                old => &*old.insert(lattice.kernel(law.0, law.1)),
            };
            made_for = law;
            state = lattice.advance(&state, kernel);
            // Quadrature weights of both signs leave rounding behind once nearly nothing survives.
            least = least.min(state.iter().sum()).max(0.0);
            survivors.push(least);
        }
        survivors
    };
    let (up, down) = (side(1.0), side(-1.0));
    up.iter().zip(&down).map(|(up, down)| up * down).collect()
}

/// A change of force, in standard deviations of a period's noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Departure {
    /// At once, by so much.
    Step(f64),
    /// By so much every period.
    Ramp(f64),
}

impl Departure {
    /// Mean of the self-starting residual in the t-th period of the change (t = 1 is the first that differs) when the
    /// recursive mean had learned `learned` periods before and goes on learning.
    ///
    /// With n = `learned` and m = n + t - 1 the mean over all periods before t has moved by A (t - 1) / m after a
    /// step A, by rho t (t - 1) / (2 m) after a ramp of rho per period; what is left is divided by the predictive
    /// standard deviation sqrt(1 + 1 / m). The noise's variance counts as known, the slope on temperature too.
    pub fn residual(self, learned: usize, t: usize) -> f64 {
        let (n, t) = (learned.max(1) as f64, t as f64);
        let m = n + t - 1.0;
        let left = match self {
            Self::Step(size) => size * (1.0 - (t - 1.0) / m),
            Self::Ramp(rate) => rate * t * (1.0 - 0.5 * (t - 1.0) / m),
        };
        left / (1.0 + 1.0 / m).sqrt()
    }

    fn scaled(self, factor: f64) -> Self {
        match self {
            Self::Step(size) => Self::Step(factor * size),
            Self::Ramp(rate) => Self::Ramp(factor * rate),
        }
    }
}

/// How long a change goes on before it is found.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Delays {
    /// Median number of periods, the one of the alarm included; `None` if fewer than half of the changes are found.
    pub median: Option<usize>,
    /// 90 % of the changes are found within so many periods; `None` if fewer are found.
    pub q90: Option<usize>,
    /// Mean over the changes that are found.
    pub mean: Option<f64>,
    /// Share that is found within the horizon.
    pub found: f64,
}

/// Delays of a change after `learned` periods, the charts at zero, by seeded runs of the charts themselves over at
/// most `horizon` periods. Only alarms of the side of the change count.
pub fn delays(design: &Design, change: Departure, learned: usize, horizon: usize, seed: u64) -> Delays {
    let path: Vec<f64> = (1..=horizon).map(|t| change.residual(learned, t)).collect();
    let mut found: Vec<usize> = alarms(design, &path, seed);
    found.sort_unstable();
    let quantile = |p: f64| found.get((p * RUNS as f64).ceil() as usize - 1).copied();
    let mean = found.iter().sum::<usize>() as f64 / found.len() as f64;
    Delays {
        median: quantile(0.5),
        q90: quantile(FOUND),
        mean: (!found.is_empty()).then_some(mean),
        found: found.len() as f64 / RUNS as f64,
    }
}

/// The smallest change in the direction of `unit` that is found within `periods` with probability [`FOUND`], as a
/// multiple of `unit`; `None` if not even `largest` of it is.
pub fn detectable(
    design: &Design,
    unit: Departure,
    learned: usize,
    periods: usize,
    largest: f64,
    seed: u64,
) -> Option<f64> {
    let is_found = |factor: f64| {
        let change = unit.scaled(factor);
        let path: Vec<f64> = (1..=periods).map(|t| change.residual(learned, t)).collect();
        alarms(design, &path, seed).len() as f64 >= FOUND * RUNS as f64
    };
    if !is_found(largest) {
        return None;
    }
    // To half a percent: the runs' own error is about that.
    let (mut low, mut high) = (0.0, largest);
    while high - low > 0.005 * high {
        let middle = 0.5 * (low + high);
        if is_found(middle) {
            high = middle;
        } else {
            low = middle;
        }
    }
    Some(high)
}

/// The period of the first alarm on the side of the change, run by run; runs without one are left out.
fn alarms(design: &Design, path: &[f64], seed: u64) -> Vec<usize> {
    let side = if path.last().is_some_and(|last| *last < 0.0) {
        Side::Down
    } else {
        Side::Up
    };
    let run = |run: u64| {
        let mut generator = random::stream(seed, run);
        let mut charts = Charts::new(*design);
        (1..).zip(path).find_map(|(t, mean)| {
            let noise: f64 = StandardNormal.sample(&mut generator);
            let signal = charts.update(t as i64, mean + noise)?;
            (signal.side == side).then_some(t)
        })
    };
    (0..RUNS).into_par_iter().filter_map(run).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Share of runs of the real charts without an alarm up to each period.
    fn simulated(
        design: &Design,
        periods: usize,
        mean: impl Fn(usize) -> f64,
        sd: impl Fn(usize) -> f64,
    ) -> Vec<f64> {
        const RUNS: u64 = 40_000;
        let mut alive = vec![0u64; periods];
        for run in 0..RUNS {
            let mut generator = random::stream(21, run);
            let mut charts = Charts::new(*design);
            for (t, alive) in (1..).zip(&mut alive) {
                let z: f64 = StandardNormal.sample(&mut generator);
                if charts.update(t as i64, mean(t) + sd(t) * z).is_some() {
                    break;
                }
                *alive += 1;
            }
        }
        alive.iter().map(|&alive| alive as f64 / RUNS as f64).collect()
    }

    #[test]
    fn agrees_with_simulated_runs_of_the_charts() {
        let design = Design::new([0.5, 0.2], 365.0);
        type Law = fn(usize) -> f64;
        let laws: [(Law, Law); 4] = [
            (|_| 0.0, |_| 1.0),
            (|_| -0.6, |_| 1.0),
            (|t| 0.02 * t as f64, |_| 1.0),
            (
                |t| if t < 20 { 0.0 } else { 0.4 },
                |t| if t < 50 { 1.2 } else { 0.9 },
            ),
        ];
        for (i, (mean, sd)) in laws.into_iter().enumerate() {
            let (exact, drawn) = (
                survival(&design, 120, mean, sd),
                simulated(&design, 120, mean, sd),
            );
            for (t, (exact, drawn)) in exact.iter().zip(&drawn).enumerate() {
                // Four binomial standard errors; a level of 0.2 costs 1e-3, the sides' independence less.
                let error = (drawn * (1.0 - drawn) / 40_000.0).sqrt();
                assert!(
                    (exact - drawn).abs() < 4.0 * error + 1.5e-3,
                    "law {i}, period {t}: {exact} {drawn}"
                );
            }
        }
    }

    #[test]
    fn charts_of_equal_reference_value_are_one() {
        let design = Design::new([0.5, 0.5], 100.0);
        let survivors = survival(&design, 400, |_| 0.0, |_| 1.0);
        // Far out the law is exponential; its rate is 1 / ARL0 to a few parts in a hundred (the start is at zero).
        let rate = -libm::log(survivors[399] / survivors[199]) / 200.0;
        assert!((rate * 100.0 - 1.0).abs() < 0.1, "{rate}");
        assert!(survivors.windows(2).all(|pair| pair[1] <= pair[0]));
    }

    /// The recursion itself: the mean of n zeros, then of the change's values, as they come.
    #[test]
    fn the_residuals_of_a_change_are_those_of_a_recursive_mean() {
        for change in [Departure::Step(-2.0), Departure::Ramp(0.03)] {
            let learned = 30;
            let (mut sum, mut count) = (0.0, learned as f64);
            for t in 1..200 {
                let value = match change {
                    Departure::Step(size) => size,
                    Departure::Ramp(rate) => rate * t as f64,
                };
                let expected = (value - sum / count) / (1.0 + 1.0 / count).sqrt();
                assert!((change.residual(learned, t) - expected).abs() < 1e-12, "{t}");
                sum += value;
                count += 1.0;
            }
        }
    }

    #[test]
    fn delays_agree_with_the_run_length_distribution() {
        let design = Design::new([0.5, 0.2], 3652.0);
        for change in [Departure::Step(-1.0), Departure::Ramp(-0.02)] {
            let delays = delays(&design, change, 90, 365, 1);
            let survivors = survival(&design, 365, |t| change.residual(90, t), |_| 1.0);
            let median = survivors.iter().position(|s| *s < 0.5).map(|index| index + 1);
            let drawn = delays.median.unwrap() as f64;
            // One period of rounding, 2 % of drawing.
            assert!(
                (drawn - median.unwrap() as f64).abs() <= 1.0 + 0.02 * drawn,
                "{delays:?} {median:?}"
            );
        }
    }

    #[test]
    fn what_the_design_requires_holds_with_margin() {
        // Daily statistic with 0.3 % noise, ARL0 ten years.
        let design = Design::new([0.5, 0.2], 3652.0);
        for learned in [30, 90, 365] {
            let median = |change| delays(&design, change, learned, 1000, 2).median;
            let step = |change: f64| Departure::Step(libm::log(1.0 + change) / 0.003);
            assert!(median(step(-0.05)).is_some_and(|days| days <= 2), "{learned}");
            assert!(median(step(-0.01)).is_some_and(|days| days <= 5), "{learned}");
        }
        let ramp = Departure::Ramp(libm::log(0.98) / 0.003 / 365.25);
        for learned in [90, 365] {
            assert!(
                delays(&design, ramp, learned, 1000, 2)
                    .median
                    .is_some_and(|days| days <= 75),
                "{learned}"
            );
        }
    }

    #[test]
    fn a_detectable_change_is_found_as_often_as_stated() {
        let design = Design::new([0.5, 0.2], 3652.0);
        let size = detectable(&design, Departure::Step(-1.0), 90, 30, 20.0, 3).unwrap();
        let survivors = survival(&design, 30, |t| Departure::Step(-size).residual(90, t), |_| 1.0);
        // Drawn with an error of 0.5 %, and the wrong side counts here.
        assert!(
            (1.0 - survivors[29] - FOUND).abs() < 0.03,
            "{size} {}",
            survivors[29]
        );
        assert_eq!(detectable(&design, Departure::Step(-1.0), 90, 1, 1e3, 3), None);
    }
}
