//! Page, report and store of a site out of the centre's rows: what the site's own store says, and nothing of what is not on the list.

use super::beats::wait;
use super::fleet::{Fleet, Storage, get, text_of};
use crate::site::Site;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Stdio};
use std::thread;
use std::time::Duration;
use tirante::site::store::{Reader, shapes};

/// What a page asks for, below `/api/v1/`.
const QUESTIONS: [&str; 6] = [
    "alarms",
    "site",
    "rods/north",
    "rods/south",
    "rods/north/records",
    "rods/south/history",
];

/// `tirante serve` of a site's own store.
struct Own {
    child: Child,
    address: String,
}

impl Own {
    fn of(site: &Site) -> Self {
        let words = ["serve", "--store", "site.db", "--listen", "127.0.0.1:0"];
        let mut child = site.command(&words).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
        let line = said.find_map(|line| {
            line.unwrap()
                .split_once("http://")
                .map(|(_, rest)| rest.to_owned())
        });
        let address = line.unwrap().split_whitespace().next().unwrap().to_owned();
        // A pipe that nobody reads would hold it.
        thread::spawn(move || said.count());
        Self { child, address }
    }
}

impl Drop for Own {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Status, head and body of an answer.
fn parts(answer: &str) -> (u16, &str, &str) {
    let (head, body) = answer.split_once("\r\n\r\n").unwrap();
    (head.split(' ').nth(1).unwrap().parse().unwrap(), head, body)
}

/// An answer as JSON, once there is one.
fn json(answer: &str) -> Option<Value> {
    let (status, _, body) = parts(answer);
    (status == 200).then(|| serde_json::from_str(body).unwrap())
}

/// Takes from a site's own answer what the centre does not have: whether a daemon runs, which its heartbeats say; the state of the
/// tracking; the files of records.
fn leave_out(own: &mut Value, centre: &Value) {
    match (own, centre) {
        (Value::Object(own), Value::Object(centre)) => {
            for (key, value) in own.iter_mut() {
                if ["monitoring", "thermal", "file"].contains(&key.as_str()) {
                    assert_eq!(centre[key], Value::Null, "{key}");
                    *value = Value::Null;
                } else {
                    leave_out(value, centre.get(key).unwrap_or(&Value::Null));
                }
            }
        }
        (Value::Array(own), Value::Array(centre)) => {
            for (own, centre) in own.iter_mut().zip(centre) {
                leave_out(own, centre);
            }
        }
        _ => {}
    }
}

/// The page at the centre says of a site what its own store says, as soon as it has everything.
fn assert_same_answers(fleet: &Fleet, place: usize, name: &str) -> Vec<Value> {
    let own = Own::of(&fleet.edges[place].site);
    let mut answers = Vec::new();
    for question in QUESTIONS {
        let path = format!("/api/v1/{question}");
        let (mut here, mut there, mut said) = (None, None, String::new());
        wait(fleet, &format!("{name} answers {question}"), || {
            here = json(&get(&own.address, &path));
            here.is_some()
        });
        // The copy follows within two seconds.
        for _ in 0..100 {
            said = fleet.get(&format!("/sites/{name}{path}"));
            there = json(&said);
            if let (Some(here), Some(there)) = (&mut here, &there) {
                leave_out(here, there);
            }
            if there == here {
                break;
            }
            thread::sleep(Duration::from_millis(100));
        }
        assert_eq!(there, here, "{name}: {question}\n{said}");
        answers.extend(here);
    }
    answers
}

/// A store written by the hub has the rows of the site's own, in every table that is sent.
fn assert_same_store(fleet: &Fleet, place: usize, name: &str) {
    let out = fleet.path(&format!("{name}.db"));
    // What has this name is replaced, as the help says.
    fs::write(&out, "an earlier file").unwrap();
    let path = out.to_str().unwrap();
    let written = fleet.hub_command(&["store", name, "--out", path]);
    assert!(written.status.success(), "{}", text_of(&written.stderr));
    let site = &fleet.edges[place].site;
    let (own, copy) = (
        Reader::open(&site.path("site.db")).unwrap(),
        Reader::open(&out).unwrap(),
    );
    for shape in shapes().unwrap() {
        let (own, copy) = (
            own.copied_rows(&shape).unwrap(),
            copy.copied_rows(&shape).unwrap(),
        );
        assert_eq!(copy, own, "{name}: {}", shape.table);
        let is_filled = ["rod", "segment", "record", "mode", "period", "alarm"].contains(&shape.table);
        assert!(!is_filled || own.len() >= 2, "{name}: {}", shape.table);
    }
    // Nothing goes on with it.
    for words in [
        &["replay", "--config", "site.toml", "--store", path, "archive"][..],
        &["ack", "--store", path, "--all"],
    ] {
        let refused = site.run(words);
        let said = text_of(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{said}");
        assert!(
            said.contains(&format!("copy of site {name}")) && said.contains("hub command"),
            "{said}"
        );
    }
    for what in ["records", "periods", "alarms", "rejections"] {
        let rows = site.history(path, what);
        assert!(!rows.is_empty(), "{what}");
        assert_eq!(rows, site.history("site.db", what), "{name}: {what}");
    }
}

/// What is not on the list is not found, and its name is not put into a document.
fn assert_refused(fleet: &Fleet) {
    for path in [
        "/sites/nowhere",
        "/sites/nowhere/",
        "/sites/nowhere/api/v1/site",
        "/sites/..%2f..%2fetc/",
        "/sites/..%2f..%2fetc%2fpasswd",
        "/sites/todi%2f..%2f..%2fhub.toml/",
        "/sites/todi/assets/..%2f..%2f..%2fhub.toml",
        "/sites/%3Cb%3Etodi%3C%2Fb%3E/",
        "/sites/%3Cb%3Etodi%3C%2Fb%3E",
    ] {
        let answer = fleet.get(path);
        let (status, head, body) = parts(&answer);
        assert_eq!(status, 404, "{path}\n{answer}");
        assert!(
            !body.contains("<b>") && !body.contains("[nats]"),
            "{path}\n{answer}"
        );
        assert!(head.contains("nosniff"), "{path}\n{answer}");
    }
    for words in [
        &["store", "nowhere", "--out", "nowhere.db"][..],
        &["report", "nowhere", "--out", "nowhere.html"],
    ] {
        let refused = fleet.hub_command(words);
        let said = text_of(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{said}");
        assert!(said.contains("nowhere"), "{said}");
    }
    let out = fleet.path("none.db");
    let refused = fleet.hub_command(&["store", "todi", "--segment", "7", "--out", out.to_str().unwrap()]);
    let said = text_of(&refused.stderr);
    assert!(
        refused.status.code() == Some(1) && said.contains("stores of site todi at the centre: 1"),
        "{said}"
    );
    assert!(!out.exists());
    // A store that a daemon writes is not replaced.
    let store = fleet.edges[1].site.path("site.db");
    let before = Reader::open(&store).unwrap().epoch().unwrap();
    let refused = fleet.hub_command(&["store", "todi", "--out", store.to_str().unwrap()]);
    let said = text_of(&refused.stderr);
    assert!(
        refused.status.code() == Some(1) && said.contains("name another file"),
        "{said}"
    );
    assert_eq!(Reader::open(&store).unwrap().epoch().unwrap(), before);
}

fn looked_at(storage: Storage) {
    let Some(mut fleet) = Fleet::of(&["todi", "gubbio"], storage) else {
        return;
    };
    for (name, position) in [("todi", "[42.782, 12.407]"), ("gubbio", "[43.3517, 12.5773]")] {
        let listed = format!("name = \"{name}\"\n");
        fleet.reconfigure_hub(|text| text.replace(&listed, &format!("{listed}position = {position}\n")));
    }
    // Of whatever age the campaign is by now.
    fleet.reconfigure_hub(|text| text + "[copies]\ndays = 36500\n");
    fleet.hide_later_weeks(0);
    fleet.start_hub();
    fleet.wait_for_hub_log(0, "all sites at http://");
    fleet.start_edge(0);
    fleet.wait_until_read(0, 3);
    fleet.wait_until_sent_of(0);

    // The first question begins the copy; the document is there at once.
    let first = fleet.get("/sites/todi/api/v1/site");
    let (status, head, body) = parts(&first);
    assert_eq!(status, 503, "{first}");
    assert!(
        head.to_ascii_lowercase().contains("\r\nretry-after: 1"),
        "{first}"
    );
    assert!(
        body.contains("the centre's rows of todi are being read"),
        "{first}"
    );
    let own = Own::of(&fleet.edges[0].site);
    let (here, there) = (get(&own.address, "/"), fleet.get("/sites/todi/"));
    assert_eq!(parts(&there).0, 200, "{there}");
    assert_eq!(parts(&there).2, parts(&here).2);
    drop(own);
    // The page knows by a file of the centre's own that it is below a list of sites, and that it can acknowledge nothing.
    let place = fleet.get("/sites/todi/assets/place.js");
    assert!(
        place.contains("siteAtCentre = \"todi\"") && place.contains("text/javascript"),
        "{place}"
    );
    let described = fleet.get("/api/v1/openapi.json");
    assert!(
        json(&described).unwrap()["paths"]["/api/v1/sites"].is_object(),
        "{described}"
    );
    let slash = fleet.get("/sites/todi");
    assert!(
        parts(&slash).0 == 308 && slash.to_ascii_lowercase().contains("location: todi/"),
        "{slash}"
    );
    // Of a site that has sent nothing there is nothing to read.
    wait(&fleet, "no store of gubbio", || {
        let answer = fleet.get("/sites/gubbio/api/v1/site");
        parts(&answer).0 == 503 && answer.contains("the centre has no store of site gubbio")
    });
    let before = assert_same_answers(&fleet, 0, "todi");

    // What comes later is shown without another word.
    fleet.start_edge(1);
    fleet.show_later_weeks(0);
    fleet.wait_until_complete();
    let after = assert_same_answers(&fleet, 0, "todi");
    assert_same_answers(&fleet, 1, "gubbio");
    let alarms = |answers: &[Value]| answers[0]["alarms"].as_array().unwrap().len();
    assert!(alarms(&after) > alarms(&before), "{after:?}");
    if let (Some(before), Some(after)) = (before.get(2), after.get(2)) {
        let of = |rod: &Value| (rod["records"].as_u64().unwrap(), rod["force_n"].clone());
        assert!(of(after).0 > of(before).0 + 20, "{before} {after}");
        assert!(
            of(after).1 != of(before).1 && !of(after).1.is_null(),
            "{before} {after}"
        );
    }

    let page = fleet.get("/");
    let (_, map) = page.split_once("<svg id=\"map\"").unwrap();
    let (map, list) = map.split_once("</svg>").unwrap();
    for (place, name) in ["todi", "gubbio"].into_iter().enumerate() {
        let link = format!("<a href=\"sites/{name}/\">");
        assert!(map.contains(&link) && list.contains(&link), "{page}");
        assert!(map.contains(&format!("{link}<circle class=alarm ")), "{page}");
        assert_same_store(&fleet, place, name);
    }
    assert_eq!(map.matches("<circle").count(), 2, "{page}");

    // The report of the site's own store, in the folder that is named.
    let folder = fleet.path("reports");
    let written = fleet.hub_command(&["report", "todi", "--out", folder.to_str().unwrap()]);
    assert!(written.status.success(), "{}", text_of(&written.stderr));
    let page = fs::read_to_string(text_of(&written.stdout).trim()).unwrap();
    assert!(text_of(&written.stdout).starts_with(folder.to_str().unwrap()));
    for word in ["Two rods", "north", "south", "kN", "<svg"] {
        assert!(page.contains(word), "{word}");
    }
    let out = fleet.path("north.html");
    let written = fleet.hub_command(&["report", "todi", "--rod", "north", "--out", out.to_str().unwrap()]);
    assert!(written.status.success(), "{}", text_of(&written.stderr));
    let one = fs::read_to_string(&out).unwrap();
    assert!(one.contains("north") && one.len() < page.len());
    assert_refused(&fleet);
}

#[test]
fn a_site_in_a_file_looks_as_from_its_own_store() {
    looked_at(Storage::Sqlite);
}

#[test]
fn a_site_in_a_server_looks_as_from_its_own_store() {
    looked_at(Storage::Postgres);
}
