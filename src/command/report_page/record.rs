//! One record as figures and tables: waveform, spectrum with its peaks, and the assignments of its peaks to
//! modes.

use super::axis;
use super::distribution::{mean_and_sd, significant};
use super::figure::Figure;
use super::markup::Markup;
use super::table::{Cell, table};
use crate::analysis::findings::{Candidate, hertz};
use crate::analysis::record_view::{Curve, PeakMark, Snapshot};
use crate::analysis::signal::modes::MotionKind;

/// Range of levels drawn below the highest \[dB\]: a line at zero power must not flatten the rest.
const DEPTH_DB: f64 = 120.0;
/// Candidates listed.
const CANDIDATES: usize = 6;
/// Height of a spectrum that has its own place in the page, and of one that shares a sheet.
pub(super) const FULL: f64 = 220.0;
pub(super) const LOW: f64 = 150.0;

/// A record with the context of its drawing.
pub(super) struct Drawn<'s> {
    /// Record to draw.
    pub record: &'s Snapshot,
    /// Its entry in the key.
    pub key: String,
    /// An earlier record behind it, with its entry.
    pub earlier: Option<(&'s Snapshot, String)>,
    /// Unit of the samples.
    pub unit: Option<&'s str>,
    /// Owner of the record in words: `rod north`.
    pub of: &'s str,
    /// Height of the spectrum without axis labels.
    pub height: f64,
}

impl Drawn<'_> {
    /// The spectrum with its peaks; `None` if there is no spectrum.
    pub fn spectrum(&self, id: &str) -> Option<Markup> {
        let curve = &self.record.curve;
        if curve.level_db.is_empty() {
            return None;
        }
        let highest = |curve: &Curve| curve.frequency_hz(curve.level_db.len());
        let earlier = self.earlier.as_ref().map(|(earlier, _)| &earlier.curve);
        let x = (0.0, highest(curve).max(earlier.map_or(0.0, highest)));
        let levels = [Some(curve), earlier];
        let levels = levels
            .iter()
            .flatten()
            .flat_map(|curve| curve.level_db.iter().copied());
        let (low, high) = axis::span(levels, 0.0)?;
        // Room for the labels above the peaks.
        let y = (
            low.max(high - DEPTH_DB) - 2.0,
            high + 0.15 * (high - low).min(DEPTH_DB) + 1.0,
        );
        let mut figure = Figure::new(x, y, self.height);
        figure.x_axis(&axis::numbers(x, 8), "frequency [Hz]");
        let unit = self.unit.map_or_else(|| "unit".to_owned(), bracketed);
        figure.y_axis(&axis::powers(y, 6), &format!("power density [{unit}\u{b2}/Hz]"));
        if let Some(earlier) = earlier {
            figure.line("c7", points(earlier).into_iter());
        }
        figure.line("c1", points(curve).into_iter());
        self.marks(&mut figure, low);
        figure.key("c1", &self.key);
        if let Some((_, key)) = &self.earlier {
            figure.key("c7", key);
        }
        let title = format!("Vibration spectrum of {}", self.of);
        Some(figure.finish(
            id,
            &title,
            "Power spectral density on a logarithmic scale against frequency, with the peaks found and what they were taken for.",
        ))
    }

    /// Draws the peaks, the highest first, so that their labels find room.
    fn marks(&self, figure: &mut Figure, low: f64) {
        let curve = &self.record.curve;
        let level_at = |hz: f64| -> f64 {
            let at = ((hz - curve.first_hz) / curve.step_hz).round().max(0.0) as usize;
            let near = curve.level_db.iter().skip(at.saturating_sub(1)).take(3);
            near.copied().fold(low, f64::max)
        };
        let mut peaks: Vec<(&PeakMark, f64)> = self
            .record
            .peaks
            .iter()
            .map(|peak| (peak, level_at(peak.frequency_hz)))
            .collect();
        peaks.sort_by(|a, b| {
            b.0.order
                .is_some()
                .cmp(&a.0.order.is_some())
                .then(b.1.total_cmp(&a.1))
        });
        let has_modes = peaks.iter().any(|(peak, _)| peak.order.is_some());
        for (peak, level) in peaks {
            let at = (peak.frequency_hz, level);
            let (dots, class, label) = match peak.order {
                Some(order) => ("c2 large", "strong", format!("mode {order}")),
                None if peak.line => ("c7 large", "soft", "tone".to_owned()),
                // Where modes are known the others need no name.
                None if has_modes => ("c7 large", "soft", String::new()),
                None => ("c2 large", "", hertz(peak.frequency_hz)),
            };
            figure.dots(dots, std::iter::once(at));
            figure.label_beside_others(class, at, &label);
        }
    }

    /// The waveform about its mean, with the onsets of decays and blows; `None` if it was not kept.
    pub fn waveform(&self, id: &str) -> Option<Markup> {
        let waveform = self.record.waveform.as_ref()?;
        let values = waveform.low.iter().chain(&waveform.high).copied();
        let (low, high) = axis::span(values, 0.06)?;
        let end = waveform.step_s * waveform.low.len() as f64;
        let x = (0.0, self.record.duration_s.max(end));
        // Powers of ten are part of the unit: 2.4 of 10^-6 m.
        let power = match low.abs().max(high.abs()) {
            0.0 => 0,
            largest => (largest.log10() / 3.0).floor() as i32 * 3,
        };
        let factor = 10f64.powi(-power);
        let y = (low * factor, high * factor);
        let mut figure = Figure::new(x, y, 130.0);
        figure.x_axis(&axis::numbers(x, 8), "time from the first sample [s]");
        let unit = self.unit.unwrap_or("unit");
        let label = match power {
            0 => format!("signal [{unit}]"),
            power => format!("signal [{} {unit}]", axis::ten_to(i64::from(power))),
        };
        figure.y_axis(&axis::numbers(y, 4), &label);
        let middle = |i: usize| (i as f64 + 0.5) * waveform.step_s;
        let pairs = waveform.low.iter().zip(&waveform.high).enumerate();
        let columns: Vec<(f64, f64, f64)> = pairs
            .map(|(i, (low, high))| (middle(i), low * factor, high * factor))
            .collect();
        if waveform.low == waveform.high {
            figure.line("c1", columns.iter().map(|(x, y, _)| (*x, *y)));
        } else {
            figure.bars("c1 dense", &columns);
        }
        if let Some(motion) = &self.record.motion {
            let name = match motion.kind {
                MotionKind::Blow => "blow",
                _ => "onset",
            };
            for onset in &motion.onsets_s {
                figure.event("onset", *onset, name);
            }
        }
        let title = format!("Waveform of {}", self.of);
        Some(figure.finish(
            id,
            &title,
            "The samples about their mean against time, as the lowest and the highest of even stretches.",
        ))
    }
}

fn points(curve: &Curve) -> Vec<(f64, f64)> {
    let level = curve.level_db.iter().enumerate();
    level.map(|(i, level)| (curve.frequency_hz(i), *level)).collect()
}

/// A unit in brackets if needed, so that it can be squared.
fn bracketed(unit: &str) -> String {
    if unit.contains('/') {
        format!("({unit})")
    } else {
        unit.to_owned()
    }
}

/// Table of the peaks; nothing for a record without peaks or of an older program.
pub(super) fn peaks(html: &mut Markup, record: &Snapshot) {
    let rows: Vec<Vec<Cell>> = record
        .peaks
        .iter()
        .filter_map(|peak| {
            Some(vec![
                Cell::Text(mean_and_sd(peak.frequency_hz, peak.sd_hz?)),
                Cell::Text(damping(peak)?),
                Cell::Text(super::axis::minus(&format!("{:.1}", peak.level_db?))),
                Cell::Line(peak.said().replace(" x ", "\u{a0}\u{d7}\u{a0}")),
            ])
        })
        .collect();
    if rows.is_empty() {
        return;
    }
    table(
        html,
        "Every peak found, frequencies with their standard error; the level is that of the fitted peak over the noise floor.",
        &["Frequency [Hz]", "Damping [%]", "Level [dB]", "Taken for"],
        &rows,
    );
}

/// Damping ratio with its standard error [%].
pub(super) fn damping(peak: &PeakMark) -> Option<String> {
    let percent = 100.0 * peak.damping?;
    Some(match peak.damping_sd {
        Some(sd) => mean_and_sd(percent, 100.0 * sd),
        None => significant(percent),
    })
}

/// Table of the assignments, with the force each implies.
pub(super) fn candidates(html: &mut Markup, candidates: &[Candidate]) {
    if candidates.is_empty() {
        return;
    }
    let rows: Vec<Vec<Cell>> = candidates
        .iter()
        .take(CANDIDATES)
        .map(|candidate| {
            let force = candidate.axial_force_n.map_or_else(
                || "not computed".to_owned(),
                |force| {
                    let kn = |n: f64| significant(1e-3 * n);
                    format!("{} [{} to {}]", kn(force.q50), kn(force.q025), kn(force.q975))
                },
            );
            vec![
                Cell::Text(candidate.said()),
                Cell::Text(super::percent_said(candidate.probability)),
                Cell::Value(force),
            ]
        })
        .collect();
    table(
        html,
        "What the peaks may be: assignments to mode orders, the likeliest first, each with the force it would give.",
        &["Modes", "Probability", "Force [kN]"],
        &rows,
    );
}
