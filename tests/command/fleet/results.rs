//! Results that are damaged, recordings that are, and what `fleet collect` makes of both.

use super::*;
use bytes::Bytes;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use std::collections::BTreeMap;
use tirante::analysis::signal::record::Timestamp;
use tirante::site::store::Reader;

/// Sites of some days each, planned into `plan.jsonl`.
fn sites(days: &[(&str, usize)]) -> (Site, Vec<Json>) {
    let site = Site::new(SITE);
    fs::create_dir_all(site.path("configs")).unwrap();
    for (name, days) in days {
        fs::create_dir_all(site.path(&format!("archive/{name}"))).unwrap();
        fs::copy(site.path("site.toml"), site.path(&format!("configs/{name}.toml"))).unwrap();
        site.simulate(&format!("{name}/week"), &Part::new(0, *days));
    }
    let tasks = planned(&site, "archive --configs configs", "plan.jsonl");
    (site, tasks)
}

fn task(site: &Site, index: usize, results: &str) -> Said {
    let line = format!("fleet task plan.jsonl --index {index} --out {results} --threads 1");
    tirante(&site.folder, &line)
}

fn collect(site: &Site, more: &str) -> Said {
    let line = format!("fleet collect plan.jsonl --results results --out fleet.db {more}");
    tirante(&site.folder, &line)
}

/// Numbers of damaged files by site, of the collected database.
fn damaged(site: &Site) -> BTreeMap<String, Option<i64>> {
    let many = Connection::open(site.path("fleet.db")).unwrap();
    let mut statement = many.prepare("SELECT site, damaged FROM task").unwrap();
    let rows = statement
        .query_map((), |row| Ok((row.get(0)?, row.get(1)?)))
        .unwrap();
    rows.collect::<Result<_, _>>().unwrap()
}

#[test]
fn a_damaged_result_is_named_by_collect_and_made_anew_by_its_task() {
    let (site, tasks) = sites(&[("a", 2), ("b", 2), ("c", 2)]);
    for index in 0..3 {
        task(&site, index, "results").done();
    }
    collect(&site, "").done();
    let place = site.path(&result(&tasks[1], "results"));
    let name = tasks[1]["site"].as_str().unwrap();
    let whole = fs::read(&place).unwrap();
    let changed = |sql: &str| {
        fs::write(&place, &whole).unwrap();
        Connection::open(&place).unwrap().execute_batch(sql).unwrap();
        fs::read(&place).unwrap()
    };
    let mut torn_page = whole.clone();
    torn_page[(whole.len() / 2).next_multiple_of(4096)..][..4096].fill(0xa5);
    let mut other_head = whole.clone();
    other_head[..100].fill(0);
    for (what, bytes) in [
        ("cut short", whole[..whole.len() / 2].to_vec()),
        ("empty", Vec::new()),
        ("no database", b"moved".repeat(100)),
        ("other head", other_head),
        ("torn page", torn_page),
        // Rows of records are none that opening a store looks at.
        (
            "changed row",
            changed("UPDATE line SET json = json || ' ' WHERE record = 2"),
        ),
        (
            "other tables",
            changed("ALTER TABLE record RENAME COLUMN rejection TO rejected"),
        ),
    ] {
        fs::write(&place, &bytes).unwrap();
        // Shown where a check below fails.
        println!("{what}");
        let said = collect(&site, "--parquet fleet.parquet --resonances resonances.parquet")
            .ends(3)
            .says(&[
                &format!("left out: task 1, site {name}: results/{name}/"),
                "run: tirante fleet task plan.jsonl --index 1 --out results",
            ]);
        assert!(said.out.contains("2 of 3 sites"), "{what}: {}", said.out);
        assert!(!said.err.contains("replay"), "{what}: {}", said.err);
        let many = Connection::open(site.path("fleet.db")).unwrap();
        for table in ["task", "config", "rod", "record", "line", "resonance"] {
            let count = |name: &Json| rows(&many, table, name.as_str()).len();
            assert_eq!(count(&tasks[1]["site"]), 0, "{what}: {table}");
            assert!(
                count(&tasks[0]["site"]) > 0 && count(&tasks[2]["site"]) > 0,
                "{what}: {table}"
            );
        }
        drop(many);
        // The command that it named.
        let said = task(&site, 1, "results").ends(0).says(&["it is made anew"]);
        assert!(!said.out.contains("is there already"), "{what}: {}", said.out);
        assert!(fs::read(&place).unwrap() == whole, "{what}: other bytes");
        let again = task(&site, 1, "results").done();
        assert!(again.contains("is there already"), "{what}: {again}");
    }
    collect(&site, "").done();
    assert_eq!(fs::read_dir(place.parent().unwrap()).unwrap().count(), 1);
}

/// Changes a byte in the middle of a recording.
fn spoil(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x40;
    fs::write(path, bytes).unwrap();
}

#[test]
fn what_was_lost_of_recordings_is_kept_and_collected_with_the_same_bytes_after_every_kill() {
    let (site, _) = sites(&[("a", 4), ("b", 4)]);
    site.simulate("a/more", &Part::new(4, 4));
    spoil(&site.path("archive/a/week.mcap"));
    fs::write(site.path("archive/a/none.mcap"), "no recording").unwrap();
    let tasks = planned(&site, "archive --configs configs", "plan.jsonl");
    assert_eq!(tasks[0]["site"], "a");
    let said = task(&site, 0, "results").done();
    assert!(
        said.contains("1 files that could not be read") && said.contains("1 files with lost data"),
        "{said}"
    );
    task(&site, 1, "results").done();
    let place = |results: &str| site.path(&result(&tasks[0], results));
    let whole = fs::read(place("results")).unwrap();

    // Killed at any time, and behind its last commit, where the result's place refuses it.
    let mut generator = random::stream(random::seed(&[b"lost"]), 1);
    for _ in 0..8 {
        let mut command = site.command(&["fleet", "task", "plan.jsonl", "--out", "killed", "--index", "0"]);
        let mut child = command
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        thread::sleep(std::time::Duration::from_millis(generator.random_range(20..400)));
        let _ = child.kill();
        child.wait().unwrap();
    }
    let _ = fs::remove_file(place("killed"));
    fs::create_dir_all(place("killed").join("in the way")).unwrap();
    task(&site, 0, "killed").ends(1);
    fs::remove_dir_all(place("killed")).unwrap();
    task(&site, 0, "killed").done();
    assert!(fs::read(place("killed")).unwrap() == whole);

    let told = collect(&site, "")
        .ends(0)
        .says(&["lost data: task 0, site a: 2 of 3 files damaged"]);
    assert!(!told.err.contains("site b"), "{}", told.err);
    let wanted = [("a".to_owned(), Some(2)), ("b".to_owned(), Some(0))];
    assert_eq!(damaged(&site), wanted.into());
    let store = result(&tasks[0], "results");
    let listed = tirante(
        &site.folder,
        &format!("files --losses --format json --store {store}"),
    );
    let listed = listed.lines();
    let names: Vec<&str> = listed.iter().map(|file| file["file"].as_str().unwrap()).collect();
    assert_eq!(names, ["a/none.mcap", "a/week.mcap"]);
    assert!(listed.iter().all(|file| file["modified"].is_null()));

    // Lost is lost to an analysis without samples, too.
    let line = "fleet plan results --from-stores --configs configs --out again.jsonl";
    tirante(&site.folder, line).done();
    for index in 0..2 {
        let line = format!("fleet task again.jsonl --index {index} --out again");
        tirante(&site.folder, &line).done();
    }
    let line = "fleet collect again.jsonl --results again --out fleet.db";
    tirante(&site.folder, line).ends(0).says(&["site a: 2 "]);
    assert_eq!(damaged(&site)["a"], Some(2));

    // A result of an earlier version tells nothing of its files.
    let earlier = Connection::open(site.path(&result(&tasks[1], "results"))).unwrap();
    earlier.execute("DELETE FROM file", ()).unwrap();
    drop(earlier);
    collect(&site, "").done();
    assert_eq!(damaged(&site)["b"], None);
}

/// Rows of a Parquet file, by column.
fn parquet_rows(path: &Path) -> Vec<BTreeMap<String, Field>> {
    let file = SerializedFileReader::new(Bytes::from(fs::read(path).unwrap())).unwrap();
    let rows = file.get_row_iter(None).unwrap();
    let columns = |row: parquet::record::Row| {
        let columns = row.get_column_iter();
        columns
            .map(|(name, field)| (name.clone(), field.clone()))
            .collect()
    };
    rows.map(|row| columns(row.unwrap())).collect()
}

#[test]
fn parquet_has_a_row_for_each_record_and_each_resonance_of_every_site() {
    let (site, tasks) = sites(&[("a", 3), ("b", 2)]);
    for index in 0..2 {
        task(&site, index, "results").done();
    }
    collect(&site, "--parquet fleet.parquet --resonances resonances.parquet").done();
    let records = parquet_rows(&site.path("fleet.parquet"));
    let resonances = parquet_rows(&site.path("resonances.parquet"));
    let of = |rows: &[BTreeMap<String, Field>], name: &str| -> Vec<BTreeMap<String, Field>> {
        let site = Field::Str(name.to_owned());
        rows.iter().filter(|row| row["site"] == site).cloned().collect()
    };
    let (mut all_records, mut all_resonances) = (0, 0);
    for task in &tasks {
        let name = task["site"].as_str().unwrap();
        let store = result(task, "results");
        let expected = site.history(&store, "records");
        let found = of(&records, name);
        assert_eq!(found.len(), expected.len(), "{name}");
        for (row, line) in found.iter().zip(&expected) {
            let text = |column: &str| Field::Str(line[column].as_str().unwrap().to_owned());
            assert_eq!(row["rod"], text("rod"), "{name}");
            let Field::Long(start_ns) = row["start"] else {
                panic!("{:?}", row["start"]);
            };
            assert_eq!(
                Timestamp::from_nanos(start_ns).to_string(),
                line["start"].as_str().unwrap()
            );
            assert_eq!(row["fs_hz"], Field::Double(line["fs_hz"].as_f64().unwrap()));
        }
        all_records += expected.len();

        let reader = Reader::open(&site.path(&store)).unwrap();
        let mut expected = Vec::new();
        for row in reader.found(0, 1000).unwrap() {
            let start_ns = row.found.start().map(Timestamp::as_nanos);
            for resonance in row.found.resonances() {
                expected.push((
                    row.rod.0.clone(),
                    start_ns.unwrap(),
                    resonance.frequency_hz,
                    resonance.evidence,
                ));
            }
        }
        let found: Vec<(String, i64, f64, f64)> = of(&resonances, name)
            .iter()
            .map(
                |row| match (&row["rod"], &row["start"], &row["frequency_hz"], &row["evidence"]) {
                    (Field::Str(rod), Field::Long(start), Field::Double(hz), Field::Double(evidence)) => {
                        (rod.clone(), *start, *hz, *evidence)
                    }
                    other => panic!("{other:?}"),
                },
            )
            .collect();
        assert!(found.len() > expected.len() / 2 && found == expected, "{name}");
        all_resonances += expected.len();
    }
    assert_eq!((records.len(), resonances.len()), (all_records, all_resonances));
    assert!(
        all_records == 10 && all_resonances > all_records,
        "{all_records}, {all_resonances}"
    );
    let columns: Vec<&String> = resonances[0].keys().collect();
    assert_eq!(columns.len(), 12, "{columns:?}");
}
