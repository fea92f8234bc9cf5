//! An archive of several sites as a job array: killed, run again, collected; and analysed again without samples.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

mod results;

use crate::program::{Said, tirante, words};
use crate::site::*;
use rand::RngExt;
use rusqlite::Connection;
use rusqlite::types::Value;
use serde_json::Value as Json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::Instant;
use tirante::analysis::numerics::random;

const SITES: [&str; 3] = ["badia", "duomo", "san marco"];

/// Variables of the three schedulers.
const INDICES: [&str; 3] = [
    "SLURM_ARRAY_TASK_ID",
    "JOB_COMPLETION_INDEX",
    "AWS_BATCH_JOB_ARRAY_INDEX",
];

/// Three sites of two rods, weeks of 8 days: the first has one more, a loss and a fault.
fn fleet() -> Site {
    let site = Site::new(SITE);
    fs::create_dir_all(site.path("configs")).unwrap();
    for (number, name) in SITES.iter().enumerate() {
        fs::create_dir_all(site.path(&format!("archive/{name}/2026"))).unwrap();
        let config = SITE.replace("seed = 11", &format!("seed = {}", 11 + number));
        fs::write(site.path(&format!("configs/{name}.toml")), &config).unwrap();
        fs::write(site.path("site.toml"), &config).unwrap();
        site.simulate(&format!("{name}/week-0"), &Part::new(0, 8));
        let held = "[[simulation.rod.fault]]\nkind = \"held\"\nat_s = 3.0\nlength_s = 20.0\nfirst_record = 2\nlast_record = 3\n";
        site.simulate(&format!("{name}/2026/week-1"), &Part::new(8, 8).north(held));
    }
    let loss = "[[simulation.rod.change]]\nstart_d = 0.0\nrelative = -0.10\n";
    site.simulate("badia/week-2", &Part::new(16, 8).north(loss));
    site
}

/// The recordings of a site in the order of `replay ARCHIVE/SITE`, folders below among them.
fn replayed(site: &Site, name: &str, config: &str, store: &str) -> String {
    let mut paths = vec![
        format!("archive/{name}/week-0.mcap"),
        format!("archive/{name}/2026"),
    ];
    if name == "badia" {
        paths.push("archive/badia/week-2.mcap".to_owned());
    }
    let replay = format!(
        "replay --config '{config}' --store {store} '{}'",
        paths.join("' '")
    );
    let said = tirante(&site.folder, &replay);
    assert!(matches!(said.code, Some(0 | 3)), "{said:?}");
    site.dump(store)
}

fn planned(site: &Site, line: &str, plan: &str) -> Vec<Json> {
    tirante(&site.folder, &format!("fleet plan --out {plan} {line}")).done();
    lines(&fs::read(site.path(plan)).unwrap())
}

/// Runs the array of a scheduler, two at once, by its own file.
fn array(site: &Site, scheduler: &str, plan: &str, results: &str) -> Said {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/fleet/array.sh");
    let results = site.path(results);
    let mut command = Command::new("bash");
    command
        .arg(script)
        .arg(scheduler)
        .args([site.path(plan), results])
        .arg("2")
        .current_dir(site.folder.path())
        .env("TIRANTE", env!("CARGO_BIN_EXE_tirante"))
        .env("TIRANTE_CACHE_DIR", env!("CARGO_TARGET_TMPDIR"))
        .stdin(Stdio::null());
    Said::of(scheduler, &mut command)
}

fn result(task: &Json, results: &str) -> String {
    format!(
        "{results}/{}/{}.db",
        task["site"].as_str().unwrap(),
        task["result"].as_str().unwrap()
    )
}

/// Rows of a table, of one site if the table is of many.
fn rows(connection: &Connection, table: &str, site: Option<&str>) -> Vec<Vec<Value>> {
    let columns: Vec<String> = connection
        // `config` has a column of its own for the site's name, which a collected database calls `site_name`.
        .prepare("SELECT name FROM pragma_table_info(?) WHERE name NOT IN ('site', 'site_name')")
        .unwrap()
        .query_map([table], |row| row.get(0))
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap();
    let only = if site.is_some() { "site = ?1" } else { "?1 IS NULL" };
    let listed = columns.join(", ");
    let mut statement = connection
        .prepare(&format!(
            "SELECT {listed} FROM {table} WHERE {only} ORDER BY {listed}"
        ))
        .unwrap();
    let read = |row: &rusqlite::Row<'_>| (0..columns.len()).map(|place| row.get(place)).collect();
    statement
        .query_map([site], read)
        .unwrap()
        .collect::<Result<_, _>>()
        .unwrap()
}

#[test]
fn an_array_killed_at_random_ends_row_by_row_in_what_replays_write() {
    let site = fleet();
    let tasks = planned(&site, "archive --configs configs", "plan.jsonl");
    assert_eq!(tasks.len(), 3);
    assert_eq!(tasks[0]["site"], "badia", "the costliest comes first");
    let files = tasks[0]["files"].as_array().unwrap();
    assert_eq!(files.len(), 3);
    assert_eq!(files[0]["path"], "badia/2026/week-1.mcap");
    assert_eq!(
        files[0]["from"].as_str().unwrap()[..10],
        noon(8).to_string()[..10]
    );

    // 24 kills, of tasks one after another and two at once, each at another point of the time that the shortest takes here.
    let timed = |run: usize| {
        let begun = Instant::now();
        let line = format!("fleet task plan.jsonl --out timed-{run} --index 2 --threads 1");
        let task = site.command(&words(&line).collect::<Vec<_>>()).output().unwrap();
        assert!(task.status.success(), "{task:?}");
        begun.elapsed()
    };
    let whole = (0..3).map(timed).min().unwrap();
    let mut generator = random::stream(random::seed(&[b"fleet"]), 1);
    let mut cut_off = 0;
    for kill in 0..24 {
        let count = 1 + kill % 2;
        let mut children = Vec::new();
        for child in 0..count {
            let index = (kill / 2 + child) % 3;
            let line = format!("fleet task plan.jsonl --out results --index {index} --threads 1");
            let mut command = site.command(&words(&line).collect::<Vec<_>>());
            children.push(
                command
                    .stdout(Stdio::null())
                    .stderr(Stdio::null())
                    .spawn()
                    .unwrap(),
            );
        }
        thread::sleep(whole.mul_f64(generator.random_range(0.03..0.3)));
        for mut child in children {
            cut_off += usize::from(child.try_wait().unwrap().is_none());
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
    assert!(cut_off >= 12, "only {cut_off} of 36 tasks were cut off");
    // What a copy under way leaves where a machine ends.
    let place = site.path(&result(&tasks[1], "results"));
    fs::write(place.with_file_name(".torn.part"), b"half").unwrap();
    array(&site, "slurm", "plan.jsonl", "results").done();

    for (number, task) in tasks.iter().enumerate() {
        let name = task["site"].as_str().unwrap();
        let whole = replayed(
            &site,
            name,
            &format!("configs/{name}.toml"),
            &format!("whole-{number}.db"),
        );
        assert_equal_dumps(&whole, &site.dump(&result(task, "results")));
    }

    // Again: nothing is done.
    let before: Vec<_> = tasks
        .iter()
        .map(|task| {
            fs::metadata(site.path(&result(task, "results")))
                .unwrap()
                .modified()
                .unwrap()
        })
        .collect();
    let again = array(&site, "slurm", "plan.jsonl", "results");
    assert_eq!(again.out.matches("is there already").count(), 3, "{again:?}");
    for (task, before) in tasks.iter().zip(before) {
        let now = fs::metadata(site.path(&result(task, "results")))
            .unwrap()
            .modified();
        assert_eq!(now.unwrap(), before);
    }

    // The other schedulers' files, from nothing: the same bytes.
    for scheduler in ["kubernetes", "aws"] {
        array(&site, scheduler, "plan.jsonl", scheduler).done();
        for task in &tasks {
            let bytes = |results: &str| fs::read(site.path(&result(task, results))).unwrap();
            assert!(bytes(scheduler) == bytes("results"), "{scheduler}: {task}");
        }
    }

    // One result is gone: it is named, the others are collected.
    fs::remove_file(site.path(&result(&tasks[2], "aws"))).unwrap();
    let name = tasks[2]["site"].as_str().unwrap();
    tirante(
        &site.folder,
        "fleet collect plan.jsonl --results aws --out fleet.db",
    )
    .ends(3)
    .says(&[&format!("missing: task 2, site {name}: "), "--index 2"]);

    tirante(
        &site.folder,
        "fleet collect plan.jsonl --results results --out fleet.db",
    )
    .done();
    let many = Connection::open(site.path("fleet.db")).unwrap();
    for (number, task) in tasks.iter().enumerate() {
        let one = Connection::open(site.path(&format!("whole-{number}.db"))).unwrap();
        for table in [
            "config",
            "rod",
            "segment",
            "state",
            "record",
            "line",
            "mode",
            "resonance",
            "period",
            "snapshot",
            "alarm",
            "outbox",
        ] {
            let (of_site, of_replay) = (rows(&many, table, task["site"].as_str()), rows(&one, table, None));
            assert!(of_site == of_replay, "{table} of {}", task["site"]);
            assert!(
                !of_replay.is_empty() || matches!(table, "alarm" | "outbox" | "period"),
                "{table}"
            );
        }
    }
}

#[test]
fn a_site_searched_in_parts_ends_in_the_bytes_of_its_own_task() {
    let site = fleet();
    let own = planned(&site, "archive --configs configs --site badia", "plan.jsonl");
    // A time between that of three parts and of four, with a tenth for reading.
    let bytes = own[0]["bytes"].as_f64().unwrap();
    let longest_s = own[0]["cost_s"].as_f64().unwrap() - 0.7 * bytes * 4e-3 / 8e3 * 0.9;
    let line = format!("archive --configs configs --site badia --split {longest_s}");
    let parts = planned(&site, &line, "parts.jsonl");
    assert_eq!(parts.len(), 4);
    assert!(
        parts.iter().all(|part| part["format"] == 2),
        "an older program would do the whole site"
    );
    let of_one = |results: &str| {
        let line = format!("fleet task plan.jsonl --index 0 --out {results}");
        tirante(&site.folder, &line).ends(0)
    };
    of_one("whole");
    let whole = fs::read(site.path(&result(&own[0], "whole"))).unwrap();
    let alone = |results: &str| {
        assert!(
            fs::read(site.path(&result(&own[0], results))).unwrap() == whole,
            "{results}"
        );
        let left = fs::read_dir(site.path(&format!("{results}/badia"))).unwrap();
        assert_eq!(left.count(), 1, "{results}: the result alone stays");
    };
    let searched = |said: &Said| {
        let (before, _) = said.out.split_once(" searched in parts").unwrap_or(("0", ""));
        before.rsplit(' ').next().unwrap().parse::<usize>().unwrap()
    };
    // Killed at any time, and two at once: run again, each part is whole.
    let mut generator = random::stream(random::seed(&[b"parts"]), 1);
    let mut killed = |line: &str| {
        let mut children = [(); 2].map(|()| {
            let mut command = site.command(&words(line).collect::<Vec<_>>());
            command
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap()
        });
        thread::sleep(std::time::Duration::from_millis(generator.random_range(50..600)));
        for child in &mut children {
            let _ = child.kill();
            child.wait().unwrap();
        }
    };
    for kill in 0..8 {
        let index = kill % 4;
        killed(&format!(
            "fleet task parts.jsonl --index {index} --out all --threads 1"
        ));
    }
    array(&site, "slurm", "parts.jsonl", "all").done();
    let again = array(&site, "slurm", "parts.jsonl", "all").done();
    assert_eq!(again.matches("is there already").count(), 4, "{again}");
    let ran = array(&site, "slurm", "parts.jsonl", "fresh").done();
    let shares: Vec<usize> = ran
        .lines()
        .filter_map(|line| line.split_once(" records searched, "))
        .map(|(before, _)| before.rsplit(' ').next().unwrap().parse().unwrap())
        .collect();
    let sum: usize = shares.iter().sum();
    assert!(
        shares.len() == 4 && shares.iter().all(|share| 8 * share > sum),
        "{shares:?}"
    );
    let name = |number: usize| {
        let result = own[0]["result"].as_str().unwrap();
        format!("badia/{result}.part-{number}-of-4")
    };
    let of = |number: usize| fs::read(site.path(&format!("fresh/{}", name(number)))).unwrap();
    for number in 0..4 {
        assert!(fs::read(site.path(&format!("all/{}", name(number)))).unwrap() == of(number));
    }
    let put = |results: &str, number: usize, bytes: &[u8]| {
        fs::create_dir_all(site.path(&format!("{results}/badia"))).unwrap();
        fs::write(site.path(&format!("{results}/{}", name(number))), bytes).unwrap();
    };
    // The site's own task, killed at any time and two at once beside all parts: run again, it ends in the same bytes.
    for number in 0..4 {
        put("killed", number, &of(number));
    }
    for _ in 0..6 {
        killed("fleet task plan.jsonl --index 0 --out killed --threads 1");
    }
    // What the killed ones have stored is not looked for in the parts again.
    let ended = of_one("killed");
    assert!(searched(&ended) <= sum, "{}", ended.out);
    alone("killed");
    // All of them; one alone; the others damaged; none.
    assert_eq!(searched(&of_one("all")), sum);
    alone("all");
    put("one", 2, &of(2));
    let alone_of_one: usize = searched(&of_one("one"));
    assert!(shares.contains(&alone_of_one), "{alone_of_one} of {shares:?}");
    alone("one");
    let mut flipped = of(0);
    let middle = flipped.len() / 2;
    flipped[middle] ^= 1;
    put("damaged", 0, &flipped);
    put("damaged", 1, &of(1)[..of(1).len() / 2]);
    put("damaged", 2, &of(2));
    put("damaged", 3, b"");
    let damaged = of_one("damaged");
    assert_eq!(searched(&damaged), alone_of_one);
    for number in [0, 1, 3] {
        let told = format!("{}: it is damaged", name(number));
        assert!(damaged.err.contains(&told), "no {told} in {}", damaged.err);
    }
    alone("damaged");
    // A part that comes after the result has nothing to do, and one that came late goes.
    put("damaged", 1, &of(1));
    let late = tirante(&site.folder, "fleet task parts.jsonl --index 1 --out damaged").done();
    assert!(late.contains("is there already"), "{late}");
    alone("damaged");
}

#[test]
fn what_cannot_be_split_is_said() {
    let site = Site::new(SITE);
    fs::create_dir_all(site.path("configs")).unwrap();
    fs::create_dir_all(site.path("archive/a")).unwrap();
    fs::copy(site.path("site.toml"), site.path("configs/a.toml")).unwrap();
    site.simulate("a/week", &Part::new(0, 2));
    fs::write(site.path("parts.jsonl"), "of yesterday\n").unwrap();
    let plan = |more: &str| {
        let line = format!("fleet plan archive --configs configs --out parts.jsonl {more}");
        tirante(&site.folder, &line)
    };
    let told = plan("--split 1e6").done();
    assert!(
        told.contains("no site is expected to cost more than 1000000 s")
            && told.contains("there is no parts.jsonl"),
        "{told}"
    );
    assert!(!site.path("parts.jsonl").exists());
    for wrong in ["0", "-1", "nan", "an hour"] {
        plan(&format!("'--split={wrong}'"))
            .ends(2)
            .says(&["a time in seconds above 0"]);
    }
    plan("--split 3600 --from-stores").ends(2);
    plan("--split 0.15").done();
    tirante(
        &site.folder,
        "fleet collect parts.jsonl --results results --out fleet.db",
    )
    .ends(2)
    .says(&["parts.jsonl: a plan of parts", "without --split"]);
    // What the file system refuses ends a part, which is then tried again.
    let path = site.path("archive/a/week.mcap");
    fs::remove_file(&path).unwrap();
    tirante(&site.folder, "fleet task parts.jsonl --index 0 --out results")
        .ends(1)
        .says(&["week.mcap"]);
}

#[test]
fn the_index_is_that_of_the_one_scheduler_there_is() {
    let site = Site::new(SITE);
    fs::create_dir_all(site.path("configs")).unwrap();
    fs::copy(site.path("site.toml"), site.path("configs/a.toml")).unwrap();
    fs::create_dir_all(site.path("archive/a")).unwrap();
    site.simulate("a/week", &Part::new(0, 1));
    planned(&site, "archive --configs configs", "plan.jsonl");
    let run = |set: &[(&str, &str)]| {
        let mut command = site.command(&["fleet", "task", "plan.jsonl", "--out", "results"]);
        for name in INDICES {
            command.env_remove(name);
        }
        let said = Said::of("fleet task", command.envs(set.iter().copied()));
        (said.code.unwrap(), said.all())
    };
    for name in INDICES {
        // An index beyond the plan names itself: it was read.
        let (code, why) = run(&[(name, "7")]);
        assert!(code == 2 && why.contains("there is no index 7"), "{name}: {why}");
        let (code, why) = run(&[(name, "first")]);
        assert!(code == 2 && why.contains(name) && why.contains("first"), "{why}");
    }
    let (code, why) = run(&[]);
    assert!(
        code == 2 && INDICES.iter().all(|name| why.contains(name)),
        "{why}"
    );
    let (code, why) = run(&[(INDICES[0], "0"), (INDICES[2], "0")]);
    assert!(code == 2 && why.contains("--index"), "{why}");
    // Set and empty counts as not set.
    let (code, why) = run(&[(INDICES[0], ""), (INDICES[1], " "), (INDICES[2], "7")]);
    assert!(code == 2 && why.contains("there is no index 7"), "{why}");
    let (code, why) = run(&[(INDICES[0], "")]);
    assert!(code == 2 && why.contains("none of"), "{why}");
    let (code, why) = run(&[(INDICES[1], "0")]);
    assert_eq!(code, 0, "{why}");
}

#[test]
fn what_does_not_fit_is_refused_with_site_file_and_next_step() {
    let site = Site::new(SITE);
    for folder in ["configs", "archive/a", "archive/empty", "archive/lonely"] {
        fs::create_dir_all(site.path(folder)).unwrap();
    }
    for name in ["a", "empty", "gone"] {
        fs::copy(site.path("site.toml"), site.path(&format!("configs/{name}.toml"))).unwrap();
    }
    site.simulate("a/week", &Part::new(0, 2));
    fs::copy(site.path("archive/a/week.mcap"), site.path("archive/stray.mcap")).unwrap();
    tirante(
        &site.folder,
        "fleet plan archive --configs configs --out plan.jsonl",
    )
    .ends(2)
    .says(&[
        "site lonely: archive/lonely has no configuration configs/lonely.toml",
        "site gone: configs/gone.toml has no folder archive/gone",
        "site empty: archive/empty: no recordings (*.mcap) in it",
        "archive/stray.mcap: lies beside the sites' folders",
    ]);
    assert!(!site.path("plan.jsonl").exists());

    planned(&site, "archive --configs configs --site a", "plan.jsonl");
    let task = |more: &str| {
        let line = format!("fleet task plan.jsonl --index 0 --out results {more}");
        tirante(&site.folder, &line)
    };
    // Out of reach: another attempt may find it.
    task("--archive elsewhere")
        .ends(1)
        .says(&["site a: elsewhere/a/week.mcap", "--archive"]);
    // Changed: another attempt does not help.
    let path = site.path("archive/a/week.mcap");
    let good = fs::read(&path).unwrap();
    let mut longer = good.clone();
    longer.push(0);
    fs::write(&path, &longer).unwrap();
    task("")
        .ends(2)
        .says(&["week.mcap changed since the plan", "plan again"]);
    fs::write(&path, &good).unwrap();
    let config = site.path("configs/a.toml");
    let text_before = fs::read_to_string(&config).unwrap();
    fs::write(&config, text_before.replace("cv = 0.2 }", "cv = 0.3 }")).unwrap();
    task("").ends(2).says(&["configs/a.toml changed"]);
    fs::write(&config, text_before).unwrap();
    task("").done();
    let cut = fs::read(site.path("plan.jsonl")).unwrap();
    fs::write(site.path("plan.jsonl"), &cut[..cut.len() / 2]).unwrap();
    task("").ends(2).says(&["cut short"]);
}

/// The configuration with a band of its own for each rod, and other texts in the place of some.
fn banded(changes: &[(&str, &str)]) -> String {
    let banded = SITE.replace("[rod.priors]", "[rod.modes]\nband_hz = [3.0, 45.0]\n[rod.priors]");
    changes.iter().fold(banded, |text, (from, to)| {
        assert!(text.contains(from));
        text.replace(from, to)
    })
}

/// Tables of a dump without the pictures.
fn without_pictures(dump: &str) -> String {
    let mut is_picture = false;
    let kept = dump.lines().filter(|line| {
        if line.starts_with("# ") {
            is_picture = line.starts_with("# snapshot:");
        }
        !is_picture
    });
    kept.map(|line| format!("{line}\n")).collect()
}

#[test]
fn another_prior_needs_no_samples_and_gives_what_a_whole_replay_gives() {
    let site = campaign();
    fs::write(site.path("old.toml"), banded(&[])).unwrap();
    let replay = |config: &str, store: &str, from: &str| {
        let line = format!("replay --json --config {config} --store {store} {from}");
        tirante(&site.folder, &line)
    };
    let first = replay("old.toml", "old.db", "archive").ends(3).out;
    for (number, change) in [
        &[("mean = 150e3, cv = 0.2", "mean = 120e3, cv = 0.4")][..],
        // Hardly any record keeps its labels: other refusals, other pictures.
        &[("mean = 150e3, cv = 0.2", "mean = 60e3, cv = 0.05")],
        // Another baseline, and other draws.
        &[
            ("baseline_records = 10", "baseline_records = 7"),
            ("seed = 11", "seed = 12"),
        ],
    ]
    .into_iter()
    .enumerate()
    {
        let (config, whole, again) = (
            format!("{number}.toml"),
            format!("{number}.db"),
            format!("{number}-again.db"),
        );
        fs::write(site.path(&config), banded(change)).unwrap();
        let full = replay(&config, &whole, "archive").out;
        let quick = replay(&config, &again, "--from-store old.db");
        assert!(matches!(quick.code, Some(0 | 3)), "{}", quick.err);
        assert!(full == quick.out && full != first, "{change:?}");
        assert_equal_dumps(
            &without_pictures(&site.dump(&whole)),
            &without_pictures(&site.dump(&again)),
        );
        // What came without samples can be analysed without samples again.
        let back = format!("{number}-back.db");
        let third = replay("old.toml", &back, &format!("--from-store {again}"));
        assert!(third.out == first, "{change:?}: {}", third.err);
    }
    // The same configuration: the pictures are those of the recordings, too.
    let same = replay("old.toml", "same.db", "--from-store old.db");
    assert!(same.out == first);
    assert_equal_dumps(&site.dump("old.db"), &site.dump("same.db"));
    // Once more into the same store: nothing is new.
    let none = replay("old.toml", "same.db", "--from-store old.db");
    assert!(none.out.is_empty(), "{none:?}");
    assert_equal_dumps(&site.dump("old.db"), &site.dump("same.db"));
}

#[test]
fn what_needs_samples_is_refused_by_name() {
    let site = Site::new(SITE);
    site.simulate("week", &Part::new(0, 4));
    let (_, code) = site.replay(&["archive"], "old.db");
    assert_eq!(code, 0);
    let refused = |config: &str| {
        fs::write(site.path("new.toml"), config).unwrap();
        let said = tirante(
            &site.folder,
            "replay --config new.toml --store new.db --from-store old.db",
        );
        assert!(!site.path("new.db").exists());
        said.ends(2).err
    };
    let other_prior = SITE.replacen("mean = 150e3, cv = 0.2", "mean = 120e3, cv = 0.4", 1);
    let why = refused(&other_prior);
    assert!(why.contains("rod north: its samples were searched from"), "{why}");
    assert!(!why.contains("rod south"), "{why}");
    for (more, wanted) in [
        ("[record]\nmin_duration_s = 20.0\n", "[record]"),
        ("[spectrum]\nprominence_db = 11.0\n", "[spectrum]"),
        (
            "[modes]\nmasks = [{ low_hz = 20.0, high_hz = 21.0 }]\n",
            "modes.masks",
        ),
    ] {
        let why = refused(&format!("{SITE}\n{more}"));
        assert!(
            why.contains(wanted) && why.contains("Replay the recordings"),
            "{why}"
        );
    }
    let why = refused(&SITE.replace("topic = \"/south\"", "topic = \"/west\""));
    assert!(why.contains("rod south: [rod.channel]"), "{why}");

    // The band that the refusal states is the one that helps.
    let why = refused(&other_prior);
    let stated = why.split('`').nth(1).unwrap();
    let widened = other_prior.replacen("[rod.priors]", &format!("[rod.modes]\n{stated}\n[rod.priors]"), 1);
    fs::write(site.path("new.toml"), widened).unwrap();
    let into = |store: &str, from: &str| {
        let line = format!("replay --json --config new.toml --store {store} {from}");
        tirante(&site.folder, &line).out
    };
    let quick = into("quick.db", "--from-store old.db");
    assert!(!quick.is_empty() && quick == into("full.db", "archive"));

    // Into itself, and a store that has none.
    tirante(
        &site.folder,
        "replay --config site.toml --store old.db --from-store old.db",
    )
    .ends(2)
    .says(&["the same store"]);
    Connection::open(site.path("old.db"))
        .unwrap()
        .execute("DELETE FROM resonance WHERE number = 3", ())
        .unwrap();
    let why = refused(SITE);
    assert!(why.contains("1 of its records have no resonances"), "{why}");
}

#[test]
fn an_array_over_stores_gives_what_an_array_over_recordings_gives() {
    let site = Site::new(SITE);
    for folder in ["configs", "new", "archive/a", "archive/b"] {
        fs::create_dir_all(site.path(folder)).unwrap();
    }
    for name in ["a", "b"] {
        site.simulate(&format!("{name}/week"), &Part::new(0, 6));
        fs::write(site.path(&format!("configs/{name}.toml")), banded(&[])).unwrap();
        let changed = banded(&[("mean = 150e3, cv = 0.2", "mean = 130e3, cv = 0.3")]);
        fs::write(site.path(&format!("new/{name}.toml")), changed).unwrap();
    }
    planned(&site, "archive --configs configs", "old.jsonl");
    array(&site, "slurm", "old.jsonl", "old").done();
    let full = planned(&site, "archive --configs new", "full.jsonl");
    array(&site, "slurm", "full.jsonl", "full").done();
    let again = planned(&site, "old --from-stores --configs new", "again.jsonl");
    array(&site, "slurm", "again.jsonl", "again").done();
    for (full, again) in full.iter().zip(&again) {
        assert_eq!(
            (&full["site"], &again["input"]),
            (&again["site"], &Json::from("store"))
        );
        let (full, again) = (
            site.dump(&result(full, "full")),
            site.dump(&result(again, "again")),
        );
        assert_equal_dumps(&without_pictures(&full), &without_pictures(&again));
    }
    // Commits that wait in a store's log are not in the file that was planned.
    let planned = site.path(&format!("old/{}", again[0]["files"][0]["path"].as_str().unwrap()));
    let log = PathBuf::from(format!("{}-wal", planned.display()));
    fs::write(&log, "commits").unwrap();
    let late = array(&site, "slurm", "again.jsonl", "late");
    assert!(
        late.code != Some(0) && late.all().contains("write-ahead log"),
        "{late:?}"
    );
    assert!(!site.path(&result(&again[0], "late")).exists());
}

/// Processor time of this process's children that ended \[s\].
fn children_s() -> f64 {
    let stat = fs::read_to_string("/proc/self/stat").unwrap();
    // After the name: fields 16 and 17, in hundredths of a second.
    let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    fields[13..15]
        .iter()
        .map(|ticks| ticks.parse::<f64>().unwrap())
        .sum::<f64>()
        / 100.0
}

/// Size of all files below a folder \[bytes\].
fn size_of(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).unwrap().flatten();
    entries
        .map(|entry| match entry.path() {
            path if path.is_dir() => size_of(&path),
            path => fs::metadata(path).unwrap().len(),
        })
        .sum()
}

/// A number from the environment.
fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().unwrap())
}

/// Wall time of an act, and processor time of its children \[s\].
fn timed(act: impl FnOnce()) -> (f64, f64) {
    let (begun, before_s) = (std::time::Instant::now(), children_s());
    act();
    (begun.elapsed().as_secs_f64(), children_s() - before_s)
}

/// Share of two cores that an array of two at once turns into results, and the cost of 88 million records:
/// `SITES=8 RECORDS=500 cargo test --release --test command -- --ignored --nocapture fleet::efficiency`, on a quiet machine.
#[test]
#[ignore = "a measurement"]
fn efficiency() {
    let (sites, records) = (number("SITES", 8), number("RECORDS", 500));
    let site = Site::new(SITE);
    fs::create_dir_all(site.path("configs")).unwrap();
    fs::create_dir_all(site.path("new")).unwrap();
    for number in 0..sites {
        fs::create_dir_all(site.path(&format!("archive/{number}"))).unwrap();
        // Records of 60 s at 40 Hz, an hour apart.
        let simulated = Part::new(0, records)
            .config(SITE)
            .replace("interval_s = 86_400.0", "interval_s = 3600.0")
            .replace("record_s = 30.0", "record_s = 60.0")
            .replace("fs_hz = 100.0\nsamples_per", "fs_hz = 40.0\nsamples_per")
            .replace("fs_hz = 100.0", "fs_hz = 40.0");
        site.simulate_as(&format!("archive/{number}/year.mcap"), &simulated, number as i64);
        let config = SITE.replace("fs_hz = 100.0", "fs_hz = 40.0");
        let banded = config.replace("[rod.priors]", "[rod.modes]\nband_hz = [3.0, 19.0]\n[rod.priors]");
        fs::write(site.path(&format!("configs/{number}.toml")), &banded).unwrap();
        let changed = banded.replace("mean = 150e3, cv = 0.2", "mean = 140e3, cv = 0.3");
        fs::write(site.path(&format!("new/{number}.toml")), changed).unwrap();
    }
    let (plan_s, _) = timed(|| {
        planned(&site, "archive --configs configs", "plan.jsonl");
    });
    let alone = timed(|| {
        for index in 0..sites {
            let line = format!("fleet task plan.jsonl --out alone --index {index} --threads 1");
            tirante(&site.folder, &line).done();
        }
    });
    let both = timed(|| drop(array(&site, "slurm", "plan.jsonl", "both").done()));
    planned(&site, "both --from-stores --configs new", "again.jsonl");
    let again = timed(|| drop(array(&site, "slurm", "again.jsonl", "again").done()));
    let (collect_s, collect_cpu_s) = timed(|| {
        tirante(
            &site.folder,
            "fleet collect plan.jsonl --results both --out fleet.db",
        )
        .done();
    });
    let all = (2 * sites * records) as f64;
    let each = |folder: &str| size_of(&site.path(folder)) as f64 / all;
    println!("{sites} sites, {all} records");
    println!(
        "plan {plan_s:.2} s, one after another {:.1} s wall, {:.1} s of processor",
        alone.0, alone.1
    );
    println!("two at once {:.1} s wall, {:.1} s of processor", both.0, both.1);
    println!("efficiency {:.1} %", 100.0 * alone.1 / (2.0 * both.0));
    println!(
        "again without samples {:.1} s wall, {:.1} s of processor: {:.1} times less",
        again.0,
        again.1,
        both.1 / again.1
    );
    println!("collect {collect_s:.2} s wall, {collect_cpu_s:.2} s of processor");
    println!(
        "a record: {:.2} ms, {:.2} ms again, {:.2} ms collected; {:.1} kB recorded, {:.1} kB stored, {:.1} kB collected",
        1e3 * both.1 / all,
        1e3 * again.1 / all,
        1e3 * collect_cpu_s / all,
        each("archive") / 1e3,
        each("both") / 1e3,
        fs::metadata(site.path("fleet.db")).unwrap().len() as f64 / all / 1e3
    );
    let million = 88.0;
    println!(
        "88 million records: {:.0} core-hours, {:.0} again; {:.2} TB recorded, {:.2} TB stored; collect alone {:.1} h",
        million * 1e6 * both.1 / all / 3600.0,
        million * 1e6 * again.1 / all / 3600.0,
        million * 1e-3 * each("archive") * 1e-3,
        million * 1e-3 * each("both") * 1e-3,
        million * 1e6 * collect_s / all / 3600.0
    );
}

/// Time until one costly site is done by its own task, and by parts, two at once, before that task:
/// `RECORDS=300 cargo test --release --test command -- --ignored --nocapture fleet::one_costly_site`, on a quiet machine.
#[test]
#[ignore = "a measurement"]
fn one_costly_site_in_parts() {
    let records = number("RECORDS", 300);
    let site = Site::new(SITE);
    for folder in ["configs", "archive/badia"] {
        fs::create_dir_all(site.path(folder)).unwrap();
    }
    // Records of ten minutes at 100 Hz, an hour apart.
    let simulated = Part::new(0, records)
        .config(SITE)
        .replace("interval_s = 86_400.0", "interval_s = 3600.0")
        .replace("record_s = 30.0", "record_s = 600.0");
    site.simulate_as("archive/badia/weeks.mcap", &simulated, 1);
    fs::write(site.path("configs/badia.toml"), SITE).unwrap();
    let own = planned(&site, "archive --configs configs", "plan.jsonl");
    let half_s = own[0]["cost_s"].as_f64().unwrap() / 1.9;
    let line = format!("archive --configs configs --split {half_s}");
    let parts = planned(&site, &line, "parts.jsonl");
    let task = |results: &str| {
        let line = format!("fleet task plan.jsonl --out {results} --index 0 --threads 1");
        tirante(&site.folder, &line).done()
    };
    let alone = timed(|| drop(task("alone")));
    let searched = timed(|| drop(array(&site, "slurm", "parts.jsonl", "split").done()));
    let rest = timed(|| assert!(task("split").contains(" searched in parts")));
    let of = |results: &str| fs::read(site.path(&result(&own[0], results))).unwrap();
    assert!(of("alone") == of("split"));
    println!(
        "{} records: its own task {:.1} s ({:.1} s of processor); {} parts, two at once, {:.1} s ({:.1} s), and the task after them \
         {:.1} s ({:.1} s): {:.2} of the time, {:.2} of the processor's",
        2 * records,
        alone.0,
        alone.1,
        parts.len(),
        searched.0,
        searched.1,
        rest.0,
        rest.1,
        (searched.0 + rest.0) / alone.0,
        (searched.1 + rest.1) / alone.1,
    );
}
