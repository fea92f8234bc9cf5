//! Splits a fit of one mode in two where the record shows two modes.

use super::Resonance;
use super::fit::{Fit, HALF_WIDTHS, Stretch, skirt};
use super::likelihood::Start;
use super::pair::{Member, Pair, pair};
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Distance of two fits that are judged together, over the sum of their half-power half-widths.
const TOUCHING: f64 = 5.0;
/// Fewest lines of a band that is whitened: of fewer the fit's noise is too uncertain, and nothing shows in the band's ends.
const LEAST_WHITENED: f64 = 100.0;

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
                Pair::Two { members, share, .. } => {
                    found.extend(next.map_or_else(
                        || split(fit, members, share),
                        |next| {
                            let (strong, weak) = by_level(fit, next);
                            [
                                member_of(strong, members[0], 1.0),
                                member_of(weak, members[1], 1.0),
                            ]
                        },
                    ));
                }
                verdict => {
                    let mut one = fit.resonance;
                    if let Pair::Open(sd_hz) = verdict {
                        one.frequency_sd_hz = one.frequency_sd_hz.hypot(sd_hz);
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
    pub(super) fn pair(&self, fit: &Fit, next: Option<&Fit>, others: &[Fit]) -> Pair {
        if fit.start == Start::Free || fit.resonance.line {
            return Pair::One;
        }
        let width = |fit: &Fit| fit.resonance.damping * fit.resonance.frequency_hz;
        // The series is exact for the pole that it is weighted for, and pushes any other mode away from that one by up to a fifth
        // of its width: the stronger of the two takes the weight.
        let (strong, weak) = next.map_or((fit, None), |next| {
            let (strong, weak) = by_level(fit, next);
            (strong, Some(weak))
        });
        let (f, gamma) = (strong.resonance.frequency_hz, width(strong));
        let mut reach = (HALF_WIDTHS * gamma, HALF_WIDTHS * gamma);
        if let Some(weak) = weak {
            let (apart, far) = (weak.resonance.frequency_hz - f, HALF_WIDTHS * width(weak));
            reach = (reach.0.max(far - apart), reach.1.max(far + apart));
        }
        // The weights are for modes: they colour white noise, up to 2.5 times in power at the band's ends, and other modes' skirts
        // reach into the band. As the single fits know them, noise and skirts are made white again; else the end of a long record's
        // band passes for a second mode.
        let is_long = (reach.0 + reach.1) * self.coefficients.duration_s >= LEAST_WHITENED;
        let whitened = |f: f64, weight: f64| {
            if !is_long {
                return 1.0;
            }
            let modes = skirt(strong, f) + weak.map_or(0.0, |weak| skirt(weak, f));
            let beside = others.iter().map(|other| skirt(other, f)).sum::<f64>();
            let noise = strong.value.noise;
            ((modes * weight + noise) / ((modes + noise + beside) * weight)).sqrt()
        };
        let none = |_| Complex::default();
        let Some(series) = self.band_series(strong, reach, others, none, whitened) else {
            return Pair::One;
        };
        let noise = (TAU * gamma / series.rate_hz).powi(-2) / strong.parameters.log_ratio.exp();
        let guess = weak.map(|weak| [strong.pole(), weak.pole()]);
        pair(&series, strong.pole(), noise, guess, strong.spread)
    }
}

/// True if two fits are so close that each lies in the other's band.
fn touch(a: &Fit, b: &Fit) -> bool {
    let width = |fit: &Fit| fit.resonance.damping * fit.resonance.frequency_hz;
    let steady = |fit: &Fit| fit.start == Start::Stationary && !fit.resonance.line;
    let apart = (a.resonance.frequency_hz - b.resonance.frequency_hz).abs();
    steady(a) && steady(b) && apart < TOUCHING * (width(a) + width(b))
}

/// Two fits, that of the higher peak first.
fn by_level<'f>(a: &'f Fit, b: &'f Fit) -> (&'f Fit, &'f Fit) {
    let level = |fit: &Fit| fit.resonance.peak_to_noise * fit.value.noise;
    if level(b) > level(a) { (b, a) } else { (a, b) }
}

/// Resonances of two modes that were fitted as one; `share` is the second's peak power over the first's.
fn split(fit: &Fit, members: [Member; 2], share: f64) -> [Resonance; 2] {
    let first = 1.0 / (1.0 + share);
    [
        member_of(fit, members[0], first),
        member_of(fit, members[1], 1.0 - first),
    ]
}

/// Resonance of one of two modes, which has `part` of the peak power that was fitted in `fit`.
fn member_of(fit: &Fit, member: Member, part: f64) -> Resonance {
    Resonance {
        peak_to_noise: part * fit.resonance.peak_to_noise,
        evidence: part * fit.resonance.evidence,
        frequency_hz: member.pole.frequency_hz,
        frequency_sd_hz: member.frequency_sd_hz * fit.spread.sqrt(),
        damping: member.pole.damping,
        damping_log_sd: member.damping_log_sd,
        ..fit.resonance
    }
}
