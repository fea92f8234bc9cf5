//! Detection of drifts of the axial force by a bank of filters and Shiryaev-Roberts statistics.
//!
//! * [`prior`]      laws of the coefficients, members of a bank
//! * [`row`]        one period as a bank takes it
//! * `passage`      decay of fluctuations from one period to the next
//! * `member`       one conjugate filter, as it begins and as it is kept
//! * `block`        some of them side by side: their prediction and their step
//! * `densities`    its predictive densities of a reading
//! * `spells`       days on which readings are worse than others
//! * [`bank`]       filters side by side, their predictive law
//! * [`detector`]   onset particles and R
//! * `level`        change of a period from the level of commissioning
//! * [`change`]     onset, size and shape of a change
//! * `compensated`  a detector with temperature, and the level of commissioning
//! * [`companions`] the other rods' median, steady while some are missing
//! * `gain`         a rod's part in what all rods of a site follow
//! * `onset`        onsets that a particle stands for
//! * `least`        smallest change that would be detected by a given day
//! * [`regressors`] filters of temperature readings, curvature, transients, a yearly cycle, other rods
//! * [`period`]     the records of one period as one statistic
//! * [`others`]     the other rods of the site
//! * [`watch`]      the detectors of one rod, and their joint finding

pub mod bank;
#[cfg(test)]
mod beside_others;
mod block;
pub mod change;
pub mod companions;
mod compensated;
mod densities;
pub mod detector;
pub mod filters;
#[cfg(test)]
mod first_weeks;
mod gain;
mod least;
mod level;
mod member;
mod onset;
pub mod others;
mod passage;
pub mod period;
pub mod prior;
pub mod regressors;
pub mod row;
mod spells;
#[cfg(test)]
mod stand_in;
#[cfg(test)]
mod standing;
mod unread;
pub mod watch;

pub use change::Change;
pub use companions::Companions;
pub use detector::{Detector, Shape};
pub use filters::Filters;
pub use prior::{BankPrior, Coefficient, Fluctuation, ThermalPrior};
pub use regressors::Regressors;
pub use row::{Law, Seen};
pub use unread::Covariance;
