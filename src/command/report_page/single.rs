//! A rod measured once: its force as the headline, facts, frequencies, figures, a line to sign; supporting
//! tables on the next page.

use super::distribution::{self, mean_and_sd, significant};
use super::markup::Markup;
use super::page::{moment, state_text};
use super::record::{self, Drawn};
use super::rod::{self, Cell, figure, table};
use super::view::{RecordPoint, RodReport};
use crate::analysis::findings::motion_said;
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::RodState;

/// The rod's part of the page; `id` begins the ids of its figures.
pub(super) fn section(html: &mut Markup, rod: &RodReport, only: &RecordPoint, id: &str) {
    html.leaf("h2", &[], format!("Rod {}", rod.rod));
    headline(html, rod, only);
    let latest = rod.latest.as_ref().or(rod.baseline.as_ref());
    facts(html, rod, only, latest);
    if let Some(latest) = latest {
        frequencies(html, latest);
        figures(html, rod, latest, id);
    }
    signature(html);
    html.leaf("h2", &[], "What it rests on");
    if let Some(latest) = latest {
        let of = format!("rod {}", rod.rod);
        let drawn = drawn(rod, latest, &of);
        let words = latest.motion.as_ref().map_or_else(
            || "The waveform.".to_owned(),
            |motion| format!("The waveform: {}.", motion_said(motion)),
        );
        figure(html, drawn.waveform(&format!("{id}-wave")), &words);
        record::peaks(html, latest);
        record::candidates(html, &latest.candidates);
        rod::taught(html, rod, latest, id);
    }
}

/// The part of a rod whose only record was refused: no force, the facts, and then the record by `record`.
pub(super) fn refused(html: &mut Markup, rod: &RodReport, record: impl FnOnce(&mut Markup)) {
    html.leaf("h2", &[], format!("Rod {}", rod.rod));
    html.element("p", &[("class", "headline")], |p| {
        p.leaf("strong", &[], "No force");
        p.text(": the record was refused, for the reason below");
    });
    listed(html, rod.facts.clone());
    record(html);
    signature(html);
}

/// Lines to be filled in by hand.
fn signature(html: &mut Markup) {
    html.element("p", &[("class", "sign")], |p| {
        for name in ["Measured by", "Date", "Signature"] {
            p.leaf("span", &[], name);
        }
    });
}

/// Facts as a list.
fn listed(html: &mut Markup, facts: Vec<(String, String)>) {
    html.element("dl", &[("class", "facts")], |list| {
        for (name, value) in facts {
            list.element("div", &[], |fact| {
                fact.leaf("dt", &[], name);
                fact.leaf("dd", &[], value);
            });
        }
    });
}

/// Force and interval in large, the marks, and the state as the second line.
fn headline(html: &mut Markup, rod: &RodReport, only: &RecordPoint) {
    let kn = |newtons: f64| significant(1e-3 * newtons);
    html.element("p", &[("class", "headline")], |p| {
        p.text("Axial force ");
        p.leaf("strong", &[], format!("{} kN", kn(only.force_n.mean)));
        p.text(format!(
            ", between {} and {} kN with 95 % probability",
            kn(only.force_n.q025),
            kn(only.force_n.q975)
        ));
    });
    rod::doubts(html, only);
    let state = match (&rod.state, rod.baseline_takes) {
        (Some(RodState::Learning { records, .. }), Some(takes)) => {
            format!("learning, baseline {records} of {takes} records")
        }
        _ => state_text(rod),
    };
    let state = format!("Measured once, so there is no change to tell: {state}.");
    html.leaf("p", &[("class", "about")], state);
}

/// Facts of the rod and of the record.
fn facts(html: &mut Markup, rod: &RodReport, only: &RecordPoint, latest: Option<&Snapshot>) {
    let mut facts = rod.facts.clone();
    let mut add = |name: &str, value: String| facts.push((name.to_owned(), value));
    add("measured", began(only.start));
    if let Some(latest) = latest {
        add(
            "record",
            format!("{:.1} s at {} Hz", latest.duration_s, significant(latest.fs_hz)),
        );
        if let Some(motion) = &latest.motion {
            add("motion", motion_said(motion));
        }
        if let Some(probability) = latest.label_probability {
            add(
                "orders of the modes",
                format!("{} certain", super::percent_said(probability)),
            );
        }
    }
    if let Some(celsius) = only.temperature_c {
        add("temperature", format!("{celsius:.1} \u{b0}C"));
    }
    listed(html, facts);
}

/// Time of a record in words; for a file without a start, a remark.
pub(super) fn began(start: Timestamp) -> String {
    match start.as_nanos() {
        0 => "at a time the file does not say".to_owned(),
        _ => moment(start),
    }
}

/// Natural frequencies and damping of the modes.
fn frequencies(html: &mut Markup, latest: &Snapshot) {
    let mut modes: Vec<_> = latest
        .peaks
        .iter()
        .filter_map(|peak| Some((peak.order?, peak)))
        .collect();
    modes.sort_by_key(|(order, _)| *order);
    let rows: Vec<Vec<Cell>> = modes
        .iter()
        .map(|(order, peak)| {
            let damping = |zeta: f64| significant(100.0 * zeta);
            vec![
                Cell::Text(order.to_string()),
                Cell::Text(peak.sd_hz.map_or_else(
                    || significant(peak.frequency_hz),
                    |sd_hz| mean_and_sd(peak.frequency_hz, sd_hz),
                )),
                Cell::Text(peak.damping.map_or_else(String::new, damping)),
            ]
        })
        .collect();
    table(
        html,
        "Natural frequencies with their standard error.",
        &["Mode", "Frequency [Hz]", "Damping [%]"],
        &rows,
    );
}

fn drawn<'s>(rod: &'s RodReport, latest: &'s Snapshot, of: &'s str) -> Drawn<'s> {
    Drawn {
        record: latest,
        key: "spectrum".to_owned(),
        earlier: None,
        unit: rod.motion_unit.as_deref(),
        of,
    }
}

/// Spectrum and the force before and after, beside each other.
fn figures(html: &mut Markup, rod: &RodReport, latest: &Snapshot, id: &str) {
    let of = format!("rod {}", rod.rod);
    figure(
        html,
        drawn(rod, latest, &of).spectrum(&format!("{id}-spec")),
        "How strongly the rod vibrates at each frequency, with its natural modes.",
    );
    let force = latest
        .densities
        .iter()
        .find(|density| density.quantity == "axial_force_n");
    if let Some(force) = force {
        html.element("div", &[("class", "pair")], |pair| {
            figure(
                pair,
                Some(distribution::density(rod, force, &format!("{id}-force"))),
                "The force before (grey) and after the measurement (blue).",
            );
            if let Some(shares) = &latest.hangs_on {
                pair.element("div", &[], |div| {
                    for sentence in &shares.said {
                        div.leaf("p", &[("class", "about")], format!("{sentence}."));
                    }
                });
            }
        });
    }
}
