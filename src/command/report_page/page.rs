//! The report of one site: one HTML page that needs no network, no script and no other file.

use super::markup::Markup;
use super::table::{Cell, table};
use super::view::{RodReport, SiteReport};
use super::{present, rod, single};
use crate::analysis::signal::record::Timestamp;
use crate::analysis::track::RodState;

const STYLE: &str = include_str!("style.css");

/// The page of a report. The same report gives the same bytes: it does not depend on the time of
/// day.
pub fn page(report: &SiteReport) -> String {
    let title = format!("{}: axial force of the tie-rods", report.site);
    document(&title, |body| {
        // For one rod measured once, its own part is complete.
        let is_one_sheet = matches!(&report.rods[..], [rod] if rod.is_sheet());
        body.element("header", &[], |header| {
            header.leaf("h1", &[], &report.site);
            if !is_one_sheet {
                heading(header, report);
            }
        });
        body.element("main", &[], |main| {
            if !is_one_sheet {
                overview(main, report);
            }
            for (i, one) in report.rods.iter().enumerate() {
                let id = anchor(i);
                let attributes = [("id", id.as_str()), ("class", "sheet")];
                let attributes = &attributes[..1 + usize::from(one.is_sheet())];
                main.element("section", attributes, |section| {
                    rod::section(section, one, &id, &report.provenance);
                });
            }
        });
        if !is_one_sheet {
            body.element("footer", &[], |footer| provenance(footer, report));
        }
    })
}

/// A whole page with this title and body.
pub(super) fn document(title: &str, body: impl FnOnce(&mut Markup)) -> String {
    let mut html = Markup::new();
    html.verbatim("<!DOCTYPE html>\n");
    html.element("html", &[("lang", "en")], |html| {
        html.element("head", &[], |head| {
            head.empty("meta", &[("charset", "utf-8")]);
            head.empty(
                "meta",
                &[
                    ("name", "viewport"),
                    ("content", "width=device-width, initial-scale=1"),
                ],
            );
            head.empty("meta", &[("name", "generator"), ("content", "tirante")]);
            // Whatever might have slipped in: the page may load and run nothing.
            head.empty(
                "meta",
                &[
                    ("http-equiv", "Content-Security-Policy"),
                    ("content", "default-src 'none'; style-src 'unsafe-inline'"),
                ],
            );
            head.leaf("title", &[], title);
            head.element("style", &[], |style| style.verbatim(STYLE));
        });
        html.element("body", &[], body);
    });
    html.into_string()
}

fn anchor(i: usize) -> String {
    format!("rod{}", i + 1)
}

fn heading(header: &mut Markup, report: &SiteReport) {
    let times = || {
        report
            .rods
            .iter()
            .flat_map(|rod| rod.records.iter().map(|record| record.start))
    };
    let text = match (times().min(), times().max()) {
        (Some(first), Some(last)) if first == last => format!(
            "Axial force of {}, from records taken {}.",
            counted(report.rods.len(), "tie-rod"),
            single::began(first)
        ),
        (Some(first), Some(last)) => format!(
            "Axial force of {}, from records between {} and {}.",
            counted(report.rods.len(), "tie-rod"),
            moment(first),
            moment(last)
        ),
        _ => format!(
            "Axial force of {}: no record gave one yet.",
            counted(report.rods.len(), "tie-rod")
        ),
    };
    header.leaf("p", &[("class", "about")], text);
}

/// `1 record`, `3 records`.
pub(super) fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// A time to the minute.
pub(super) fn moment(time: Timestamp) -> String {
    let text = time.to_string();
    match (text.get(..10), text.get(11..16)) {
        (Some(date), Some(clock)) if text.as_bytes().get(10) == Some(&b'T') => format!("{date} {clock} UTC"),
        _ => text,
    }
}

fn overview(main: &mut Markup, report: &SiteReport) {
    main.leaf("h2", &[], "All rods");
    if report.rods.is_empty() {
        main.leaf("p", &[], "No rod is known yet.");
        return;
    }
    let header = [
        "Rod",
        "State",
        "Force now, as measured",
        "Force now, at the reference temperature",
        "Change since the baseline, at the reference temperature",
        "Last record (UTC)",
        "Records used / refused",
        "Alarms standing",
    ];
    let rows: Vec<Vec<Cell>> = report
        .rods
        .iter()
        .enumerate()
        .map(|(i, rod)| overview_row(i, rod))
        .collect();
    table(
        main,
        "Intervals in brackets hold the true value with 95 % probability. A force with ! or ? may be wrong: the rod's part says why.",
        &header,
        &rows,
    );
}

fn overview_row(i: usize, rod: &RodReport) -> Vec<Cell> {
    let last = rod.records.last();
    let refused: usize = rod.rejections.iter().map(|rejection| rejection.count).sum();
    let now = present::now(rod);
    let standing: Vec<String> = rod
        .standing()
        .map(|alarm| {
            let seen = if alarm.acknowledged.is_some() {
                " (acknowledged)"
            } else {
                ""
            };
            format!("{}{seen} since {}", alarm.kind, day(alarm.raised))
        })
        .collect();
    vec![
        Cell::Link(format!("#{}", anchor(i)), rod.rod.clone()),
        Cell::State(state_class(rod), state_name(rod).to_owned()),
        Cell::Value(now.as_measured),
        Cell::Value(now.at_reference),
        Cell::Value(now.change),
        Cell::Line(last.map_or_else(
            || "none".to_owned(),
            |record| moment(record.start).replace(" UTC", ""),
        )),
        Cell::Text(format!("{} / {refused}", rod.used())),
        Cell::Value(if standing.is_empty() {
            "none".to_owned()
        } else {
            standing.join("; ")
        }),
    ]
}

/// A time to the day.
pub(super) fn day(time: Timestamp) -> String {
    time.to_string().chars().take(10).collect()
}

/// State in one word.
fn state_name(rod: &RodReport) -> &'static str {
    match &rod.state {
        Some(RodState::NotMonitoring { .. }) | None => "not monitoring",
        Some(state) => state.code(),
    }
}

/// State in words.
pub(super) fn state_text(rod: &RodReport) -> String {
    match &rod.state {
        Some(RodState::Learning { records, periods }) => {
            format!(
                "learning ({}, {})",
                counted(*records, "record"),
                counted(*periods, "period")
            )
        }
        Some(RodState::Monitoring) => "monitoring".to_owned(),
        Some(RodState::Alarm) => "alarm".to_owned(),
        Some(RodState::NotMonitoring { reason }) => format!("not monitoring: {reason}"),
        None => "not monitoring".to_owned(),
    }
}

/// Style class of the state.
pub(super) fn state_class(rod: &RodReport) -> &'static str {
    match &rod.state {
        Some(RodState::Alarm) => "alarm-state",
        Some(state) => state.code(),
        None => "not-monitoring",
    }
}

fn provenance(footer: &mut Markup, report: &SiteReport) {
    footer.leaf("h2", &[], "Where these numbers come from");
    footer.leaf(
        "p",
        &[],
        "The absolute force is what one record says by itself; it is wide because stiffness, density and section are \
         uncertain, and is not compared between records. The change since the baseline is what all records say together about \
         the same rod; it is tight, and it alone raises alarms.",
    );
    footer.element("dl", &[], |list| {
        for (name, value) in &report.provenance {
            list.leaf("dt", &[], name);
            list.leaf("dd", &[], value);
        }
    });
}
