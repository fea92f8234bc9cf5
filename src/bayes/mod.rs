//! Priors, approximate Bayesian computation, posteriors and their diagnostics.
//!
//! [`Inference::plan`] once per rod, [`Inference::run`] per record:
//! * [`table`]       the simulated draws, drawn once and reused, and the noise that goes with them
//! * [`distance`]    the generative model's last step and the pass that keeps the nearest draws
//! * [`abc`]         rejection (paper, Algorithms 2 and 3)
//! * [`adjust`]      local-linear regression adjustment of the accepted
//! * [`sequential`]  a sequence of populations instead of one table
//! * [`fixity`]      the prior of a support between hinge and clamp
//! * [`posterior`]   the weighted sample, its means and quantiles
//! * [`conflict`]    how far the observation lies from everything the beam can produce
//! * [`variance_shares`] which source carries how much of the variance of N
//! * [`mcmc`]        Metropolis-Hastings with data augmentation (paper, Algorithm 1) on the exact likelihood
//! * [`chains`]      what chains have drawn, and whether it can be trusted
//! * [`likelihood`]  the density of the observed frequencies
//! * [`diagnostics`] Monte Carlo errors, effective sample size, tests of calibration

pub mod abc;
pub mod adjust;
pub mod chains;
pub mod conflict;
pub mod diagnostics;
pub mod distance;
mod explained;
pub mod fixity;
pub mod inference;
pub mod likelihood;
pub mod mcmc;
pub mod observation;
pub mod posterior;
pub mod prior;
mod prior_place;
mod real_line;
pub mod sequential;
pub mod settings;
pub mod table;
pub mod variance_shares;

pub use adjust::Withheld;
pub use chains::Chains;
pub use conflict::{Conflict, Violation};
pub use fixity::Fixity;
pub use inference::{Inference, PlanError};
pub use likelihood::Likelihood;
pub use mcmc::{McmcError, McmcSettings};
pub use observation::{InvalidObservation, Observation};
pub use posterior::{Marginal, Posterior, Stop};
pub use prior::{Prior, RodPrior};
pub use settings::{AbcSettings, Accept, Adjustment, Distance, Method, Noise};
pub use table::{LaterTable, Table, Tables};
pub use variance_shares::{MassDependence, Source, SourceShare, VarianceShares};
