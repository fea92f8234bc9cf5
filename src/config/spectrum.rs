//! `[spectrum]`: settings of the spectral estimate and of its peaks.

use super::range::Range;
use super::reader::{Absent, Table, key};
use crate::analysis::signal::spectrum::{PeakSettings, WelchSettings, Window};

const WINDOWS: [(&str, Window); 4] = [
    ("hann", Window::Hann),
    ("hamming", Window::Hamming),
    ("blackman", Window::Blackman),
    ("rectangular", Window::Rectangular),
];

/// Reads the section.
pub(super) fn read(table: &mut Table<'_>) -> (WelchSettings, PeakSettings) {
    let (welch, peaks) = (WelchSettings::default(), PeakSettings::default());
    let welch = WelchSettings {
        window: table.choice(key("window", "taper of each segment"), &WINDOWS, welch.window),
        segment_s: table.maybe_number(
            key("segment_s", "length of a segment [s]"),
            Range::within(1.0, 3600.0),
            Absent::Nothing("chosen from the record's length"),
        ),
        overlap: table.number(
            key(
                "overlap",
                "overlap of neighbouring segments as a share of their length [-]",
            ),
            Range::within(0.0, 0.95),
            welch.overlap,
        ),
    };
    let peaks = PeakSettings {
        prominence_db: table.number(
            key(
                "prominence_db",
                "least height of a peak above the local noise floor [dB]",
            ),
            Range::within(1.0, 60.0),
            peaks.prominence_db,
        ),
        max_peaks: table.integer(
            key("max_peaks", "the most peaks kept, the most prominent first"),
            1,
            1000,
            peaks.max_peaks as u64,
        ) as usize,
    };
    (welch, peaks)
}
