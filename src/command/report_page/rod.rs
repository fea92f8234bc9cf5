//! One rod's part of the report: status, figures with their captions, tables.

use super::distribution::{self, significant};
use super::figure::figure;
use super::history::{self, Span};
use super::markup::Markup;
use super::page::{counted, day, moment, state_class, state_text};
use super::present::{now, signed};
use super::record::{self, Drawn};
use super::table::{Cell, table};
use super::view::{RecordPoint, RodReport};
use super::{learned, refused, single};
use crate::analysis::findings::{Doubt, motion_said};
use crate::analysis::record_view::Snapshot;
use crate::analysis::track::{Alarm, Interval};

/// Most alarms listed, the latest.
const ALARMS_LISTED: usize = 200;

/// The rod's part of the page; `id` begins the ids of its figures.
pub(super) fn section(html: &mut Markup, rod: &RodReport, id: &str, provenance: &[(String, String)]) {
    if rod.is_sheet() {
        return single::section(html, rod, id, provenance);
    }
    html.leaf("h2", &[], format!("Rod {}", rod.rod));
    html.element("p", &[], |p| {
        p.leaf(
            "span",
            &[("class", &format!("state {}", state_class(rod)))],
            state_text(rod),
        );
    });
    for alarm in rod.standing() {
        html.element("div", &[("class", "note"), ("role", "note")], |note| {
            note.leaf(
                "strong",
                &[],
                format!("{} since {}. ", alarm.kind, moment(alarm.raised)),
            );
            // A unit stays with its number.
            note.text(alarm.message.replace(" %", "\u{a0}%"));
            let seen = match (alarm.acknowledged, rod.words.get(&alarm.id)) {
                (Some(time), Some(words)) => format!("acknowledged {} ({words})", moment(time)),
                (Some(time), None) => format!("acknowledged {}", moment(time)),
                (None, _) => "not acknowledged".to_owned(),
            };
            let told = format!("Alarm {}, as of {}, {seen}.", alarm.id, day(alarm.told));
            note.leaf("div", &[("class", "about")], told);
        });
    }
    remarks(html, rod);
    let known = now(rod);
    if !rod.records.is_empty() {
        html.element("dl", &[], |list| {
            for (name, value) in [
                ("Force as measured", known.as_measured),
                ("Force at reference", known.at_reference),
                ("Change since baseline", known.change),
            ] {
                list.leaf("dt", &[], name);
                list.leaf("dd", &[], value);
            }
        });
    }
    over_time(html, rod, id);
    last_record(html, rod, id);
    tables(html, rod, id);
}

/// Reasons to doubt a force, one sentence each. What a baseline learned is as doubtful as the records it learned from.
pub(super) fn doubts(html: &mut Markup, record: &RecordPoint) {
    for doubt in &record.doubts {
        let said = doubt.said();
        let (first, rest) = said.split_at(said.chars().next().map_or(0, char::len_utf8));
        let mut sentence = format!("{}{rest}.", first.to_uppercase());
        if *doubt == Doubt::Conflict && record.ratio.is_some() {
            sentence += " Changes since the baseline do not depend on this.";
        }
        html.leaf("p", &[("class", "note"), ("role", "note")], sentence);
    }
}

/// Remarks that qualify the figures.
fn remarks(html: &mut Markup, rod: &RodReport) {
    if let Some(last) = rod.last_used() {
        doubts(html, last);
    }
    let mut calm = |text: String| html.leaf("p", &[("class", "note calm")], text);
    let Some(last) = rod.records.last() else {
        let refused: usize = rod.rejections.iter().map(|rejection| rejection.count).sum();
        return calm(match refused {
            0 => "There is no record of this rod yet.".to_owned(),
            _ => format!(
                "None of {} could be used; the reasons are listed below.",
                counted(refused, "record")
            ),
        });
    };
    if let Some(fault) = rod.segment().and_then(|segment| segment.fault.as_ref()) {
        calm(format!("The last attempt to learn a baseline: {fault}."));
    }
    if rod
        .last_used()
        .is_some_and(|used| used.ratio.is_some() && used.ratio_at_reference.is_none())
    {
        calm(
            "The change is not compensated for temperature: a warm day can look like a loss of force, a cold one like a gain."
                .to_owned(),
        );
    }
    if let Some(reason) = &last.set_aside {
        calm(format!(
            "The last record does not count on the charts: {}.",
            reason.replace('-', " ")
        ));
    }
}

fn over_time(html: &mut Markup, rod: &RodReport, id: &str) {
    let Some(span) = Span::of(rod) else { return };
    if rod.records.len() < 2 {
        let text = match rod.older_used {
            0 => "Figures over time begin with the second record.",
            _ => {
                "The figures over time need the lines of two records; those of the older ones were removed ([store] keep_lines_d)."
            }
        };
        return html.leaf("p", &[("class", "about")], text);
    }
    let relative = history::relative_force(rod, &span, &format!("{id}-rel"));
    let has_relative = relative.is_some();
    if let Some(drawing) = relative {
        html.leaf("h3", &[], "Change of force since the baseline");
        figure(
            html,
            Some(drawing),
            "A sound rod stays at zero at the reference temperature; the grey measured values move with the weather. A lasting \
             departure of the blue line beyond its band is a change of the rod, and a red line marks when somebody was told.",
        );
        figure(
            html,
            history::temperature(rod, &span, &format!("{id}-temp")),
            "Temperature over the same time: the force as measured falls when the rod warms and rises when it cools.",
        );
    }
    if let Some(drawing) = history::evidence(rod, &span, &format!("{id}-evid")) {
        html.leaf("h3", &[], "Evidence of a change");
        figure(
            html,
            Some(drawing),
            "What speaks for a change against what temperature, weather and the rod's own fluctuation explain, over its limit: an \
             alarm is raised where the line crosses it. Without a change it does so once in the stated time at most.",
        );
    }
    let thermal = distribution::thermal(rod, &format!("{id}-ther"));
    if thermal.is_some() {
        html.leaf("h3", &[], "Force against temperature");
        figure(
            html,
            thermal,
            "Each dot is one period. The line is what temperature alone does to the force of the baseline: dots that leave it lost or gained force besides.",
        );
    }
    html.leaf("h3", &[], "Absolute force");
    figure(
        html,
        history::absolute_force(rod, &span, &format!("{id}-abs")),
        match has_relative {
            true => {
                "The grey interval is what each record says by itself; the blue one, once there is a baseline, uses all of them. Both \
                 are wide because the rod's stiffness and density are uncertain: judge changes by the figure above, not by this one."
            }
            false => {
                "The grey interval is what each record says by itself. It is wide because the rod's stiffness and density are \
                 uncertain: no change can be told from it, only once there is a baseline."
            }
        },
    );
    html.leaf("h3", &[], "Natural frequencies");
    figure(
        html,
        history::frequencies(rod, &span, &format!("{id}-freq")),
        "Everything above rests on these frequencies. When the force changes all of them move together; one that moves alone points \
         to something else, such as an added mass or a loose support.",
    );
}

fn last_record(html: &mut Markup, rod: &RodReport, id: &str) {
    latest_spectrum(html, rod, id);
    if let Some(latest) = rod.shown() {
        learned::section(html, rod, latest, id);
    }
}

/// The latest spectrum with its resonances, the baseline's first behind it.
fn latest_spectrum(html: &mut Markup, rod: &RodReport, id: &str) {
    let Some(latest) = rod.shown() else {
        return;
    };
    let earlier = rod
        .baseline
        .as_ref()
        .filter(|baseline| baseline.start != latest.start);
    let of = format!("rod {}", rod.rod);
    let drawn = Drawn {
        record: latest,
        key: format!("latest record, {}", day(latest.start)),
        earlier: earlier.map(|first| (first, format!("first of the baseline, {}", day(first.start)))),
        unit: rod.motion_unit.as_deref(),
        of: &of,
        height: record::FULL,
    };
    let Some(spectrum) = drawn.spectrum(&format!("{id}-spec")) else {
        return;
    };
    html.leaf("h3", &[], "Spectrum");
    figure(
        html,
        Some(spectrum),
        "How strongly the rod vibrates at each frequency. The marked peaks are its natural modes; grey dots are peaks that belong \
         to something else.",
    );
    if let Some(words) = motion_and_labels(latest) {
        html.leaf("p", &[("class", "about")], words);
    }
    record::candidates(html, &latest.candidates);
}

/// Motion of the rod, and certainty of its mode orders.
fn motion_and_labels(record: &Snapshot) -> Option<String> {
    let motion = record.motion.as_ref().map(motion_said)?;
    let probability = record.label_probability.map_or_else(String::new, |probability| {
        format!(
            " The orders of its modes are right with a probability of {}.",
            super::percent_said(probability)
        )
    });
    Some(format!("The record shows {motion}.{probability}"))
}

fn tables(html: &mut Markup, rod: &RodReport, id: &str) {
    html.leaf("h3", &[], "Alarms");
    if rod.alarms.is_empty() {
        html.leaf("p", &[], "None so far.");
    } else {
        let latest = rod.alarms.iter().rev().take(ALARMS_LISTED);
        let mut listed: Vec<_> = latest.clone().map(alarm_row).collect();
        let caption = if rod.alarms.len() > ALARMS_LISTED {
            format!("The latest {ALARMS_LISTED} of {}.", rod.alarms.len())
        } else {
            "The latest first. Intervals hold the true value with 95 % probability.".to_owned()
        };
        let mut header = vec![
            "Kind",
            "Raised",
            "Began",
            "Size [%]",
            "Rate [%/year]",
            "Acknowledged",
            "Cleared",
        ];
        // For a drift the columns are complete.
        if rod.alarms.iter().any(|alarm| alarm.change.is_none()) {
            header.push("What it says");
        }
        let columns = header.len();
        listed.iter_mut().for_each(|row| row.truncate(columns));
        if !rod.words.is_empty() {
            header.push("Acknowledged by");
            for (row, alarm) in listed.iter_mut().zip(latest) {
                row.push(Cell::Text(rod.words.get(&alarm.id).cloned().unwrap_or_default()));
            }
        }
        table(html, &caption, &header, &listed);
    }
    if !rod.segments.is_empty() {
        html.leaf("h3", &[], "Baselines");
        let rows: Vec<Vec<Cell>> = rod
            .segments
            .iter()
            .map(|segment| {
                let (span, records) = match segment.baseline {
                    Some((first, last)) => (
                        format!("{} to {}", moment(first), moment(last)),
                        segment.records.to_string(),
                    ),
                    None => ("not yet learned".to_owned(), String::new()),
                };
                let number = |value: Option<f64>| value.map_or_else(String::new, significant);
                vec![
                    Cell::Text(segment.number.to_string()),
                    Cell::Text(segment.reason.replace('-', " ")),
                    Cell::Line(span),
                    Cell::Text(records),
                    Cell::Text(number(segment.reference_c)),
                    Cell::Text(number(segment.overdispersion)),
                ]
            })
            .collect();
        let header = [
            "Segment",
            "Opened",
            "Baseline",
            "Records",
            "Reference [\u{b0}C]",
            "Scatter over stated error",
        ];
        table(
            html,
            "Each baseline begins a stretch of history of its own; changes are never compared across two.",
            &header,
            &rows,
        );
    }
    if !rod.rejections.is_empty() {
        refused::by_reason(html, rod);
    }
    refused::latest(html, rod, id);
}

fn alarm_row(alarm: &Alarm) -> Vec<Cell> {
    let (onset, size, rate) = alarm.change.as_ref().map_or_else(
        || (String::new(), String::new(), String::new()),
        |change| {
            let onset = format!(
                "{} [{} to {}]",
                day(change.onset),
                day(change.onset_q025),
                day(change.onset_q975)
            );
            let percent = |interval: &Interval| {
                let one = |x: f64| signed(100.0 * x);
                format!(
                    "{} [{} to {}]",
                    one(interval.mean),
                    one(interval.q025),
                    one(interval.q975)
                )
            };
            let rate = if change.step_probability > 0.5 {
                format!("a step ({:.0} %)", 100.0 * change.step_probability)
            } else {
                percent(&change.rate_per_year)
            };
            (onset, percent(&change.size), rate)
        },
    );
    let when = |time: Option<_>| time.map_or_else(|| "no".to_owned(), day);
    vec![
        Cell::Line(alarm.kind.to_string()),
        Cell::Line(day(alarm.raised)),
        Cell::Value(onset),
        Cell::Value(size),
        Cell::Value(rate),
        Cell::Line(when(alarm.acknowledged)),
        Cell::Line(when(alarm.cleared)),
        // The columns before already show it.
        Cell::Text(match alarm.change {
            Some(_) => String::new(),
            None => alarm.message.clone(),
        }),
    ]
}
