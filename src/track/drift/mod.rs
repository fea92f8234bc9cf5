//! Detection of drifts of the axial force by a bank of filters and Shiryaev-Roberts statistics.
//!
//! * [`prior`]      laws of the coefficients, members of a bank
//! * [`bank`]       conjugate filters side by side, their predictive law
//! * [`detector`]   onset particles and R
//! * [`change`]     onset, size and shape of a change, the change since commissioning
//! * [`regressors`] filters of temperature readings, curvature, transients, a yearly cycle, other rods
//! * [`site_rule`]  what the detectors of a site's rods mean together

pub mod bank;
pub mod change;
pub mod detector;
pub mod prior;
pub mod regressors;
pub mod site_rule;

pub use bank::{Law, Seen};
pub use change::Change;
pub use detector::{Detector, Shape};
pub use prior::{BankPrior, Coefficient, Fluctuation, ThermalPrior};
pub use regressors::{Filters, Regressors};
