//! The paper's printed figures: its case study, Tables 1 to 3 and the figures in its text.

use crate::rod::beam::Quantity;
use crate::rod::prior::{Prior, RodPrior};
use serde::Serialize;

/// The quantities the paper infers, in the order of `theta`; the springs are latent.
pub const INFERRED: [Quantity; 4] = [
    Quantity::AxialForce,
    Quantity::YoungsModulus,
    Quantity::Density,
    Quantity::Side,
];

/// The first three natural frequencies of the rod \[Hz\] (section 4.1).
pub const OBSERVED_HZ: [f64; 3] = [4.492, 9.288, 13.252];

/// Draws of one ABC (section 5.1).
pub const ABC_DRAWS: usize = 10_000;

/// Standard deviation of the measurement error as printed, the root of 1e-3 \[Hz\] (section 4.2).
pub fn error_sd_hz() -> f64 {
    1e-3f64.sqrt()
}

/// Table 1, with another prior mean of the density \[kg/m^3\] (7500 in Table 1, 7000 in Table 3) and the same
/// coefficient of variation.
pub fn prior(density_mean_kg_m3: f64) -> RodPrior {
    let todi = RodPrior::todi();
    let mut priors = todi.priors().to_vec();
    priors[2] = Prior::TruncatedNormal {
        mean: density_mean_kg_m3,
        sd: 0.1 * density_mean_kg_m3,
    };
    RodPrior::new(*todi.parameterisation(), priors).unwrap_or(todi)
}

/// A printed number and the unit of its last digit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Printed {
    /// The number, SI.
    pub value: f64,
    /// The unit of its last digit, SI.
    pub digit: f64,
}

/// One column of Table 2: per inferred quantity, posterior mean and coefficient of variation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Table2Column {
    /// Posterior means.
    pub mean: [Printed; 4],
    /// Posterior coefficients of variation.
    pub cv: [Printed; 4],
}

const fn table_2(n: f64, e: f64, rho: f64, a: f64, cv: [f64; 4]) -> Table2Column {
    const fn printed(value: f64, digit: f64) -> Printed {
        Printed { value, digit }
    }
    Table2Column {
        mean: [
            printed(n, 1e3),
            printed(e, 1e9),
            printed(rho, 1.0),
            printed(a, 1e-3),
        ],
        cv: [
            printed(cv[0], 1e-3),
            printed(cv[1], 1e-3),
            printed(cv[2], 1e-3),
            printed(cv[3], 1e-3),
        ],
    }
}

/// Table 2, MCMC on finite elements.
#[allow(clippy::approx_constant, reason = "0.318 is a printed figure")]
pub const MCMC: Table2Column = table_2(605e3, 1.58e11, 7520.0, 0.076, [0.168, 0.318, 0.096, 0.074]);
/// Table 2, ABC on finite elements.
pub const ABC: Table2Column = table_2(558e3, 1.59e11, 7580.0, 0.075, [0.206, 0.350, 0.082, 0.082]);
/// Table 2, MCMC on the chaos.
pub const MCMC_PCE: Table2Column = table_2(573e3, 1.53e11, 7299.0, 0.074, [0.206, 0.349, 0.086, 0.087]);
/// Table 2, ABC on the chaos.
pub const ABC_PCE: Table2Column = table_2(564e3, 1.53e11, 7540.0, 0.075, [0.194, 0.347, 0.084, 0.081]);

/// Table 3, the parameters behind the five frequencies: N, E, density, side. The table's head gives N/mm^2
/// for E; the values are pascals.
pub const TRUTH: [f64; 4] = [700e3, 1.8e11, 7500.0, 0.07];
/// Table 3, prior mean of the density \[kg/m^3\]; Table 1 says 7500.
pub const TABLE_3_DENSITY: f64 = 7000.0;
/// Table 3: posterior means of N, E, density, side with the first one to five frequencies.
pub const TABLE_3: [[f64; 4]; 5] = [
    [582_910.0, 1.29e11, 7550.0, 0.0736],
    [713_170.0, 1.86e11, 7270.0, 0.0724],
    [716_660.0, 1.75e11, 7363.0, 0.0719],
    [712_490.0, 1.72e11, 7349.0, 0.0716],
    [714_490.0, 1.70e11, 7347.0, 0.0718],
];
/// Units of the last digits of [`TABLE_3`].
pub const TABLE_3_DIGITS: [f64; 4] = [10.0, 1e9, 1.0, 1e-4];

/// Largest Kullback-Leibler divergence that the text of section 5.1 allows in cases A, B and D; in case C, by
/// the text, N alone exceeds this.
pub const DIVERGENCE_BOUNDS: [f64; 4] = [0.15, 0.016, 0.2, 0.12];

/// The chaos's error on its 46 656 design points: largest mean \[Hz\] and variance (section 4.4).
pub const GRID_ERROR: (f64, f64) = (1.8127e-5, 1.364e-5);
/// Largest errors of the chaos in the tails, modes 1 to 3 \[Hz\].
pub const TAIL_ERRORS_HZ: [f64; 3] = [5e-3, 5e-2, 4e-2];
