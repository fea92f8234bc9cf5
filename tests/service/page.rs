//! The page's server over the store of a campaign: the API's answers equal those of `history` and `status`
//! and match its description, foreign clients are refused, and a new record is announced. tests/service/browser.rs
//! tests the page itself.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::server::{Server, TOKEN};
use crate::site::{Part, SITE, Site, campaign, lines, noon};
use flate2::read::GzDecoder;
use serde_json::{Value as Json, json};
use std::io::{BufRead, BufReader, Read};
use std::sync::LazyLock;
use tirante::analysis::findings::{Assigned, Candidate, Doubt, Multiple, Nature, Quantiles};
use tirante::analysis::inference::Source;
use tirante::analysis::record_view::{PeakMark, Reason, Snapshot};
use tirante::analysis::signal::modes::{Motion, MotionKind};
use tirante::analysis::signal::record::{RodId, Timestamp};
use tirante::service::api::{Days, Looks, Records, SiteAnswer};
use tirante::service::http::{Shown, Unanswered};
use tirante::site::store::{Commit, Durability, SnapshotRow, Store};

/// The campaign's store, made once.
static CAMPAIGN: LazyLock<Site> = LazyLock::new(|| {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    site
});

fn row_of<'j>(rows: &'j Json, key: &str, value: &str) -> &'j Json {
    rows.as_array()
        .unwrap()
        .iter()
        .find(|row| row[key] == value)
        .unwrap()
}

#[test]
fn the_site_says_what_status_says() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let site = server.get("/api/v1/site");
    assert_eq!(site["site"], "Two rods");
    let output = CAMPAIGN.run(&["status", "--store", "site.db", "--format", "json"]);
    for said in lines(&output.stdout) {
        let rod = said["rod"].as_str().unwrap();
        for shown in [
            row_of(&site["rods"], "rod", rod),
            &server.get(&format!("/api/v1/rods/{rod}")),
        ] {
            for (key, value) in said.as_object().unwrap() {
                // What depends on the time of asking, and the site's.
                if !matches!(&**key, "is_stale" | "monitoring") {
                    assert_eq!(&shown[key], value, "{rod} {key}");
                }
            }
            assert_eq!(
                (&said["is_stale"], &said["monitoring"]),
                (&json!(true), &site["monitoring"])
            );
        }
    }
    // The campaign has an alarm, without which the checks above would be weak.
    assert_eq!(row_of(&site["rods"], "rod", "north")["state"], "alarm");
}

#[test]
fn pages_of_records_are_the_history() {
    let server = Server::of(&CAMPAIGN, "site.db");
    for (rod, what, rejected) in [
        ("north", "records", ""),
        ("south", "records", ""),
        ("north", "rejections", "&rejected=true"),
    ] {
        let said: Vec<Json> = CAMPAIGN
            .history("site.db", what)
            .into_iter()
            .filter(|line| line["rod"] == rod && !line["start"].is_null())
            .collect();
        let mut shown: Vec<Json> = Vec::new();
        let mut before = String::new();
        loop {
            let page = server.get(&format!("/api/v1/rods/{rod}/records?limit=7{rejected}{before}"));
            let records = page["records"].as_array().unwrap();
            assert!(records.len() <= 7);
            shown.extend(records.iter().cloned());
            match page["next"].as_str() {
                Some(next) => before = format!("&before={next}"),
                None => break,
            }
        }
        shown.reverse();
        for record in &mut shown {
            // Eight days a file, from 1 January on.
            let start = Timestamp::as_written(record["start"].as_str().unwrap()).unwrap();
            let day = (start.seconds_since(noon(0)) / 86_400.0).round() as u32;
            let file = record.as_object_mut().unwrap().remove("file").unwrap();
            assert_eq!(file, json!(format!("archive/week-{}.mcap", day / 8)), "{record}");
        }
        assert!(said.len() > 1, "{rod} {what}");
        assert_eq!(shown, said, "{rod} {what}");
    }
    let alarms = CAMPAIGN.history("site.db", "alarms");
    let mut shown = Vec::new();
    let mut before = String::new();
    loop {
        let page = server.get(&format!("/api/v1/alarms?limit=1{before}"));
        shown.extend(page["alarms"].as_array().unwrap().iter().cloned());
        match page["next"].as_str() {
            Some(next) => before = format!("&before={next}"),
            None => break,
        }
    }
    shown.reverse();
    assert!(!alarms.is_empty());
    assert_eq!(shown.len(), alarms.len());
    for alarm in &alarms {
        assert!(shown.contains(alarm), "{alarm}");
    }
}

#[test]
fn columns_are_the_records() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let history = server.get("/api/v1/rods/north/history");
    assert!(history["step_s"].is_null());
    let records: Vec<Json> = CAMPAIGN
        .history("site.db", "records")
        .into_iter()
        .filter(|line| line["rod"] == "north")
        .collect();
    assert_eq!(history["time"].as_array().unwrap().len(), records.len());
    let part = |value: &Json, name: &str| value.get(name).cloned().unwrap_or(Json::Null);
    for (i, record) in records.iter().enumerate() {
        assert_eq!(history["time"][i], record["start"]);
        for name in [
            "relative_force_at_reference",
            "relative_force",
            "force_at_reference_n",
            "tracked_force_n",
            "axial_force_n",
        ] {
            for key in ["mean", "q025", "q975"] {
                assert_eq!(
                    history[name][key][i],
                    part(&record[name], key),
                    "{name} {key} {i}"
                );
            }
        }
        assert_eq!(history["temperature_c"][i], record["temperature_c"], "{i}");
        assert_eq!(history["set_aside"][i], record["set_aside"], "{i}");
    }
    // A window, and the periods of the chart.
    let span = "from=2026-01-20&to=2026-01-25T00:00:00Z";
    let part = server.get(&format!("/api/v1/rods/north/history?{span}"));
    let inside = |time: &Json| ("2026-01-20".."2026-01-25").contains(&time.as_str().unwrap());
    let times: Vec<&Json> = history["time"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|time| inside(time))
        .collect();
    assert_eq!(part["time"].as_array().unwrap().iter().collect::<Vec<_>>(), times);
    // The modes of every record, and of every third.
    for (points, every) in [(5000, 1), (records.len().div_ceil(3), 3)] {
        let answer = server.get(&format!("/api/v1/rods/north/frequencies?points={points}"));
        assert_eq!(answer["every"], json!(every));
        let listed: Vec<&Json> = records.iter().step_by(every).collect();
        assert_eq!(answer["time"].as_array().unwrap().len(), listed.len());
        assert_eq!(answer["modes"].as_array().unwrap().len(), 3);
        for (i, record) in listed.iter().enumerate() {
            assert_eq!(answer["time"][i], record["start"]);
            for column in answer["modes"].as_array().unwrap() {
                let modes = record["modes"].as_array().unwrap();
                let mode = modes.iter().find(|mode| mode["order"] == column["order"]);
                for key in ["frequency_hz", "sd_hz"] {
                    let wanted = mode.map_or(Json::Null, |mode| mode[key].clone());
                    assert_eq!(column[key][i], wanted, "{key} {i}");
                }
            }
        }
    }
    let chart = server.get("/api/v1/rods/north/chart");
    let periods: Vec<Json> = CAMPAIGN
        .history("site.db", "periods")
        .into_iter()
        .filter(|period| period["rod"] == "north" && period["segment"] == chart["segment"])
        .collect();
    assert!(periods.len() > 10);
    assert_eq!(chart["time"].as_array().unwrap().len(), periods.len());
    for (i, period) in periods.iter().enumerate() {
        assert_eq!(chart["time"][i], period["start"]);
        for name in [
            "residual",
            "at_reference",
            "evidence",
            "evidence_peers",
            "evidence_blind",
        ] {
            let shown = chart[name].get(i).unwrap_or_else(|| panic!("{name} {i}"));
            assert_eq!(*shown, period[name], "{name} {i}");
        }
    }
}

#[test]
fn few_points_are_means_of_the_records() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let whole = server.get("/api/v1/rods/south/history");
    let coarse = server.get("/api/v1/rods/south/history?points=8");
    let numbers =
        |column: &Json| -> Vec<Option<f64>> { column.as_array().unwrap().iter().map(Json::as_f64).collect() };
    let count = coarse["time"].as_array().unwrap().len();
    assert!((5..=9).contains(&count), "{count}");
    let step_ns = (coarse["step_s"].as_f64().unwrap() * 1e9).round() as i64;
    let nanos = |text: &Json| {
        text.as_str()
            .unwrap()
            .parse::<jiff::Timestamp>()
            .unwrap()
            .as_nanosecond() as i64
    };
    let means = numbers(&coarse["axial_force_n"]["mean"]);
    let all = numbers(&whole["axial_force_n"]["mean"]);
    let mut seen = 0;
    for (i, mean) in means.iter().enumerate() {
        let start = nanos(&coarse["time"][i]);
        let inside: Vec<usize> = (0..all.len())
            .filter(|j| (start..start + step_ns).contains(&nanos(&whole["time"][*j])))
            .collect();
        assert_eq!(coarse["records"][i], json!(inside.len()));
        seen += inside.len();
        let forces: Vec<f64> = inside
            .iter()
            .filter(|j| whole["set_aside"][**j].is_null())
            .filter_map(|j| all[*j])
            .collect();
        match mean {
            Some(mean) => {
                let wanted = forces.iter().sum::<f64>() / forces.len() as f64;
                // Seven digits are kept of a mean.
                assert!((mean / wanted - 1.0).abs() < 1e-6, "{mean} {wanted}");
            }
            None => assert!(forces.is_empty()),
        }
    }
    assert_eq!(seen, all.len());
}

/// Compares a value with a schema: types, required and further properties, items, references, alternatives.
fn check(value: &Json, schema: &Json, all: &Json, at: &str) -> Result<(), String> {
    if let Some(name) = schema["$ref"].as_str() {
        let name = name.rsplit('/').next().unwrap();
        return check(
            value,
            &all["components"]["schemas"][name],
            all,
            &format!("{at}<{name}>"),
        );
    }
    if let Some(choices) = schema["anyOf"].as_array() {
        let tries: Vec<String> = choices
            .iter()
            .filter_map(|choice| check(value, choice, all, at).err())
            .collect();
        return if tries.len() < choices.len() {
            Ok(())
        } else {
            Err(tries.join(" and "))
        };
    }
    let kind = match value {
        Json::Null => "null",
        Json::Bool(_) => "boolean",
        Json::Number(number) if number.is_u64() || number.is_i64() => "integer",
        Json::Number(_) => "number",
        Json::String(_) => "string",
        Json::Array(_) => "array",
        Json::Object(_) => "object",
    };
    let is = |wanted: &Json| wanted == kind || (wanted == "number" && kind == "integer");
    let fits = match &schema["type"] {
        Json::Array(kinds) => kinds.iter().any(is),
        wanted => is(wanted),
    };
    if !fits {
        return Err(format!("{at} is {kind}, not {}", schema["type"]));
    }
    if let Some(choices) = schema["enum"].as_array()
        && !choices.contains(value)
    {
        return Err(format!("{at} is {value}"));
    }
    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
        check(item, &schema["items"], all, &format!("{at}[{i}]"))?;
    }
    if let (Some(object), Some(properties)) = (value.as_object(), schema["properties"].as_object()) {
        for (key, item) in object {
            match properties.get(key) {
                Some(property) => check(item, property, all, &format!("{at}.{key}"))?,
                None if schema["additionalProperties"] == false => {
                    return Err(format!("{at}.{key} is not described"));
                }
                None => {}
            }
        }
        for key in schema["required"].as_array().into_iter().flatten() {
            if !object.contains_key(key.as_str().unwrap()) {
                return Err(format!("{at} has no {key}"));
            }
        }
    }
    Ok(())
}

#[test]
fn the_description_holds() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let description = server.get("/api/v1/openapi.json");
    let mut checked = 0;
    for (path, operations) in description["paths"].as_object().unwrap() {
        let schema = &operations["get"]["responses"]["200"]["content"]["application/json"]["schema"];
        if schema.is_null() {
            continue;
        }
        for rod in ["north", "south"] {
            let answer = server.get(&path.replace("{rod}", rod));
            check(&answer, schema, &description, path).unwrap_or_else(|fault| panic!("{fault}"));
        }
        // Every parameter that is described is taken, and no other.
        for parameter in operations["get"]["parameters"].as_array().into_iter().flatten() {
            let name = parameter["name"].as_str().unwrap();
            let value = match (&parameter["in"], name) {
                (place, _) if place == "path" => continue,
                (_, "from" | "to") => "2026-01-20",
                (_, "rejected" | "standing") => "true",
                (_, "rod") => "north",
                (_, "before") => continue,
                _ => "3",
            };
            server.get(&format!("{}?{name}={value}", path.replace("{rod}", "north")));
            checked += 1;
        }
    }
    assert!(checked > 6, "{checked}");
    let wrong = json!({"alarms": [], "more": 1});
    assert!(
        check(
            &wrong,
            &json!({"$ref": "#/components/schemas/Alarms"}),
            &description,
            ""
        )
        .is_err()
    );
}

#[test]
fn a_refused_record_is_answered_as_described() {
    let description: Json = serde_json::from_str(include_str!("../../docs/openapi.json")).unwrap();
    let rod = RodId("north".to_owned());
    let good = crate::archive::snapshot(&crate::archive::identified(&rod, 1)).unwrap();
    let peak = |taken_for, multiple_of| PeakMark {
        frequency_hz: 9.0,
        order: None,
        line: false,
        sd_hz: Some(0.01),
        damping: Some(0.002),
        damping_sd: Some(0.0003),
        level_db: Some(20.0),
        taken_for: Some(taken_for),
        multiple_of,
    };
    let multiple = Multiple {
        times: 2,
        frequency_hz: 4.5,
    };
    let candidate = |axial_force_n| Candidate {
        modes: vec![Assigned {
            order: 1,
            frequency_hz: 9.0,
        }],
        probability: 0.5,
        axial_force_n,
    };
    let force = Quantiles {
        q025: 1.0,
        q50: 2.0,
        q975: 3.0,
    };
    let refused = Snapshot {
        seed: String::new(),
        peaks: vec![
            peak(Nature::Candidate, Some(multiple)),
            peak(Nature::Doubtful, None),
            peak(Nature::Tone, None),
            peak(Nature::Harmonic, None),
            peak(Nature::Broad, None),
            peak(Nature::Drift, None),
        ],
        densities: vec![],
        motion: Some(Motion {
            kind: MotionKind::FreeDecays,
            onsets_s: vec![1.5, 20.0],
        }),
        candidates: vec![candidate(Some(force)), candidate(None)],
        rejection: Some(Reason {
            code: "no-label".to_owned(),
            message: "cannot number the modes".to_owned(),
        }),
        ..good.clone()
    };
    let mut store = Store::in_memory().unwrap();
    for picture in [&good, &refused] {
        let commit = Commit {
            snapshot: Some(SnapshotRow {
                rod: &rod,
                segment: 1,
                snapshot: picture,
            }),
            ..Commit::default()
        };
        store.commit(&commit).unwrap();
    }
    let answer = serde_json::to_value(Looks::of(&store, &rod).unwrap()).unwrap();
    assert_eq!(answer["refused"]["rejection"]["code"], "no-label", "{answer}");
    assert!(answer["latest"]["rejection"].is_null(), "{answer}");
    let schema = json!({"$ref": "#/components/schemas/Latest"});
    check(&answer, &schema, &description, "").unwrap();
    let mut wrong = answer.clone();
    wrong["refused"]["peaks"][0]["taken_for"] = json!("ghost");
    assert!(check(&wrong, &schema, &description, "").is_err());
}

#[test]
fn wrong_questions_and_strangers_are_refused() {
    let server = Server::of(&CAMPAIGN, "site.db");
    assert_eq!(server.refused("/api/v1/rods/nobody"), 404);
    for of_nobody in [
        "/api/v1/rods/nobody/history",
        "/api/v1/rods/nobody/frequencies",
        "/api/v1/rods/nobody/records",
        "/api/v1/rods/nobody/records?rejected=true",
        "/api/v1/rods/nobody/chart",
        "/api/v1/rods/nobody/latest",
        "/api/v1/alarms?rod=nobody",
    ] {
        assert_eq!(server.refused(of_nobody), 404, "{of_nobody}");
    }
    for bad in [
        "/api/v1/rods/north/history?from=yesterday",
        "/api/v1/rods/north/history?from=2026-02-01&to=2026-01-01",
        "/api/v1/rods/north/frequencies?from=2026-02-01&to=2026-02-01",
        "/api/v1/rods/north/history?points=0",
        "/api/v1/rods/north/history?points=1000000",
        "/api/v1/rods/north/records?limit=100000",
        "/api/v1/rods/north/records?before=x",
        "/api/v1/alarms?before=nothing",
        "/api/v1/rods/north/chart?periods=0",
    ] {
        assert_eq!(server.refused(bad), 400, "{bad}");
    }
    for (method, path, headers, status) in [
        ("GET", "/api/v1/site?x=1", "", 200),
        ("GET", "/api/v1/rods/north/records?unknown=1", "", 400),
        ("GET", "/nothing", "", 404),
        ("GET", "/assets/../Cargo.toml", "", 404),
        ("GET", "/", "Host: evil.example\r\n", 421),
        ("GET", "/api/v1/site", "Host: evil.example:7417\r\n", 421),
        ("GET", "/api/v1/site", "Host: [::1]:7417\r\n", 200),
        ("DELETE", "/api/v1/site", "", 405),
        ("POST", "/api/v1/alarms/x/acknowledge", "", 401),
        (
            "POST",
            "/api/v1/alarms/x/acknowledge",
            "Authorization: Bearer wrong\r\n",
            401,
        ),
        ("POST", "/api/v1/site", "Content-Length: 5\r\n", 413),
    ] {
        let (found, body) = server.ask(method, path, headers);
        assert_eq!(found, status, "{method} {path} {headers}: {body}");
    }
    for page in ["/", "/rod?id=north", "/alarms"] {
        let head = server.head(page);
        let policy = head
            .lines()
            .find(|line| line.starts_with("content-security-policy"))
            .unwrap();
        assert!(
            policy.contains("default-src 'none'") && policy.contains("script-src 'self';"),
            "{policy}"
        );
        assert!(head.contains("x-content-type-options: nosniff"), "{head}");
    }
}

#[test]
fn the_first_load_is_light() {
    let server = Server::of(&CAMPAIGN, "site.db");
    let mut bytes = 0;
    for path in [
        "/rod",
        "/assets/rod.js",
        "/assets/latest.js",
        "/assets/common.js",
        "/assets/place.js",
        "/assets/figures.js",
        "/assets/plot.js",
        "/assets/style.css",
        "/assets/icon.svg",
        "/api/v1/rods/north",
        "/api/v1/rods/north/history",
        "/api/v1/rods/north/frequencies",
        "/api/v1/rods/north/chart",
        "/api/v1/rods/north/latest",
        "/api/v1/rods/north/records",
        "/api/v1/alarms",
    ] {
        let (status, plain) = server.bytes(path, "");
        assert_eq!(status, 200, "{path}");
        let (_, packed) = server.bytes(path, "Accept-Encoding: gzip\r\n");
        let mut unpacked = Vec::new();
        if packed == plain {
            // Short answers stay as they are.
            assert!(plain.len() < 1024, "{path}");
        } else {
            GzDecoder::new(&packed[..]).read_to_end(&mut unpacked).unwrap();
            assert!(unpacked == plain, "{path}");
        }
        bytes += packed.len();
        // Content that the browser already has is not sent again.
        let head = server.head(path);
        let but_the_date = |head: &str| -> Vec<String> {
            let lines = head.lines().filter(|line| !line.starts_with("date:"));
            lines.map(str::to_owned).collect()
        };
        assert_eq!(
            but_the_date(&server.only_head(path)),
            but_the_date(&head),
            "{path}"
        );
        // The head is in small letters.
        let tag = head.lines().find_map(|line| line.strip_prefix("etag: ")).unwrap();
        let tag = tag.replace("w/", "W/");
        let (status, body) = server.ask("GET", path, &format!("If-None-Match: {tag}\r\n"));
        assert_eq!((status, body.as_str()), (304, ""), "{path}");
    }
    // 26 kB of scripts and style, 85 kB of data: 25 records in full, 56 in columns, two records' waveforms and spectra.
    assert!(bytes < 150_000, "{bytes}");
}

#[test]
fn an_acknowledgement_lands_and_a_commit_rings() {
    let site = campaign();
    site.replay(&["archive"], "site.db");
    let server = Server::of(&site, "site.db");
    let mut events = BufReader::new(server.stream("/api/v1/events"));
    let mut next = || -> u64 {
        let mut line = String::new();
        loop {
            line.clear();
            assert!(events.read_line(&mut line).unwrap() > 0, "the stream ended");
            if let Some(number) = line.strip_prefix("data: ") {
                return number.trim().parse().unwrap();
            }
        }
    };
    let first = next();
    let alarm = server.get("/api/v1/alarms?standing=true")["alarms"][0].clone();
    assert!(alarm["acknowledged"].is_null(), "{alarm}");
    let id = alarm["id"].as_str().unwrap();
    let path = format!("/api/v1/alarms/{id}/acknowledge?by=M.+Rossi&note=seen,%20sound");
    assert_eq!(server.ask("POST", &path, "Authorization: Bearer no\r\n").0, 401);
    let (status, body) = server.ask("POST", &path, &format!("Authorization: Bearer {TOKEN}\r\n"));
    assert_eq!(status, 200, "{body}");
    assert!(next() > first);
    let known = |alarms: &[Json]| {
        alarms
            .iter()
            .any(|alarm| alarm["id"] == id && alarm["acknowledged_words"] == "M. Rossi: seen, sound")
    };
    assert!(known(server.get("/api/v1/alarms")["alarms"].as_array().unwrap()));
    assert!(known(&site.history("site.db", "alarms")));
    // Asked again, nothing changes.
    let (status, body) = server.ask("POST", &path, &format!("Authorization: Bearer {TOKEN}\r\n"));
    assert!(status == 200 && body.contains("was acknowledged"), "{body}");
    let unknown = server.ask(
        "POST",
        "/api/v1/alarms/none/acknowledge",
        &format!("Authorization: Bearer {TOKEN}\r\n"),
    );
    assert_eq!(unknown.0, 404);

    site.simulate("later", &Part::new(56, 2));
    site.replay(&["archive"], "site.db");
    next();
    let rods = server.get("/api/v1/site");
    let latest = row_of(&rods["rods"], "rod", "south")["latest_record"]
        .as_str()
        .unwrap()
        .to_owned();
    assert!(latest.as_str() >= "2026-02-27", "{latest}");
}

#[test]
fn a_store_that_is_not_there_or_damaged_is_told() {
    let site = Site::new(SITE);
    let output = site.run(&["serve", "--store", "none.db", "--listen", "127.0.0.1:0"]);
    assert_eq!(output.status.code(), Some(1));
    let output = site.run(&["serve", "--store", "none.db", "--listen", "0.0.0.0:0"]);
    assert_eq!(output.status.code(), Some(2));

    site.simulate("0", &Part::new(0, 3));
    site.replay(&["archive"], "site.db");
    // A force changed outside the program is detected by the row's checksum.
    let store = rusqlite::Connection::open(site.path("site.db")).unwrap();
    store
        .execute(
            "UPDATE record SET axial_force_n = axial_force_n + 1000 WHERE id = 2",
            (),
        )
        .unwrap();
    drop(store);
    let server = Server::of(&site, "site.db");
    assert_eq!(server.refused("/api/v1/site"), 503);
    let (_, body) = server.ask("GET", "/api/v1/rods/north/history", "");
    assert!(body.contains("not what was written"), "{body}");
}

#[test]
fn a_large_store_says_how_far_it_was_read_and_then_answers() {
    const RECORDS: i64 = 18_500;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = Store::open(&path, Durability::Replay).unwrap();
    store
        .keep_config(crate::archive::CONFIG, "Large", "[site]\nname = \"Large\"\n")
        .unwrap();
    let rod = RodId("north".to_owned());
    store.begin_group().unwrap();
    for number in 0..RECORDS {
        let outcome = crate::archive::identified(&rod, number);
        let row = crate::archive::row(&outcome);
        let commit = Commit {
            record: Some(crate::archive::new_record(&outcome, &row)),
            ..Commit::default()
        };
        store.commit(&commit).unwrap();
    }
    store.end_group().unwrap();

    // A question reads 18 000 records itself.
    let shown = Shown::new(&path);
    let ask = || shown.ask(|reader, days| Ok((SiteAnswer::of(reader, days)?, days.counts(&rod))));
    match ask() {
        Err(Unanswered::Reading { share }) => assert!((share - 18_000.0 / 18_500.0).abs() < 1e-12),
        _ => panic!("it was not told that the store is being read"),
    }
    let (_, counts) = ask().unwrap();
    assert_eq!((counts.records, counts.rejected), (RECORDS as u64, 0));
    // Requests that do not scan the whole store are answered at once.
    let last = Shown::new(&path).read(|reader| reader.last_record()).unwrap();
    assert_eq!(last, RECORDS);
}

#[test]
fn a_list_that_ends_where_lines_were_removed_says_so() {
    let mut store = Store::in_memory().unwrap();
    crate::archive::fill(&mut store, 0..80);
    let rod = RodId("south è".to_owned());
    let listed = |store: &Store, only_rejected: bool, most: usize| {
        let mut days = Days::default();
        while days.take_up(store).unwrap() {}
        let page = Records::of(store, &days, &rod, None, only_rejected, most).unwrap();
        (page.records.len(), page.next.is_some(), page.older_lines_removed)
    };
    assert_eq!(listed(&store, false, 100), (40, false, false));
    let lines = store
        .lines_before(
            &rod,
            (crate::archive::hour(-1), crate::archive::hour(1000)),
            None,
            false,
            10,
        )
        .unwrap();
    let tenth = lines.found.last().unwrap().mark;
    let before = Timestamp::from_nanos(tenth.start_ns);
    // Lines that a copy does not have yet stay.
    store.forget_lines(&rod, None, before, Some(1)).unwrap();
    assert_eq!(listed(&store, false, 100), (40, false, false));
    store.forget_lines(&rod, None, before, None).unwrap();
    assert_eq!(listed(&store, false, 100), (10, false, true));
    assert_eq!(listed(&store, false, 5), (5, true, false));
    // Every fifth record of this rod was rejected, the last among them.
    assert_eq!(listed(&store, true, 100), (2, false, true));
}

#[test]
fn a_clock_that_jumped_once_does_not_hide_the_rod() {
    let site = Site::new(SITE);
    site.simulate("first", &Part::new(0, 12));
    site.simulate("wrong", &Part::new(1838, 1));
    site.simulate("then", &Part::new(12, 1));
    site.replay(&["archive/first.mcap"], "site.db");
    for (name, last) in [("wrong", 11), ("then", 12)] {
        site.replay(&[&format!("archive/{name}.mcap")], "site.db");
        let server = Server::of(&site, "site.db");
        let answer = server.get("/api/v1/site");
        let shown = row_of(&answer["rods"], "rod", "north");
        assert_eq!(shown["latest_record"], noon(last).to_string());
        assert_eq!(
            (&shown["records_ahead"], &shown["records"]),
            (&json!(1), &json!(last + 2))
        );
        assert_eq!(shown["recent"]["records"], json!(last + 1));
        assert!(shown["trend"]["mean"].as_array().unwrap().len() > 1, "{shown}");
        let rod = server.get("/api/v1/rods/north");
        assert_eq!(
            rod["span"],
            json!(["2026-01-01T00:00:00Z", format!("2026-01-{}T00:00:00Z", last + 2)])
        );
        // Nothing is hidden from whoever asks for everything.
        let all = server.get("/api/v1/rods/north/history");
        assert_eq!(all["time"].as_array().unwrap().len() as i64, last + 2);
        let said = site.run(&["status", "--store", "site.db"]);
        let said = String::from_utf8(said.stdout).unwrap();
        assert!(
            !said.contains("2031") && said.contains("1 record dated after that by a wrong clock"),
            "{said}"
        );
    }
}

#[test]
fn every_refusal_of_the_api_is_json() {
    let server = Server::of(&CAMPAIGN, "site.db");
    for (path, status) in [
        ("/api/v1/rods/north/history?points=-1", 400),
        ("/api/v1/rods/north/records?rejected=maybe", 400),
        ("/api/v1/alarms?standing=1", 400),
        ("/api/v1/alarms?limit=1&limit=2", 400),
        ("/api/v1/alarms?since=2026", 400),
        ("/api/v1/rods/%FF/history", 400),
        ("/api/v1/nothing", 404),
        ("/api/v2/site", 404),
        ("/api/v1/alarms/none/acknowledge", 405),
    ] {
        assert_eq!(server.refused(path), status, "{path}");
        assert!(
            server.head(path).contains("content-type: application/json"),
            "{path}"
        );
    }
    assert!(
        server
            .head("/api/v1/alarms/none/acknowledge")
            .contains("allow: post")
    );
    // What people type into a browser stays text.
    assert!(server.head("/nothing").contains("content-type: text/plain"));
}

#[test]
fn counts_of_the_page_are_those_of_status() {
    let mut store = Store::in_memory().unwrap();
    crate::archive::fill(&mut store, 0..20);
    let rod = RodId("south è".to_owned());
    let timeless = crate::archive::rejected(&rod, 31);
    let mut row = crate::archive::row(&timeless);
    row.start = None;
    let commit = Commit {
        record: Some(crate::archive::new_record(&timeless, &row)),
        ..Commit::default()
    };
    store.commit(&commit).unwrap();
    let mut days = Days::default();
    while days.take_up(&store).unwrap() {}
    let counts = days.counts(&rod);
    assert_eq!((counts.records, counts.rejected), (11, 3));
    assert_eq!(store.counts(&rod).unwrap(), days.counts(&rod));
}

#[test]
fn data_are_stale_when_the_alarm_would_be_raised() {
    // Learning, of which the site knows two records, a week apart; then with a baseline of daily ones.
    let site = Site::new(&SITE.replace("[track]", "[alarm]\nsilence_h = 24\n[track]"));
    site.simulate("first", &Part::new(0, 1));
    site.simulate("second", &Part::new(7, 1));
    site.replay(&["archive/first.mcap"], "site.db");
    let stale_after_s = || {
        let server = Server::of(&site, "site.db");
        let answer = server.get("/api/v1/site");
        let rod = server.get("/api/v1/rods/north");
        let shown = &row_of(&answer["rods"], "rod", "north")["stale_after_s"];
        assert_eq!(shown, &rod["stale_after_s"]);
        shown.as_f64().unwrap()
    };
    assert_eq!(stale_after_s(), 86_400.0);
    site.replay(&["archive/second.mcap"], "site.db");
    // Rounding alone.
    assert!((stale_after_s() - 3.5 * 7.0 * 86_400.0).abs() < 1e-3);
    let learned = Server::of(&CAMPAIGN, "site.db").get("/api/v1/rods/south");
    let spacing = learned["stale_after_s"].as_f64().unwrap() / 3.5;
    // Ten daily records, of which a few were lost.
    assert!((86_400.0..1.5 * 86_400.0).contains(&spacing), "{spacing}");
}

#[test]
fn page_and_description_have_the_words_of_the_report() {
    use tirante::analysis::rod::beam::{Parameterisation, Section};
    let server = Server::of(&CAMPAIGN, "site.db");
    let (_, script) = server.ask("GET", "/assets/figures.js", "");
    let mut keys = vec!["fixity_left", "fixity_right"];
    for section in Section::ALL {
        let parameterisation = Parameterisation::new(section);
        keys.extend(
            parameterisation
                .quantities()
                .iter()
                .map(|quantity| quantity.key()),
        );
    }
    for key in keys {
        let (name, unit, factor) = tirante::command::report_page::quantity(key);
        assert_ne!(unit, "SI", "{key}");
        let wanted = format!("{key}: [\"{name} [{unit}]\", {factor:e}]");
        let written = script.replace("\\u00b3", "\u{b3}").replace("\\u00b2", "\u{b2}");
        let wanted = wanted.replace("1e0]", "1]");
        assert!(written.contains(&wanted), "{wanted}");
    }
    let (_, script) = server.ask("GET", "/assets/common.js", "");
    for doubt in Doubt::ALL {
        let wanted = format!("{}: \"{}\"", doubt.code(), doubt.said());
        assert!(script.contains(&wanted), "{wanted}");
    }
    let described = server.get("/api/v1/openapi.json").to_string();
    let enumerated = format!("\"enum\":{}", json!(Doubt::ALL.map(Doubt::code)));
    let lists = described.matches("\"enum\":[\"conflict\"").count();
    assert!(lists > 0 && described.matches(&enumerated).count() == lists);
    let (_, script) = server.ask("GET", "/assets/latest.js", "");
    for source in [
        Source::Modulus,
        Source::Density,
        Source::Section,
        Source::Rigidity,
        Source::Mass,
        Source::Springs,
        Source::Length,
        Source::Measurement,
        Source::Discrepancy,
    ] {
        let key = serde_json::to_value(source).unwrap();
        let wanted = format!("{}: \"{}\"", key.as_str().unwrap(), source.name());
        assert!(key == source.name() || script.contains(&wanted), "{wanted}");
    }
}

#[test]
fn a_record_of_a_wrong_clock_does_not_stay_the_picture() {
    let site = Site::new(SITE);
    site.simulate("first", &Part::new(0, 12));
    site.simulate("wrong", &Part::new(400, 1));
    site.simulate("then", &Part::new(12, 2));
    let pictured = |name: &str| {
        site.replay(&[&format!("archive/{name}.mcap")], "site.db");
        let server = Server::of(&site, "site.db");
        server.get("/api/v1/rods/north/latest")["latest"]["start"]
            .as_str()
            .unwrap()
            .to_owned()
    };
    assert_eq!(pictured("first"), noon(11).to_string());
    assert_eq!(pictured("wrong"), noon(11).to_string());
    assert_eq!(pictured("then"), noon(13).to_string());
}
