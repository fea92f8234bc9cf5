//! Splits a fit of one mode in two where the record shows two modes.

use super::Resonance;
use super::fit::{Fit, HALF_WIDTHS, Stretch};
use super::likelihood::Start;
use super::pair::{Member, Pair, pair};
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Distance of two fits that are judged together, over the sum of their half-power half-widths.
const TOUCHING: f64 = 5.0;
/// Distance of the farther mode in units of the standard error added, where one mode or two remains open.
const OPEN_SHARE: f64 = 1.5;

impl Stretch<'_> {
    /// Resonances of all fits: a fit of two close modes becomes two resonances, and wider errors where that
    /// remains open. `fits` ascend in frequency.
    pub fn apart(&self, fits: &[Fit]) -> Vec<Resonance> {
        let mut found: Vec<Resonance> = Vec::new();
        let mut n = 0;
        while n < fits.len() {
            let fit = &fits[n];
            let next = fits.get(n + 1).filter(|next| touch(fit, next));
            let taken = 1 + usize::from(next.is_some());
            let others: Vec<Fit> = fits[..n].iter().chain(&fits[n + taken..]).copied().collect();
            match self.pair(fit, next, &others) {
                Pair::Two(members) => {
                    found.extend(members.map(|member| member_of(fit, member)));
                }
                verdict => {
                    let mut one = fit.resonance;
                    if let Pair::Open(far_hz) = verdict {
                        one.frequency_sd_hz = one.frequency_sd_hz.hypot(far_hz / OPEN_SHARE);
                    }
                    found.push(one);
                    found.extend(next.map(|next| next.resonance));
                }
            }
            n += taken;
        }
        found.sort_by(|a, b| a.frequency_hz.total_cmp(&b.frequency_hz));
        found
    }

    /// Decides if a fit, alone or with the next one, is two modes.
    fn pair(&self, fit: &Fit, next: Option<&Fit>, others: &[Fit]) -> Pair {
        if fit.start == Start::Free || fit.resonance.line {
            return Pair::One;
        }
        let width = |fit: &Fit| fit.resonance.damping * fit.resonance.frequency_hz;
        let (f, gamma) = (fit.resonance.frequency_hz, width(fit));
        let (reach, guess) = match next {
            None => (HALF_WIDTHS * gamma, None),
            Some(next) => {
                let apart = next.resonance.frequency_hz - f;
                let reach = apart + HALF_WIDTHS * gamma.max(width(next));
                (reach, Some([fit.pole(), next.pole()]))
            }
        };
        let Some(series) = self.band_series(fit, reach, others, |_| Complex::default()) else {
            return Pair::One;
        };
        let noise = (TAU * gamma / series.rate_hz).powi(-2) / fit.parameters.log_ratio.exp();
        pair(&series, fit.pole(), noise, guess, fit.spread)
    }
}

/// True if two fits are so close that each lies in the other's band.
fn touch(a: &Fit, b: &Fit) -> bool {
    let width = |fit: &Fit| fit.resonance.damping * fit.resonance.frequency_hz;
    let steady = |fit: &Fit| fit.start == Start::Stationary && !fit.resonance.line;
    let apart = (a.resonance.frequency_hz - b.resonance.frequency_hz).abs();
    steady(a) && steady(b) && apart < TOUCHING * (width(a) + width(b))
}

/// Resonance of one of two modes that were fitted as one in `fit`.
fn member_of(fit: &Fit, member: Member) -> Resonance {
    Resonance {
        frequency_hz: member.pole.frequency_hz,
        frequency_sd_hz: member.frequency_sd_hz * fit.spread.sqrt(),
        damping: member.pole.damping,
        damping_log_sd: member.damping_log_sd,
        ..fit.resonance
    }
}
