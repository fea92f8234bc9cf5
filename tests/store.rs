//! The store: what goes in comes out, once; what is damaged is never believed; one writer at a time.

use rusqlite::Connection;
use std::collections::BTreeMap;
use std::path::Path;
use tirante::analysis::{Identification, Measurement};
use tirante::bayes::{Adjustment, Conflict, Method, Posterior};
use tirante::beam::{Parameterisation, Section};
use tirante::modes::Mode;
use tirante::outcome::{Outcome, Rejected};
use tirante::record::{Reading, Rejection, RodId, Timestamp};
use tirante::store::{
    Asked, Commit, Durability, Filter, Listing, Position, Reader, RecordRow, RodRow, Store, StoreError,
    request_of_writer,
};
use tirante::track::alarm::{Board, Watches};
use tirante::track::baseline::BaselineMode;
use tirante::track::period::{Charted, Pending};
use tirante::track::plausibility::Plausibility;
use tirante::track::relative::Misfit;
use tirante::track::state::Opening;
use tirante::track::thermal::Thermal;
use tirante::track::{AlarmEvent, Baseline, Kind, LogMode, Period, RodState, Segment, State};

const HOUR_NS: i64 = 3_600_000_000_000;
const CONFIG: &str = "0123456789abcdef";

fn hour(number: i64) -> Timestamp {
    Timestamp::from_nanos(1_700_000_000_123_456_789 + number * HOUR_NS)
}

fn identity(number: i64) -> [u8; 32] {
    let mut identity = [7; 32];
    identity[..8].copy_from_slice(&number.to_le_bytes());
    identity
}

fn identified(rod: &RodId, number: i64) -> Outcome {
    let mode = |order: usize| Mode {
        order,
        frequency_hz: 4.5 * order as f64 + 1e-3 * (number % 7) as f64,
        sd_hz: 0.004,
        damping: (order > 1).then_some(0.002),
    };
    Outcome::Identified(Box::new(Identification {
        rod: rod.clone(),
        measurement: Some(Measurement {
            identity: identity(number),
            start: hour(number),
            duration_s: 60.0,
            fs_hz: 200.0,
            temperature_c: Some(12.25),
            readings: Vec::new(),
            rms: 1.5e-5,
            flags: Vec::new(),
        }),
        modes: vec![mode(1), mode(2), mode(3)],
        posterior: Posterior {
            parameterisation: Parameterisation::new(Section::Direct),
            particles: vec![5.7e5, 4e5, 37.0, 4e5, 4e5, 14.0],
            weights: vec![1.0],
            epsilon: 0.01,
            draws: 1_000_000,
            accepted: 1,
            invalid: 0,
            ess: 1.0,
            seed: u64::MAX,
            method: Method::Rejection,
            adjustment: Adjustment::None,
            stop: None,
        },
        conflict: Conflict {
            score: 0.4,
            nearest_hz: vec![4.5, 9.0, 13.5],
            residuals: vec![0.1, 0.2, -0.3],
            violation: None,
            prior_tail: 0.5,
        },
    }))
}

fn rejected(rod: &RodId, number: i64) -> Outcome {
    Outcome::Rejected(Box::new(Rejected {
        rod: rod.clone(),
        start: Some(hour(number)),
        duration_s: Some(3.0),
        fs_hz: None,
        identity: None,
        readings: Vec::new(),
        rejection: Rejection::NoPeak {
            low_hz: 1.0,
            high_hz: 9.0,
        },
    }))
}

/// A line as `replay --json` prints it, as far as the columns go.
fn line(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Identified(identification) => format!(
            concat!(
                r#"{{"rod":"{}","start":"{}","duration_s":60.0,"fs_hz":200.0,"modes":[],"#,
                r#""axial_force_n":{{"mean":574000.0,"sd":109000.0,"cv":0.19,"q025":4e5,"q50":570000.0,"q975":8e5}},"#,
                r#""parameters":{{"density_kg_m3":{{"mean":7500.5,"cv":0.05}}}},"epsilon":0.01,"draws":1000000,"#,
                r#""accepted":100,"ess":99.5,"conflict":0.4,"prior_tail":0.5,"tracked_force_n":null,"#,
                r#""relative_force":{{"mean":0.9515,"sd":0.0014,"q025":0.9487,"q975":0.9543}},"not_axial_p":0.37,"#,
                r#""temperature_c":12.25,"reference_temperature_c":null,"force_at_reference_n":null,"#,
                r#""relative_force_at_reference":null,"state":"monitoring","state_reason":null,"segment":1,"#,
                r#""set_aside":null,"alarms":[],"events":[],"flags":[],"rejection":null,"#,
                r#""seed":18446744073709551615,"config":"{}","analysis_version":1}}"#
            ),
            identification.rod,
            identification.measurement.as_ref().unwrap().start,
            CONFIG
        ),
        Outcome::Rejected(rejected) => format!(
            concat!(
                r#"{{"rod":"{}","start":"{}","duration_s":3.0,"fs_hz":null,"state":"monitoring","#,
                r#""rejection":{{"code":"no-peak","message":"no \"peak\", none"}},"seed":null,"config":"{}","analysis_version":1}}"#
            ),
            rejected.rod,
            rejected.start.unwrap(),
            CONFIG
        ),
    }
}

fn state(rod: &RodId, number: i64) -> State {
    let modes: Vec<LogMode> = (1..=3)
        .map(|order| LogMode {
            order,
            log_frequency: 1.504_077_396_776_274 + (order as f64).ln() + 1e-5 * number as f64,
            log_sd: 8.9e-4,
        })
        .collect();
    State {
        rod: rod.clone(),
        segment: Segment {
            number: 1,
            reason: Opening::First,
            key: "1-00".to_owned(),
            baseline: Some(Baseline {
                first: hour(0),
                last: hour(29),
                records: 30,
                modes: vec![BaselineMode {
                    order: 1,
                    log_frequency: 0.1 + 0.2,
                    log_sd: 1e-4,
                    records: 30,
                }],
                particles: (0..3072).map(|i| 1e5 / (1.0 + f64::from(i))).collect(),
                overdispersion: 1.0,
                rms: (1e-5, 2e-5),
                misfit: 1.2,
            }),
            reference_c: Some(11.1),
            fault: None,
        },
        learning: Vec::new(),
        open: (0..number.rem_euclid(24))
            .map(|n| Pending {
                start: hour(number - n),
                end: hour(number - n).plus_seconds(60.0),
                delta: -0.049 + 1e-4 / (1.0 + n as f64),
                sd: 2e-3,
                misfit: misfit(),
            })
            .collect(),
        readings: vec![
            Reading {
                time: hour(number),
                celsius: 0.1 * number as f64,
            };
            6
        ],
        thermal: Thermal {
            lags_s: vec![0.0, 3600.0],
            time: Some(hour(number)),
            last_c: 12.3,
            lagged_c: vec![12.3, 12.1],
        },
        regression: None,
        charts: None,
        frozen: false,
        closed: Some(number.div_euclid(24)),
        periods: Vec::new(),
        alarms: Vec::new(),
        watches: Watches::default(),
        plausibility: Plausibility::default(),
        latest: Some(hour(number)),
        latest_modes: modes,
    }
}

fn misfit() -> Vec<Misfit> {
    (1..=3)
        .map(|order| Misfit {
            order,
            residual: 1e-4 / order as f64,
            sd: 9e-4,
        })
        .collect()
}

fn period(index: i64) -> Period {
    Period {
        index,
        start: hour(24 * index),
        records: 24,
        delta: -1e-3 / 3.0,
        delta_sd: 4e-4,
        lagged_c: Some(vec![12.3, 12.1]),
        misfit: misfit(),
        not_axial_p: 0.61,
        charted: (index % 2 == 0).then_some(Charted {
            expected: 1e-4,
            expected_sd: 3e-3,
            residual: -1.5,
            leverage: 0.1,
            at_reference: -2e-3,
            at_reference_sd: 1e-3,
            temperature_c: Some(12.2),
            cusum: Some([[0.0, 1.0], [0.25, 2.5]]),
        }),
    }
}

fn raise(state: &mut State, kind: Kind, number: i64) -> Vec<AlarmEvent> {
    let rod = state.rod.clone();
    let mut board = Board::new(&rod, state.segment.number, &mut state.alarms);
    board.raise(
        kind,
        hour(number),
        format!("the \"{kind}\" of record {number}"),
        None,
    );
    board.into_events()
}

/// Two rods, records, a rejection every tenth, a period a day, an alarm at record 40; `from..to` of them.
fn fill(store: &mut Store, range: std::ops::Range<i64>) {
    store
        .keep_config(CONFIG, "the site", "[site]\nname = \"the site\"\n")
        .unwrap();
    let mut states = store.states().unwrap();
    for number in range {
        let rod = RodId(["north", "south è"][(number % 2) as usize].to_owned());
        let outcome = if number % 10 == 9 {
            rejected(&rod, number)
        } else {
            identified(&rod, number)
        };
        if store.known(&rod, &outcome.identity().unwrap()) {
            continue;
        }
        let before = states.get(&rod);
        let mut now = state(&rod, number);
        if let Some(before) = before {
            now.alarms.clone_from(&before.alarms);
            now.periods.clone_from(&before.periods);
        }
        let closed: Vec<Period> = (number % 24 == 0)
            .then(|| period(number / 24))
            .into_iter()
            .collect();
        now.periods.extend(closed.iter().cloned());
        let events = if number == 40 {
            raise(&mut now, Kind::Drift, number)
        } else {
            Vec::new()
        };
        let stands = if now.alarms.is_empty() {
            RodState::Monitoring
        } else {
            RodState::Alarm
        };
        store
            .commit(&Commit {
                record: Some(RecordRow {
                    outcome: &outcome,
                    line: &line(&outcome),
                    emulator: "reduced",
                }),
                rod: Some(RodRow {
                    state: &now,
                    stands: &stands,
                    closed: &closed,
                    events: &events,
                }),
                applied: None,
                source: Some(Position {
                    name: "a.mcap",
                    bytes: number as u64 * 1000,
                    records: number as u64,
                }),
            })
            .unwrap();
        states.insert(rod, now);
    }
}

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
            record: Some(RecordRow {
                outcome: &outcome,
                line: &line(&outcome),
                emulator: "reduced",
            }),
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
    // What would read back as something else is refused, not written.
    now.thermal.last_c = f64::NAN;
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
        matches!(&error, StoreError::Unkeepable { what, .. } if what == "thermal"),
        "{error}"
    );
    assert_eq!(store.dump().unwrap(), dump);
    // And the next good commit writes everything that the refused ones did not.
    now.thermal.last_c = 1.5;
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
    assert_eq!(store.alarm(&alarm).unwrap(), Some((north.clone(), false)));
    assert_eq!(store.alarm("none").unwrap(), None);
    let acknowledge = Asked::Acknowledge { alarm: alarm.clone() };
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
    assert_eq!(store.acknowledge_waiting(&mut states).unwrap(), 2);
    assert_eq!(store.alarm(&alarm).unwrap(), Some((north.clone(), true)));
    let kept = store.alarms(&Filter::default()).unwrap();
    assert_eq!(kept[0].acknowledged, Some(asked));
    assert_eq!(store.events(&north).unwrap().len(), 2);
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
        .pragma_update(None, "user_version", 2)
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
                    found: 2,
                    known: 1,
                    ..
                }
            ),
            "{error}"
        );
        let text = error.to_string();
        assert!(
            text.contains("format 2") && text.contains(env!("CARGO_PKG_VERSION")),
            "{text}"
        );
    }
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

/// Opens a damaged copy as a writer: fine and equal, refused with a reason, or moved aside with its journals.
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
