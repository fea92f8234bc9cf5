//! One campaign in table, JSON lines, history, status and report: the same numbers everywhere.
use crate::program::{ROOT, tirante};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn number(value: &Value, pointer: &str) -> f64 {
    value
        .pointer(pointer)
        .and_then(Value::as_f64)
        .unwrap_or_else(|| panic!("{pointer} in {value}"))
}

/// A cell of a row in which no cell before it holds a comma.
fn column<'t>(row: &'t str, header: &str, name: &str) -> &'t str {
    let place = header
        .split(',')
        .position(|known| known == name)
        .unwrap_or_else(|| panic!("no {name}"));
    row.split(',').nth(place).unwrap()
}

/// `-3.67` or `+0.12`.
fn percent(ratio: f64) -> String {
    let text = format!("{:+.2}", 100.0 * (ratio - 1.0));
    if ["+0.00", "-0.00"].contains(&text.as_str()) {
        "0.00".to_owned()
    } else {
        text
    }
}

#[test]
fn every_command_tells_the_same_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (told, kept, pages) = (at("table.db"), at("json.db"), at("pages"));
    // Alarms are data: they are no reason for another code.
    let run = |line: &str| tirante(ROOT, line).ends(0);
    let replay = |more: &str| {
        let config = "--config config/campaign.toml --draws 50000";
        run(&format!("replay recordings/campaign-2025.mcap {config} {more}"))
    };
    let replayed = replay(&format!("--store {told} --report {pages}"));
    let (table, closing) = (replayed.out, replayed.err);
    let lines = replay(&format!("--store {kept} --json"));
    let records = lines.lines();
    assert_eq!(records.len(), 360);

    // History as JSON: the same bytes, from either store.
    for store in [&told, &kept] {
        let history = run(&format!("history --store {store} --format json")).out;
        assert!(
            history == lines.out,
            "history of {store} is not what replay printed"
        );
    }

    // The table: the same numbers, rounded.
    let mut rows = table.lines().filter(|row| row.starts_with("nave-3"));
    for record in &records {
        let row = rows.next().unwrap();
        let start = record["start"].as_str().unwrap();
        assert!(row.contains(&start[..16].replace('T', " ")), "{start} in {row}");
        for mode in record["modes"].as_array().unwrap() {
            // Five digits.
            let hz = number(mode, "/frequency_hz");
            let cell = if hz < 10.0 {
                format!("{hz:.4}")
            } else {
                format!("{hz:.3}")
            };
            assert!(row.contains(&cell), "{cell} in {row}");
        }
        let force = format!(
            "{:.0}±{:.0}",
            1e-3 * number(record, "/axial_force_n/mean"),
            1e-3 * number(record, "/axial_force_n/sd")
        );
        assert!(row.contains(&force), "{force} in {row}");
        let change = match (&record["relative_force_at_reference"], &record["relative_force"]) {
            (Value::Null, Value::Null) => " -".to_owned(),
            (Value::Null, ratio) => {
                format!(
                    "~{}±{:.2}",
                    percent(number(ratio, "/mean")),
                    100.0 * number(ratio, "/sd")
                )
            }
            (ratio, _) => {
                format!(
                    " {}±{:.2}",
                    percent(number(ratio, "/mean")),
                    100.0 * number(ratio, "/sd")
                )
            }
        };
        assert!(row.contains(&change), "{change} in {row}");
        match record["state"].as_str().unwrap() {
            "monitoring" => assert!(!row.contains("monitoring"), "{row}"),
            state => assert!(row.contains(state), "{row}"),
        }
    }
    assert_eq!(rows.next(), None);
    for line in table.lines().filter(|line| !line.contains("tirante ack")) {
        assert!(line.chars().count() <= 80, "{line}");
    }

    // History as a spreadsheet: every digit.
    let csv = run(&format!("history --store {told} --format csv")).out;
    let mut csv = csv.lines();
    let header = csv.next().unwrap();
    for (record, row) in records.iter().zip(csv.by_ref()) {
        // Cells with commas (JSON) come after these columns.
        for (name, pointer) in [
            ("relative_force", "/relative_force/mean"),
            ("relative_force_sd", "/relative_force/sd"),
            ("relative_force_at_reference", "/relative_force_at_reference/mean"),
            ("force_at_reference_q975_n", "/force_at_reference_n/q975"),
            ("temperature_c", "/temperature_c"),
            ("axial_force_n", "/axial_force_n/mean"),
            ("axial_force_q025_n", "/axial_force_n/q025"),
        ] {
            let wanted = record.pointer(pointer).and_then(Value::as_f64);
            assert_eq!(column(row, header, name).parse().ok(), wanted, "{name} of {row}");
        }
    }

    // Status: the last record, in every format, and the state that replay prints at the end.
    let last = records.last().unwrap();
    let status = run(&format!("status --store {told} --format json")).only();
    assert_eq!(status["relative_force"], last["relative_force_at_reference"]);
    assert_eq!(status["force_n"], last["force_at_reference_n"]);
    assert_eq!(status["state"], last["state"]);
    assert_eq!(status["latest_record"], last["start"]);
    assert_eq!(status["records"], 360);
    let shown = run(&format!("status --store {told}")).out;
    let [mean, low, high] =
        ["/mean", "/q025", "/q975"].map(|which| number(&last["relative_force_at_reference"], which));
    let [force, least, most] =
        ["/mean", "/q025", "/q975"].map(|which| 1e-3 * number(&last["force_at_reference_n"], which));
    let change = format!("{} ({} to {})", percent(mean), percent(low), percent(high));
    assert!(shown.contains(&change), "{change} in {shown}");
    assert!(
        shown.contains(&format!("{force:.0} ({least:.0} to {most:.0})")),
        "{shown}"
    );
    assert!(closing.contains(shown.trim_end()), "{shown} in {closing}");

    // The report.
    let page = fs::read_to_string(Path::new(&pages).join("simulated-campaign.html")).unwrap();
    let minus = |text: String| text.replace('-', "\u{2212}");
    for wanted in [
        minus(format!(
            "{} % [{} to {}]",
            percent(mean),
            percent(low),
            percent(high)
        )),
        format!("{force:.0} kN [{least:.0} to {most:.0}]"),
    ] {
        assert!(page.contains(&wanted), "{wanted} is not in the report");
    }

    // The one drift alarm, under one id.
    let alarms = run(&format!("history --store {told} --what alarms --format json")).lines();
    assert_eq!(alarms.len(), 1, "{alarms:?}");
    let (id, kind) = (
        alarms[0]["id"].as_str().unwrap(),
        alarms[0]["kind"].as_str().unwrap(),
    );
    assert_eq!(kind, "drift");
    assert_eq!(table.matches(">>> ALARM").count(), 1);
    assert!(
        table.contains(&format!("tirante ack {id} --store {told}")),
        "{table}"
    );
    let raised: Vec<&Value> = records
        .iter()
        .flat_map(|record| record["events"].as_array().unwrap())
        .filter(|event| event["what"] == "raised")
        .collect();
    assert_eq!(raised.len(), 1);
    assert_eq!(raised[0]["id"], alarms[0]["id"]);
    assert_eq!(status["alarms"][0]["id"], alarms[0]["id"]);
    assert_eq!(status["alarms"][0]["message"], alarms[0]["message"]);
    assert_eq!(last["alarms"][0]["message"], alarms[0]["message"]);
    assert!(page.contains(id), "the report does not name {id}");
    // No record before the one that raised it is in alarm.
    let first = records
        .iter()
        .position(|record| record["state"] == "alarm")
        .unwrap();
    assert!(
        records[first]["events"]
            .as_array()
            .is_some_and(|events| !events.is_empty())
    );
    assert!(records[first..].iter().all(|record| record["state"] == "alarm"));
}
