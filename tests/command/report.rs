//! The report page: well-formed, self-contained, the same for the same data, whatever is missing.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::synthetic::{HOUR, refused, rod, site, time};
use std::fs;
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::RodState;
use tirante::command::report;
use tirante::command::report_page::page;
use tirante::command::report_page::view::{RejectionCount, RodReport, SiteReport};
use tirante::site::store::Store;

/// After a loss the regression expects the force that is left; the line that the report draws stays the baseline's.
#[test]
fn the_line_over_temperature_is_the_baselines() {
    let report = site();
    let mut settled = report.clone();
    for (_, period) in settled.rods.iter_mut().flat_map(|rod| &mut rod.periods) {
        if let Some(charted) = &mut period.charted {
            charted.expected -= 0.03;
        }
    }
    assert_ne!(report, settled);
    let html = page(&report);
    assert!(html.contains("the baseline&#39;s force: "), "the figure is there");
    assert_eq!(html, page(&settled));
}

/// Every element is closed in order, attributes are quoted, ids are unique.
fn assert_well_formed(html: &str) {
    let mut open: Vec<&str> = Vec::new();
    let mut ids = std::collections::HashSet::new();
    let mut rest = html.strip_prefix("<!DOCTYPE html>\n").expect("a document type");
    while let Some(at) = rest.find('<') {
        assert!(
            !rest[..at].contains('>') || open.last() == Some(&"style"),
            "stray > in {:?}",
            &rest[..at]
        );
        let end = at + rest[at..].find('>').expect("a tag that ends");
        let tag = &rest[at + 1..end];
        rest = &rest[end + 1..];
        assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
        assert!(!tag.contains('<'), "{tag}");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name));
            continue;
        }
        let name = tag.split([' ', '/']).next().unwrap();
        if let Some(id) = tag.split(" id=\"").nth(1).and_then(|rest| rest.split('"').next()) {
            assert!(ids.insert(id), "{id} twice");
        }
        if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "{open:?} left open");
    for reference in html.split("aria-labelledby=\"").skip(1) {
        for id in reference.split('"').next().unwrap().split(' ') {
            assert!(ids.contains(id), "{id} is referred to, but is not there");
        }
    }
}

/// Nothing is loaded, nothing is run, no number is none.
fn assert_self_contained(html: &str) {
    for word in [
        "http://",
        "https://",
        "<script",
        "src=",
        "@import",
        "javascript:",
        "<link",
        "NaN",
        "inf ",
        "\"inf",
    ] {
        assert!(!html.contains(word), "{word}");
    }
    let urls = html.matches("url(").count();
    assert_eq!(urls, html.matches("url(#").count());
}

fn checked(report: &SiteReport) -> String {
    let html = page(report);
    assert_well_formed(&html);
    assert_self_contained(&html);
    assert_eq!(html, page(report));
    html
}

fn one(rod: RodReport) -> SiteReport {
    SiteReport {
        site: "Somewhere".to_owned(),
        rods: vec![rod],
        provenance: vec![],
    }
}

#[test]
fn a_year_of_two_rods_shows_everything() {
    let html = checked(&site());
    for wanted in [
        "Change of axial force of rod north",
        "Evidence of a change, rod north",
        "Vibration spectrum",
        "Prior and posterior of the axial force",
        "Force of rod north against temperature",
        "Natural frequencies of rod",
        "Temperature beside rod",
        "2025-03-01",
        "mode 3",
        "baseline</text>",
        "Refused records",
        "prefers-color-scheme:dark",
        "lang=\"en\"",
    ] {
        assert!(html.contains(wanted), "{wanted}");
    }
    assert!(html.len() < 700_000, "{} bytes", html.len());
}

#[test]
fn ten_years_of_hours_stay_small() {
    let html = checked(&one(rod("hourly", 87_600, HOUR, 3)));
    assert!(html.len() < 2_000_000, "{} bytes", html.len());
}

#[test]
fn whatever_is_missing_the_page_is_whole() {
    checked(&SiteReport::default());
    let html = checked(&one(RodReport::new("a")));
    assert!(html.contains("There is no record of this rod yet."));

    for count in [1, 2, 3, 31] {
        let mut few = rod("few", count, 24 * HOUR, 1);
        checked(&one(few.clone()));
        // No baseline: absolute force alone.
        few.segments.clear();
        few.periods.clear();
        few.baseline = None;
        for record in &mut few.records {
            record.ratio = None;
            record.ratio_at_reference = None;
            record.tracked_force_n = None;
            record.force_at_reference_n = None;
        }
        let html = checked(&one(few.clone()));
        // A rod measured once is about its force.
        let wanted = match count {
            1 => ["class=\"headline\"", "so there is no change to tell", "Signature"],
            _ => ["no baseline yet", "All rods", "Absolute force"],
        };
        for wanted in wanted {
            assert!(html.contains(wanted), "{count}: {wanted}");
        }
        few.latest = None;
        checked(&one(few));
    }

    let mut uncompensated = rod("cold", 200, 24 * HOUR, 2);
    for record in &mut uncompensated.records {
        record.temperature_c = None;
        record.ratio_at_reference = None;
        record.force_at_reference_n = None;
    }
    for (_, period) in &mut uncompensated.periods {
        period.charted = None;
        period.filtered_c = None;
    }
    let html = checked(&one(uncompensated));
    assert!(html.contains("not compensated for temperature") && html.contains("uncompensated"));
    assert!(!html.contains("Evidence of a change"));

    let mut refused = RodReport::new("refused");
    refused.rejections.push(RejectionCount {
        code: "no-peak".to_owned(),
        count: 7,
        last: Some(time(0)),
        message: "no peak between 2 and 20 Hz".to_owned(),
    });
    let html = checked(&one(refused));
    assert!(html.contains("None of 7 records could be used"));
}

#[test]
fn the_latest_refused_record_is_shown_with_its_evidence() {
    // Beside a history, and where no record was ever used.
    for mut shown in [rod("north", 60, 24 * HOUR, 3), RodReport::new("north")] {
        shown.refused = Some(refused(time(0)));
        let html = checked(&one(shown.clone()));
        for wanted in [
            "The latest refused record",
            "cannot number the modes of 7 peaks: mask 13.4 Hz, or narrow the prior of axial_force_n (no-label)",
            "Vibration spectrum of the latest refused record of rod north",
            "Waveform of the latest refused record of rod north",
            "ambient vibration with blows at 12.50, 40.00 s",
            "1 at 4.490, 3 at 13.200 Hz",
            "61 %",
            "harmonic, 2\u{a0}\u{d7}\u{a0}8.335",
            ">13.200</text>",
        ] {
            assert!(html.contains(wanted), "{wanted}");
        }
        // Refused before there was a spectrum: the waveform alone.
        let mut early = refused(time(0));
        early.curve.level_db.clear();
        early.peaks.clear();
        early.candidates.clear();
        early.motion = None;
        shown.refused = Some(early);
        let html = checked(&one(shown));
        assert!(
            html.contains("Waveform of the latest refused record")
                && !html.contains("spectrum of the latest refused")
        );
    }
}

#[test]
fn what_comes_from_outside_stays_text() {
    let hostile = "</title></svg><script>alert(1)</script>\"' onload=x &amp; https://example.org";
    let mut report = site();
    report.site = hostile.to_owned();
    report.provenance.push((hostile.to_owned(), hostile.to_owned()));
    let rod = &mut report.rods[0];
    rod.rod = hostile.to_owned();
    rod.motion_unit = Some(hostile.to_owned());
    rod.state = Some(RodState::NotMonitoring {
        reason: hostile.to_owned(),
    });
    for alarm in &mut rod.alarms {
        alarm.message = hostile.to_owned();
    }
    for rejection in &mut rod.rejections {
        rejection.code = hostile.to_owned();
        rejection.message = hostile.to_owned();
    }
    rod.refused = Some(refused(time(0)));
    if let Some(reason) = rod
        .refused
        .as_mut()
        .and_then(|refused| refused.rejection.as_mut())
    {
        reason.code = hostile.to_owned();
        reason.message = hostile.to_owned();
    }
    for segment in &mut rod.segments {
        segment.fault = Some(hostile.to_owned());
        segment.reason = hostile.to_owned();
    }
    let html = page(&report);
    assert_well_formed(&html);
    assert!(!html.contains("<script") && !html.contains("onload=x &amp; ") && !html.contains("\"' onload"));
}

#[test]
fn a_store_becomes_a_page_of_the_same_bytes_every_time() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::in_memory().unwrap();
    crate::archive::fill(&mut store, 0..120);
    let page = report::write(&store, None, folder.path()).unwrap();
    assert_eq!(page.file_name().unwrap(), "the-site.html");
    let html = fs::read_to_string(&page).unwrap();
    assert_well_formed(&html);
    assert_self_contained(&html);
    for wanted in [
        "Rod north",
        "Rod south è",
        "60 / 0",
        "48 / 12",
        "Vibration spectrum of rod north",
        "Prior and posterior of the axial force of rod north",
        "the &quot;drift&quot; of record 40",
        "no &quot;peak&quot;, none",
        crate::archive::CONFIG,
    ] {
        assert!(html.contains(wanted), "{wanted}");
    }
    let rod = RodId("north".to_owned());
    let named = folder.path().join("sub/north.html");
    assert_eq!(report::write(&store, Some(&rod), &named).unwrap(), named);
    let of_one = fs::read_to_string(&named).unwrap();
    assert!(of_one.contains("Rod north") && !of_one.contains("Rod south"));
    report::write(&store, None, &page).unwrap();
    assert_eq!(fs::read_to_string(&page).unwrap(), html);

    let empty = Store::in_memory().unwrap();
    let page = report::write(&empty, None, folder.path()).unwrap();
    assert_well_formed(&fs::read_to_string(page).unwrap());
}

#[test]
fn numbers_beyond_all_bounds_are_drawn_or_left_out() {
    let mut wild = rod("wild", 300, 24 * HOUR, 4);
    wild.records[10].force_n.mean = f64::NAN;
    wild.records[11].force_n.q975 = f64::INFINITY;
    wild.records[12].temperature_c = Some(f64::NEG_INFINITY);
    wild.records[13].modes = vec![];
    wild.records[14].ratio = wild.records[14].ratio.map(|mut ratio| {
        ratio.mean = 1e300;
        ratio
    });
    let html = page(&one(wild));
    assert_well_formed(&html);
    for path in html.split(" d=\"").skip(1) {
        let path = path.split('"').next().unwrap();
        assert!(!path.contains("NaN") && !path.contains("inf"), "{path}");
    }
}

#[test]
fn force_now_is_that_of_a_record_that_counts_and_of_the_present_baseline() {
    let cells = |rod: RodReport| {
        let html = page(&SiteReport {
            rods: vec![rod],
            ..site()
        });
        let row = html.split("href=\"#rod1\"").nth(1).unwrap();
        row.split("</tr>").next().unwrap().to_owned()
    };
    let mut report = rod("north", 60, HOUR, 1);
    report.segment = Some(1);
    let good = cells(report.clone());
    let used = report.records.len();
    assert!(good.contains(&format!("{used} / ")), "{good}");
    // Of a clock that was wrong: the last by time, of no use.
    let mut wrong = report.records.last().unwrap().clone();
    wrong.set_aside = Some("clock".to_owned());
    wrong.force_n.mean *= 2.0;
    (wrong.tracked_force_n, wrong.ratio, wrong.ratio_at_reference) = (None, None, None);
    report.records.push(wrong);
    assert_eq!(report.used(), used);
    assert_eq!(cells(report.clone()), good);
    // The baseline was given up: no change against it is told.
    report.segment = Some(2);
    let given_up = cells(report);
    assert!(given_up.contains("no baseline yet"), "{given_up}");
}

#[test]
fn the_current_segment_is_not_always_the_highest() {
    let mut report = rod("north", 60, HOUR, 1);
    let mut later = report.segments[0].clone();
    later.number = 2;
    report.segments.push(later);
    assert_eq!(report.segment().unwrap().number, 2);
    report.segment = Some(1);
    assert_eq!(report.segment().unwrap().number, 1);
}

#[test]
fn a_rod_with_one_line_left_of_years_is_not_measured_once() {
    let mut old = rod("old", 2, 24 * HOUR, 1);
    old.segments.clear();
    old.periods.clear();
    old.baseline = None;
    for record in &mut old.records {
        record.ratio = None;
        record.ratio_at_reference = None;
        record.tracked_force_n = None;
        record.force_at_reference_n = None;
    }
    old.older_used = 20;
    let last = old.records.pop().unwrap();
    let html = checked(&one(old.clone()));
    assert!(!html.contains("Measured once") && !html.contains("begin with the second record"));
    assert!(html.contains("those of the older ones were removed") && html.contains("All rods"));
    // Without a figure of changes there is none above the absolute force.
    old.records.push(last);
    let html = checked(&one(old));
    assert!(html.contains("Absolute force") && !html.contains("judge changes by the figure above"));
    let html = checked(&one(rod("tracked", 60, 24 * HOUR, 1)));
    assert!(html.contains("judge changes by the figure above"));
}

#[test]
fn every_reason_to_doubt_a_force_is_told_with_its_mark() {
    use tirante::analysis::findings::Doubt;
    let mut doubtful = rod("doubtful", 60, 24 * HOUR, 1);
    let html = checked(&one(doubtful.clone()));
    for mark in ["! ", "? "] {
        assert!(
            !html.contains(&format!("<dd>{mark}"))
                && !html.contains(&format!("<span class=\"nowrap\">{mark}"))
        );
    }
    for (doubts, mark) in [
        (vec![Doubt::Conflict], "! "),
        (vec![Doubt::Prior, Doubt::Orders], "! "),
        (vec![Doubt::Orders], "? "),
        (vec![Doubt::Wide], "? "),
    ] {
        doubtful.records.last_mut().unwrap().doubts = doubts.clone();
        let html = checked(&one(doubtful.clone()));
        // In the overview and in the rod's part, both forces.
        for wanted in [
            format!("<dt>Force as measured</dt><dd>{mark}"),
            format!("<dt>Force at reference</dt><dd>{mark}"),
        ] {
            assert!(html.contains(&wanted), "{wanted}");
        }
        assert_eq!(html.matches(&format!("<span class=\"nowrap\">{mark}")).count(), 2);
        for doubt in doubts {
            let said = &doubt.said()[1..];
            assert!(html.contains(said), "{said}");
        }
    }
}
