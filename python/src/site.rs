//! A configuration with the plans of its rods.

use crate::event::{Event, Records};
use crate::outcome::Outcome;
use crate::refused;
use crate::tracker::Tracker;
use numpy::PyReadonlyArray1;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use tirante::analysis::rod::beam::forward::MAX_MODES;
use tirante::recording::import::How;
use tirante::site::analyse::{Analysed, Known, analyse};
use tirante::site::prepared::Generation;
use tirante::{Config, Mode, Others, Plans, Reading, Record, RodId, Setting, Timestamp, Unit};

/// A site: a configuration, every rod of it ready for records.
#[pyclass(frozen, module = "tirante._core")]
pub struct Site {
    generation: Generation,
    config_hash: String,
    /// Plan of the rod and number of modes that frequencies were given for last.
    given: Mutex<Option<(RodId, usize, Arc<Plans>)>>,
}

impl Site {
    fn prepare(py: Python<'_>, config: Config) -> PyResult<Self> {
        py.detach(|| {
            let generation = Generation::prepare(config, |_| |_, _| ()).map_err(refused)?;
            Ok(Self {
                config_hash: generation.provenance().hash.to_owned(),
                generation,
                given: Mutex::default(),
            })
        })
    }

    /// The rod called so; the only one, if no name is given.
    fn rod(&self, name: Option<&str>) -> PyResult<RodId> {
        let rods = &self.generation.config.rods;
        let found = match (name, rods.as_slice()) {
            (None, [only]) => Some(only),
            (None, _) => None,
            (Some(name), _) => self.generation.config.rod(name),
        };
        found.map(|rod| rod.analysis.rod.clone()).ok_or_else(|| {
            let known: Vec<&str> = rods.iter().map(|rod| rod.analysis.rod.0.as_str()).collect();
            PyKeyError::new_err(format!("rod: one of {} is wanted", known.join(", ")))
        })
    }

    /// Plan for frequencies of a rod up to an order, as `tirante identify --frequencies` makes it.
    fn plan_for(&self, rod: &RodId, highest: usize) -> PyResult<Arc<Plans>> {
        let mut given = self.given.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((known, modes, plans)) = &*given
            && (known, *modes) == (rod, highest)
        {
            return Ok(Arc::clone(plans));
        }
        let mut config = self.generation.config.clone();
        config.rods.retain(|candidate| candidate.analysis.rod == *rod);
        for candidate in &mut config.rods {
            candidate.analysis = candidate.analysis.clone().for_orders(highest);
        }
        let plans = Arc::new(tirante::plans(&config, |_| |_, _| ()).map_err(refused)?);
        *given = Some((rod.clone(), highest, Arc::clone(&plans)));
        Ok(plans)
    }
}

/// The unit of a record's samples, those of a rod's motion.
fn motion(text: &str) -> PyResult<Unit> {
    let unit =
        Unit::as_written(text).ok_or_else(|| refused(tirante::recording::import::unknown_unit(text)))?;
    if Unit::MOTION.contains(&unit) {
        return Ok(unit);
    }
    let known: Vec<&str> = Unit::MOTION.iter().map(|unit| unit.key()).collect();
    Err(refused(format!(
        "unit: {text:?} is none of motion; {} are",
        known.join(", ")
    )))
}

/// Modes from order, frequency and standard error, ascending.
pub(crate) fn modes(given: &[(usize, f64, f64)]) -> PyResult<Vec<Mode>> {
    let positive = |value: f64| value.is_finite() && value > 0.0;
    let good = given
        .iter()
        .all(|(order, hz, sd)| (1..=MAX_MODES).contains(order) && positive(*hz) && positive(*sd));
    let ascending = given
        .windows(2)
        .all(|two| two[0].0 < two[1].0 && two[0].1 < two[1].1);
    if given.is_empty() || !good || !ascending {
        return Err(refused(format!(
            "frequencies: ascending ones above 0 Hz of modes 1 to {MAX_MODES} are wanted, each with a standard error above 0 Hz"
        )));
    }
    Ok(given
        .iter()
        .map(|&(order, frequency_hz, sd_hz)| Mode {
            order,
            frequency_hz,
            sd_hz,
            damping: None,
        })
        .collect())
}

#[pymethods]
impl Site {
    /// Reads a configuration file; without a path the built-in rod of the paper. `settings` are pairs of a key and its value
    /// in TOML, as of the program's `--set`.
    #[staticmethod]
    #[pyo3(signature = (path = None, settings = Vec::new()))]
    fn load(py: Python<'_>, path: Option<PathBuf>, settings: Vec<(String, String)>) -> PyResult<Self> {
        let settings: Vec<Setting> = settings
            .iter()
            .map(|(key, value)| Setting::new(key, value))
            .collect();
        Self::prepare(py, Config::resolve(path.as_deref(), &settings).map_err(refused)?)
    }

    /// Reads a configuration from its text.
    #[staticmethod]
    fn parse(py: Python<'_>, text: &str) -> PyResult<Self> {
        Self::prepare(py, Config::parse(text, "the text").map_err(refused)?)
    }

    /// Name of the site.
    #[getter]
    fn name(&self) -> &str {
        &self.generation.config.site
    }

    /// Ids of the rods.
    #[getter]
    fn rods(&self) -> Vec<&str> {
        let rods = self.generation.config.rods.iter();
        rods.map(|rod| rod.analysis.rod.0.as_str()).collect()
    }

    /// The configuration with every default filled in, as TOML.
    #[getter]
    fn effective(&self) -> String {
        self.generation.config.effective()
    }

    /// Analyses frequencies measured elsewhere: order, frequency and standard error in hertz of each.
    #[pyo3(signature = (given, rod = None))]
    fn identify_frequencies(
        &self,
        py: Python<'_>,
        given: Vec<(usize, f64, f64)>,
        rod: Option<&str>,
    ) -> PyResult<Outcome> {
        let rod = self.rod(rod)?;
        let modes = modes(&given)?;
        let highest = modes.last().map_or(0, |mode| mode.order);
        let found = py.detach(|| {
            let plans = self.plan_for(&rod, highest)?;
            let Some(plan) = plans.get(&rod) else {
                return Err(PyKeyError::new_err(rod.0.clone()));
            };
            Ok(tirante::Outcome::of_frequencies(
                &rod,
                plan.run_frequencies(modes),
            ))
        })?;
        Outcome::new(py, found, &self.config_hash)
    }

    /// Analyses an event that is a record, or a stretch that makes none.
    fn identify(&self, py: Python<'_>, event: &Event) -> PyResult<Outcome> {
        // Records of another site's rods have no plan here.
        self.rod(Some(&event.0.rod().0))?;
        let copy = event.0.clone();
        match py.detach(|| analyse(copy, &self.generation.plans, &Known::new())) {
            Analysed::Record(outcome) => Outcome::new(py, *outcome, &self.config_hash),
            Analysed::Known(..) | Analysed::Readings(..) => {
                Err(refused("temperatures are no record; a tracker takes them"))
            }
        }
    }

    /// A record from evenly spaced samples, copied: the checks may repair them. Without a unit they are in that of the
    /// rod's channel.
    #[pyo3(signature = (samples, fs_hz, start_ns, *, rod = None, unit = None, temperature_c = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    fn record(
        &self,
        py: Python<'_>,
        samples: PyReadonlyArray1<'_, f64>,
        fs_hz: f64,
        start_ns: i64,
        rod: Option<&str>,
        unit: Option<&str>,
        temperature_c: Option<f64>,
    ) -> PyResult<Event> {
        let rod = self.rod(rod)?;
        if !(fs_hz.is_finite() && fs_hz > 0.0) {
            return Err(refused(format!("fs_hz = {fs_hz}: a rate above 0 Hz is wanted")));
        }
        let config = &self.generation.config;
        let unit = match unit {
            Some(text) => motion(text)?,
            None => config
                .rod(&rod.0)
                .map_or(Unit::Metre, |rod| rod.channels.displacement.unit),
        };
        let start = Timestamp::from_nanos(start_ns);
        let samples: Vec<f64> = samples
            .as_slice()?
            .iter()
            .map(|value| unit.convert(*value))
            .collect();
        let duration_s = samples.len() as f64 / fs_hz;
        let checked = py.detach(|| Record::from_samples(rod.clone(), start, fs_hz, samples, &config.record));
        Ok(Event(match checked {
            Ok(mut record) => {
                record.temperature_c = temperature_c;
                record.readings = temperature_c
                    .map(|celsius| Reading {
                        time: start.plus_seconds(duration_s / 2.0),
                        celsius,
                    })
                    .into_iter()
                    .collect();
                tirante::Event::Record(record)
            }
            Err(rejection) => tirante::Event::Rejected {
                rod,
                start: Some(start),
                duration_s,
                fs_hz: Some(fs_hz),
                waveform: None,
                rejection,
            },
        }))
    }

    /// Records of files, or folders of them, in the order of their times. `rate_hz`, `unit`, `start_ns`: facts that a file
    /// of another program does not say itself.
    #[pyo3(signature = (paths, *, rate_hz = None, unit = None, start_ns = None))]
    fn read(
        &self,
        paths: Vec<PathBuf>,
        rate_hz: Option<f64>,
        unit: Option<&str>,
        start_ns: Option<i64>,
    ) -> PyResult<Records> {
        let unit = unit.map(motion).transpose()?;
        let others = Others {
            how: How {
                rate_hz,
                unit,
                start: start_ns.map(Timestamp::from_nanos),
                ..How::default()
            },
            is_meant: true,
            any_start: true,
            needs_all: false,
        };
        Ok(Records::new(tirante::Records::open(
            &paths,
            &self.generation.config,
            others,
        )))
    }

    /// A tracker of the site's rods, without records.
    fn tracker(&self) -> Tracker {
        Tracker::new(&self.generation)
    }

    /// Natural frequencies of a rod with these quantities (SI, in the order of [`Site::quantities`]), by its model.
    #[pyo3(signature = (quantities, modes = 3, rod = None))]
    fn frequencies(&self, quantities: Vec<f64>, modes: usize, rod: Option<&str>) -> PyResult<Vec<f64>> {
        let plan = self.plan(rod)?;
        let model = plan.model();
        if quantities.len() != model.parameterisation().len() || !(1..=model.modes()).contains(&modes) {
            return Err(refused(format!(
                "{} quantities and 1 to {} modes are wanted",
                model.parameterisation().len(),
                model.modes()
            )));
        }
        let mut hz = vec![0.0; modes];
        model.frequencies(&quantities, &mut hz).map_err(refused)?;
        Ok(hz)
    }

    /// Names of a rod's quantities, in the order of the columns of its draws.
    #[pyo3(signature = (rod = None))]
    fn quantities(&self, rod: Option<&str>) -> PyResult<Vec<&'static str>> {
        let plan = self.plan(rod)?;
        let quantities = plan.settings().prior.parameterisation().quantities();
        Ok(quantities.iter().map(|quantity| quantity.key()).collect())
    }
}

impl Site {
    fn plan(&self, rod: Option<&str>) -> PyResult<&tirante::Plan> {
        let rod = self.rod(rod)?;
        let plan = self.generation.plans.get(&rod);
        plan.ok_or_else(|| PyKeyError::new_err(rod.0.clone()))
    }
}
