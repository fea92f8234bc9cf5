//! Tirante: the axial force of historic tie-rods from contactless vibration records.
//!
//! A record flows one way:
//!
//! ```text
//! Source -> Record -> Spectrum -> Modes -> Identification -> Track -> Verdict -> Store -> output
//! ```
//!
//! Pure (functions of their arguments; no file, clock, thread pool of its own or global generator,
//! and `tests/purity.rs` proves it):
//! * [`record`]   what a record is, how samples are cut into records, and what disqualifies one
//! * [`spectrum`] windows, Welch's power spectral density, peak picking
//! * [`modes`]    natural frequency, damping and standard error per peak; peaks to mode orders
//! * [`beam`]     the tensioned Euler-Bernoulli beam: sections, finite elements, exact solver
//! * [`forward`]  one trait for every map from rod parameters to natural frequencies
//! * [`emulator`] chaos expansions and a perceptron that stand in for the beam, with their error reports
//! * [`bayes`]    priors, approximate Bayesian computation, Markov chains, posteriors, conflict
//! * [`study`]    the paper's own study, beside what it prints
//! * [`analysis`] a plan once per rod, then one pure `run` per record
//! * [`outcome`]  what came of one record: a force, or a reason why there is none
//! * [`findings`] what was found in a record besides its force: peaks, motion, assignments
//! * [`snapshot`] what one record looked like, for the report
//! * [`track`]    the relative force over time: baseline, temperature, charts, alarms; one pure fold per rod
//! * [`synthesis`] displacement histories of a simulated rod, faults included
//! * [`ordered`]  what comes of several rods' records in the order of its time
//! * [`random`]   seeds and counter-based streams
//! * `wide`       inner loops on the widest vectors a processor has
//!
//! Shell (everything that waits, fails or remembers):
//! * [`config`]   the TOML configuration, every fault reported at once
//! * [`source`]   recordings in: MCAP, message decoding
//! * [`sink`]     recordings out: MCAP
//! * [`clock`]    the time people's requests carry
//! * [`import`]   measurements of other programs in: CSV, UFF58, WAV, MATLAB
//! * [`cache`]    fitted emulators on disk
//! * [`line`](mod@line)     a record as one JSON line
//! * [`step`]     one record through its rod's plan, the same for `replay` and daemon
//! * [`site`]     the trackers of a site's rods, folded in the order records come, and the store they commit to
//! * [`store`]    what is remembered: SQLite, one transaction per record
//! * [`plot`]     figures and the report page
//! * [`api`]      what a store says to the page and to other programs, as JSON
//! * [`pipeline`] reading and computing at once, results in order
//! * [`cli`], [`command`] arguments as typed, one file per subcommand
//!
//! The daemon (`tirante run`; everything live becomes a file first, docs/daemon.md):
//!
//! ```text
//! ingest -> journal --.
//! watched folder -----+-> daemon: reader -> pipeline -> core -> store -> alert
//! ```
//! * [`daemon`]   its life and its threads: reader, pipeline, core; reload, drain, suspects
//! * [`ingest`]   sockets: the protocol, named senders and what is acknowledged, limits, TLS
//! * [`journal`]  what the sockets took, as MCAP parts on disk
//! * [`alert`]    news of alarms to the sinks, at least once and in order
//! * [`telemetry`] faults and health, metrics, the log
//! * [`viewer`]   results as messages for robotics viewers, as a file and live
//! * [`http`]     the page, its API, `/healthz`, `/readyz`, `/metrics`
//!
//! Units are SI throughout; where no documentation travels, the unit is a suffix of the name.

pub mod alert;
pub mod analysis;
pub mod api;
pub mod bayes;
pub mod beam;
pub mod cache;
pub mod cli;
pub mod clock;
pub mod command;
pub mod config;
pub mod daemon;
pub mod emulator;
pub mod findings;
pub mod forward;
pub mod http;
pub mod import;
pub mod ingest;
pub mod journal;
pub mod line;
pub mod modes;
pub mod ordered;
pub mod outcome;
pub mod pipeline;
pub mod plot;
pub mod random;
pub mod record;
pub mod sink;
pub mod site;
pub mod snapshot;
pub mod source;
pub mod spectrum;
pub mod step;
pub mod store;
pub mod study;
pub mod synthesis;
pub mod telemetry;
pub mod track;
pub mod viewer;
mod wide;
