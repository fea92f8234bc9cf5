//! Results of records.

use crate::{kept, refused, table};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use tirante::Outcome as Inner;
use tirante::analysis::findings::Doubt;
use tirante::analysis::track::Verdict;
use tirante::site::record_row::RecordRow;

/// Result of a record: a force, or the reason why there is none.
#[pyclass(frozen, module = "tirante._core")]
pub struct Outcome {
    /// Without its particles and spectrum, which are in the arrays.
    pub(crate) inner: Inner,
    row: RecordRow,
    quantities: Vec<&'static str>,
    draws: Option<Py<PyArray2<f64>>>,
    weights: Option<Py<PyArray1<f64>>>,
    df_hz: Option<f64>,
    psd: Option<Py<PyArray1<f64>>>,
}

impl Outcome {
    /// Takes over a result; its arrays become NumPy's without being copied.
    pub(crate) fn new(py: Python<'_>, mut inner: Inner, config: &str) -> PyResult<Self> {
        let row = RecordRow::of(&inner, None, config);
        let (mut quantities, mut draws, mut weights) = (Vec::new(), None, None);
        let mut measurement = None;
        match &mut inner {
            Inner::Identified(found) => {
                let posterior = &mut found.posterior;
                quantities = posterior
                    .parameterisation
                    .quantities()
                    .iter()
                    .map(|quantity| quantity.key())
                    .collect();
                let particles = std::mem::take(&mut posterior.particles);
                draws = Some(table(py, particles, quantities.len())?.unbind());
                weights = Some(kept(py, std::mem::take(&mut posterior.weights))?.unbind());
                measurement = found.measurement.as_mut();
            }
            Inner::Rejected(rejected) => measurement = rejected.measurement.as_deref_mut(),
            Inner::Tabulated(_) => {}
        }
        let (mut df_hz, mut psd) = (None, None);
        if let Some(measurement) = measurement {
            df_hz = Some(measurement.spectrum.df_hz);
            psd = Some(kept(py, std::mem::take(&mut measurement.spectrum.psd))?.unbind());
        }
        Ok(Self {
            inner,
            row,
            quantities,
            draws,
            weights,
            df_hz,
            psd,
        })
    }

    /// The same with what tracking made of the record.
    pub(crate) fn tracked(&self, py: Python<'_>, verdict: &Verdict) -> Self {
        Self {
            inner: self.inner.clone(),
            row: self.row.clone().with_verdict(verdict),
            quantities: self.quantities.clone(),
            draws: self.draws.as_ref().map(|draws| draws.clone_ref(py)),
            weights: self.weights.as_ref().map(|weights| weights.clone_ref(py)),
            df_hz: self.df_hz,
            psd: self.psd.as_ref().map(|psd| psd.clone_ref(py)),
        }
    }
}

#[pymethods]
impl Outcome {
    /// The line of JSON that the program prints for the record.
    fn to_json(&self) -> PyResult<String> {
        self.row.to_json().map_err(refused)
    }

    /// True if the record gave a force.
    #[getter]
    fn is_identified(&self) -> bool {
        matches!(self.inner, Inner::Identified(_))
    }

    /// Reasons to doubt the force.
    #[getter]
    fn doubts(&self) -> Vec<&'static str> {
        self.row.doubts().into_iter().map(Doubt::code).collect()
    }

    /// Names of the columns of the draws.
    #[getter]
    fn quantities(&self) -> Vec<&'static str> {
        self.quantities.clone()
    }

    /// Posterior draws, one a row, SI.
    #[getter]
    fn draws(&self, py: Python<'_>) -> Option<Py<PyArray2<f64>>> {
        Some(self.draws.as_ref()?.clone_ref(py))
    }

    /// Weights of the draws; they sum to one.
    #[getter]
    fn weights(&self, py: Python<'_>) -> Option<Py<PyArray1<f64>>> {
        Some(self.weights.as_ref()?.clone_ref(py))
    }

    /// Distance of the lines of the spectrum in hertz.
    #[getter]
    fn df_hz(&self) -> Option<f64> {
        self.df_hz
    }

    /// Welch's spectrum, unit^2/Hz.
    #[getter]
    fn psd(&self, py: Python<'_>) -> Option<Py<PyArray1<f64>>> {
        Some(self.psd.as_ref()?.clone_ref(py))
    }
}
