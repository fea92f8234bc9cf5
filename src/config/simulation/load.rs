//! Sources of motion of a simulated rod and beside it: pulls, gusts, knocks, a neighbour, foreign
//! resonances.

use super::super::range::Range;
use super::super::reader::{Absent, Table, key};
use super::rod::share_of_length;
use crate::analysis::lab::synthesis::{Gusts, Knocks, Neighbour, Pull, PullKind, Resonance};

const PULLS: [(&str, PullKind); 2] = [("release", PullKind::Release), ("blow", PullKind::Blow)];

/// Reads the schedule of pulls.
pub(super) fn pull(table: &mut Table<'_>) -> Pull {
    let kind = table.choice(
        key("kind", "a slow pull and sudden release, or a blow"),
        &PULLS,
        PullKind::Release,
    );
    Pull {
        kind,
        at: table.number(
            key("at", "where, as a share of the length [-]"),
            share_of_length(),
            0.3,
        ),
        deflection_m: table.number(
            key(
                "deflection_m",
                "deflection there at release; for a blow the first mode's amplitude [m]",
            ),
            Range::above(0.0, 0.5),
            1e-3,
        ),
        first_s: table.number(
            key(
                "first_s",
                "first release, from the start of each record; below 0 it begins inside the decay [s]",
            ),
            Range::within(-600.0, 86_400.0),
            5.0,
        ),
        every_s: table.number(
            key("every_s", "from one release to the next [s]"),
            Range::within(1.0, 86_400.0),
            86_400.0,
        ),
        ramp_s: table.number(
            key("ramp_s", "how long the pull takes [s]")
                .only(kind == PullKind::Release, "kind = \"release\""),
            Range::within(0.0, 600.0),
            2.0,
        ),
    }
}

/// Reads the gusts.
pub(super) fn gusts(table: &mut Table<'_>) -> Gusts {
    Gusts {
        log_sd: table.number(
            key(
                "log_sd",
                "standard deviation of ln amplitude; 0.6 is 5 dB, 1.2 is 10 dB [-]",
            ),
            Range::within(0.0, 3.0),
            0.6,
        ),
        correlation_s: table.number(
            key("correlation_s", "correlation time of ln amplitude [s]"),
            Range::within(0.01, 3600.0),
            5.0,
        ),
    }
}

/// Reads the knocks.
pub(super) fn knocks(table: &mut Table<'_>) -> Knocks {
    Knocks {
        every_s: table.number(
            key(
                "every_s",
                "mean time from one to the next; the gaps are exponential [s]",
            ),
            Range::within(0.1, 86_400.0),
            20.0,
        ),
        at: table.number(
            key("at", "where, as a share of the length [-]"),
            share_of_length(),
            0.3,
        ),
        deflection_m: table.number(
            key("deflection_m", "median of the first mode's amplitude [m]"),
            Range::above(0.0, 0.5),
            1e-4,
        ),
        log_sd: table.number(
            key("log_sd", "standard deviation of ln deflection [-]"),
            Range::within(0.0, 3.0),
            0.3,
        ),
    }
}

/// Reads the neighbour.
pub(super) fn neighbour(table: &mut Table<'_>) -> Neighbour {
    Neighbour {
        detuning: table
            .maybe_number(
                key("detuning", "its frequencies over the rod's, less one [-]"),
                Range::within(-0.5, 1.0),
                Absent::Required,
            )
            .unwrap_or(0.0),
        share: table.number(
            key("share", "share of its vibration that the sensor sees [-]"),
            Range::within(0.0, 10.0),
            0.3,
        ),
    }
}

/// Reads a foreign resonance; `None` if a required key is missing.
pub(super) fn resonance(table: &mut Table<'_>) -> Option<Resonance> {
    let frequency_hz = table.maybe_number(
        key("frequency_hz", "its natural frequency [Hz]"),
        Range::within(0.01, 5e4),
        Absent::Required,
    );
    let damping = table.number(
        key("damping", "its damping ratio [-]"),
        Range::within(1e-5, 0.5),
        0.01,
    );
    let ambient_m = table.maybe_number(
        key(
            "ambient_m",
            "standard deviation of what the sensor sees of it [m]",
        ),
        Range::within(0.0, 0.1),
        Absent::Required,
    );
    Some(Resonance {
        frequency_hz: frequency_hz?,
        damping,
        ambient_m: ambient_m?,
    })
}
