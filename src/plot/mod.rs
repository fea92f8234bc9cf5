//! Figures and the self-contained report page, drawn from plain data.
//!
//! [`view`] says what a report is about; everything else turns it into one HTML page:
//! * [`page`](mod@page)      the whole page
//! * [`terminal`] a small plot in the terminal
//! * [`study`](fn@study) the paper's study as a page
//! * `rod`         one rod's part of it
//! * `history`     figures over time: forces, temperature, frequencies, charts
//! * `distribution` spectrum, densities, regression: figures not over time
//! * `figure`      one drawing: frame, axes, lines, bands, marks
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
mod markup;
pub mod page;
mod rod;
mod study;
pub mod terminal;
pub mod view;

pub use page::page;
pub use study::study;
pub use view::SiteReport;
