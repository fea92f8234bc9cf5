//! The laboratory: the paper's study, simulated records and sites, and the samplers and emulators only these use.
//!
//! * [`study`]      the paper's own study, compared with its printed figures
//! * [`synthesis`]  displacement histories of a simulated rod, faults included
//! * [`mcmc`]       Metropolis-Hastings with data augmentation (paper, Algorithm 1) on the exact likelihood
//! * [`chains`]     draws of chains, and their convergence
//! * [`likelihood`] the density of the observed frequencies
//! * [`ann`]        a perceptron in place of the beam

pub mod ann;
pub mod chains;
pub mod likelihood;
pub mod mcmc;
pub mod study;
pub mod synthesis;
