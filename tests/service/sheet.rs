//! The report of a rod measured once, printed by Chromium: one A4 page, legible, whatever the record; the annex behind it if open.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::browser::{Browser, decoded};
use crate::site::text;
use serde_json::{Value as Json, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use tirante::analysis::findings::Doubt;
use tirante::analysis::record_view::PeakMark;
use tirante::command::report_page::{SiteReport, page};

/// Width \[px\] of what an A4 page shows between margins of 15 mm.
const PAPER: u32 = 680;
/// Smallest letters \[px\]: 8 points.
const LETTER: f64 = 8.0 / 72.0 * 96.0;

/// Smallest letters on the page in print, however much a drawing is scaled.
const SMALLEST: &str =
    "const said = [...document.querySelectorAll('body *')].filter((one) => one.getClientRects().length > 0
    && [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim() !== ''));
  return Math.min(...said.map((one) => {
    const drawing = one.ownerSVGElement;
    const scale = drawing ? drawing.getBoundingClientRect().width / drawing.viewBox.baseVal.width : 1;
    return scale * parseFloat(getComputedStyle(one).fontSize);
  }))";

/// A recording measured as users do, with words in one string; the report.
fn measured(folder: &Path, (recording, words, code): (&str, &str, i32)) -> PathBuf {
    let recording = format!("{}/recordings/{recording}", env!("CARGO_MANIFEST_DIR"));
    let output = Command::new(env!("CARGO_BIN_EXE_tirante"))
        .arg("measure")
        .arg(&recording)
        .args(words.split(' '))
        .args(["--material", "iron", "--out"])
        .arg(folder)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(code), "{}", text(&output.stderr));
    let stem = Path::new(&recording).file_stem().unwrap();
    folder.join(stem).with_extension("html")
}

/// A page with ten modes, and every doubt that goes together.
fn crowded(folder: &Path) -> PathBuf {
    let mut one = crate::synthetic::rod("crowded", 1, crate::synthetic::HOUR, 1);
    let only = &mut one.records[0];
    (only.ratio, only.ratio_at_reference) = (None, None);
    only.doubts = vec![Doubt::Prior, Doubt::Orders, Doubt::Wide];
    one.alarms.clear();
    let mut latest = one.latest.take().unwrap();
    latest.candidates = crate::synthetic::refused(latest.start).candidates;
    let first = latest.peaks[0];
    latest.peaks = (1..=10_usize)
        .map(|order| PeakMark {
            frequency_hz: 1.7 * order as f64,
            order: Some(order),
            sd_hz: Some(0.001),
            damping: Some(0.002),
            damping_sd: Some(0.0003),
            ..first
        })
        .collect();
    one.latest = Some(latest);
    one.facts = (0..9)
        .map(|i| (format!("fact {i}"), "0 to 0.99 (0 hinge, 1 clamp)".to_owned()))
        .collect();
    let html = page(&SiteReport {
        site: "Crowded".to_owned(),
        rods: vec![one],
        provenance: vec![("program".to_owned(), "tirante".to_owned())],
    });
    assert!(html.contains("Annex"), "it is a sheet");
    let path = folder.join("crowded.html");
    std::fs::write(&path, html).unwrap();
    path
}

/// Number of pages in print, all of them A4; kept in the folder `LOOKS` to look at.
fn pages(browser: &Browser, name: &str) -> usize {
    let settings = json!({"cmd": "Page.printToPDF", "params": {"preferCSSPageSize": true}});
    let answer: Json = browser.post("/goog/cdp/execute", &settings);
    let pdf = decoded(answer["data"].as_str().unwrap());
    if let Some(folder) = std::env::var_os("LOOKS") {
        std::fs::write(Path::new(&folder).join(format!("{name}.pdf")), &pdf).unwrap();
    }
    let pdf = String::from_utf8_lossy(&pdf);
    let count = pdf.matches("/Type /Page\n").count();
    let a4 = pdf.matches("/MediaBox [0 0 594.95").count();
    assert!(count > 0 && a4 == count, "{count} pages, {a4} of them A4");
    count
}

#[test]
fn one_measurement_is_one_sheet_of_paper() {
    let Some(browser) = Browser::start(1000, 900, false) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rod = "--length 9.5 --section d45";
    let long = format!(
        "{rod} --site {} --id {}",
        "Navata,maggiore,".repeat(12),
        "x".repeat(64)
    );
    let marked = format!("{rod} --force 60..90kN");
    let measurements = [
        ("ambient", ("aisle.mcap", rod, 0)),
        ("long-names", ("aisle.mcap", &long, 0)),
        ("marked", ("aisle.mcap", &marked, 0)),
        (
            "pull-refused",
            ("todi-pull.mcap", "--length 14 --section s71.5", 3),
        ),
        ("early-refused", ("aisle.mcap", "--length 1 --section s200", 3)),
    ];
    let mut looks: Vec<(&str, PathBuf)> = measurements
        .into_iter()
        .map(|(name, measurement)| (name, measured(&at.join(name), measurement)))
        .collect();
    looks.push(("crowded", crowded(at)));
    for (name, report) in looks {
        let device = |width: u32, media: &str| {
            let size = json!({"width": width, "height": 1000, "deviceScaleFactor": 1, "mobile": false});
            for (cmd, params) in [
                ("Emulation.setDeviceMetricsOverride", size),
                ("Emulation.setEmulatedMedia", json!({"media": media})),
            ] {
                browser.post("/goog/cdp/execute", &json!({"cmd": cmd, "params": params}));
            }
        };
        browser.post("/url", &json!({"url": format!("file://{}", report.display())}));
        assert_eq!(pages(&browser, name), 1, "{name}");
        device(PAPER, "print");
        let smallest = browser.run(SMALLEST).as_f64().unwrap();
        assert!(smallest > LETTER - 0.05, "{name}: letters of {smallest:.2} px");
        let wide = browser
            .run("return document.documentElement.scrollWidth")
            .as_u64();
        assert!(wide <= Some(u64::from(PAPER)), "{name}: {wide:?} px wide");
        device(1000, "");
        // The annex is printed on request, behind the sheet.
        browser.run("document.querySelector('.annex').open = true");
        let all = pages(&browser, &format!("{name}-annex"));
        assert!((2..=5).contains(&all), "{name}: {all} pages");
    }
}
