//! Present force and change of a rod, as text.

use super::axis::minus;
use super::distribution::significant;
use super::view::{RecordPoint, RodReport};
use crate::analysis::findings::Doubt;
use crate::analysis::track::Interval;

/// Present force and change, as text; a force in doubt with its mark.
pub(super) struct Now {
    pub as_measured: String,
    pub at_reference: String,
    pub change: String,
}

/// Force and change of the latest record that counts. What is relative to a baseline is left out where that was given up since.
pub(super) fn now(rod: &RodReport) -> Now {
    let last = rod.last_used().cloned().map(|last| {
        if rod.segment.is_none() || rod.segment == last.segment {
            return last;
        }
        RecordPoint {
            tracked_force_n: None,
            force_at_reference_n: None,
            ratio: None,
            ratio_at_reference: None,
            ..last
        }
    });
    let Some(last) = last else {
        let none = || "not known".to_owned();
        return Now {
            as_measured: none(),
            at_reference: none(),
            change: none(),
        };
    };
    let mark = Doubt::mark(&last.doubts);
    let kilonewtons = |force: &Interval| format!("{mark}{}", kilonewtons(force));
    let force = last.tracked_force_n.unwrap_or(last.force_n);
    let change = match (last.ratio_at_reference, last.ratio) {
        (Some(ratio), _) => percent(&ratio),
        (None, Some(ratio)) => format!("{}, uncompensated", percent(&ratio)),
        (None, None) => "no baseline yet".to_owned(),
    };
    let at_reference = last.force_at_reference_n.map_or_else(
        || "not known".to_owned(),
        |force| match last.reference_c {
            Some(celsius) => format!("{} at {celsius:.1} \u{b0}C", kilonewtons(&force)),
            None => kilonewtons(&force),
        },
    );
    let as_measured = match last.temperature_c {
        Some(celsius) => format!(
            "{} at {} \u{b0}C",
            kilonewtons(&force),
            minus(&format!("{celsius:.1}"))
        ),
        None => kilonewtons(&force),
    };
    Now {
        as_measured,
        at_reference,
        change,
    }
}

fn kilonewtons(force_n: &Interval) -> String {
    let kn = |n: f64| significant(1e-3 * n);
    format!(
        "{} kN [{} to {}]",
        kn(force_n.mean),
        kn(force_n.q025),
        kn(force_n.q975)
    )
}

/// A ratio as a change in percent with its interval.
fn percent(ratio: &Interval) -> String {
    let change = |x: f64| signed(100.0 * (x - 1.0));
    format!(
        "{} % [{} to {}]",
        change(ratio.mean),
        change(ratio.q025),
        change(ratio.q975)
    )
}

pub(super) fn signed(value: f64) -> String {
    minus(&format!("{value:+.2}"))
}
