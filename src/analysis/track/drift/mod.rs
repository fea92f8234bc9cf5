//! Detection of drifts of the axial force by a bank of filters and Shiryaev-Roberts statistics.
//!
//! * [`prior`]      laws of the coefficients, members of a bank
//! * [`bank`]       conjugate filters side by side, their predictive law
//! * [`detector`]   onset particles and R
//! * `level`        change of a period from the level of commissioning
//! * [`change`]     onset, size and shape of a change
//! * [`companions`] the other rods' median, steady while some are missing
//! * `least`        smallest change that would be detected by a given day
//! * [`regressors`] filters of temperature readings, curvature, transients, a yearly cycle, other rods
//! * [`period`]     the records of one period as one statistic
//! * [`others`]     the other rods of the site
//! * [`watch`]      the detectors of one rod, and their joint finding

pub mod bank;
pub mod change;
pub mod companions;
pub mod detector;
mod least;
mod level;
pub mod others;
pub mod period;
pub mod prior;
pub mod regressors;
pub mod watch;

pub use bank::{Law, Seen};
pub use change::Change;
pub use companions::Companions;
pub use detector::{Detector, Shape};
pub use prior::{BankPrior, Coefficient, Fluctuation, ThermalPrior};
pub use regressors::{Filters, Regressors};
