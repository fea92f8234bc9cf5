//! From samples to natural frequencies, to the posterior of the axial force of a tie-rod, to its change over years.
//!
//! Functions of their arguments: no file, clock, thread pool of its own or global generator, and the same bits for
//! the same input and seed on any number of threads. Units are SI; where no documentation is at hand, the unit is a
//! suffix of the name. The crate `tirante` adds configuration files, recordings and the program.
//!
//! # Frequencies to the posterior of the force
//!
//! [`Rod`] takes what is known of a rod beforehand: a number for what is known exactly, a [`Prior`] for the rest.
//! [`Rod::prepare`] makes its [`Plan`], once. The rod of the paper, with the frequencies measured there:
//!
//! ```
//! use tirante_analysis::{Mode, Prior, Rod};
//!
//! let rod = Rod::square("todi")
//!     .axial_force_n(Prior::normal(800e3, 0.20))
//!     .youngs_modulus_pa(Prior::normal(2.0e11, 0.30))
//!     .density_kg_m3(Prior::normal(7500.0, 0.10))
//!     .side_m(Prior::normal(0.07, 0.10))
//!     .springs_n_m(Prior::normal(400e3, 0.30))
//!     .length_m(14.0)
//!     .discrepancy(0.0)
//!     .prepare()?;
//! let found = rod.run_frequencies(Mode::first(&[4.492, 9.288, 13.252], 1e-3_f64.sqrt()))?;
//! let force = found.axial_force();
//! println!("{:.0} kN, 95 % between {:.0} and {:.0}", force.mean / 1e3, force.q025 / 1e3, force.q975 / 1e3);
//! assert!((500e3..620e3).contains(&force.mean));
//! // No beam has a third frequency below three times the first: the paper's are in conflict with the model.
//! assert!(found.conflict.score > 10.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`Identification`] has the [`Posterior`] as a weighted sample of all quantities, the [`Conflict`] of the
//! frequencies with the model, and the sources of the force's variance.
//!
//! # Samples to modes
//!
//! [`Record::from_samples`] checks a signal, [`Plan::run`] finds its motion, its resonances and their orders, and
//! the force. Here a rod under 60 kN, released once, as a sensor with a resolution of 10 nm sees it:
//!
//! ```
//! use tirante_analysis::{Prior, Record, RecordSettings, Rod, RodId, Timestamp};
//!
//! let rod = Rod::round("nave-3")
//!     .axial_force_n(Prior::log_uniform(5e3, 200e3))
//!     .youngs_modulus_pa(Prior::normal(200e9, 0.1))
//!     .density_kg_m3(Prior::normal(7650.0, 0.03))
//!     .diameter_m(0.040)
//!     .springs_n_m(Prior::fixity(0.0, 0.9))
//!     .length_m(9.5)
//!     .prepare()?;
//! let mut hz = [0.0; 3];
//! rod.model().frequencies(&[60e3, 200e9, 7650.0, 0.040, 2e4, 3e4, 9.5], &mut hz)?;
//! let fs_hz = 200.0;
//! let sample = |k: i32| {
//!     let t = f64::from(k) / fs_hz;
//!     let mode = |f: &f64| {
//!         let omega = std::f64::consts::TAU * f;
//!         (-0.002 * omega * t).exp() * (omega * t).sin() / f
//!     };
//!     (5e-4 * hz.iter().map(mode).sum::<f64>() / 1e-8).round() * 1e-8
//! };
//! let samples: Vec<f64> = (0..12_000).map(sample).collect();
//! let start = Timestamp::as_written("2026-03-01T06:00:00Z")?;
//! let record = Record::from_samples(RodId::from("nave-3"), start, fs_hz, samples, &RecordSettings::default())?;
//! let found = rod.run(&record).map_err(|refusal| refusal.rejection)?;
//! for (mode, truth) in found.modes.iter().zip(hz) {
//!     assert!((mode.frequency_hz - truth).abs() < 1e-3);
//! }
//! let force = found.axial_force();
//! assert!(force.q025 < 60e3 && 60e3 < force.q975);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Records to relative force
//!
//! A [`Tracker`] learns a baseline from the first records of a rod and gives the change of force of every later one,
//! much more exactly than the force itself: what is not known of the rod stays the same. Records come as
//! [`Outcome`]s, here from frequencies identified elsewhere; after thirty days the force is a tenth lower:
//!
//! ```
//! use tirante_analysis::{Mode, Outcome, Prior, Rod, TableRow, Timestamp, Tracker};
//!
//! let rod = Rod::round("nave-3")
//!     .axial_force_n(Prior::log_uniform(5e3, 200e3))
//!     .youngs_modulus_pa(Prior::normal(200e9, 0.1))
//!     .density_kg_m3(Prior::normal(7650.0, 0.03))
//!     .diameter_m(0.040)
//!     .springs_n_m(Prior::fixity(0.0, 0.9))
//!     .length_m(9.5)
//!     .prepare()?;
//! let model = rod.model();
//! let mut tracker = Tracker::of(&rod);
//! let start = Timestamp::as_written("2026-03-01")?;
//! let mut ratio = None;
//! for day in 0..35 {
//!     let force_n = if day < 30 { 60e3 } else { 54e3 };
//!     let mut hz = [0.0; 3];
//!     model.frequencies(&[force_n, 200e9, 7650.0, 0.040, 2e4, 3e4, 9.5], &mut hz)?;
//!     let row = TableRow {
//!         start: start.plus_seconds(f64::from(day) * 86_400.0),
//!         duration_s: 60.0,
//!         modes: Mode::first(&hz, 0.002),
//!         temperature_c: None,
//!         readings: Vec::new(),
//!         rms: None,
//!     };
//!     let input = Outcome::of_row(&rod, row).input().ok_or("no time")?;
//!     ratio = tracker.step(&input, &[]).relative.map(|relative| relative.ratio);
//! }
//! let ratio = ratio.ok_or("no baseline")?;
//! assert!(ratio.q025 < 0.9 && 0.9 < ratio.q975 && ratio.sd < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Inside
//!
//! The items listed below are for programs. Everything else is public for the program `tirante` alone, is not in these
//! pages, and changes without notice. Imports go downward only, from the last line of this list to the first:
//! * `numerics`    seeds, special functions, polynomials, optimisation, statistics of samples
//! * `rod`         the tensioned beam, its emulators, the priors of its parameters
//! * `signal`      records, spectra, modes
//! * `inference`   approximate Bayesian computation: frequencies to the posterior of the force
//! * `identify`    a plan once per rod, then one pure `run` per record
//! * `findings`    findings of a record besides its force: peaks, motion, assignments
//! * `track`       the relative force over time: baseline, drift, alarms; one pure fold per rod
//! * `outcome`     a record's result: a force, or a reason why there is none
//! * `record_view` one record as the report shows it
//! * `builder`     a rod described quantity by quantity
//! * `lab`         the paper's study, simulated records and sites, Markov chains, a perceptron

mod builder;
#[doc(hidden)]
pub mod findings;
#[doc(hidden)]
pub mod identify;
#[doc(hidden)]
pub mod inference;
#[doc(hidden)]
pub mod lab;
#[doc(hidden)]
pub mod numerics;
#[doc(hidden)]
pub mod outcome;
#[doc(hidden)]
pub mod record_view;
#[doc(hidden)]
pub mod rod;
#[doc(hidden)]
pub mod signal;
#[doc(hidden)]
pub mod track;

pub use builder::{Rod, RodError};
pub use identify::{AnalysisSettings, Identification, Measurement, Plan, Refusal};
pub use inference::{
    AbcSettings, Accept, Adjustment, Conflict, Distance, Marginal, Method, Noise, PlanError, Posterior,
    VarianceShares,
};
pub use outcome::{Outcome, Rejected, TableRow, Tabulated};
pub use rod::beam::forward::ForwardModel;
pub use rod::beam::{OutsideRange, Parameterisation, Quantity, Section};
pub use rod::prior::{Prior, RodPrior};
pub use signal::modes::{
    Candidate, Labels, Mask, Mode, ModeSettings, ModeWindow, Motion, MotionKind, Resonance,
};
pub use signal::record::{Event, Flag, Reading, Record, RecordSettings, Rejection, RodId, Timestamp, Unit};
pub use signal::spectrum::{
    Peak, PeakSettings, Spectrum, Welch, WelchError, WelchSettings, Window, find_peaks, pick_peaks,
};
pub use track::{
    Alarm, AlarmEvent, AlarmSettings, AtReference, Input, Interval, Observation, Relative, RodState,
    SetAside, TrackPlan, TrackSettings, Tracker, Verdict,
};
