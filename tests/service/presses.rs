//! What is pressed on the page, in a real browser: answers that come late, failures, stretches of time without end, zooms, saved
//! figures. tests/service/browser.rs tests what is drawn.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::browser::{Browser, DRAWN};
use crate::server::Server;
use crate::site::{Site, campaign};
use serde_json::{Value as Json, json};
use std::sync::LazyLock;
use std::thread;
use std::time::Duration;

/// The campaign's store, made once.
static CAMPAIGN: LazyLock<Site> = LazyLock::new(|| {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    site
});

const ALARMS: &str = "return document.querySelectorAll('tr[data-alarm]').length > 0";
const LISTED: &str = "return document.querySelectorAll('tr[data-start]').length === 25";

/// Makes requests that contain a text wait for a second, and tells how often they were asked.
fn delay(browser: &Browser, part: &str) {
    browser.run(&format!(
        "const real = window.fetch; window.asked = 0; window.answered = 0;
         window.fetch = async (path, options) => {{
           if (!path.includes('{part}')) return real(path, options);
           window.asked += 1;
           const answer = await real(path, options);
           await new Promise((resolve) => setTimeout(resolve, 1000));
           setTimeout(() => {{ window.answered += 1; }}, 300);
           return answer;
         }};"
    ));
}

/// Answers requests that contain a text with this instead.
fn instead(browser: &Browser, part: &str, status: u16, answer: &Json) {
    browser.run(&format!(
        "const real = window.fetch;
         window.fetch = (path, options) => path.includes('{part}')
           ? Promise.resolve(new Response({}, {{ status: {status} }})) : real(path, options);",
        json!(answer.to_string())
    ));
}

#[test]
fn the_list_of_alarms_is_that_of_the_button_pressed_last() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/alarms");
    browser.wait("the alarms", ALARMS);
    instead(
        &browser,
        "standing=true",
        200,
        &json!({"alarms": [], "next": null}),
    );
    delay(&browser, "standing=false");
    browser.run("const [standing, all] = document.querySelectorAll('button[aria-pressed]'); all.click(); standing.click()");
    browser.wait("the late answer", "return window.answered > 0");
    let says = "return document.getElementById('content').innerText.includes('No alarm stands.')
        && document.querySelectorAll('tr[data-alarm]').length === 0";
    browser.wait("the answer to the last press", says);
    thread::sleep(Duration::from_millis(500));
    assert_eq!(browser.run(says), json!(true));
    // A press that fails says so, and the next that does not clears it.
    instead(
        &browser,
        "standing=false",
        500,
        &json!({"error": "the store is away"}),
    );
    browser.run("document.querySelectorAll('button[aria-pressed]')[1].click()");
    let failed = "return document.querySelector('.failed')?.textContent === 'The store is away'";
    browser.wait("the failure", failed);
    browser.run("document.querySelectorAll('button[aria-pressed]')[0].click()");
    browser.wait("its end", "return document.querySelector('.failed') === null");
}

#[test]
fn records_are_listed_once_and_under_their_own_heading() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    let older = "[...document.querySelectorAll('button')].find((b) => b.textContent === 'older ones')";
    browser.open(&server, "/rod?id=north");
    browser.wait("the records", LISTED);
    browser.wait("the plots", DRAWN);
    delay(&browser, "before=");
    browser.run(&format!("const b = {older}; b.click(); b.click()"));
    browser.wait("the answer", "return window.answered > 0");
    let starts = browser
        .run("return [...document.querySelectorAll('tr[data-start]')].map((row) => row.dataset.start)");
    let starts = starts.as_array().unwrap();
    let mut once = starts.clone();
    once.dedup();
    assert_eq!((starts.len(), browser.run("return window.asked")), (50, json!(1)));
    assert_eq!(&once, starts);

    browser.open(&server, "/rod?id=north");
    browser.wait("the records", LISTED);
    delay(&browser, "before=");
    browser.run(&format!(
        "{older}.click(); document.getElementById('rejected').click()"
    ));
    browser.wait("the late answer", "return window.answered > 0");
    let all_rejected = "const rows = [...document.querySelectorAll('tr[data-start] td[data-name=result]')];
        return rows.length > 0 && rows.every((cell) => cell.textContent.startsWith('rejected'))";
    assert_eq!(browser.run(all_rejected), json!(true));

    // A list that failed is left as it was, and said to.
    instead(
        &browser,
        "rejected=false",
        503,
        &json!({"error": "the store is away"}),
    );
    browser.run("document.getElementById('rejected').click()");
    browser.wait(
        "the failure",
        "return document.querySelector('.failed')?.textContent === 'The store is away'",
    );
    assert_eq!(browser.run(all_rejected), json!(true));
}

#[test]
fn no_press_leaves_the_calendar() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/rod?id=south");
    browser.wait("the plots", DRAWN);
    let span = browser.run("return JSON.parse(document.getElementById('relative').dataset.axes).x");
    let length = |range: &Json| range[1].as_f64().unwrap() - range[0].as_f64().unwrap();
    let axes = "JSON.parse(document.getElementById('relative').dataset.axes).x";
    for (name, times) in [("wider", 12), ("later", 12), ("earlier", 30), ("closer", 3)] {
        for _ in 0..times {
            browser.run(&format!(
                "document.querySelector('button[aria-label={name}]').click()"
            ));
        }
        // The address is the stretch that is drawn, or that nothing is said to lie in.
        let settled = "const kept = new URLSearchParams(location.hash.slice(1)), drawn = document.getElementById('nothing');
             const near = (a, b) => Math.abs(a - Date.parse(kept.get(b))) < 1;
             return !drawn.hidden || (near(AXES[0], 'from') && near(AXES[1], 'to'))";
        browser.wait(name, &settled.replace("AXES", axes));
        let kept = browser.run(
            "const kept = new URLSearchParams(location.hash.slice(1));
            return ['from', 'to'].map((end) => Date.parse(kept.get(end)))",
        );
        assert!(
            length(&kept) > 0.0 && length(&kept) <= 3.001 * length(&span),
            "{name}: {kept} {span}"
        );
        assert_eq!(
            browser.run("return document.querySelector('.failed')"),
            Json::Null,
            "{name}"
        );
    }
    for _ in 0..40 {
        browser.run("document.querySelector('button[aria-label=closer]').click()");
    }
    let empty = "const words = document.getElementById('nothing');
        return !words.hidden && words.textContent.startsWith('No record lies between')";
    browser.wait("words in place of figures", empty);
    let kept = browser.run("return location.hash");
    browser.run("location.reload()");
    browser.wait("the same after a reload", empty);
    assert_eq!(browser.run("return location.hash"), kept);
    // An address of another time than the calendar's is brought into it.
    browser.open(&server, "/");
    browser.open(&server, "/rod?id=south#from=1500-01-01&to=9999-01-01");
    browser.wait("the plots of all times", DRAWN);

    instead(&browser, "/history", 500, &json!({"error": "the store is away"}));
    browser.run("document.querySelector('button[data-days=\"30\"]').click()");
    browser.wait(
        "the failure",
        "return document.querySelector('.failed')?.textContent === 'The store is away'",
    );
}

/// Drags across the middle of a figure, from one share of its width to another.
fn drag(browser: &Browser, plot: &str, shares: [f64; 2]) {
    browser.run(&format!(
        "document.getElementById('{plot}').scrollIntoView({{ block: 'center', behavior: 'instant' }})"
    ));
    let place = browser.run(&format!(
        "const r = document.getElementById('{plot}').getBoundingClientRect(); return [r.left, r.top, r.width, r.height]"
    ));
    let at = |index: usize| place[index].as_f64().unwrap();
    let moved = |share: f64| json!({"type": "pointerMove", "duration": 50, "x": (at(0) + share * at(2)) as i64, "y": (at(1) + 0.5 * at(3)) as i64});
    browser.post(
        "/actions",
        &json!({"actions": [{"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": [
            moved(shares[0]), {"type": "pointerDown", "button": 0}, moved(shares[1]), {"type": "pointerUp", "button": 0},
        ]}]}),
    );
}

#[test]
fn a_zoom_is_of_one_quantity_and_can_be_left_without_a_mouse() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/rod?id=south");
    browser.wait("the plots", DRAWN);
    let axis = || browser.run("return JSON.parse(document.getElementById('density').dataset.axes).x");
    let choose = |quantity: &str| {
        browser.run(&format!(
            "const choice = document.getElementById('quantity'); choice.value = '{quantity}'; choice.dispatchEvent(new Event('change'))"
        ));
    };
    let whole = "const b = document.querySelector('#density ~ .save .whole'); return b.hidden ? 'hidden' : b.textContent";
    let points = "const line = document.querySelector('#density path.line'), [from, to] = JSON.parse(document.getElementById('density').dataset.axes).y;
        return line !== null && to > from && !(from === 0 && to === 1)";
    choose("axial_force_n");
    let all = axis();
    drag(&browser, "density", [0.4, 0.6]);
    let part = axis();
    assert!(
        part[0].as_f64() > all[0].as_f64() && part[1].as_f64() < all[1].as_f64(),
        "{part} {all}"
    );
    assert_eq!(browser.run(whole), "whole figure");
    choose("density_kg_m3");
    assert_eq!(browser.run(whole), "hidden");
    assert!(axis()[0].as_f64().unwrap() > 5000.0, "{}", axis());
    assert_eq!(browser.run(points), json!(true));
    // A drag, then the button in place of the double click.
    choose("axial_force_n");
    assert_eq!(axis(), all);
    drag(&browser, "density", [0.4, 0.6]);
    browser.run("document.querySelector('#density ~ .save .whole').click()");
    assert_eq!((axis(), browser.run(whole)), (all, json!("hidden")));
}

#[test]
fn saved_figures_name_their_rod_and_hold_what_was_found() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/rod?id=south");
    browser.wait("the plots", DRAWN);
    let mut chart = server.get("/api/v1/rods/south/chart");
    let count = chart["time"].as_array().unwrap().len();
    assert!(count > 3);
    // Beyond both ends of the axis.
    let found: Vec<f64> = (0..count).map(|n| [1e-9, 0.5, 123_456.0][n % 3]).collect();
    chart["evidence"] = json!(found);
    instead(&browser, "/chart", 200, &chart);
    browser.run("document.querySelector('button[data-days=null]').click()");
    browser.wait(
        "the chart",
        "return document.querySelector('button[data-days=null]').getAttribute('aria-pressed') === 'true'
         && JSON.parse(document.getElementById('charts').dataset.axes).y[1] === 3.1",
    );
    thread::sleep(Duration::from_millis(500));
    let save = |plot: &str, kind: &str| -> Json {
        let script = format!(
            "const done = arguments[0], click = HTMLAnchorElement.prototype.click;
             let text = null;
             URL.createObjectURL = (blob) => {{ text = blob.text(); return 'data:,'; }};
             HTMLAnchorElement.prototype.click = function () {{ text.then((words) => done([this.download, words])); }};
             document.querySelector('button[aria-label=\"save {plot} as {kind}\"]').click();
             HTMLAnchorElement.prototype.click = click;"
        );
        browser.post("/execute/async", &json!({"script": script, "args": []}))
    };
    let saved = save("charts", "CSV");
    assert_eq!(saved[0], "south-charts.csv");
    let rows: Vec<&str> = saved[1].as_str().unwrap().lines().collect();
    let column: Vec<f64> = rows[1..]
        .iter()
        .filter_map(|row| row.split(',').nth(1)?.parse().ok())
        .collect();
    assert_eq!(column, found, "{rows:?}");
    let picture = save("relative", "SVG");
    assert_eq!(picture[0], "south-relative.svg");
    assert!(
        picture[1]
            .as_str()
            .unwrap()
            .contains(">south: Change of the axial force"),
        "{picture}"
    );
}

#[test]
fn an_older_browser_and_a_broken_page_are_told_from_a_silent_server() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    // As in browsers of 2022.
    let source =
        "delete Map.groupBy; delete Object.groupBy; delete Array.fromAsync; delete Promise.withResolvers;
        for (const name of ['toSorted', 'toReversed', 'toSpliced', 'with']) delete Array.prototype[name];";
    browser.post(
        "/goog/cdp/execute",
        &json!({"cmd": "Page.addScriptToEvaluateOnNewDocument", "params": {"source": source}}),
    );
    browser.open(&server, "/");
    browser.wait(
        "the overview",
        "return document.querySelectorAll('tr[data-rod]').length === 2",
    );
    assert_eq!(browser.run("return typeof Map.groupBy"), "undefined");
    browser.open(&server, "/rod?id=south");
    browser.wait("the plots", DRAWN);
    browser.open(&server, "/alarms");
    browser.wait("the alarms", ALARMS);
    assert_eq!(browser.complaints(), [""; 0]);

    let words = "return document.querySelector('.failed')?.textContent ?? ''";
    let press = "document.querySelectorAll('button[aria-pressed]')[1].click()";
    browser.run("window.fetch = () => Promise.reject(new TypeError('Failed to fetch'))");
    browser.run(press);
    browser.wait("the failure", "return document.querySelector('.failed') !== null");
    assert_eq!(browser.run(words), "The server did not answer: Failed to fetch");
    browser.run("window.fetch = () => Promise.resolve(new Response('{}'))");
    browser.run(press);
    browser.wait(
        "the break",
        "return document.querySelector('.failed').textContent.startsWith('This page broke: ')",
    );
}

#[test]
fn a_stop_is_told_once_and_the_rest_beneath_it() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    let mut site = server.get("/api/v1/site");
    let condition = |kind: &str, about: &str, detail: &str, is_told: bool| json!({"kind": kind, "about": about, "detail": detail, "since": "2026-02-01T10:00:00Z", "is_told": is_told});
    site["monitoring"] = json!({
        "stopped_since": "2026-02-01T10:00:00Z",
        "why": "there is no room",
        "conditions": [condition("disk-full", "/data", "there is no room", true), condition("sink", "desk", "it does not answer", false)],
    });
    // A rod whose latest record lies ahead is never fresh.
    site["rods"][0]["latest_record"] = json!("2100-01-01T00:00:00Z");
    site["rods"][0]["records_ahead"] = json!(2);
    browser.open(&server, "/alarms");
    browser.wait("the alarms", ALARMS);
    let source = format!(
        "const real = window.fetch; window.fetch = (path, options) => path.endsWith('api/v1/site')
           ? Promise.resolve(new Response({})) : real(path, options);",
        json!(site.to_string())
    );
    browser.post(
        "/goog/cdp/execute",
        &json!({"cmd": "Page.addScriptToEvaluateOnNewDocument", "params": {"source": source}}),
    );
    browser.open(&server, "/");
    browser.wait(
        "the overview",
        "return document.querySelectorAll('tr[data-rod]').length === 2",
    );
    let text = browser.run("return document.body.innerText");
    let text = text.as_str().unwrap();
    assert_eq!(text.matches("there is no room").count(), 1, "{text}");
    assert!(
        text.contains("monitoring stopped since 2026-02-01 10:00 UTC: /data, there is no room"),
        "{text}"
    );
    assert!(text.contains("sink: desk, it does not answer"), "{text}");
    assert!(text.contains("2 dated after that by a wrong clock"), "{text}");
    let ages = browser.run("return [...document.querySelectorAll('tr[data-rod] .age, #newest .age')].map((e) => [e.textContent, e.className])");
    let ahead = json!(["ahead of this clock", "age stale"]);
    assert_eq!((&ages[0], &ages[1]), (&ahead, &ahead), "{ages}");
}
