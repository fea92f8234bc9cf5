//! From natural frequencies to the posterior of the axial force, by approximate Bayesian computation.
//!
//! [`Inference::plan`] once per rod, [`Inference::run`] per record:
//! * [`table`]       the simulated draws, drawn once and reused, and the noise that goes with them
//! * [`distance`]    the generative model's last step and the pass that keeps the nearest draws
//! * [`abc`]         rejection (paper, Algorithms 2 and 3)
//! * [`adjust`]      local-linear regression adjustment of the accepted
//! * [`sequential`]  a sequence of populations instead of one table
//! * [`posterior`]   the weighted sample, its means and quantiles
//! * [`conflict`]    the distance of an observation from everything the beam can produce
//! * [`joint`]       one posterior of frequencies, tests and direct measurements
//! * [`with_tests`]  a record together with tests of its rod
//! * [`variance_shares`] the share of each source in the variance of N

pub mod abc;
pub mod adjust;
mod column;
pub mod conflict;
pub mod distance;
mod explained;
pub mod joint;
pub mod observation;
mod pattern;
pub mod plan;
pub mod posterior;
mod prior_place;
mod real_line;
pub mod sequential;
pub mod settings;
pub mod table;
pub mod variance_shares;
pub mod with_tests;

pub use adjust::Withheld;
pub use conflict::{Conflict, Violation};
pub use explained::Source;
pub use observation::{InvalidObservation, Observation};
pub use plan::{Inference, PlanError};
pub use posterior::{Marginal, Posterior, Stop};
pub use settings::{AbcSettings, Accept, Adjustment, Distance, Method, Noise};
pub use table::{LaterTable, Statics, Table, Tables};
pub use variance_shares::{MassDependence, SourceShare, VarianceShares};
pub use with_tests::{SensorRatio, Tested, agreed};
