//! A site of two rods with made-up results, to fill a store.

#![allow(clippy::unwrap_used, dead_code)] // helpers of tests are tests; not every test uses all of them
use tirante::analysis::identify::{Identification, Measurement};
use tirante::analysis::inference::{Adjustment, Conflict, Method, Posterior};
use tirante::analysis::outcome::{Outcome, Rejected};
use tirante::analysis::record_view::Snapshot;
use tirante::analysis::rod::beam::{Parameterisation, Section};
use tirante::analysis::rod::prior::{Prior, RodPrior};
use tirante::analysis::signal::modes::{Mode, Motion, MotionKind};
use tirante::analysis::signal::record::{Envelope, Reading, Rejection, RodId, Timestamp};
use tirante::analysis::signal::spectrum::Spectrum;
use tirante::analysis::track::alarm::{Board, Watches};
use tirante::analysis::track::baseline::BaselineMode;
use tirante::analysis::track::drift::Filters;
use tirante::analysis::track::drift::period::{Charted, Evidence, Pending};
use tirante::analysis::track::fold::state::Opening;
use tirante::analysis::track::plausibility::Plausibility;
use tirante::analysis::track::relative::Misfit;
use tirante::analysis::track::thermometer::Thermometer;
use tirante::analysis::track::{AlarmEvent, Baseline, Kind, Period, RodState, Segment, State};
use tirante::site::record_row::RecordRow;
use tirante::site::store::{Commit, NewRecord, Position, RodRow, SnapshotRow, Store};

pub const HOUR_NS: i64 = 3_600_000_000_000;
pub const CONFIG: &str = "0123456789abcdef";

pub fn hour(number: i64) -> Timestamp {
    Timestamp::from_nanos(1_700_000_000_123_456_789 + number * HOUR_NS)
}

pub fn identity(number: i64) -> [u8; 32] {
    let mut identity = [7; 32];
    identity[..8].copy_from_slice(&number.to_le_bytes());
    identity
}

pub fn identified(rod: &RodId, number: i64) -> Outcome {
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
            waveform: Envelope::of(&[1.5e-5, -1.5e-5], 200.0),
            flags: Vec::new(),
            spectrum: Spectrum {
                df_hz: 0.1,
                psd: (0..400)
                    .map(|line| 1e-12 / f64::from(1 + (line - 45) * (line - 45)))
                    .collect(),
                segments: 8,
            },
            resonances: Vec::new(),
            motion: Motion {
                kind: MotionKind::Ambient,
                onsets_s: Vec::new(),
            },
        }),
        modes: vec![mode(1), mode(2), mode(3)],
        labels: None,
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
            withheld: None,
            stop: None,
        },
        conflict: Conflict {
            score: 0.4,
            nearest_hz: vec![4.5, 9.0, 13.5],
            residuals: vec![0.1, 0.2, -0.3],
            violation: None,
            prior_tail: 0.5,
            prior_distance: 0.3,
            is_outside_prior: false,
        },
        hangs_on: None,
        tested: None,
        joint: None,
    }))
}

/// View of an identified record.
pub fn snapshot(outcome: &Outcome) -> Option<Snapshot> {
    let Outcome::Identified(identification) = outcome else {
        return None;
    };
    let means = [8e5, 5e5, 37.0, 4e5, 4e5, 14.0];
    let normal = |mean: f64| Prior::TruncatedNormal { mean, sd: 0.2 * mean };
    let priors = means.iter().map(|mean| normal(*mean)).collect();
    Snapshot::of(
        &RodPrior::new(Parameterisation::new(Section::Direct), priors)?,
        identification,
    )
}

pub fn rejected(rod: &RodId, number: i64) -> Outcome {
    let rejection = Rejection::NoPeak {
        low_hz: 1.0,
        high_hz: 9.0,
    };
    Outcome::Rejected(Box::new(Rejected {
        start: Some(hour(number)),
        duration_s: Some(3.0),
        ..Rejected::new(rod.clone(), rejection)
    }))
}

/// A record in the form in which the store takes it.
pub fn new_record<'a>(outcome: &Outcome, row: &'a RecordRow) -> NewRecord<'a> {
    NewRecord {
        row,
        identity: outcome.identity().unwrap(),
        found: None,
        rms: outcome.rms(),
        emulator: "reduced",
    }
}

pub fn line(outcome: &Outcome) -> String {
    row(outcome).to_json().unwrap()
}

pub fn row(outcome: &Outcome) -> RecordRow {
    let line = match outcome {
        Outcome::Identified(identification) => format!(
            concat!(
                r#"{{"rod":"{}","start":"{}","duration_s":60.0,"fs_hz":200.0,"modes":{},"#,
                r#""axial_force_n":{{"mean":574000.0,"sd":109000.0,"cv":0.19,"q025":4e5,"q50":570000.0,"q975":8e5,"mean_error":9e3}},"#,
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
            serde_json::to_string(&identification.modes).unwrap(),
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
        Outcome::Tabulated(_) => unreachable!("the archive holds records"),
    };
    RecordRow::parse(&line).unwrap()
}

pub fn state(rod: &RodId, number: i64) -> State {
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
                usual_s: Some(3600.0),
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
        filters: filters(number),
        watch: tirante::analysis::track::fold::packed::Packed::default(),
        scatter: Default::default(),
        before: None,
        doubted: None,
        early: None,
        closed: Some(number.div_euclid(24)),
        periods: Vec::new(),
        alarms: Vec::new(),
        watches: Watches::default(),
        thermometer: Thermometer::default(),
        plausibility: Plausibility::default(),
        latest: Some(hour(number)),
        opened: 2,
    }
}

/// Low passes after some hours of readings.
pub fn filters(number: i64) -> Filters {
    let mut filters = Filters::default();
    for past in (0..6).rev() {
        filters.push(hour(number - past).days(), 12.0 + 0.1 * past as f64);
    }
    filters
}

pub fn misfit() -> Vec<Misfit> {
    (1..=3)
        .map(|order| Misfit {
            order,
            residual: 1e-4 / order as f64,
            sd: 9e-4,
        })
        .collect()
}

pub fn period(index: i64) -> Period {
    Period {
        index,
        start: hour(24 * index),
        began: Some(hour(24 * index)),
        measured: Some(hour(24 * index + 11)),
        records: 24,
        delta: -1e-3 / 3.0,
        delta_sd: 4e-4,
        filtered_c: filters(24 * index).at(hour(24 * index).days()),
        unread_k2: None,
        lagged_c: None,
        misfit: misfit(),
        not_axial_p: 0.61,
        charted: (index % 2 == 0).then_some(Charted {
            expected: 1e-4,
            expected_sd: 3e-3,
            residual: -1.5,
            leverage: 0.1,
            unread_sd: None,
            at_reference: Some(-2e-3),
            at_reference_sd: Some(1e-3),
            temperature_c: Some(12.2),
            evidence: Evidence {
                compensated: Some(0.25),
                peers: None,
                blind: Some(2.5),
            },
        }),
    }
}

pub fn raise(state: &mut State, kind: Kind, number: i64) -> Vec<AlarmEvent> {
    let rod = state.rod.clone();
    let mut board = Board::new(&rod, state.segment.number, &mut state.alarms);
    board.raise(
        kind,
        hour(number),
        format!("the \"{kind}\" of record {number}"),
        tirante::analysis::track::alarm::Known::default(),
    );
    board.into_events()
}

/// Two rods, records, a rejection every tenth, a period a day, an alarm at record 40; `from..to` of them.
pub fn fill(store: &mut Store, range: std::ops::Range<i64>) {
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
        let snapshot = snapshot(&outcome);
        store
            .commit(&Commit {
                record: Some(new_record(&outcome, &row(&outcome))),
                rod: Some(RodRow {
                    state: &now,
                    stands: &stands,
                    closed: &closed,
                    events: &events,
                }),
                snapshot: snapshot.as_ref().map(|snapshot| SnapshotRow {
                    rod: &rod,
                    segment: now.segment.number,
                    snapshot,
                }),
                source: Some(Position {
                    origin: "a.mcap",
                    name: "a.mcap",
                    bytes: number as u64 * 1000,
                    records: number as u64,
                }),
                ..Commit::default()
            })
            .unwrap();
        states.insert(rod, now);
    }
}
