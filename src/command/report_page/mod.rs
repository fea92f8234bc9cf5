//! Figures and the self-contained report page, drawn from plain data.
//!
//! [`view`] is the content of a report; everything else turns it into one HTML page:
//! * [`page`](mod@page)      the whole page
//! * [`terminal`] a small plot in the terminal
//! * [`study`](fn@study) the paper's study as a page
//! * [`shares`](fn@shares) bars of shares as a file of its own
//! * `rod`         one rod's part of it: `present` its force and change, `learned` what the latest record adds,
//!   `refused` the records that gave no force
//! * `single`      that of a rod measured once: to hand in and to sign
//! * `history`     figures over time: forces, temperature, frequencies, charts
//! * `record`      one record: waveform, spectrum, peaks, candidates
//! * [`spectra`](fn@spectra) records without a rod as a page
//! * `distribution` densities, regression: figures not over time
//! * `figure`      one drawing: frame, axes, lines, bands, marks
//! * `table`       one table and its cells
//! * `axis`        scales and ticks, of numbers and of dates
//! * `decimate`    long series to one value per pixel column
//! * `markup`      balanced, escaped HTML and SVG
//!
//! The drawings are SVG written here rather than by a plotting library: colours come from the page's style
//! sheet, which alone can follow a dark screen, and a ten-year history stays one path per line.

mod axis;
mod decimate;
mod distribution;
mod figure;
mod history;
mod learned;
mod markup;
pub mod page;
mod present;
mod record;
mod refused;
mod rod;
mod shares;
mod single;
mod spectra;
mod study;
mod table;
pub mod terminal;
pub mod view;

pub use distribution::quantity;
pub use page::page;
pub use shares::{Share, shares};
pub use spectra::spectra;
pub use study::study;
pub use view::SiteReport;

/// A probability in percent: never rounded to 100 unless certain.
fn percent_said(probability: f64) -> String {
    match 100.0 * probability {
        percent if percent > 99.9 && probability < 1.0 => "over 99.9 %".to_owned(),
        percent if percent < 0.1 && probability > 0.0 => "under 0.1 %".to_owned(),
        percent if !(1.0..=99.0).contains(&percent) => format!("{percent:.1} %"),
        percent => format!("{percent:.0} %"),
    }
}
