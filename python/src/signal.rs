//! Spectra and resonances of arrays.

use crate::{kept, refused};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use tirante::analysis::signal::modes::PeakSearch;
use tirante::{
    Mask, MotionKind, PeakSettings, Record, RecordSettings, RodId, Timestamp, Welch, WelchSettings, Window,
};

/// Settings of a spectrum.
fn settings(segment_s: Option<f64>, overlap: f64, window: &str) -> PyResult<WelchSettings> {
    let window = match window {
        "hann" => Window::Hann,
        "hamming" => Window::Hamming,
        "blackman" => Window::Blackman,
        "rectangular" => Window::Rectangular,
        other => {
            return Err(refused(format!(
                "window {other:?}: one of hann, hamming, blackman, rectangular is wanted"
            )));
        }
    };
    if !(0.0..=0.95).contains(&overlap) || segment_s.is_some_and(|length| length.is_nan() || length <= 0.0) {
        return Err(refused(
            "a segment above 0 s and an overlap from 0 to 0.95 are wanted",
        ));
    }
    Ok(WelchSettings {
        window,
        segment_s,
        overlap,
    })
}

/// Welch's one-sided power spectral density of samples, which are read in place: distance of its lines in hertz,
/// density, segments averaged.
#[pyfunction]
#[pyo3(signature = (samples, fs_hz, *, segment_s = None, overlap = 0.5, window = "hann"))]
pub fn welch<'py>(
    py: Python<'py>,
    samples: PyReadonlyArray1<'py, f64>,
    fs_hz: f64,
    segment_s: Option<f64>,
    overlap: f64,
    window: &str,
) -> PyResult<(f64, Bound<'py, PyArray1<f64>>, usize)> {
    let settings = settings(segment_s, overlap, window)?;
    let samples = samples.as_slice()?;
    let nperseg = settings.nperseg(fs_hz, samples.len());
    let spectrum = py
        .detach(|| {
            Welch::plan(fs_hz, nperseg, settings.noverlap(nperseg), settings.window)
                .and_then(|welch| welch.run(samples))
        })
        .map_err(refused)?;
    Ok((spectrum.df_hz, kept(py, spectrum.psd)?, spectrum.segments))
}

/// One resonance: frequency, its standard error, damping ratio, its logarithm's standard error, peak to noise, line or not.
type Found = (f64, f64, f64, f64, f64, bool);

/// Resonances of samples between two frequencies, of no rod in particular; with the motion that was recognised.
#[pyfunction]
#[pyo3(signature = (samples, fs_hz, low_hz, high_hz, *, masks = Vec::new()))]
pub fn resonances(
    py: Python<'_>,
    samples: PyReadonlyArray1<'_, f64>,
    fs_hz: f64,
    low_hz: f64,
    high_hz: f64,
    masks: Vec<(f64, f64)>,
) -> PyResult<(String, Vec<Found>)> {
    if !(low_hz > 0.0 && high_hz > low_hz && fs_hz > 0.0) {
        return Err(refused("fs_hz > 0 and 0 < low_hz < high_hz are wanted"));
    }
    // The checks repair samples: a record has its own.
    let samples = samples.as_slice()?.to_vec();
    let masks = masks
        .into_iter()
        .map(|(low_hz, high_hz)| Mask { low_hz, high_hz });
    let search = PeakSearch::new(WelchSettings::default(), PeakSettings::default(), masks.collect());
    let evidence = py
        .detach(|| {
            let start = Timestamp::from_nanos(0);
            let checks = RecordSettings::default();
            let record = Record::from_samples(RodId::default(), start, fs_hz, samples, &checks)?;
            search.evidence(&record, low_hz, high_hz)
        })
        .map_err(refused)?;
    let motion = match evidence.motion.kind {
        MotionKind::Ambient => "ambient",
        MotionKind::FreeDecay => "free-decay",
        MotionKind::FreeDecays => "free-decays",
        MotionKind::Blow => "blow",
    };
    let found = evidence.resonances.iter().map(|one| {
        (
            one.frequency_hz,
            one.frequency_sd_hz,
            one.damping,
            one.damping_log_sd,
            one.peak_to_noise,
            one.line,
        )
    });
    Ok((motion.to_owned(), found.collect()))
}
