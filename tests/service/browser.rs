//! The page in a real browser: it draws without a network, a new record appears by itself, an acknowledgement lands. Chromium is
//! driven by its own driver; without one the test reports that it is skipped, or fails with
//! `TIRANTE_REAL_PEERS`.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::server::{Server, TOKEN};
use crate::site::{Part, SITE, Site, campaign, doubtful_table};
use serde_json::{Value as Json, json};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tirante::site::store::Reader;

/// Longest wait for a page on a busy machine.
const PATIENCE: Duration = Duration::from_secs(90);

/// A browser without a window.
pub(super) struct Browser {
    driver: Child,
    session: String,
}

/// A driver and its port; `None` if there is none on this machine.
fn driver() -> Option<(Child, u16)> {
    // Seldom one ends before it listens, seen beside others that start.
    for _ in 0..5 {
        let driver = Command::new("chromedriver")
            .arg("--port=0")
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn();
        let Ok(mut driver) = driver else {
            assert!(
                std::env::var_os("TIRANTE_REAL_PEERS").is_none(),
                "chromedriver is not installed"
            );
            eprintln!("left out: chromedriver is not installed");
            return None;
        };
        // "ChromeDriver was started successfully on port 12345."
        let port = BufReader::new(driver.stdout.take().unwrap())
            .lines()
            .map_while(Result::ok)
            .find_map(|line| {
                let (_, port) = line.split_once("successfully on port ")?;
                port.trim_end_matches('.').parse::<u16>().ok()
            });
        if let Some(port) = port {
            return Some((driver, port));
        }
        driver.wait().unwrap();
    }
    panic!("chromedriver ends before it listens, five times in a row");
}

impl Browser {
    /// `None` if there is none on this machine.
    pub(super) fn start(width: u32, height: u32, is_dark: bool) -> Option<Self> {
        let (driver, port) = driver()?;
        let mut browser = Self {
            driver,
            session: format!("http://127.0.0.1:{port}/session"),
        };
        let mut arguments = vec![
            "--headless=new".to_owned(),
            "--no-sandbox".to_owned(),
            "--disable-gpu".to_owned(),
            "--disable-dev-shm-usage".to_owned(),
            // Nothing but this machine.
            "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost".to_owned(),
            format!("--window-size={width},{height}"),
        ];
        if is_dark {
            arguments.push("--force-dark-mode".to_owned());
        }
        let options = json!({"capabilities": {"alwaysMatch": {
            "browserName": "chrome",
            "goog:chromeOptions": {"args": arguments},
            "goog:loggingPrefs": {"browser": "ALL"},
        }}});
        let answer = browser.post("", &options);
        let id = answer["sessionId"].as_str().expect("a session").to_owned();
        browser.session = format!("{}/{id}", browser.session);
        Some(browser)
    }

    pub(super) fn post(&self, path: &str, body: &Json) -> Json {
        let agent: ureq::Agent = ureq::Agent::config_builder()
            .timeout_global(Some(PATIENCE))
            .http_status_as_error(false)
            .build()
            .into();
        let mut answer = agent
            .post(format!("{}{path}", self.session))
            .content_type("application/json")
            .send(body.to_string())
            .unwrap();
        let text = answer.body_mut().read_to_string().unwrap();
        let answer: Json = serde_json::from_str(&text).unwrap();
        assert!(answer["value"]["error"].is_null(), "{path}: {answer}");
        answer["value"].clone()
    }

    pub(super) fn open(&self, server: &Server, path: &str) {
        let address = format!("http://127.0.0.1:{}{path}", server.address.port());
        self.post("/url", &json!({"url": address}));
    }

    /// Return value of a script.
    pub(super) fn run(&self, script: &str) -> Json {
        self.post("/execute/sync", &json!({"script": script, "args": []}))
    }

    /// Waits until a script gives `true`.
    pub(super) fn wait(&self, what: &str, script: &str) {
        let until = Instant::now() + PATIENCE;
        while self.run(script) != json!(true) {
            if Instant::now() > until {
                let text = self.run("return document.body.innerText");
                panic!("{what} does not come: {text}\n{}", self.complaints().join("\n"));
            }
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// Messages of the page on the console: script errors, policy violations, failed loads.
    pub(super) fn complaints(&self) -> Vec<String> {
        let log = self.post("/se/log", &json!({"type": "browser"}));
        let entries = log.as_array().cloned().unwrap_or_default();
        entries.iter().map(|entry| entry["message"].to_string()).collect()
    }

    /// A picture of the document's upper `most_px` pixels.
    pub(super) fn screenshot(&self, path: &Path, most_px: u64) {
        // The document, not the window alone.
        let height = self
            .run("return document.documentElement.scrollHeight")
            .as_u64()
            .unwrap();
        let width = self.run("return window.innerWidth").as_u64().unwrap();
        let shot = self.post(
            "/goog/cdp/execute",
            &json!({"cmd": "Page.captureScreenshot", "params": {
                "format": "png", "captureBeyondViewport": true,
                "clip": {"x": 0, "y": 0, "width": width, "height": height.min(most_px), "scale": 1},
            }}),
        );
        std::fs::write(path, decoded(shot["data"].as_str().unwrap())).unwrap();
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = ureq::delete(&self.session).call();
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}

/// Base64 (RFC 4648).
pub(super) fn decoded(text: &str) -> Vec<u8> {
    let alphabet = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let digits: Vec<u32> = text
        .bytes()
        .filter_map(|byte| alphabet.iter().position(|letter| *letter == byte))
        .map(|digit| digit as u32)
        .collect();
    let mut bytes = Vec::new();
    for four in digits.chunks(4) {
        let bits = four.iter().fold(0, |bits, digit| bits << 6 | digit) << (6 * (4 - four.len()));
        bytes.extend(&bits.to_be_bytes()[1..four.len()]);
    }
    bytes
}

pub(super) const DRAWN: &str =
    "const seen = [...document.querySelectorAll('.plot')].filter((p) => !p.closest('figure').hidden);
    return document.getElementById('content').getAttribute('aria-busy') === 'false' && seen.length >= 8
    && seen.every((p) => p.querySelectorAll('path.line, path.dots, path.bar').length > 0)";

#[test]
fn the_page_draws_follows_and_acknowledges() {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    let server = Server::of(&site, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };

    browser.open(&server, "/");
    browser.wait(
        "the overview",
        "return document.querySelectorAll('tr[data-rod]').length === 2",
    );
    browser.wait(
        "the light",
        "return document.getElementById('live').textContent === 'connected'",
    );
    let text = browser.run("return document.body.innerText");
    assert!(
        text.as_str().unwrap().contains("Two rods") && text.as_str().unwrap().contains("alarm"),
        "{text}"
    );

    browser.open(&server, "/rod?id=south");
    browser.wait("the plots", DRAWN);
    let rows = "return document.querySelectorAll('tr[data-start]').length > 10";
    browser.wait("the records", rows);
    // The number on the page is the number of the command.
    let record = site
        .history("site.db", "records")
        .into_iter()
        .rfind(|line| line["rod"] == "south")
        .unwrap();
    let force = record["axial_force_n"]["mean"].as_f64().unwrap() / 1e3;
    let shown = browser.run(
        "return document.querySelector('tr[data-start] td[data-name=\"force, record alone [kN]\"]').firstChild.textContent",
    );
    let shown: f64 = shown.as_str().unwrap().parse().unwrap();
    assert!((shown - force).abs() <= 0.5, "{shown} {force}");
    // Each quantity has one value on the page, and every force is shown with its temperature.
    let said = browser.run(
        "const tile = [...document.querySelectorAll('.facts dt')].find((dt) => dt.textContent.startsWith('axial force'));
         const used = [...document.querySelectorAll('tr[data-start] td[data-name=\"force given the baseline [kN]\"]')]
           .find((cell) => cell.querySelector('small'));
         return [tile.textContent, tile.nextSibling.innerText.split('\\n')[0], used.firstChild.textContent, used.lastChild.textContent]",
    );
    let reference = record["reference_temperature_c"].as_f64().unwrap();
    assert_eq!(
        said[0],
        format!("axial force at {reference:.1} \u{b0}C [kN]"),
        "{said}"
    );
    assert_eq!(said[1], said[2], "{said}");
    assert_eq!(said[3], format!("at {reference:.1} \u{b0}C"), "{said}");
    // The connection is one thing, old data another.
    let age = browser.run("return document.querySelector('#newest .age').className");
    assert_eq!(age, "age stale");
    let history = server.get("/api/v1/rods/south/history");
    let change = |ratio: f64| 100.0 * (ratio - 1.0);
    let stretches = drawn_is_data(
        &browser,
        ("relative", "c1"),
        (&history, "relative_force_at_reference"),
        change,
    );
    assert!(stretches.len() >= 2, "the campaign has a gap: {stretches:?}");
    saved_is_data(&browser, &server);
    let before = browser.run("return document.getElementById('relative').dataset.points");

    // A record comes while the page is open.
    site.simulate("later", &Part::new(56, 2));
    site.replay(&["archive"], "site.db");
    browser.wait(
        "the new record",
        "return document.querySelector('tr[data-start]').dataset.start >= '2026-02-27'",
    );
    browser.wait(
        "the new point",
        &format!("return document.getElementById('relative').dataset.points !== {before}"),
    );
    browser.wait("the plots", DRAWN);

    // The axis follows the buttons.
    browser.run("document.querySelector('button[data-days=\"7\"]').click()");
    browser.wait(
        "a week",
        "return Number(document.getElementById('relative').dataset.points) <= 8",
    );
    // The visible range is kept in the address.
    assert_eq!(browser.run("return location.hash"), "#days=7");
    browser.run("document.querySelector('button[aria-label=closer]').click()");
    let closer = "return Number(document.getElementById('relative').dataset.points) <= 4";
    browser.wait("half a week", closer);
    let address = browser.run("return location.hash");
    assert!(
        address.as_str().unwrap().starts_with("#from=2026-02-2"),
        "{address}"
    );
    browser.run("history.back()");
    browser.wait("the week again", "return location.hash === '#days=7'");
    browser.open(&server, "/alarms");
    browser.open(&server, &format!("/rod?id=south{}", address.as_str().unwrap()));
    browser.wait("the plots of the address", DRAWN);
    assert_eq!(browser.run(closer), json!(true));
    browser.run("document.querySelector('button[data-days=\"7\"]').click()");
    browser.wait(
        "the week",
        "return document.querySelector('button[data-days=\"7\"]').getAttribute('aria-pressed') === 'true'",
    );

    browser.open(&server, "/alarms");
    browser.wait(
        "the alarms",
        "return document.querySelectorAll('tr[data-alarm]').length > 0",
    );
    let id = browser.run("return document.querySelector('tr[data-alarm]').dataset.alarm");
    browser.run("document.querySelector('tr[data-alarm] button').click()");
    browser.wait(
        "the question for the token",
        "return document.querySelector('dialog[open]') !== null",
    );
    browser.run(&format!(
        "document.getElementById('by').value = 'M. Rossi'; document.getElementById('note').value = 'wedge sound';
         document.getElementById('token').value = '{TOKEN}'; document.querySelector('dialog button').click()"
    ));
    browser.wait(
        "the answer",
        "return document.getElementById('said').textContent.includes('acknowledged')",
    );
    let shown = "return document.querySelector('tr[data-alarm]')?.dataset.stands !== 'stands'";
    browser.wait("the mark", shown);
    let alarm = site
        .history("site.db", "alarms")
        .into_iter()
        .find(|alarm| alarm["id"] == id)
        .unwrap();
    assert!(!alarm["acknowledged"].is_null(), "{alarm}");
    assert_eq!(alarm["acknowledged_words"], "M. Rossi: wedge sound");
    // Its name stands on the rod's time axis, at the time of the acknowledging machine: long after these data.
    let all_times = "/rod?id=north#from=2026-01-01T00:00:00Z&to=2100-01-01T00:00:00Z";
    browser.open(&server, all_times);
    browser.wait("the plots of the alarmed rod", DRAWN);
    let titles = browser
        .run("return [...document.querySelectorAll('#relative .strip title')].map((t) => t.textContent)");
    assert!(titles.to_string().contains("M. Rossi: wedge sound"), "{titles}");
    assert_eq!(browser.complaints(), [""; 0]);
}

/// Compares the drawn outline of a band with the API's answer: each stretch without a gap is one closed outline, upper edge forward,
/// lower edge back, and it ends with the data. A gap is a record without a value, or a step in time of more than four times the usual
/// one. Returns the number of records in each stretch.
pub(super) fn drawn_is_data(
    browser: &Browser,
    (plot, shade): (&str, &str),
    (history, column): (&Json, &str),
    scale: fn(f64) -> f64,
) -> Vec<usize> {
    let axes = browser.run(&format!(
        "return JSON.parse(document.getElementById('{plot}').dataset.axes)"
    ));
    let number = |value: &Json| value.as_f64().unwrap();
    let (x, y, area) = (&axes["x"], &axes["y"], &axes["box"]);
    let pixels = |ms: f64, value: f64| {
        let across = (ms - number(&x[0])) / (number(&x[1]) - number(&x[0]));
        let down = (number(&y[1]) - value) / (number(&y[1]) - number(&y[0]));
        [
            number(&area["x"]) + number(&area["w"]) * across,
            number(&area["y"]) + number(&area["h"]) * down,
        ]
    };
    let band = &history[column];
    let times: Vec<f64> = history["time"]
        .as_array()
        .unwrap()
        .iter()
        .map(|time| {
            time.as_str()
                .unwrap()
                .parse::<jiff::Timestamp>()
                .unwrap()
                .as_millisecond() as f64
        })
        .collect();
    let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let far = 4.0 * steps[steps.len() / 2];
    let point = |i: usize, edge: &str| Some(pixels(times[i], scale(band[edge][i].as_f64()?)));
    let mut open: Vec<Vec<usize>> = Vec::new();
    let mut last = None;
    for i in 0..times.len() {
        if point(i, "mean").is_none() {
            last = None;
            continue;
        }
        match (last, open.last_mut()) {
            (Some(before), Some(stretch)) if times[i] - times[before] <= far => stretch.push(i),
            _ => open.push(vec![i]),
        }
        last = Some(i);
    }
    let outline = |stretch: &Vec<usize>| -> Vec<[f64; 2]> {
        let forth = stretch.iter().filter_map(|&i| point(i, "q975"));
        let back = stretch.iter().rev().filter_map(|&i| point(i, "q025"));
        forth.chain(back).collect()
    };
    let wanted: Vec<Vec<[f64; 2]>> = open.iter().map(outline).collect();
    let drawn = browser.run(&format!(
        "return document.querySelector('#{plot} path.band.s-{shade}').getAttribute('d')"
    ));
    let drawn: Vec<Vec<[f64; 2]>> = drawn
        .as_str()
        .unwrap()
        .split_terminator('Z')
        .map(|outline| {
            let points = outline.trim_start_matches('M').split('L');
            points
                .map(|point| {
                    let (x, y) = point.split_once(' ').unwrap();
                    [x.parse().unwrap(), y.parse().unwrap()]
                })
                .collect()
        })
        .collect();
    assert_eq!(
        drawn.iter().map(Vec::len).collect::<Vec<_>>(),
        wanted.iter().map(Vec::len).collect::<Vec<_>>(),
        "{plot}"
    );
    for (drawn, wanted) in drawn.iter().flatten().zip(wanted.iter().flatten()) {
        // Two digits of a pixel are written.
        let off = (drawn[0] - wanted[0]).hypot(drawn[1] - wanted[1]);
        assert!(off < 0.02, "{plot}: {drawn:?} {wanted:?}");
    }
    open.iter().map(Vec::len).collect()
}

/// Compares what `CSV` saves with the answer of the API, digit by digit, and checks that `SVG` saves a
/// picture.
fn saved_is_data(browser: &Browser, server: &Server) {
    let save = |plot: &str, place: usize| {
        let script = format!(
            "const done = arguments[0];
             URL.createObjectURL = (blob) => {{ blob.text().then(done); return 'data:,'; }};
             document.querySelectorAll('#{plot} ~ .save button')[{place}].click();"
        );
        let saved = browser.post("/execute/async", &json!({"script": script, "args": []}));
        saved.as_str().unwrap().to_owned()
    };
    let answer = server.get("/api/v1/rods/south/frequencies");
    let csv = save("frequencies", 0);
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert!(
        rows[0][0] == "time (UTC)" && rows[0][1].ends_with("[Hz]"),
        "{csv}"
    );
    let shown: Vec<usize> = (0..answer["time"].as_array().unwrap().len())
        .filter(|i| {
            let modes = answer["modes"].as_array().unwrap();
            modes.iter().any(|mode| !mode["frequency_hz"][*i].is_null())
        })
        .collect();
    assert_eq!(rows.len() - 1, shown.len());
    for (row, i) in rows[1..].iter().zip(shown) {
        for (place, mode) in answer["modes"].as_array().unwrap().iter().enumerate() {
            let cell = row[1 + 3 * place];
            match mode["frequency_hz"][i].as_f64() {
                Some(frequency_hz) => assert_eq!(cell.parse(), Ok(frequency_hz)),
                None => assert_eq!(cell, ""),
            }
        }
    }
    let picture = save("relative", 1);
    assert!(
        picture.starts_with("<svg")
            && picture.contains("class=\"band")
            && !picture.contains("class=\"cursor"),
        "{picture}"
    );
}

#[test]
fn a_phone_shows_it_without_scrolling_sideways() {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    let server = Server::of(&site, "site.db");
    let Some(browser) = Browser::start(500, 900, true) else {
        return;
    };
    for (path, ready) in [
        (
            "/",
            "return document.querySelectorAll('tr[data-rod]').length === 2",
        ),
        ("/rod?id=north", DRAWN),
        (
            "/alarms",
            "return document.querySelectorAll('tr[data-alarm]').length > 0",
        ),
    ] {
        browser.open(&server, path);
        browser.wait(path, ready);
        let wider = browser.run("return document.documentElement.scrollWidth - window.innerWidth");
        assert!(wider.as_i64().unwrap() <= 0, "{path} is {wider} px too wide");
        // Every control and picture has a name for screen readers.
        let nameless = browser.run(
            "return [...document.querySelectorAll('button, a, input, select, [role=img]')].filter((e) => !e.hidden
             && !(e.textContent.trim() || e.getAttribute('aria-label') || e.getAttribute('aria-labelledby')
             || (e.id && document.querySelector(`label[for=${e.id}]`)))).map((e) => e.outerHTML)",
        );
        assert_eq!(nameless, json!([]), "{path}");
    }
    let dark = browser.run("return matchMedia('(prefers-color-scheme: dark)').matches");
    assert_eq!(dark, json!(true));
    assert_eq!(browser.complaints(), [""; 0]);
}

/// Time from a record's commit to its display on the rod's page \[ms\]: printed, one line per record.
#[test]
#[ignore = "a measurement: cargo test --release --test service -- --ignored --nocapture how_soon"]
fn how_soon_a_commit_is_shown() {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    let server = Server::of(&site, "site.db");
    let browser = Browser::start(1280, 900, false).expect("chromedriver");
    browser.open(&server, "/rod?id=south");
    browser.wait("the plots", DRAWN);
    let reader = Reader::open(&site.path("site.db")).unwrap();
    let mut all = Vec::new();
    for day in 56..76 {
        browser.run(
            "const first = () => document.querySelector('tr[data-start]')?.dataset.start; const was = first();
             window.shownAt = 0;
             const look = () => { if (first() && first() !== was) window.shownAt = Date.now(); else setTimeout(look, 5); };
             look();",
        );
        let after = reader.last_record().unwrap();
        site.simulate(&format!("day-{day}"), &Part::new(day, 1));
        let committed = thread::scope(|scope| {
            scope.spawn(|| site.replay(&[&format!("archive/day-{day}.mcap")], "site.db"));
            let until = Instant::now() + PATIENCE;
            loop {
                let points = reader.points_after(after, 10).unwrap();
                if points.iter().any(|point| point.rod.0 == "south") {
                    return SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
                }
                assert!(Instant::now() < until, "no record comes");
                thread::sleep(Duration::from_millis(2));
            }
        });
        browser.wait("the record", "return window.shownAt > 0");
        let shown_ms = browser.run("return window.shownAt").as_f64().unwrap();
        let took_ms = shown_ms - committed.as_secs_f64() * 1e3;
        println!("day {day}: shown {took_ms:.0} ms after its commit");
        all.push(took_ms);
    }
    all.sort_by(f64::total_cmp);
    println!(
        "median {:.0} ms, largest {:.0} ms",
        all[all.len() / 2],
        all[all.len() - 1]
    );
    assert!(all[0] > 0.0);
}

/// The mark of a doubtful force and its reason, on every page that shows the force: a baseline does not take them away.
#[test]
fn a_force_in_doubt_bears_its_mark_on_every_page() {
    let site = Site::new(SITE);
    std::fs::write(site.path("table.csv"), doubtful_table()).unwrap();
    let output = site.run(&[
        "track",
        "--config",
        "site.toml",
        "table.csv",
        "--store",
        "site.db",
    ]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let server = Server::of(&site, "site.db");
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/");
    browser.wait(
        "the overview",
        "return document.querySelector('tr[data-rod=\"north\"] td[data-name=\"force [kN]\"]')?.textContent.startsWith('! ') === true",
    );
    browser.open(&server, "/rod?id=north");
    browser.wait(
        "the tile and its reason",
        "const tile = [...document.querySelectorAll('.facts dt')].find((dt) => dt.textContent.startsWith('axial force'));
         return tile?.nextSibling.textContent.startsWith('! ') === true
           && [...document.querySelectorAll('p.note')].some((note) => note.textContent.startsWith('hardly any rod of the prior'))",
    );
    browser.wait(
        "the records",
        "const rows = [...document.querySelectorAll('tr[data-start]')];
         const cell = rows[0]?.querySelector('td[data-name=\"force given the baseline [kN]\"]');
         return cell?.textContent.startsWith('! ') === true && rows[0].textContent.includes('hardly in the prior')",
    );
}

/// What a record of several sensors owes to whom, as the API says it; a rod with one sensor shows nothing of the kind.
#[test]
fn a_record_names_its_sensors_and_those_left_out() {
    let second =
        "[[rod.sensor]]\ntopic = \"/north/2\"\nfield = \"values\"\nunit = \"m\"\nfs_hz = 100.0\nat = 0.15\n";
    let topic = "topic = \"/north\"\n";
    assert!(SITE.contains(topic) && SITE.contains("[rod.temperature]"));
    let several = SITE.replacen(topic, &format!("{topic}at = 0.4\n"), 1).replacen(
        "[rod.temperature]",
        &format!("{second}[rod.temperature]"),
        1,
    );
    let site = Site::new(SITE);
    site.simulate("first", &Part::new(0, 3));
    std::fs::write(site.path("site.toml"), several).unwrap();
    site.replay(&["archive/first.mcap"], "site.db");
    let server = Server::of(&site, "site.db");
    let told = &server.get("/api/v1/rods/north/records?limit=1")["records"][0]["sensors"];
    let why = told["left_out"][0]["why"].as_str().unwrap();
    assert_eq!(
        (&told["used"], &told["left_out"][0]["sensor"]),
        (&json!(["/north"]), &json!("/north/2"))
    );
    let Some(browser) = Browser::start(1280, 900, false) else {
        return;
    };
    browser.open(&server, "/rod?id=north");
    let expected = json!(["by /north", format!("without /north/2: {why}")]);
    browser.wait(
        "the sensors",
        &format!(
            "const row = document.querySelector('tr[data-start]');
             const told = [...row?.querySelectorAll('small.sensors') ?? []].map((one) => one.textContent);
             return JSON.stringify(told) === JSON.stringify({expected})"
        ),
    );
    browser.open(&server, "/rod?id=south");
    browser.wait(
        "the other rod",
        "return document.querySelectorAll('tr[data-start]').length > 0 && document.querySelectorAll('small.sensors').length === 0",
    );
}
