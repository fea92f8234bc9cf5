//! The run-length distribution of both charts together, for any path of the residuals' mean.

use super::chart::Design;
use super::lattice::{COARSE, Lattice};

/// P(no alarm up to and including period t), t = 1.., of both charts, both sides, from zero, when r_t ~
/// N(`mean(t)`, `sd(t)`^2) independently.
///
/// The law of both charts of one side is carried forward on the lattice of the integral equation; the two sides count as
/// independent. The clamp is left out: it matters for means beyond about three.
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

#[cfg(test)]
mod tests {
    use super::super::chart::Charts;
    use super::*;
    use crate::random;
    use rand_distr::{Distribution, StandardNormal};

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
}
