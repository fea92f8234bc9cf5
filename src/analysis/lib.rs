//! The pure part: from samples to frequencies, to the posterior of the axial force, to its track over years.
//!
//! Functions of their arguments: no file, clock, thread pool of its own or global generator. Imports go downward only,
//! from the last line of this list to the first:
//! * [`numerics`]    seeds, special functions, polynomials, optimisation, statistics of samples
//! * [`rod`]         the tensioned beam, its emulators, the priors of its parameters
//! * [`signal`]      records, spectra, modes
//! * [`inference`]   approximate Bayesian computation: frequencies to the posterior of the force
//! * [`identify`]    a plan once per rod, then one pure `run` per record
//! * [`findings`]    findings of a record besides its force: peaks, motion, assignments
//! * [`track`]       the relative force over time: baseline, drift, alarms; one pure fold per rod
//! * [`outcome`]     a record's result: a force, or a reason why there is none
//! * [`record_view`] one record as the report shows it
//! * [`lab`]         the paper's study, simulated records and sites, Markov chains, a perceptron

pub mod findings;
pub mod identify;
pub mod inference;
pub mod lab;
pub mod numerics;
pub mod outcome;
pub mod record_view;
pub mod rod;
pub mod signal;
pub mod track;
