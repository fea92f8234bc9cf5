//! Mode orders of resonances, by inference over assignments of peaks to orders.
//!
//! An assignment maps the orders seen to peaks; all other peaks are foreign. Its probability follows from the
//! frequencies (a tensioned beam on springs with the rod's prior, the force's prior doubted), from the orders
//! that a sensor may see, and from the usual properties of foreign peaks: their number, their strength,
//! harmonics of stronger peaks, lines. The orders reported are those whose joint probability over all
//! assignments reaches a stated level; below it there is no force, but the candidates, each with its own.
//!
//! * `quantile`    priors as functions of a standard normal coordinate, doubt about the force
//! * `wavenumber`  natural frequencies and their derivatives, warm-started
//! * `rod`         five whitened coordinates of a rod
//! * `peak`        the peaks, and what each is worth as a foreign one
//! * `likeness`    dampings of modes of one rod are alike
//! * `visibility`  which orders a sensor sees beforehand
//! * `code`        an assignment as a number
//! * `search`      candidates from a coarse grid
//! * `evidence`    Laplace's integral per assignment
//! * `posterior`   all assignments worth counting
//! * `force`       the force per candidate
//! * `labelling`   the orders reported, or the reason why none are

mod code;
mod evidence;
mod force;
mod labelling;
mod likeness;
mod peak;
mod posterior;
mod quantile;
mod rod;
mod search;
mod visibility;
mod wavenumber;

pub use labelling::{LabelPlan, Labelling, Unlabelled};
