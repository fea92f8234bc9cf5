//! A rod measured once, as one sheet of A4: its force as the headline, facts, frequencies, figures, a line to sign. The
//! evidence is an annex, printed on request.

use super::axis::minus;
use super::distribution::{self, mean_and_sd, significant};
use super::figure::figure;
use super::markup::Markup;
use super::page::{moment, state_text};
use super::record::{self, Drawn};
use super::table::{Cell, table};
use super::view::{RecordPoint, RodReport};
use super::{learned, refused, rod};
use crate::analysis::findings::{Doubt, motion_said};
use crate::analysis::record_view::Snapshot;
use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::RodState;
use std::path::Path;

/// Assignments of the peaks on the sheet of a force whose orders are in doubt.
const ON_SHEET: usize = 3;

/// The rod's part of the page; `id` begins the ids of its figures.
pub(super) fn section(html: &mut Markup, rod: &RodReport, id: &str, provenance: &[(String, String)]) {
    html.leaf("h2", &[], format!("Rod {}", rod.rod));
    match rod.only_record() {
        Some(only) => measured(html, rod, only, id),
        None => refused(html, rod, id),
    }
    let of_numbers = provenance.iter().map(|(name, value)| match name.as_str() {
        "program" => value.clone(),
        _ => format!("{name} {value}"),
    });
    let line = of_numbers.collect::<Vec<_>>().join(" \u{b7} ");
    html.leaf("p", &[("class", "from")], line);
    html.element("p", &[("class", "sign")], |p| {
        for name in ["Measured by", "Date", "Signature"] {
            p.leaf("span", &[], name);
        }
    });
    // Open, it is printed on pages of its own; closed, the sheet alone.
    html.element("details", &[("class", "annex")], |annex| {
        annex.leaf(
            "summary",
            &[],
            "Annex: waveform, every peak, what was known before and after (printed if open)",
        );
        match (rod.shown(), &rod.refused) {
            (Some(latest), _) => evidence(annex, rod, latest, id),
            (None, Some(record)) => refused::samples(annex, rod, record, id),
            (None, None) => {}
        }
    });
}

/// A record that gave a force.
fn measured(html: &mut Markup, rod: &RodReport, only: &RecordPoint, id: &str) {
    headline(html, rod, only);
    facts(html, rod, only.start, only.temperature_c, rod.shown());
    let Some(latest) = rod.shown() else { return };
    let shares = latest.hangs_on.as_ref();
    html.element("div", &[("class", "pair")], |pair| {
        frequencies(pair, latest);
        if let Some(shares) = shares {
            learned::sources(pair, shares, "What the force hangs on: shares of its variance.");
        }
    });
    let of = format!("rod {}", rod.rod);
    figure(html, drawn(rod, latest, &of).spectrum(&format!("{id}-spec")), "");
    html.element("div", &[("class", "pair")], |pair| {
        let mut densities = latest.densities.iter();
        if let Some(force) = densities.find(|density| density.quantity == "axial_force_n") {
            figure(
                pair,
                Some(distribution::density(
                    rod,
                    force,
                    distribution::LOW,
                    &format!("{id}-force"),
                )),
                "",
            );
        }
        pair.element("div", &[], |div| {
            div.leaf(
                "p",
                &[("class", "about")],
                "Grey: the force before; blue: after the measurement.",
            );
            if let Some(shares) = shares {
                learned::sentences(div, shares);
            }
            if only.doubts.contains(&Doubt::Orders) {
                let some = latest.candidates.get(..ON_SHEET);
                record::candidates(div, some.unwrap_or(&latest.candidates));
            }
        });
    });
}

/// All that the sheet has no room for.
fn evidence(html: &mut Markup, rod: &RodReport, latest: &Snapshot, id: &str) {
    let of = format!("rod {}", rod.rod);
    let words = latest.motion.as_ref().map_or_else(
        || "The waveform.".to_owned(),
        |motion| format!("The waveform: {}.", motion_said(motion)),
    );
    figure(
        html,
        drawn(rod, latest, &of).waveform(&format!("{id}-wave")),
        &words,
    );
    record::peaks(html, latest);
    record::candidates(html, &latest.candidates);
    learned::section(html, rod, latest, id);
    if !rod.rejections.is_empty() {
        refused::by_reason(html, rod);
        refused::latest(html, rod, id);
    }
}

/// A record that gave none: the facts, and the reason.
fn refused(html: &mut Markup, rod: &RodReport, id: &str) {
    html.element("p", &[("class", "headline")], |p| {
        p.leaf("strong", &[], "No force");
        p.text(": the record was refused, for the reason below");
    });
    let Some(record) = &rod.refused else { return };
    facts(html, rod, record.start, None, Some(record));
    refused::reason(html, rod, record, id);
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
        let mark = Doubt::mark(&only.doubts);
        p.leaf("strong", &[], format!("{mark}{} kN", kn(only.force_n.mean)));
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
fn facts(
    html: &mut Markup,
    rod: &RodReport,
    start: Timestamp,
    temperature_c: Option<f64>,
    record: Option<&Snapshot>,
) {
    let mut facts = rod.facts.clone();
    let mut add = |name: &str, value: String| facts.push((name.to_owned(), value));
    add("measured", began(start));
    if let Some(file) = &rod.file {
        let name = Path::new(file).file_name().unwrap_or(file.as_ref());
        add("file", name.to_string_lossy().into_owned());
    }
    if let Some(record) = record {
        add(
            "record",
            format!("{:.1} s at {} Hz", record.duration_s, significant(record.fs_hz)),
        );
        if let Some(motion) = &record.motion {
            add("motion", motion_said(motion));
        }
        if let Some(probability) = record.label_probability {
            add(
                "orders of the modes",
                format!("{} certain", super::percent_said(probability)),
            );
        }
    }
    if let Some(celsius) = temperature_c {
        add("temperature", minus(&format!("{celsius:.1} \u{b0}C")));
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
            vec![
                Cell::Text(order.to_string()),
                Cell::Text(peak.sd_hz.map_or_else(
                    || significant(peak.frequency_hz),
                    |sd_hz| mean_and_sd(peak.frequency_hz, sd_hz),
                )),
                Cell::Text(record::damping(peak).unwrap_or_default()),
            ]
        })
        .collect();
    table(
        html,
        "Natural frequencies and damping, with standard errors.",
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
        height: record::LOW,
    }
}
