//! Refused records of a rod: counted by reason, and the latest with its figures.

use super::figure::figure;
use super::markup::Markup;
use super::page::{day, moment};
use super::record::{self, Drawn};
use super::table::{Cell, table};
use super::view::RodReport;
use crate::analysis::findings::motion_said;
use crate::analysis::record_view::Snapshot;

/// The latest refused record: the reason, and its figures.
pub(super) fn latest(html: &mut Markup, rod: &RodReport, id: &str) {
    let Some(record) = &rod.refused else { return };
    html.leaf("h3", &[], "The latest refused record");
    reason(html, rod, record, id);
    samples(html, rod, record, id);
}

/// A refused record: the reason, the assignments considered, its spectrum.
pub(super) fn reason(html: &mut Markup, rod: &RodReport, record: &Snapshot, id: &str) {
    if let Some(reason) = &record.rejection {
        html.element("p", &[], |p| {
            p.leaf(
                "span",
                &[("class", "nowrap")],
                format!("{}: ", moment(record.start)),
            );
            p.text(format!(
                "{} ({}).",
                reason.message.trim_end_matches('.'),
                reason.code
            ));
        });
    }
    record::candidates(html, &record.candidates);
    let of = refused_of(rod);
    figure(
        html,
        drawn_refused(rod, record, &of).spectrum(&format!("{id}-refspec")),
        "Its spectrum with every peak that was found; none of them was believed to be a mode of the rod.",
    );
}

/// Waveform and peaks of a refused record.
pub(super) fn samples(html: &mut Markup, rod: &RodReport, record: &Snapshot, id: &str) {
    let words = record.motion.as_ref().map_or_else(
        || "Its waveform.".to_owned(),
        |motion| format!("Its waveform: {}.", motion_said(motion)),
    );
    let of = refused_of(rod);
    figure(
        html,
        drawn_refused(rod, record, &of).waveform(&format!("{id}-refwave")),
        &words,
    );
    record::peaks(html, record);
}

fn refused_of(rod: &RodReport) -> String {
    format!("the latest refused record of rod {}", rod.rod)
}

fn drawn_refused<'s>(rod: &'s RodReport, record: &'s Snapshot, of: &'s str) -> Drawn<'s> {
    Drawn {
        record,
        key: format!("refused record, {}", day(record.start)),
        earlier: None,
        unit: rod.motion_unit.as_deref(),
        of,
        height: record::FULL,
    }
}

/// Refused records by reason.
pub(super) fn by_reason(html: &mut Markup, rod: &RodReport) {
    html.leaf("h3", &[], "Refused records");
    let rows: Vec<Vec<Cell>> = rod
        .rejections
        .iter()
        .map(|rejection| {
            vec![
                Cell::Line(rejection.code.clone()),
                Cell::Text(rejection.count.to_string()),
                Cell::Line(rejection.last.map_or_else(|| "time unknown".to_owned(), moment)),
                Cell::Text(rejection.message.clone()),
            ]
        })
        .collect();
    table(
        html,
        "Records that gave no force, by reason.",
        &["Reason", "Records", "Last", "Said the last time"],
        &rows,
    );
}
