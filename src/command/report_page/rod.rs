//! One rod's part of the report: status, figures with their captions, tables.

use super::axis::minus;
use super::distribution::{self, significant};
use super::history::{self, Span};
use super::markup::Markup;
use super::page::{counted, day, moment, state_class, state_text};
use super::record::{self, Drawn};
use super::single;
use super::view::{RecordPoint, RodReport};
use crate::analysis::findings::{Doubt, motion_said};
use crate::analysis::inference::VarianceShares;
use crate::analysis::record_view::Snapshot;
use crate::analysis::track::{Alarm, Interval};

/// Most alarms listed, the latest.
const ALARMS_LISTED: usize = 200;

/// A cell of a table.
pub(super) enum Cell {
    /// Plain text.
    Text(String),
    /// Text that stays on one line.
    Line(String),
    /// A value with an interval, a temperature or a time: wrapped only between them.
    Value(String),
    /// A state with its style.
    State(&'static str, String),
    /// A link within the page: target and text.
    Link(String, String),
}

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

fn signed(value: f64) -> String {
    minus(&format!("{value:+.2}"))
}

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
            let seen = match alarm.acknowledged {
                Some(time) => format!("acknowledged {}", moment(time)),
                None => "not acknowledged".to_owned(),
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

/// A drawing with its caption, if there is one.
pub(super) fn figure(html: &mut Markup, drawing: Option<Markup>, caption: &str) {
    let Some(drawing) = drawing else { return };
    html.element("figure", &[], |figure| {
        // Narrow screens scroll the drawing, not the page; the keyboard can too.
        figure.element("div", &[("class", "scroll"), ("tabindex", "0")], |div| {
            div.append(drawing)
        });
        if !caption.is_empty() {
            figure.leaf("figcaption", &[], caption);
        }
    });
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
        taught(html, rod, latest, id);
    }
}

/// Priors and posteriors of the quantities, and the sources of the force's variance.
pub(super) fn taught(html: &mut Markup, rod: &RodReport, latest: &Snapshot, id: &str) {
    if latest.densities.is_empty() {
        return;
    }
    html.leaf("h3", &[], "What the record taught");
    html.leaf(
        "p",
        &[("class", "about")],
        "What was assumed of each quantity (grey) and what the latest record leaves possible (blue). A blue curve narrower than the \
         grey one was learned from the vibration; one that covers it was not.",
    );
    html.element("div", &[("class", "pair many")], |pair| {
        for (i, density) in latest.densities.iter().enumerate() {
            figure(
                pair,
                Some(distribution::density(
                    rod,
                    density,
                    distribution::HIGH,
                    &format!("{id}-den{i}"),
                )),
                "",
            );
        }
    });
    let rows: Vec<Vec<Cell>> = latest
        .densities
        .iter()
        .map(|density| {
            let (name, unit, factor) = distribution::quantity(&density.quantity);
            let shown =
                |(mean, sd): (f64, f64)| Cell::Text(distribution::mean_and_sd(mean * factor, sd * factor));
            vec![
                Cell::Text(format!("{name} [{unit}]")),
                shown(density.prior_mean_sd),
                shown(density.posterior_mean_sd),
            ]
        })
        .collect();
    let caption = format!(
        "Mean \u{b1} standard deviation, record of {}, {:.0} s at {} Hz, seed {}.",
        moment(latest.start),
        latest.duration_s,
        significant(latest.fs_hz),
        latest.seed
    );
    table(
        html,
        &caption,
        &["Quantity", "Before (prior)", "After (posterior)"],
        &rows,
    );
    if let Some(shares) = &latest.hangs_on {
        hangs_on(html, shares);
    }
}

/// Sentences on the sources of the force's variance, and their table.
fn hangs_on(html: &mut Markup, shares: &VarianceShares) {
    html.leaf("h3", &[], "What the force hangs on");
    sentences(html, shares);
    sources(
        html,
        shares,
        "Shares of the variance of the absolute force; they add up to all of it. The last column is the part that would vanish if this source were known exactly: sources \
         that the frequencies tie together overlap there.",
    );
}

/// Sentences on the sources of the force's variance.
pub(super) fn sentences(html: &mut Markup, shares: &VarianceShares) {
    for sentence in &shares.said {
        html.leaf("p", &[("class", "about")], format!("{sentence}."));
    }
}

/// Table of the sources of the force's variance.
pub(super) fn sources(html: &mut Markup, shares: &VarianceShares, caption: &str) {
    let percent = |share: f64| Cell::Line(format!("{:.0} %", 100.0 * share));
    let rows: Vec<Vec<Cell>> = shares
        .sources
        .iter()
        .map(|part| {
            vec![
                Cell::Text(part.source.name().to_owned()),
                percent(part.share),
                percent(part.if_known),
            ]
        })
        .collect();
    table(html, caption, &["Source", "Share", "Less if known"], &rows);
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

/// The latest refused record: the reason, and its figures.
pub(super) fn latest_refused(html: &mut Markup, rod: &RodReport, id: &str) {
    let Some(record) = &rod.refused else { return };
    html.leaf("h3", &[], "The latest refused record");
    refused_said(html, rod, record, id);
    refused_samples(html, rod, record, id);
}

/// A refused record: the reason, the assignments considered, its spectrum.
pub(super) fn refused_said(html: &mut Markup, rod: &RodReport, record: &Snapshot, id: &str) {
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
pub(super) fn refused_samples(html: &mut Markup, rod: &RodReport, record: &Snapshot, id: &str) {
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

fn tables(html: &mut Markup, rod: &RodReport, id: &str) {
    html.leaf("h3", &[], "Alarms");
    if rod.alarms.is_empty() {
        html.leaf("p", &[], "None so far.");
    } else {
        let mut listed = rod
            .alarms
            .iter()
            .rev()
            .take(ALARMS_LISTED)
            .map(alarm_row)
            .collect::<Vec<_>>();
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
        rejections(html, rod);
    }
    latest_refused(html, rod, id);
}

/// Refused records by reason.
pub(super) fn rejections(html: &mut Markup, rod: &RodReport) {
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

/// A table with its caption, scrollable on a narrow screen.
pub(super) fn table(html: &mut Markup, caption: &str, header: &[&str], rows: &[Vec<Cell>]) {
    html.element("div", &[("class", "scroll"), ("tabindex", "0")], |div| {
        div.element("table", &[], |table| {
            table.leaf("caption", &[], caption);
            table.element("thead", &[], |head| {
                head.element("tr", &[], |row| {
                    for name in header {
                        row.leaf("th", &[("scope", "col")], name);
                    }
                });
            });
            table.element("tbody", &[], |body| {
                for cells in rows {
                    body.element("tr", &[], |row| cells.iter().for_each(|cell| write(row, cell)));
                }
            });
        });
    });
}

fn write(row: &mut Markup, cell: &Cell) {
    match cell {
        Cell::Text(text) => row.leaf("td", &[], text),
        Cell::Line(text) => row.leaf("td", &[("class", "nowrap")], text),
        Cell::Value(text) => row.element("td", &[], |td| {
            for (i, part) in parts(text).iter().enumerate() {
                if i > 0 {
                    td.text(" ");
                }
                td.leaf("span", &[("class", "nowrap")], part);
            }
        }),
        Cell::State(class, text) => row.element("td", &[], |td| {
            td.leaf("span", &[("class", &format!("state {class}"))], text);
        }),
        Cell::Link(to, text) => row.element("td", &[("class", "nowrap")], |td| {
            td.leaf("a", &[("href", to)], text);
        }),
    }
}

/// Splits a value from its interval, temperature or time.
fn parts(text: &str) -> Vec<&str> {
    let mut parts = Vec::new();
    let mut rest = text;
    // The first character is never a break, so that every part is shorter than the rest.
    while let Some(place) = [" [", " at ", " since ", ", ", "; "]
        .iter()
        .filter_map(|mark| rest.find(mark))
        .filter(|place| *place > 0)
        .min()
    {
        let place = place + usize::from(!rest[place..].starts_with(' '));
        parts.push(&rest[..place]);
        rest = rest[place..].trim_start();
    }
    parts.push(rest);
    parts
}
