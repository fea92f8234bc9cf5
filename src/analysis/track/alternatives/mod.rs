//! The kinds of change that the pattern of the modes' shifts allows, each with its probability and size.
//!
//! A rod's baseline leaves particles theta_i of its parameters. A change of kind e and size x (the logarithm of a ratio) moves
//! ln f_n of particle i by r_n(e, x, theta_i), known to a relative error e_n that goes with the model's discrepancy. Given the
//! mean shift z of the modes since an onset, with covariance C,
//!
//! ```text
//! p(z | e) = mean_i int N(z; r(e, x, theta_i), C + D(e, x)) p(x | e) dx,     D_nn = (e_n |r(e, x)|)^2,
//! ```
//!
//! with |r| the root mean square over the modes of the particles' mean. The integral is taken exactly for an r that is
//! straight between nodes of x (`evidence`). All kinds have equal prior probability.
//!
//! * [`Kind`]      kinds of change, priors of their sizes
//! * `response`    r at the nodes, for all particles
//! * `evidence`    p(z | e) and the size's posterior
//! * [`MeanShift`] z and its covariance from records
//! * [`Explained`] probabilities, sizes, one sentence
//! * [`Needed`]    measurements that would decide for or against the force

mod evidence;
mod explained;
mod forecast;
mod kind;
mod mean_shift;
mod response;

pub use explained::{Explained, Weighed};
pub use forecast::Needed;
pub use kind::Kind;
pub use mean_shift::{MeanShift, Shifted};
pub use response::Alternatives;
