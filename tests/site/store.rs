//! The store: data is read back as written, once; damaged data is never used; one writer at a time.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::archive::*;
use rusqlite::Connection;
use std::collections::BTreeMap;
use std::path::Path;
use tirante::analysis::signal::record::RodId;
use tirante::analysis::track::fold::state::Opening;
use tirante::analysis::track::{Alarm, Kind, RodState, SetAside, State};
use tirante::site::prepared::Provenance;
use tirante::site::store::{
    Asked, Commit, Durability, Filter, Listing, Reader, RodRow, Store, StoreError, request_of_writer,
};
use tirante::site::trackers::Site;

fn open(path: &Path) -> Store {
    Store::open(path, Durability::Replay).unwrap()
}

#[test]
fn what_goes_in_comes_out_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = open(&path);
    assert!(store.moved_aside().is_none());
    fill(&mut store, 0..60);
    let dump = store.dump().unwrap();
    let states = store.states().unwrap();
    drop(store);

    let mut store = open(&path);
    assert!(store.moved_aside().is_none());
    assert_eq!(store.dump().unwrap(), dump);
    assert_eq!(store.states().unwrap(), states);
    let (north, south) = (RodId("north".into()), RodId("south è".into()));
    let mut expected = state(&north, 58);
    expected.periods = vec![period(0), period(1), period(2)];
    raise(&mut expected, Kind::Drift, 40);
    assert_eq!(states[&north], expected);
    assert_eq!(states[&south], state(&south, 59));

    assert!(store.known(&north, &identity(0)) && !store.known(&south, &identity(0)));
    assert!(store.known(&south, &rejected(&south, 9).identity().unwrap()));
    // The same archive fed again adds nothing, under whatever name.
    fill(&mut store, 0..60);
    assert_eq!(store.dump().unwrap(), dump);
    assert_eq!(store.periods(&north, 1).unwrap().len(), 3);
    assert_eq!(store.segments(&north).unwrap(), [expected.segment]);
    assert_eq!(store.alarms(&Filter::default()).unwrap(), expected.alarms);
    assert_eq!(store.events(&north).unwrap().len(), 1);
}

#[test]
fn the_plot_of_a_replay_ends_with_the_last_record() {
    let mut store = Store::in_memory().unwrap();
    fill(&mut store, 0..60);
    let rod = RodId("north".into());
    let starts = |most: usize| -> Vec<_> {
        let points = store.last_points(&rod, most).unwrap();
        points.iter().map(|point| point.start.unwrap()).collect()
    };
    assert_eq!(starts(3), [54, 56, 58].map(hour));
    assert_eq!(starts(100).len(), 30);
    let drawn = |most: usize| tirante::command::sketch::force(&store, &rod, most, 100).unwrap();
    assert!(drawn(10).contains("the last 10 records"), "{}", drawn(10));
    assert!(drawn(100).contains("north: change of force") && !drawn(100).contains("the last"));
}

#[test]
fn words_of_people_stay_on_their_line() {
    let said = |by: &str, note: &str| match Asked::acknowledge("a", Some(by), Some(note)) {
        Asked::Acknowledge { said, .. } => said,
        Asked::Rebaseline { .. } => None,
    };
    assert_eq!(
        said("Eve\nfake", "\u{1b}[2J x\u{202e}"),
        Some("Eve fake: [2J x".to_owned())
    );
    assert_eq!(said("\n", " "), None);
    let asked = Asked::rebaseline(Some("wedges\r\nrenewed"));
    assert_eq!(
        asked,
        Asked::Rebaseline {
            reason: Some("wedges  renewed".to_owned())
        }
    );
}

#[test]
fn a_record_that_a_wrong_clock_dated_is_not_the_latest() {
    let mut store = Store::in_memory().unwrap();
    fill(&mut store, 0..6);
    let rod = RodId("north".into());
    let mut commit = |outcome: &tirante::analysis::outcome::Outcome, set_aside: Option<SetAside>| {
        let mut row = row(outcome);
        row.set_aside = set_aside;
        let record = Some(new_record(outcome, &row));
        store
            .commit(&Commit {
                record,
                ..Commit::default()
            })
            .unwrap();
    };
    // Years ahead: set aside by tracking, rejected, and the first of a rod, which tracking has to believe.
    commit(&identified(&rod, 40_000), Some(SetAside::Clock));
    commit(&rejected(&rod, 50_000), None);
    commit(&identified(&rod, 60_000), None);
    let at = |now: i64| {
        let found = store.standings_of(Some(&rod), hour(now)).unwrap();
        let used = found[0].latest_row().unwrap().unwrap().start;
        (found[0].latest_start, used, found[0].ahead)
    };
    // North has the even hours.
    assert_eq!(at(5), (Some(hour(4)), Some(hour(4)), 3));
    // Without a gap they go on, before this clock or not: simulated, or the clock is wrong.
    assert_eq!(at(-23), (Some(hour(4)), Some(hour(4)), 3));
    assert_eq!(at(-9_000), (Some(hour(60_000)), Some(hour(60_000)), 0));
    // The time came.
    assert_eq!(at(50_000), (Some(hour(50_000)), Some(hour(4)), 1));
    assert_eq!(at(60_000), (Some(hour(60_000)), Some(hour(60_000)), 0));
}

#[test]
fn an_interrupted_run_ends_in_the_store_of_an_undisturbed_one() {
    let folder = tempfile::tempdir().unwrap();
    let mut whole = Store::in_memory().unwrap();
    fill(&mut whole, 0..60);
    let path = folder.path().join("site.db");
    for end in [1, 2, 3, 17, 41, 42, 60] {
        fill(&mut open(&path), 0..end);
    }
    assert_eq!(open(&path).dump().unwrap(), whole.dump().unwrap());
}

#[test]
fn columns_say_what_the_line_says() {
    let mut store = Store::in_memory().unwrap();
    fill(&mut store, 0..20);
    let mut listed = Vec::new();
    store
        .list(
            Listing::Records,
            &Filter::default(),
            |names, values| -> Result<(), StoreError> {
                assert_eq!(names.len(), values.len());
                listed.push(
                    names
                        .iter()
                        .cloned()
                        .zip(values.iter().cloned())
                        .collect::<BTreeMap<_, _>>(),
                );
                Ok(())
            },
        )
        .unwrap();
    assert_eq!(listed.len(), 20);
    use rusqlite::types::Value::{Integer, Null, Real, Text};
    let first = &listed[0];
    assert_eq!(first["rod"], Text("north".into()));
    assert_eq!(first["start"], Text(hour(0).to_string()));
    assert_eq!(first["relative_force"], Real(0.9515));
    assert_eq!(first["axial_force_q025_n"], Real(4e5));
    assert_eq!(first["seed"], Text(u64::MAX.to_string()));
    assert_eq!(first["mode_3_hz"], Real(13.5));
    assert_eq!(first["mode_1_damping"], Null);
    assert_eq!(first["draws"], Integer(1_000_000));
    assert_eq!(first["rms"], Real(1.5e-5));
    assert_eq!(first["rejection"], Null);
    let mut lines = Vec::new();
    let filter = Filter {
        rod: Some(RodId("south è".into())),
        from: Some(hour(5)),
        to: Some(hour(11)),
    };
    store
        .lines(Listing::Records, &filter, |line| -> Result<(), StoreError> {
            lines.push(line.to_owned());
            Ok(())
        })
        .unwrap();
    let south = filter.rod.clone().unwrap();
    let expected: Vec<String> = [5, 7].map(|n| line(&identified(&south, n))).to_vec();
    assert_eq!(lines[..2], expected);
    assert_eq!(lines[2], line(&rejected(&south, 9)));
    assert_eq!(lines.len(), 3);
}

#[test]
fn a_record_twice_is_refused_and_leaves_no_trace() {
    let mut store = Store::in_memory().unwrap();
    fill(&mut store, 0..5);
    let dump = store.dump().unwrap();
    let rod = RodId("north".into());
    let outcome = identified(&rod, 2);
    let mut now = state(&rod, 99);
    let commit = |store: &mut Store, now: &State| {
        store.commit(&Commit {
            record: Some(crate::archive::new_record(
                &outcome,
                &crate::archive::row(&outcome),
            )),
            rod: Some(RodRow {
                state: now,
                stands: &RodState::Monitoring,
                closed: &[],
                events: &[],
            }),
            ..Commit::default()
        })
    };
    assert!(commit(&mut store, &now).is_err());
    assert_eq!(store.dump().unwrap(), dump);
    // A value that would not read back equal is refused, not written.
    now.open[0].delta = f64::NAN;
    let error = store
        .commit(&Commit {
            rod: Some(RodRow {
                state: &now,
                stands: &RodState::Monitoring,
                closed: &[],
                events: &[],
            }),
            ..Commit::default()
        })
        .unwrap_err();
    assert!(
        matches!(&error, StoreError::NotStorable { what, .. } if what == "open"),
        "{error}"
    );
    assert_eq!(store.dump().unwrap(), dump);
    // And the next good commit writes everything that the refused ones did not.
    now.open[0].delta = 1.5;
    store
        .commit(&Commit {
            rod: Some(RodRow {
                state: &now,
                stands: &RodState::Monitoring,
                closed: &[],
                events: &[],
            }),
            ..Commit::default()
        })
        .unwrap();
    let mut kept = store.states().unwrap().remove(&rod).unwrap();
    kept.periods.clear();
    assert_eq!(kept, now);
}

#[test]
fn a_second_writer_is_told_who_writes_and_readers_are_let_in() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = open(&path);
    fill(&mut store, 0..4);
    let link = folder.path().join("link.db");
    std::os::unix::fs::symlink(&path, &link).unwrap();
    for name in [&path, &link] {
        let error = Store::open(name, Durability::Full).err().unwrap();
        assert!(matches!(error, StoreError::Held { pid: Some(pid), .. } if pid == std::process::id()));
    }
    let reader = Reader::open(&path).unwrap();
    assert_eq!(reader.standings().unwrap().len(), 2);
    fill(&mut store, 4..44);
    assert_eq!(reader.dump().unwrap(), store.dump().unwrap());
    drop(store);
    open(&path);
    assert_eq!(
        std::fs::read_dir(folder.path())
            .unwrap()
            .filter(|e| {
                e.as_ref()
                    .unwrap()
                    .file_name()
                    .to_string_lossy()
                    .contains("corrupt")
            })
            .count(),
        0
    );
}

#[test]
fn requests_wait_for_the_writer_and_keep_their_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = open(&path);
    fill(&mut store, 0..44);
    let north = RodId("north".into());
    let alarm = store.alarms(&Filter::default()).unwrap()[0].id.clone();
    assert_eq!(store.alarm(&alarm).unwrap().unwrap().acknowledged, None);
    assert_eq!(store.alarm("none").unwrap(), None);
    let acknowledge = Asked::Acknowledge {
        alarm: alarm.clone(),
        said: Some("M. Rossi: looked at".to_owned()),
    };
    let rebaseline = Asked::Rebaseline {
        reason: Some("tightened".into()),
    };
    let asked = hour(1000);
    let numbers = request_of_writer(
        &path,
        &[
            (north.clone(), acknowledge.clone()),
            (north.clone(), rebaseline.clone()),
        ],
        asked,
    )
    .unwrap();
    assert_eq!(numbers, [1, 2]);
    assert_eq!(store.request(&north, &acknowledge, asked).unwrap(), 3);
    let waiting: Vec<Asked> = store
        .waiting(&north)
        .unwrap()
        .into_iter()
        .map(|r| r.what)
        .collect();
    assert_eq!(waiting, [acknowledge.clone(), rebaseline, acknowledge]);
    assert_eq!(store.waiting(&RodId("south è".into())).unwrap(), []);

    // The first is applied at once; the second needs the fold, and the third waits behind it.
    let mut states = store.states().unwrap();
    assert_eq!(store.acknowledge_waiting(&mut states).unwrap(), (1, 2));
    assert_eq!(store.alarm(&alarm).unwrap().unwrap().acknowledged, Some(asked));
    let kept = store.alarms(&Filter::default()).unwrap();
    assert_eq!(kept[0].acknowledged, Some(asked));
    assert_eq!(store.events(&north).unwrap().len(), 2);
    let news = store.news_after(0, 10).unwrap();
    let words: Vec<Option<&str>> = news.iter().map(|news| news.words.as_deref()).collect();
    assert_eq!(words, [None, Some("M. Rossi: looked at")]);
    let standing = store.standings().unwrap().remove(0);
    assert_eq!((standing.rod, standing.alarms), (north.clone(), kept));
    let waiting: Vec<i64> = store.waiting(&north).unwrap().iter().map(|r| r.number).collect();
    assert_eq!(waiting, [2, 3]);
    store
        .commit(&Commit {
            applied: Some(2),
            ..Commit::default()
        })
        .unwrap();
    drop(store);
    assert_eq!(open(&path).waiting(&north).unwrap().len(), 1);
}

#[test]
fn what_is_no_store_is_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let text = folder.path().join("notes.txt");
    std::fs::write(&text, "n".repeat(200)).unwrap();
    let other = folder.path().join("other.db");
    Connection::open(&other)
        .unwrap()
        .execute_batch("CREATE TABLE t (a); INSERT INTO t VALUES (1)")
        .unwrap();
    for path in [&text, &other] {
        let before = std::fs::read(path).unwrap();
        for _ in 0..2 {
            let error = Store::open(path, Durability::Full).err().unwrap();
            assert!(matches!(error, StoreError::Foreign { .. }), "{error}");
        }
        assert_eq!(std::fs::read(path).unwrap(), before);
    }
    assert!(matches!(
        Store::open(folder.path(), Durability::Full),
        Err(StoreError::Foreign { .. })
    ));
    assert!(matches!(
        Reader::open(&folder.path().join("none.db")),
        Err(StoreError::Missing { .. })
    ));
    assert!(Store::open(&folder.path().join("none/none.db"), Durability::Full).is_err());
}

#[test]
fn a_newer_format_is_refused_by_name_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    fill(&mut open(&path), 0..3);
    Connection::open(&path)
        .unwrap()
        .pragma_update(None, "user_version", 99)
        .unwrap();
    let before = std::fs::read(&path).unwrap();
    for error in [
        Store::open(&path, Durability::Full).err(),
        Reader::open(&path).err(),
    ] {
        let error = error.unwrap();
        assert!(
            matches!(
                error,
                StoreError::Newer {
                    found: 99,
                    known: 7,
                    ..
                }
            ),
            "{error}"
        );
        let text = error.to_string();
        assert!(
            text.contains("format 99") && text.contains(env!("CARGO_PKG_VERSION")),
            "{text}"
        );
    }
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

/// Opens a damaged copy as a writer: it must be intact and equal, refused with a reason, or moved aside with
/// its journals.
fn survives(path: &Path, damaged: &[u8], dump: &str, what: &str) -> bool {
    let folder = path.parent().unwrap();
    for entry in std::fs::read_dir(folder).unwrap().flatten() {
        std::fs::remove_file(entry.path()).unwrap();
    }
    std::fs::write(path, damaged).unwrap();
    std::fs::write(format!("{}.lock", path.display()), "1").unwrap();
    match Store::open(path, Durability::Replay) {
        Ok(mut store) => match store.moved_aside().map(Path::to_owned) {
            None => {
                assert_eq!(store.dump().unwrap(), dump, "{what}");
                false
            }
            Some(aside) => {
                assert_eq!(std::fs::read(aside).unwrap(), damaged, "{what}");
                fill(&mut store, 0..2);
                true
            }
        },
        Err(error) => {
            assert!(
                matches!(error, StoreError::Newer { .. } | StoreError::Database { .. }),
                "{what}: {error}"
            );
            assert_eq!(std::fs::read(path).unwrap(), damaged, "{what}");
            true
        }
    }
}

#[test]
fn damage_is_found_and_moved_aside() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = open(&path);
    fill(&mut store, 0..50);
    let dump = store.dump().unwrap();
    drop(store);
    let whole = std::fs::read(&path).unwrap();
    assert!(!survives(&path, &whole, &dump, "whole"));
    for cut in [
        0,
        1,
        16,
        50,
        99,
        100,
        4095,
        4096,
        8192,
        whole.len() / 2,
        whole.len() - 4096,
    ] {
        assert!(
            survives(&path, &whole[..cut], &dump, &format!("cut at {cut}")),
            "cut at {cut}"
        );
    }
    // The last byte of the last page may be one that nothing hangs on.
    survives(&path, &whole[..whole.len() - 1], &dump, "cut by one byte");
    assert!(survives(&path, &vec![0; whole.len()], &dump, "zeros"));
    let mut found = 0;
    let places: Vec<usize> = (0..100)
        .chain((100..whole.len()).step_by(whole.len() / 100))
        .collect();
    for (n, &place) in places.iter().enumerate() {
        let mut damaged = whole.clone();
        damaged[place] ^= if n % 2 == 0 { 1 << (n % 8) } else { 0xff };
        found += usize::from(survives(&path, &damaged, &dump, &format!("byte {place}")));
    }
    // Free space and counters of no consequence take the rest.
    assert!(found > places.len() / 3, "{found} of {}", places.len());
}

#[test]
fn a_reader_does_not_believe_a_changed_row() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    fill(&mut open(&path), 0..50);
    let read = |reader: Reader, listing| {
        reader.list(listing, &Filter::default(), |_, _| Ok::<(), StoreError>(()))?;
        reader.lines(listing, &Filter::default(), |_| Ok::<(), StoreError>(()))
    };
    read(Reader::open(&path).unwrap(), Listing::Records).unwrap();
    for change in [
        "UPDATE record SET relative_force = 0.96 WHERE id = 7",
        "UPDATE line SET json = replace(json, '0.9515', '0.9615') WHERE record = 7",
        "UPDATE mode SET frequency_hz = 4.6 WHERE record = 7 AND mode_order = 1",
        "UPDATE alarm SET stands = 0",
        "UPDATE period SET residual = 1.5 WHERE period = 0",
    ] {
        let copy = folder.path().join("copy.db");
        std::fs::copy(&path, &copy).unwrap();
        assert!(
            Connection::open(&copy).unwrap().execute(change, ()).unwrap() > 0,
            "{change}"
        );
        let error = Reader::open(&copy)
            .and_then(|reader| read(reader, Listing::Records))
            .unwrap_err();
        assert!(matches!(error, StoreError::Damaged { .. }), "{change}: {error}");
        let store = open(&copy);
        assert!(store.moved_aside().is_some(), "{change}");
    }
}

/// A store that the program of format 1 wrote (`replay recordings/todi-pull.mcap`), and its output of
/// `history --format json`.
#[test]
fn a_store_of_the_first_format_is_read_as_it_is_and_brought_up_to_date_by_a_writer() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let packed = include_bytes!("../fixtures/store-format-1.db.zst");
    std::fs::write(&path, zstd::decode_all(&packed[..]).unwrap()).unwrap();
    // The program that wrote it left its lock's file.
    std::fs::write(folder.path().join("site.db.lock"), "1\n").unwrap();
    let history = |reader: &Reader| {
        let mut text = String::new();
        reader
            .lines(
                Listing::Records,
                &Filter::default(),
                |line| -> Result<(), StoreError> {
                    text += line;
                    text.push('\n');
                    Ok(())
                },
            )
            .unwrap();
        text
    };
    let expected = include_str!("../fixtures/store-format-1.json");
    // All but the names of the columns of periods, of which it has none.
    let dumped = |reader: &Reader| {
        let mut dump = reader.dump().unwrap();
        let from = dump.find("# period:").unwrap();
        let to = from + dump[from..].find('\n').unwrap();
        dump.replace_range(from..to, "");
        dump
    };
    let reader = Reader::open(&path).unwrap();
    assert_eq!(history(&reader), expected);
    // Its table of periods lacks columns of now.
    let periods = reader.columns(Listing::Periods).unwrap();
    assert_eq!(periods.last().unwrap(), "evidence_blind");
    let none = |_: &[String], _: &[rusqlite::types::Value]| {
        Err(StoreError::Held {
            path: path.clone(),
            pid: None,
        })
    };
    reader.list(Listing::Periods, &Filter::default(), none).unwrap();
    let before = dumped(&reader);
    drop(reader);
    let store = open(&path);
    assert_eq!(store.moved_aside(), None);
    assert_eq!(history(&store), expected);
    assert_eq!(dumped(&store), before);
    assert_eq!(store.files().unwrap().len(), 0);
    assert_eq!(store.delivered("mail").unwrap(), None);
    drop(store);
    assert_eq!(dumped(&Reader::open(&path).unwrap()), before);
}

/// Writes the state of a rod, with its alarms as raised.
fn keep(store: &mut Store, state: &State, stands: &RodState) {
    let raised = state
        .alarms
        .iter()
        .map(|alarm| tirante::analysis::track::AlarmEvent {
            what: tirante::analysis::track::What::Raised,
            time: alarm.raised,
            alarm: alarm.clone(),
        });
    let events: Vec<_> = raised.collect();
    store
        .commit(&Commit {
            rod: Some(RodRow {
                state,
                stands,
                closed: &[],
                events: &events,
            }),
            ..Commit::default()
        })
        .unwrap();
}

#[test]
fn a_state_from_before_a_requested_baseline_does_not_come_back() {
    let mut store = Store::in_memory().unwrap();
    let rod = RodId("north".into());
    let found = |store: &Store, key: &str| {
        let state = store.off_the_shelf(&rod, key).unwrap();
        state.map(|state| state.segment.number)
    };
    let first = State::new(rod.clone(), "K".into());
    keep(&mut store, &first, &RodState::Monitoring);
    store.shelve(&first).unwrap();
    let second = first.next_segment(Opening::Changed, "L".into(), false);
    keep(&mut store, &second, &RodState::Monitoring);
    assert_eq!(found(&store, "K"), Some(1));
    for (opening, number) in [(Opening::Requested, 3), (Opening::Clock, 3)] {
        let mut store = Store::in_memory().unwrap();
        keep(&mut store, &first, &RodState::Monitoring);
        store.shelve(&first).unwrap();
        keep(&mut store, &second, &RodState::Monitoring);
        let third = second.next_segment(opening, "L".into(), false);
        keep(&mut store, &third, &RodState::Monitoring);
        assert_eq!(found(&store, "K"), None, "{opening:?}");
        assert_eq!(store.shelved(&rod).unwrap(), []);
        // A baseline learned after it does.
        store.shelve(&third).unwrap();
        keep(
            &mut store,
            &third.next_segment(Opening::Changed, "M".into(), false),
            &RodState::Monitoring,
        );
        assert_eq!(found(&store, "L"), Some(number));
    }
}

#[test]
fn without_a_fold_an_acknowledgement_leaves_the_state_that_the_fold_would() {
    let mut store = Store::in_memory().unwrap();
    let rod = RodId("north".into());
    let mut state = State::new(rod.clone(), "K".into());
    state.segment.fault = Some("too few modes".to_owned());
    let mut alarm = Alarm::new(&rod, Kind::Drift, 1, hour(1), "It fell.".into());
    alarm.cleared = Some(hour(2));
    state.alarms.push(alarm.clone());
    keep(&mut store, &state, &RodState::Alarm);
    let said = Asked::acknowledge(&alarm.id, Some("M. Rossi"), None);
    store.request(&rod, &said, hour(3)).unwrap();
    let mut states = store.states().unwrap();
    assert_eq!(store.acknowledge_waiting(&mut states).unwrap(), (1, 0));
    let reason = "no baseline: too few modes".to_owned();
    let standing = store.standing(&rod).unwrap().unwrap();
    assert_eq!(standing.state, RodState::NotMonitoring { reason });
}

#[test]
fn alarms_of_a_rod_that_was_taken_out_end_and_can_be_acknowledged() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("site.db");
    let mut store = open(&path);
    let rod = RodId("north".into());
    let mut state = State::new(rod.clone(), "K".into());
    state.latest = Some(hour(5));
    for kind in [Kind::Drift, Kind::Sensor] {
        state
            .alarms
            .push(Alarm::new(&rod, kind, 1, hour(1), "It is so.".into()));
    }
    keep(&mut store, &state, &RodState::Alarm);
    let provenance = Provenance {
        site: "Duomo",
        hash: "h",
        effective: "",
    };
    let mut site = Site::open([], store, provenance).unwrap();
    let standing = |site: &Site| -> Vec<Kind> {
        let alarms = site.store().standing(&rod).unwrap().unwrap().alarms;
        alarms.iter().map(|alarm| alarm.kind).collect()
    };
    // The sensor's condition is over; what is latched waits for a person.
    assert_eq!(standing(&site), [Kind::Drift]);
    let said = Asked::acknowledge(&state.alarms[0].id, Some("M. Rossi"), None);
    request_of_writer(&path, &[(rod.clone(), said)], hour(6)).unwrap();
    assert_eq!(site.apply_requests().unwrap(), 1);
    assert_eq!(standing(&site), []);
    assert_eq!(site.store().rods_asked().unwrap(), []);
}
