//! Every page in every state, light and dark, on a phone, a tablet and a desk: what it says, that nothing is cut off or moves while it
//! loads, and that bands are drawn as the data are, at gaps too.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::browser::{Browser, DRAWN, drawn_is_data};
use crate::server::Server;
use crate::site::{Part, SITE, Site, campaign, copy, noon, text};
use serde_json::{Value as Json, json};
use std::path::PathBuf;
use std::time::{SystemTime, UNIX_EPOCH};

/// Widths \[px\] of a phone, a tablet and a desk.
const WIDTHS: [u32; 3] = [390, 800, 1400];

/// A page: path, name, condition that it is there, and its words.
type Page = (&'static str, &'static str, &'static str, &'static [&'static str]);

/// A state of a site, with the pages that show it.
struct State {
    name: &'static str,
    site: Site,
    pages: Vec<Page>,
}

const ROWS: &str = "return document.querySelectorAll('tr[data-rod]').length === 2";
const SETTLED: &str = "return document.getElementById('content').getAttribute('aria-busy') === 'false'";

fn states() -> Vec<State> {
    let alarm = campaign();
    alarm.replay(&["archive"], "site.db");

    // Two weeks are missing but for one day between them.
    let gaps = Site::new(SITE);
    std::fs::create_dir_all(gaps.path("archive")).unwrap();
    for week in [0, 1, 2, 5, 6] {
        let name = format!("archive/week-{week}.mcap");
        copy(&alarm.path(&name), &gaps.path(&name));
    }
    gaps.simulate("week-4", &Part::new(32, 1));
    gaps.replay(&["archive"], "site.db");

    let one = Site::new(SITE);
    one.simulate("first", &Part::new(0, 1));
    one.replay(&["archive"], "site.db");

    let none = Site::new(SITE);
    none.replay(&["archive"], "site.db");

    // Up to yesterday.
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_nanos() as i64;
    let today = (now - noon(0).as_nanos()) / 86_400_000_000_000;
    let fresh = Site::new(SITE);
    fresh.simulate("month", &Part::new(today - 27, 28));
    fresh.replay(&["archive"], "site.db");

    vec![
        State {
            name: "alarm",
            site: alarm,
            pages: vec![
                (
                    "/",
                    "site",
                    ROWS,
                    &["alarms standing", "no new data (monitoring)", "d ago"],
                ),
                (
                    "/rod?id=north",
                    "rod",
                    DRAWN,
                    &["onset of the change", "limit of loss", "archive/week-6.mcap"],
                ),
                ("/alarms", "alarms", SETTLED, &["drift", "acknowledge"]),
            ],
        },
        State {
            name: "gaps",
            site: gaps,
            pages: vec![
                ("/", "site", ROWS, &["no new data (monitoring)"]),
                ("/rod?id=south", "rod", DRAWN, &["At a gap the line stops"]),
            ],
        },
        State {
            name: "one",
            site: one,
            pages: vec![
                (
                    "/",
                    "site",
                    ROWS,
                    &[
                        "of one record alone",
                        "9 more records for the baseline",
                        "no new data (learning)",
                    ],
                ),
                (
                    "/rod?id=north",
                    "rod",
                    SETTLED,
                    &["9 more records for the baseline", "of the latest record alone"],
                ),
                ("/alarms", "alarms", SETTLED, &["No alarm stands."]),
            ],
        },
        State {
            name: "none",
            site: none,
            pages: vec![
                (
                    "/",
                    "site",
                    SETTLED,
                    &[
                        "never",
                        "no record has come yet",
                        "under the topic of the configuration",
                    ],
                ),
                (
                    "/rod?id=north",
                    "rod",
                    SETTLED,
                    &["No record has come yet", "There are no records."],
                ),
                (
                    "/rod?id=nobody",
                    "stranger",
                    "return document.querySelector('.failed') !== null",
                    &["The store has no rod nobody"],
                ),
                ("/alarms", "alarms", SETTLED, &["No alarm stands."]),
            ],
        },
        State {
            name: "fresh",
            site: fresh,
            pages: vec![
                ("/", "site", ROWS, &["no alarm stands", "monitoring"]),
                (
                    "/rod?id=south",
                    "rod",
                    DRAWN,
                    &["monitoring", "given the baseline"],
                ),
            ],
        },
    ]
}

fn look(browser: &Browser, width: u32, is_dark: bool) {
    let size = json!({"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500});
    let scheme = if is_dark { "dark" } else { "light" };
    let media = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
    for (command, parameters) in [
        ("Emulation.setDeviceMetricsOverride", size),
        ("Emulation.setEmulatedMedia", media),
    ] {
        browser.post(
            "/goog/cdp/execute",
            &json!({"cmd": command, "params": parameters}),
        );
    }
}

/// Rules of WCAG 2.2 (A, AA) and good practice that a document breaks, each with the first places, as axe-core finds them.
fn barriers(browser: &Browser, axe: &str) -> Json {
    browser.run(&format!("if (!window.axe) {{ {axe} }}"));
    let script = "const done = arguments[0];
        axe.run().then((found) => done(found.violations.map((rule) => [rule.id, rule.help,
          rule.nodes.slice(0, 3).map((node) => node.html.slice(0, 200) + ' ' + node.failureSummary)])),
          (error) => done(String(error)));";
    browser.post("/execute/async", &json!({"script": script, "args": []}))
}

/// With `LOOKS` set to a folder, every view is written there as a picture. With `AXE` set to the file `axe.min.js` of axe-core, every
/// view is examined by it.
#[test]
fn every_state_is_shown_as_it_is() {
    let Some(browser) = Browser::start(1400, 900, false) else {
        return;
    };
    let folder = std::env::var_os("LOOKS").map(PathBuf::from);
    let axe =
        std::env::var_os("AXE").map(|path| std::fs::read_to_string(path).expect("AXE names axe.min.js"));
    for state in states() {
        let server = Server::of(&state.site, "site.db");
        for (path, name, ready, words) in &state.pages {
            for width in WIDTHS {
                for is_dark in [false, true] {
                    let view = format!(
                        "{}-{name}-{width}-{}",
                        state.name,
                        if is_dark { "dark" } else { "light" }
                    );
                    look(&browser, width, is_dark);
                    browser.open(&server, path);
                    browser.wait(&view, ready);
                    let said = browser
                        .run("return document.body.innerText")
                        .as_str()
                        .unwrap()
                        .to_owned();
                    for wanted in *words {
                        assert!(said.contains(wanted), "{view}: no {wanted:?} in {said}");
                    }
                    let wider =
                        browser.run("return document.documentElement.scrollWidth - window.innerWidth");
                    assert!(wider.as_i64().unwrap() <= 0, "{view} is {wider} px too wide");
                    let cut = browser.run(
                        "return [...document.querySelectorAll('.facts > div, .note, h1, h2, figcaption, .scroll')]
                         .filter((e) => e.scrollWidth > e.clientWidth).map((e) => e.innerText)",
                    );
                    assert_eq!(cut, json!([]), "{view}: cut off");
                    // A heading has something beneath it, and a choice something to choose.
                    let empty = browser.run(
                        "const seen = (e) => e.checkVisibility();
                         const all = [...document.querySelectorAll('#content > *')].filter(seen);
                         return [...all.filter((e, i) => e.tagName === 'H2' && (!all[i + 1] || all[i + 1].tagName === 'H2')).map((e) => e.innerText)
                           .filter((words) => words !== 'No record identified yet'),
                           ...[...document.querySelectorAll('select')].filter((e) => seen(e) && !e.options.length).map((e) => e.id)]",
                    );
                    assert_eq!(empty, json!([]), "{view}: empty");
                    // Sum of all shifts that no one asked for: more than 0.1 disturbs reading (web.dev/cls).
                    let shift = browser.run(
                        "let sum = 0; const seen = new PerformanceObserver(() => {});
                         seen.observe({type: 'layout-shift', buffered: true});
                         for (const shift of seen.takeRecords()) if (!shift.hadRecentInput) sum += shift.value;
                         return sum",
                    );
                    assert!(shift.as_f64().unwrap() < 0.1, "{view}: {shift}");
                    if let Some(axe) = &axe {
                        assert_eq!(barriers(&browser, axe), json!([]), "{view}");
                    }
                    if let Some(folder) = &folder {
                        std::fs::create_dir_all(folder).unwrap();
                        browser.screenshot(&folder.join(format!("{view}.png")), 8000);
                    }
                }
            }
        }
        look(&browser, 1400, false);
        if state.name == "gaps" {
            browser.open(&server, "/rod?id=south");
            browser.wait("the plots", DRAWN);
            let history = server.get("/api/v1/rods/south/history");
            let change = |ratio: f64| 100.0 * (ratio - 1.0);
            let kilo = |newtons: f64| 1e-3 * newtons;
            for (drawn, column, scale) in [
                (
                    ("relative", "c1"),
                    "relative_force_at_reference",
                    change as fn(f64) -> f64,
                ),
                (("absolute", "c4"), "axial_force_n", kilo),
                (("absolute", "c1"), "force_at_reference_n", kilo),
            ] {
                let stretches = drawn_is_data(&browser, drawn, (&history, column), scale);
                assert!(
                    stretches.len() >= 3 && stretches.contains(&1),
                    "{column}: {stretches:?}"
                );
            }
        }
        // The page is left before its server ends: a stream of events that breaks off is a complaint of the browser.
        browser.post("/url", &json!({"url": "about:blank"}));
        // Requests for rods and stores that are not there are refused by design, and the browser notes them.
        let complaints = browser.complaints();
        let ours: Vec<_> = complaints.iter().filter(|text| !text.contains("404")).collect();
        assert!(ours.is_empty(), "{}: {ours:?}", state.name);
    }
}

/// What hides a line stays, though its name changes with the data.
#[test]
fn a_hidden_line_stays_hidden() {
    let site = Site::new(SITE);
    site.simulate("first", &Part::new(0, 20));
    site.replay(&["archive"], "site.db");
    let server = Server::of(&site, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/rod?id=south");
    let buttons = "[...document.querySelectorAll('#frequencies')].map((p) => p.closest('figure'))[0].querySelectorAll('.legend button')";
    browser.wait("the frequencies", &format!("return {buttons}.length === 3"));
    let name = browser.run(&format!("{buttons}[0].click(); return {buttons}[0].textContent"));
    let lines = "return document.querySelectorAll('#frequencies path.line').length";
    assert_eq!(browser.run(lines), json!(2));
    // A loss moves the median.
    let loss = "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n";
    site.simulate("later", &Part::new(20, 30).south(loss));
    site.replay(&["archive"], "site.db");
    browser.wait(
        "another median",
        &format!("return {buttons}[0].textContent !== {name}"),
    );
    assert_eq!(browser.run(lines), json!(2));
    assert_eq!(
        browser.run(&format!("return {buttons}[0].getAttribute('aria-pressed')")),
        json!("false")
    );
}

/// Pictures for the README, into the folder `SCREENSHOTS`.
#[test]
#[ignore = "writes pictures: SCREENSHOTS=docs/images cargo test --test service -- --ignored screenshots"]
fn screenshots() {
    let folder = PathBuf::from(std::env::var_os("SCREENSHOTS").expect("SCREENSHOTS names a folder"));
    std::fs::create_dir_all(&folder).unwrap();
    let site = campaign();
    site.replay(&["archive"], "site.db");
    let server = Server::of(&site, "site.db");
    let browser = Browser::start(1400, 900, false).expect("chromedriver");
    let report = site.path("report.html");
    let root = env!("CARGO_MANIFEST_DIR");
    let (recording, config) = (
        format!("{root}/recordings/campaign-2025.mcap"),
        format!("{root}/config/campaign.toml"),
    );
    for words in [
        &["replay", &recording, "--config", &config, "--store", "half.db"][..],
        &["report", "--store", "half.db", "--out", report.to_str().unwrap()],
    ] {
        let output = site.run(words);
        assert!(output.status.success(), "{}", text(&output.stderr));
    }
    look(&browser, 940, false);
    browser.post("/url", &json!({"url": format!("file://{}", report.display())}));
    browser.wait("the report", "return document.querySelectorAll('svg').length > 3");
    browser.screenshot(&folder.join("report.png"), 1330);
    for (name, path, ready, width, is_dark) in [
        ("site", "/", ROWS, 1280, false),
        ("rod", "/rod?id=north", DRAWN, 1280, false),
        ("alarms", "/alarms", SETTLED, 1280, false),
        ("rod-phone-dark", "/rod?id=north", DRAWN, 500, true),
    ] {
        look(&browser, width, is_dark);
        browser.open(&server, path);
        browser.wait(name, ready);
        browser.wait("records", "return document.querySelector('table') !== null");
        browser.screenshot(&folder.join(format!("{name}.png")), 2200);
    }
}
