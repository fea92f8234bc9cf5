//! A steady tone in the band of a resonance: found by likelihood, and taken out of the samples.
//!
//! A machine's tone near a mode pulls the fit of one resonance to itself, and one fit of both is neither. The tone is an undamped
//! pole: of a record of length `T` its coefficients (see [`super::likelihood`]) are
//!
//! ```text
//! J_k = a sqrt(T) / 2 g(f_t T - k),     g(u) = (e^(2 pi i u) - 1) / (2 pi i u),     x_t = Re a e^(2 pi i f_t t)
//! ```
//!
//! It is there if tone and resonance together explain the lines better than a resonance alone, and if a resonance remains
//! without it: else the peak itself is judged as resonance or tone ([`super::tone`]).

use super::band::{Band, Cell};
use super::fit::{Fit, HALF_WIDTHS, LEAST_LINES, Stretch};
use super::likelihood::{self, Parameters, Start, Value};
use super::maximum::{FIRST_DAMPING, subtract};
use super::pair::Pair;
use super::tone::Tone;
use super::{Mask, Resonance};
use crate::numerics::optimum::golden;
use rustfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Ordinate over the fitted spectrum above which a tone is tried: chance exceeds it on one of 3000 lines.
const CONSPICUOUS: f64 = 8.0;
/// Half-power half-width in lines below which a fit may be to the tone itself.
const NARROW_LINES: f64 = 1.0;
/// Half-power half-width in lines below which one of two modes is a tone.
const TONE_LINES: f64 = 0.3;
/// Twice the log-posterior gain of a tone beside a resonance that makes it certain. Of 1668 modes without one, a third of them in
/// gusts, the highest gained 31.
const CERTAIN: f64 = 32.0;
/// The same from which on the distance of the fits with and without it counts, more and more, as an error: one mode of fifty has as
/// much by chance.
const OPEN: f64 = 19.0;
/// Lines of one band at which a tone is tried.
const MOST_TRIALS: usize = 3;
/// Lines to either side of a tone that its frequency and amplitude are found from.
const NEAR_LINES: f64 = 8.0;
/// Lines to either side of a tone that its amplitude takes up; they are left out of the fits beside it.
const CORE_LINES: f64 = 1.0;
/// Widest cell of lines beside a tone, as a share of its frequency: a tenth of the half-power half-width of a mode with a damping of
/// 0.06 %.
const CELL: f64 = 6e-5;
/// The same, as a share of its distance from the tone: what leaks from it changes by as much across the cell, which looks like noise.
const CELL_BESIDE: f64 = 0.05;
/// Cells over which the rest is averaged to find the resonance in it.
const SMOOTHED: usize = 7;

/// A sinusoid that goes on from the first sample to the last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SteadyTone {
    /// The tone as it is told: a line, foreign by ten to one.
    pub resonance: Resonance,
    /// The resonance beside it: frequency and half-power half-width \[Hz\].
    pub beside_hz: (f64, f64),
    /// Its value at the first sample, `a`.
    amplitude: Complex<f64>,
}

/// Verdict on the band of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Beside {
    /// No tone shows.
    Nothing,
    /// Perhaps there is one; the standard error that this adds \[Hz\].
    Open(f64),
    /// A steady tone beside a resonance.
    Tone(SteadyTone),
}

impl SteadyTone {
    /// Band of the lines of a stretch of `duration_s` that it takes up.
    pub fn core(&self, duration_s: f64) -> Mask {
        core(self.resonance.frequency_hz, 1.0 / duration_s)
    }

    /// Subtracts it from a record's samples.
    pub fn subtract_from(&self, samples: &mut [f64], fs_hz: f64) {
        let turn = TAU * self.resonance.frequency_hz / fs_hz;
        for (i, x) in samples.iter_mut().enumerate() {
            *x -= (self.amplitude * Complex::from_polar(1.0, turn * i as f64)).re;
        }
    }

    /// The same tone, for samples that begin `before_s` earlier.
    pub(super) fn begun(self, before_s: f64) -> Self {
        let turn = -TAU * self.resonance.frequency_hz * before_s;
        Self {
            amplitude: self.amplitude * Complex::from_polar(1.0, turn),
            ..self
        }
    }
}

impl Stretch<'_> {
    /// Verdicts on the bands of the fits, in their order.
    pub fn beside(&self, fits: &[Option<Fit>]) -> Vec<Beside> {
        let of = |(n, fit): (usize, &Option<Fit>)| {
            let others = fits.iter().enumerate().filter(|(m, _)| *m != n);
            let others: Vec<Fit> = others.filter_map(|(_, fit)| *fit).collect();
            fit.and_then(|fit| self.tone_beside(&fit, &others))
                .unwrap_or(Beside::Nothing)
        };
        fits.iter().enumerate().map(of).collect()
    }

    fn tone_beside(&self, fit: &Fit, others: &[Fit]) -> Option<Beside> {
        let r = &fit.resonance;
        let (f, gamma) = (r.frequency_hz, r.damping * r.frequency_hz);
        let line_hz = 1.0 / self.coefficients.duration_s;
        let is_narrow = gamma < NARROW_LINES * line_hz;
        // A tone also explains what a decay has beyond its fit: damping that falls with the amplitude, softening. One that hardly
        // decays may be the tone itself.
        if fit.start == Start::Free && !is_narrow {
            return None;
        }
        // A fit to the tone itself says nothing of the resonance's width.
        let width_hz = if is_narrow { FIRST_DAMPING * f } else { gamma };
        let half_hz = (HALF_WIDTHS * width_hz).max(LEAST_LINES * line_hz);
        let limits = self.limits(f, others);
        let bands = Bands {
            stretch: self,
            range_hz: ((f - half_hz).max(limits.0), (f + half_hz).min(limits.1)),
            others,
            level: fit.value.noise,
            start: fit.start,
        };
        let whole = bands.lines(None);
        let p = &fit.parameters;
        let excess = |cell: &Cell| {
            let h = likelihood::shape(p.frequency_hz, p.log_damping.exp(), cell.frequency_hz);
            let floor = cell.floor * (1.0 + p.slope * cell.x);
            cell.power / (fit.value.noise * (floor + p.log_ratio.exp() * h.norm_sqr()))
        };
        let mut places_hz: Vec<f64> = Vec::new();
        if is_narrow {
            places_hz.extend(highest_line(&whole, |cell| cell.power, &[], line_hz).map(|(_, hz)| hz));
        }
        while fit.start == Start::Stationary
            && let Some((excess, hz)) = highest_line(&whole, excess, &places_hz, line_hz)
            && excess > CONSPICUOUS
            && places_hz.len() < MOST_TRIALS
        {
            places_hz.push(hz);
        }
        let trials = places_hz.into_iter().filter_map(|hz| bands.trial(&whole, hz));
        let best = trials.max_by(|a, b| a.explained.total_cmp(&b.explained))?;
        let whole = bands.coarse(whole, best.tone_hz);
        let explained = |p: &Parameters| Some(explained(&likelihood::resonance(&whole, fit.start, p)?, p));
        // The best single resonance explains no less than the fit does: mostly that is enough.
        let fitted = explained(p).unwrap_or(f64::NEG_INFINITY);
        if best.explained - fitted <= OPEN {
            return Some(Beside::Nothing);
        }
        // A fit that spans two peaks may not be the best of one.
        let anew = highest(&whole).and_then(|hz| self.start(&whole, hz, fit.start));
        let climbed = [Some(*p), anew].into_iter().flatten().filter_map(|from| {
            let top = self.climb(&whole, from, fit.start);
            explained(&top.map_or(from, |top| Parameters::from_array(top.at, from.softening)))
        });
        let alone = climbed.fold(fitted, f64::max);
        // Without any single resonance to compare with, nothing is known to be gained.
        if alone == f64::NEG_INFINITY {
            return None;
        }
        let gain = best.explained - alone;
        let is_pair = || match self.pair(fit, None, others) {
            Pair::Two {
                members,
                gain: of_two,
                ..
            } => {
                let widths = members.map(|member| member.pole.damping * member.pole.frequency_hz);
                of_two > gain && widths.iter().all(|&width| width > TONE_LINES * line_hz)
            }
            _ => false,
        };
        Some(if gain > CERTAIN {
            // Of two modes that one fit spans, the highest line passes for a tone.
            if is_pair() {
                return None;
            }
            Beside::Tone(best.tone(gain, self.coefficients.duration_s))
        } else if gain > OPEN && fit.start == Start::Stationary {
            let share = (gain - OPEN) / (CERTAIN - OPEN);
            Beside::Open(share.sqrt() * (best.beside.frequency_hz - r.frequency_hz).hypot(best.sd_hz))
        } else {
            Beside::Nothing
        })
    }
}

/// Bands of a stretch about one fit.
struct Bands<'a> {
    stretch: &'a Stretch<'a>,
    range_hz: (f64, f64),
    others: &'a [Fit],
    level: f64,
    start: Start,
}

/// A tone and a resonance fitted to the lines of one band.
struct Trial {
    tone_hz: f64,
    amplitude: Complex<f64>,
    beside: Parameters,
    sd_hz: f64,
    noise: f64,
    explained: f64,
}

impl Bands<'_> {
    /// Every line by itself, those of a core left out, with the skirts of the other modes in the floor.
    fn lines(&self, core: Option<Mask>) -> Band {
        let masks: Vec<Mask> = self.stretch.left_out().chain(core).collect();
        let (low_hz, high_hz) = self.range_hz;
        let mut band = self.stretch.coefficients.band(low_hz, high_hz, &masks, |_| 0.0);
        for other in self.others {
            subtract(&mut band, other, self.level);
        }
        band
    }

    fn line_hz(&self) -> f64 {
        1.0 / self.stretch.coefficients.duration_s
    }

    /// The band with the lines far from a tone added up, of which a long record has very many. Not for a decay, far above the noise,
    /// whose detail would look like it.
    fn coarse(&self, band: Band, tone_hz: f64) -> Band {
        match self.start {
            Start::Stationary => band.merged(|f| (CELL * f).min(CELL_BESIDE * (f - tone_hz).abs())),
            Start::Free => band,
        }
    }

    /// The band without its core, and whole, less a tone.
    fn less(&self, whole: &Band, tone_hz: f64, amplitude: Complex<f64>) -> [Band; 2] {
        let line_hz = self.line_hz();
        let mut bands = [self.lines(Some(core(tone_hz, line_hz))), whole.clone()];
        for band in &mut bands {
            remove(band, |cell| {
                amplitude * reach(cell.frequency_hz, tone_hz, line_hz)
            });
        }
        bands
    }

    /// Tone near a line, and the best resonance in what is left without it, if one is left.
    fn trial(&self, whole: &Band, near_hz: f64) -> Option<Trial> {
        let (tone_hz, amplitude) = strongest(whole, near_hz, self.line_hz());
        let bands = self.less(whole, tone_hz, amplitude);
        let [open, rest] = bands.map(|band| self.coarse(band, tone_hz));
        let start = self.stretch.start(&open, highest(&open)?, Start::Stationary)?;
        let top = self.stretch.climb(&open, start, Start::Stationary)?;
        if !open.holds(top.at[0]) {
            return None;
        }
        let beside = Parameters::from_array(top.at, 0.0);
        let value = likelihood::resonance(&rest, Start::Stationary, &beside)?;
        let nothing = [0.0, beside.slope].map(|slope| likelihood::noise_only(&rest, slope));
        let nothing = nothing.into_iter().flatten().reduce(f64::max)?;
        let is_left = self.stretch.is_evident(2.0 * (value.log_profile - nothing));
        is_left.then(|| Trial {
            tone_hz,
            amplitude,
            beside,
            sd_hz: top.covariance[(0, 0)].sqrt(),
            noise: value.noise,
            explained: explained(&value, &beside),
        })
    }
}

impl Trial {
    fn tone(&self, gain: f64, duration_s: f64) -> SteadyTone {
        let h = likelihood::shape(
            self.beside.frequency_hz,
            self.beside.log_damping.exp(),
            self.tone_hz,
        );
        let level = self.noise * (1.0 + self.beside.log_ratio.exp() * h.norm_sqr());
        let power = self.amplitude.norm_sqr();
        SteadyTone {
            resonance: Resonance {
                frequency_hz: self.tone_hz,
                // Bound of Cramer and Rao for a sinusoid of so much energy over the spectrum beside it.
                frequency_sd_hz: (6.0 * level / power).sqrt() / (TAU * duration_s),
                damping: 0.1 / (self.tone_hz * duration_s),
                damping_log_sd: 2.0,
                peak_to_noise: power / self.noise,
                evidence: gain,
                line: true,
                misfit: 0.0,
                foreign_log_odds: Tone::Sure.log_odds(),
            },
            beside_hz: (
                self.beside.frequency_hz,
                self.beside.frequency_hz * self.beside.log_damping.exp(),
            ),
            amplitude: self.amplitude * (2.0 / duration_s.sqrt()),
        }
    }
}

/// Twice the log likelihood at its best transient, plus the damping's log prior.
fn explained(value: &Value, p: &Parameters) -> f64 {
    2.0 * (value.log_profile + likelihood::damping_log_prior(p.log_damping))
}

fn remove(band: &mut Band, part: impl Fn(&Cell) -> Complex<f64>) {
    band.for_each(|cell| {
        let left = Complex::new(cell.re, cell.im) - part(cell);
        (cell.re, cell.im, cell.power) = (left.re, left.im, left.norm_sqr());
    });
}

/// The highest line of a band by some measure, two lines or more from those known.
fn highest_line(
    band: &Band,
    by: impl Fn(&Cell) -> f64,
    known_hz: &[f64],
    line_hz: f64,
) -> Option<(f64, f64)> {
    let is_new = |hz: f64| known_hz.iter().all(|known| (hz - known).abs() > 1.5 * line_hz);
    band.cells()
        .filter(|cell| is_new(cell.frequency_hz))
        .map(|cell| (by(&cell), cell.frequency_hz))
        .max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Band of the lines that a tone takes up.
fn core(tone_hz: f64, line_hz: f64) -> Mask {
    let half_hz = CORE_LINES * line_hz;
    Mask {
        low_hz: tone_hz - half_hz,
        high_hz: tone_hz + half_hz,
    }
}

/// Response `g` of the line at `hz` to a tone.
fn reach(hz: f64, tone_hz: f64, line_hz: f64) -> Complex<f64> {
    let turn = PI * (tone_hz - hz) / line_hz;
    let size = if turn.abs() < 1e-6 { 1.0 } else { turn.sin() / turn };
    Complex::from_polar(size, turn)
}

/// Best tone within a line of `near_hz`: its frequency, and its amplitude by least squares over the lines around it.
fn strongest(band: &Band, near_hz: f64, line_hz: f64) -> (f64, Complex<f64>) {
    let fitted = |hz: f64| {
        let near = |cell: &Cell| (cell.frequency_hz - hz).abs() < NEAR_LINES * line_hz;
        let (mut gg, mut gj, mut jj) = (0.0, Complex::default(), 0.0);
        for cell in band.cells().filter(near) {
            let g = reach(cell.frequency_hz, hz, line_hz);
            gg += g.norm_sqr();
            gj += Complex::new(cell.re, cell.im) * g.conj();
            jj += cell.power;
        }
        (gj / gg, gj.norm_sqr() / gg - jj)
    };
    let hz = golden(|hz| Some(fitted(hz).1), near_hz - line_hz, near_hz + line_hz, 24);
    (hz, fitted(hz).0)
}

/// Frequency about which the lines are highest on average.
fn highest(band: &Band) -> Option<f64> {
    let cells: Vec<_> = band.cells().collect();
    cells
        .windows(SMOOTHED.min(cells.len()).max(1))
        .map(|window| {
            let power: f64 = window.iter().map(|cell| cell.power / cell.floor).sum();
            let lines: f64 = window.iter().map(|cell| cell.lines).sum();
            (power / lines, window[window.len() / 2].frequency_hz)
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, hz)| hz)
}
