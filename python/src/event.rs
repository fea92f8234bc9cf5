//! Records as they come from files or from arrays.

use crate::refused;
use numpy::PyArray1;
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};
use tirante::Event as Inner;
use tirante::recording::read::SourceError;

/// A record, a stretch that makes none, or temperatures beside records. Of a rod with several sensors all that they recorded at one
/// moment: samples and facts are those of the first, and `Site.identify` uses all of them.
#[pyclass(frozen, module = "tirante._core")]
pub struct Event(pub(crate) Inner);

impl Event {
    /// Of the sensors of one moment the first record, or else the first refused stretch.
    fn first(&self) -> &Inner {
        let Inner::Moment(moment) = &self.0 else {
            return &self.0;
        };
        let mut seen = moment.seen.iter().map(|(_, event)| event);
        let record = seen.clone().find(|event| matches!(event, Inner::Record(_)));
        record.or_else(|| seen.next()).unwrap_or(&self.0)
    }
}

#[pymethods]
impl Event {
    /// `record`, `rejected` or `readings`.
    #[getter]
    fn kind(&self) -> &'static str {
        match self.first() {
            Inner::Record(_) => "record",
            Inner::Readings { .. } => "readings",
            Inner::Rejected { .. } | Inner::Moment(_) => "rejected",
        }
    }

    /// Id of the rod.
    #[getter]
    fn rod(&self) -> &str {
        &self.0.rod().0
    }

    /// Time of the first sample, nanoseconds since 1970.
    #[getter]
    fn start_ns(&self) -> Option<i64> {
        match self.first() {
            Inner::Record(record) => Some(record.start.as_nanos()),
            Inner::Rejected { start, .. } => start.map(|start| start.as_nanos()),
            Inner::Readings { readings, .. } => readings.first().map(|first| first.time.as_nanos()),
            Inner::Moment(_) => None,
        }
    }

    /// Length in seconds.
    #[getter]
    fn duration_s(&self) -> Option<f64> {
        match self.first() {
            Inner::Record(record) => Some(record.duration_s()),
            Inner::Rejected { duration_s, .. } => Some(*duration_s),
            Inner::Readings { .. } | Inner::Moment(_) => None,
        }
    }

    /// Sample rate in hertz.
    #[getter]
    fn fs_hz(&self) -> Option<f64> {
        match self.first() {
            Inner::Record(record) => Some(record.fs_hz),
            Inner::Rejected { fs_hz, .. } => *fs_hz,
            Inner::Readings { .. } | Inner::Moment(_) => None,
        }
    }

    /// Mean temperature during a record, degrees Celsius.
    #[getter]
    fn temperature_c(&self) -> Option<f64> {
        match self.first() {
            Inner::Record(record) => record.temperature_c,
            _ => None,
        }
    }

    /// Reason why a stretch makes no record.
    #[getter]
    fn reason(&self) -> Option<String> {
        match self.first() {
            Inner::Rejected { rejection, .. } => Some(rejection.to_string()),
            _ => None,
        }
    }

    /// Temperature readings: nanoseconds since 1970, degrees Celsius.
    #[getter]
    fn readings(&self) -> Vec<(i64, f64)> {
        let readings = match self.first() {
            Inner::Record(record) => &record.readings[..],
            Inner::Readings { readings, .. } => readings,
            Inner::Rejected { .. } | Inner::Moment(_) => &[],
        };
        readings
            .iter()
            .map(|reading| (reading.time.as_nanos(), reading.celsius))
            .collect()
    }

    /// Copy of a record's samples, SI of their unit.
    fn samples<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        match self.first() {
            Inner::Record(record) => Some(PyArray1::from_slice(py, &record.samples)),
            _ => None,
        }
    }
}

/// Events of files, in the order of their times.
#[pyclass(frozen, module = "tirante._core")]
pub struct Records {
    inner: Mutex<tirante::Records>,
    notes: Mutex<Vec<String>>,
}

impl Records {
    pub(crate) fn new(inner: tirante::Records) -> Self {
        Self {
            inner: Mutex::new(inner),
            notes: Mutex::default(),
        }
    }

    /// Keeps what the files read so far say; one that cannot be read, or has no topic of the site, is an error.
    fn note(&self, records: &mut tirante::Records) -> PyResult<()> {
        for result in records.files() {
            let summary = match result {
                Ok(summary) => summary,
                Err(error @ SourceError::Io { .. }) => return Err(PyOSError::new_err(error.to_string())),
                Err(error) => return Err(refused(error)),
            };
            if summary.has_nothing() {
                return Err(refused(summary.absence().unwrap_or_default()));
            }
            let mut notes = self.notes.lock().unwrap_or_else(PoisonError::into_inner);
            notes.extend(summary.notes.iter().cloned().chain(summary.faults()));
        }
        Ok(())
    }
}

#[pymethods]
impl Records {
    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    fn __next__(&self, py: Python<'_>) -> PyResult<Option<Event>> {
        py.detach(|| {
            let mut records = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
            let event = records.next();
            self.note(&mut records)?;
            Ok(event.map(Event))
        })
    }

    /// Remarks about the files read so far: damage, lost data, samples left out.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
