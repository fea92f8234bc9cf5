//! Welch's one-sided power spectral density (Welch 1967), planned once and run many times.

use super::{Window, window};
use realfft::{RealFftPlanner, RealToComplex};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};
use thiserror::Error;

/// Reason why a spectrum cannot be planned or estimated.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum WelchError {
    /// The sample rate is not a positive number.
    #[error("sample rate {fs_hz} Hz is not a positive number")]
    SampleRate {
        /// Sample rate \[Hz\].
        fs_hz: f64,
    },
    /// Fewer than two samples a segment, or segments that overlap completely.
    #[error("segments of {nperseg} samples with {noverlap} shared cannot be averaged")]
    Segment {
        /// Samples per segment.
        nperseg: usize,
        /// Samples shared by neighbouring segments.
        noverlap: usize,
    },
    /// Fewer samples than one segment.
    #[error("{samples} samples are fewer than one segment of {nperseg}")]
    TooShort {
        /// Samples given.
        samples: usize,
        /// Samples per segment.
        nperseg: usize,
    },
}

/// Most samples of the lengths with a plan or a window kept; a plan takes about 16 bytes a sample.
const KEPT: usize = 1 << 20;

/// Transform plans and windows by length, shared by all rods and records: each takes longer to make than a transform to run.
///
/// Those beyond the latest few are made anew, so a thousand lengths of records take no more memory than a few.
///
/// The scalar and SSE code paths of the transform use no fused multiply-add, so that a spectrum has
/// the same bits on every x86-64 machine; the faster AVX path would not.
#[derive(Clone)]
pub struct Transforms(Arc<Mutex<Planners>>);

/// Planners, which keep every plan they made, and windows.
struct Planners {
    real: RealFftPlanner<f64>,
    complex: FftPlanner<f64>,
    windows: BTreeMap<(Window, usize), Arc<[f64]>>,
    /// Lengths of all that is kept.
    lengths: BTreeSet<(usize, Kept)>,
}

/// Kind of thing kept of a length.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Kept {
    Real,
    Complex,
    Window(Window),
}

static SHARED: LazyLock<Transforms> = LazyLock::new(|| Transforms(Arc::default()));

impl Default for Transforms {
    fn default() -> Self {
        SHARED.clone()
    }
}

impl Default for Planners {
    fn default() -> Self {
        Self {
            real: RealFftPlanner::new(),
            complex: FftPlanner::new(),
            windows: BTreeMap::new(),
            lengths: BTreeSet::new(),
        }
    }
}

impl Planners {
    /// Makes room for a plan or window of a length: what is in use lives on in its users.
    fn make_room(&mut self, length: usize, kept: Kept) {
        self.lengths.insert((length, kept));
        if self.lengths.iter().map(|(n, _)| n).sum::<usize>() > KEPT {
            *self = Self::default();
            self.lengths.insert((length, kept));
        }
    }
}

impl Transforms {
    /// The plan for real transforms of length `n`.
    pub fn plan(&self, n: usize) -> Arc<dyn RealToComplex<f64>> {
        if n > KEPT {
            return RealFftPlanner::new().plan_fft_forward(n);
        }
        let mut planners = self.planners();
        planners.make_room(n, Kept::Real);
        planners.real.plan_fft_forward(n)
    }

    /// The inverse complex transform of `values`, in place, without a factor.
    pub(crate) fn back(&self, values: &mut [Complex<f64>]) {
        let mut planners = self.planners();
        planners.make_room(values.len(), Kept::Complex);
        let plan = planners.complex.plan_fft_inverse(values.len());
        drop(planners);
        plan.process(values);
    }

    /// The `n` weights of a window.
    fn weights(&self, window: Window, n: usize) -> Arc<[f64]> {
        if n > KEPT {
            return window.weights(n).into();
        }
        let mut planners = self.planners();
        planners.make_room(n, Kept::Window(window));
        let weights = planners.windows.entry((window, n));
        weights.or_insert_with(|| window.weights(n).into()).clone()
    }

    fn planners(&self) -> MutexGuard<'_, Planners> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for Transforms {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Transforms")
    }
}

/// A one-sided power spectral density.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// Distance of neighbouring lines \[Hz\]; line `k` lies at `k df_hz`.
    pub df_hz: f64,
    /// Density at each line, from 0 Hz to the Nyquist frequency \[unit^2/Hz\].
    pub psd: Vec<f64>,
    /// Number of segments averaged.
    pub segments: usize,
}

impl Spectrum {
    /// Frequency of line `k` \[Hz\].
    pub fn frequency_hz(&self, k: usize) -> f64 {
        k as f64 * self.df_hz
    }
}

/// A planned estimate: `P_k = c_k / (fs sum w^2 L) sum_l |sum_j w_j x_lj e^(-2 pi i j k / n)|^2`, with
/// `c_k` = 2 except at 0 Hz and (even n) at the Nyquist frequency, over `L` segments of `n` samples,
/// each less its least-squares straight line.
#[derive(Clone)]
pub struct Welch {
    fs_hz: f64,
    noverlap: usize,
    weights: Arc<[f64]>,
    scale: f64,
    transform: Arc<dyn RealToComplex<f64>>,
}

impl Welch {
    /// Plans for a sample rate \[Hz\], samples per segment, samples shared by neighbours, and taper.
    pub fn plan(fs_hz: f64, nperseg: usize, noverlap: usize, window: Window) -> Result<Self, WelchError> {
        Self::plan_with(&Transforms::default(), fs_hz, nperseg, noverlap, window)
    }

    /// [`Welch::plan`] with transforms planned and windows made before.
    pub fn plan_with(
        transforms: &Transforms,
        fs_hz: f64,
        nperseg: usize,
        noverlap: usize,
        window: Window,
    ) -> Result<Self, WelchError> {
        if !(fs_hz.is_finite() && fs_hz > 0.0) {
            return Err(WelchError::SampleRate { fs_hz });
        }
        if nperseg < 2 || noverlap >= nperseg {
            return Err(WelchError::Segment { nperseg, noverlap });
        }
        let weights = transforms.weights(window, nperseg);
        let power: f64 = weights.iter().map(|w| w * w).sum();
        Ok(Self {
            fs_hz,
            noverlap,
            scale: 1.0 / (fs_hz * power),
            weights,
            transform: transforms.plan(nperseg),
        })
    }

    /// Samples per segment.
    pub fn nperseg(&self) -> usize {
        self.weights.len()
    }

    /// The spectrum of `samples`; the rest after the last whole segment is not used.
    pub fn run(&self, samples: &[f64]) -> Result<Spectrum, WelchError> {
        let nperseg = self.nperseg();
        if samples.len() < nperseg {
            return Err(WelchError::TooShort {
                samples: samples.len(),
                nperseg,
            });
        }
        let step = nperseg - self.noverlap;
        let mut segment = self.transform.make_input_vec();
        let mut lines = self.transform.make_output_vec();
        let mut scratch = self.transform.make_scratch_vec();
        let mut psd = vec![0.0; lines.len()];
        let mut segments = 0;
        for part in samples.windows(nperseg).step_by(step) {
            window::detrend_and_taper(part, &self.weights, &mut segment);
            transform(&*self.transform, &mut segment, &mut lines, &mut scratch);
            for (sum, line) in psd.iter_mut().zip(&lines) {
                *sum += line.re * line.re + line.im * line.im;
            }
            segments += 1;
        }
        let scale = self.scale / segments as f64;
        let last = psd.len() - 1;
        for (k, value) in psd.iter_mut().enumerate() {
            let once = k == 0 || (k == last && nperseg.is_multiple_of(2));
            *value *= if once { scale } else { 2.0 * scale };
        }
        Ok(Spectrum {
            df_hz: self.fs_hz / nperseg as f64,
            psd,
            segments,
        })
    }
}

/// Runs a transform on buffers made by the plan itself.
pub(crate) fn transform(
    plan: &dyn RealToComplex<f64>,
    input: &mut [f64],
    output: &mut [Complex<f64>],
    scratch: &mut [Complex<f64>],
) {
    let done = plan.process_with_scratch(input, output, scratch);
    debug_assert!(done.is_ok(), "buffers come from the plan, so their lengths fit");
}

/// The largest even number up to `n` with no prime factor beyond 5 (transforms of such lengths are
/// fast); `n` itself below 4.
pub fn fast_length(n: usize) -> usize {
    if n < 4 {
        return n;
    }
    let mut best = 2;
    let mut fives = 2;
    while fives <= n {
        let mut threes = fives;
        while threes <= n {
            best = best.max(threes << (n / threes).ilog2());
            threes *= 3;
        }
        fives *= 5;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fast_lengths_are_near_and_smooth() {
        assert_eq!(fast_length(16_384), 16_384);
        assert_eq!(fast_length(120_000), 120_000);
        for n in [4usize, 7, 97, 1009, 12_347, 3_600_001] {
            let fast = fast_length(n);
            assert!(fast <= n && fast.is_multiple_of(2), "{n}: {fast}");
            let mut rest = fast;
            for p in [2, 3, 5] {
                while rest.is_multiple_of(p) {
                    rest /= p;
                }
            }
            assert_eq!(rest, 1);
            // Numbers of this form are dense: beyond 1000 the next one is within 2.5 %.
            assert!(n < 1000 || fast as f64 > 0.975 * n as f64, "{n}: {fast}");
        }
    }

    #[test]
    fn plans_of_many_lengths_are_not_all_kept() {
        let transforms = Transforms(Arc::default());
        let long = transforms.plan(20_000);
        for n in 0..200 {
            transforms.plan(20_002 + 2 * n);
            transforms.back(&mut vec![Complex::new(1.0, 0.0); 300 + n]);
        }
        let planners = transforms.0.lock().unwrap();
        let kept = planners.lengths.iter().map(|(n, _)| n).sum::<usize>();
        assert!(kept <= KEPT && planners.lengths.len() > 20, "{kept}");
        // One in use stays.
        assert_eq!(long.len(), 20_000);
    }
}
