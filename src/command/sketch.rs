//! Small plots at the end of `identify` and `replay` on a terminal.

use crate::analysis::findings::hertz;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::RodId;
use crate::command::report_page::terminal::Sketch;
use crate::site::store::{Reader, StoreError};
use std::io::{self, IsTerminal};

/// Default number of characters of a line.
const WIDTH: usize = 80;
/// Most records of a force plot.
pub const MOST: usize = 100_000;

/// Condition for drawing plots.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum When {
    /// If stdout is a terminal.
    #[default]
    Auto,
    /// Also into files and pipes.
    Always,
    /// Never.
    Never,
}

impl When {
    /// Width of the plots \[characters\]; `None` for no plots.
    pub fn width(self) -> Option<usize> {
        let out = io::stdout();
        if self == Self::Never || (self == Self::Auto && !out.is_terminal()) {
            return None;
        }
        let size = rustix::termios::tcgetwinsize(&out).ok();
        Some(size.map_or(WIDTH, |size| usize::from(size.ws_col)).max(1))
    }
}

/// The spectrum of a record with its modes, or with its peaks where none is known; empty without a spectrum.
pub fn spectrum(snapshot: &Snapshot, width: usize) -> String {
    let curve = &snapshot.curve;
    let has_modes = snapshot.peaks.iter().any(|peak| peak.order.is_some());
    let points: Vec<(f64, f64)> = (0..)
        .zip(&curve.level_db)
        .map(|(i, level)| (curve.frequency_hz(i), *level))
        .collect();
    let labels: Vec<(f64, String)> = snapshot
        .peaks
        .iter()
        .filter(|peak| peak.order.is_some() || !has_modes)
        .map(|peak| {
            let text = match peak.order {
                Some(order) => format!("{order}: {:.3}", peak.frequency_hz),
                None => hertz(peak.frequency_hz),
            };
            (peak.frequency_hz, text)
        })
        .collect();
    let sketch = Sketch {
        title: "power spectral density [dB] over frequency [Hz]",
        points: &points,
        is_time: false,
        labels: &labels,
    };
    sketch.draw(width)
}

/// The change of a rod's force since its baseline, or its force while there is none, over the time of its last records, at
/// most `most`; empty for fewer than two records.
///
/// # Errors
/// The store cannot be read.
pub fn force(reader: &Reader, rod: &RodId, most: usize, width: usize) -> Result<String, StoreError> {
    let found = reader.last_points(rod, most)?;
    let counted = || found.iter().filter(|point| point.set_aside.is_none());
    let column = |value: fn(&crate::site::store::Point) -> Option<f64>| -> Vec<(f64, f64)> {
        counted()
            .filter_map(|point| Some((point.start?.as_nanos() as f64 * 1e-9, value(point)?)))
            .collect()
    };
    let choices = [
        (
            "change of force at the reference temperature [%]",
            column(|point| {
                point
                    .relative_force_at_reference
                    .map(|ratio| (ratio.mean - 1.0) * 100.0)
            }),
        ),
        (
            "change of force, not compensated for temperature [%]",
            column(|point| point.relative_force.map(|ratio| (ratio.mean - 1.0) * 100.0)),
        ),
        (
            "axial force of each record alone [kN]",
            column(|point| point.axial_force_n.map(|force| force.mean * 1e-3)),
        ),
    ];
    let Some((what, points)) = choices.into_iter().find(|(_, points)| points.len() > 1) else {
        return Ok(String::new());
    };
    let title = if found.len() < most {
        format!("{rod}: {what}")
    } else {
        format!("{rod}: {what}, the last {most} records")
    };
    let sketch = Sketch {
        title: &title,
        points: &points,
        is_time: true,
        labels: &[],
    };
    Ok(sketch.draw(width))
}
