//! The spectra of records without a rod: one self-contained page, `tirante spectrum --html`.

use super::figure::figure;
use super::markup::Markup;
use super::page::{counted, document};
use super::record::{self, Drawn};
use super::single::began;
use super::view::SpectrumReport;
use crate::analysis::findings::motion_said;

/// Page of some records; `left_out` is the number of records beyond its limit.
pub fn spectra(title: &str, records: &[SpectrumReport], left_out: usize) -> String {
    document(&format!("{title}: spectrum"), |body| {
        body.element("header", &[], |header| {
            header.leaf("h1", &[], title);
            let shown = counted(records.len(), "record");
            let text = match left_out {
                0 => format!("{shown}, each with its waveform, its spectrum and every peak found."),
                more => format!("The first {shown}; {more} more are not in this page."),
            };
            header.leaf("p", &[("class", "about")], text);
        });
        body.element("main", &[], |main| {
            for (i, one) in records.iter().enumerate() {
                main.element("section", &[("id", &format!("record{}", i + 1))], |html| {
                    section(html, one, &format!("r{}", i + 1));
                });
            }
        });
        body.element("footer", &[], |footer| {
            footer.leaf(
                "p",
                &[],
                format!(
                    "tirante {}. A tone is a pure sine (mains, a motor); a broad peak is no vibration of a rod; \
                     the modes of a taut rod lie near multiples of the first, so that a multiple alone is no reproach.",
                    env!("CARGO_PKG_VERSION")
                ),
            );
        });
    })
}

fn section(html: &mut Markup, one: &SpectrumReport, id: &str) {
    html.leaf("h2", &[], &one.channel);
    html.leaf("p", &[("class", "about")], &one.file);
    refusal(html, one.fault.as_deref());
    let Some(record) = &one.record else { return };
    html.element("dl", &[], |list| {
        let mut entry = |name: &str, value: String| {
            list.leaf("dt", &[], name);
            list.leaf("dd", &[], value);
        };
        entry(
            "Record",
            format!(
                "{}, {:.1} s at {:.4} Hz",
                began(record.start),
                record.duration_s,
                record.fs_hz
            ),
        );
        if let Some((low, high)) = one.band_hz {
            entry("Searched", format!("{low:.2} to {high:.2} Hz"));
        }
        if let Some(motion) = &record.motion {
            entry("Motion", motion_said(motion));
        }
        if let Some(force) = &one.force {
            entry("Axial force", force.clone());
            for doubt in &one.doubts {
                entry("In doubt", doubt.said().to_owned());
            }
        }
        if let Some(probability) = record.label_probability {
            entry("Orders right with", super::percent_said(probability));
        }
        for flag in &one.flags {
            entry("Noticed", flag.clone());
        }
    });
    let drawn = Drawn {
        record,
        key: "power spectral density".to_owned(),
        earlier: None,
        unit: one.unit.as_deref(),
        of: &one.channel,
        height: record::FULL,
    };
    figure(html, drawn.spectrum(&format!("{id}-spec")), "");
    figure(html, drawn.waveform(&format!("{id}-wave")), "");
    record::candidates(html, &record.candidates);
    match record.peaks.is_empty() {
        false => record::peaks(html, record),
        true if record.curve.level_db.is_empty() => {}
        true => html.leaf("p", &[], "No peak stands above the noise."),
    }
}

fn refusal(html: &mut Markup, why: Option<&str>) {
    if let Some(why) = why {
        html.element("div", &[("class", "note"), ("role", "note")], |note| {
            note.leaf("strong", &[], "Refused. ");
            note.text(why);
        });
    }
}
