//! Scenarios of months, at the level of frequencies, through the real fold: cases that must alarm, that must
//! not, and that must not be lost.

use crate::scenario::{DAY_S, Scenario, follow_on, raised, told};
use std::sync::Arc;
use tirante::analysis::lab::synthesis::{AddedMass, Truth};
use tirante::analysis::signal::record::Timestamp;
use tirante::analysis::track::settings::TemperatureUse;
use tirante::analysis::track::{Input, Kind, Observation, RodState, SetAside, State, Tracker, Verdict, What};

#[test]
fn a_year_of_seasons_without_a_change_raises_nothing() {
    let scenario = Scenario::new(396);
    let history = scenario.history(11);
    let observations: Vec<Observation> = history.iter().map(|record| record.observation.clone()).collect();
    let (_, verdicts) = scenario.follow(&observations);
    assert_eq!(raised(&verdicts), []);
    assert!(matches!(
        verdicts[10].state,
        RodState::Learning { records: 11, .. }
    ));
    assert_eq!(verdicts[395].state, RodState::Monitoring);
    // The force moved with the seasons, by more than a tenth; at the reference temperature it did not.
    let forces: Vec<f64> = history.iter().map(|record| record.axial_force_n).collect();
    let swing =
        forces.iter().copied().fold(0.0, f64::max) / forces.iter().copied().fold(f64::INFINITY, f64::min);
    assert!(swing > 1.1, "{swing}");
    for verdict in &verdicts[60..] {
        let ratio = verdict.at_reference.expect("compensated").ratio;
        assert!((ratio.mean - 1.0).abs() < 0.02 && ratio.sd < 0.01, "{ratio:?}");
    }
}

#[test]
fn a_step_is_one_drift_found_within_days_with_its_size() {
    let scenario = Scenario::new(260).step(200.0, -0.05);
    let (_, verdicts) = scenario.follow(&scenario.observations(12));
    let alarms = raised(&verdicts);
    assert_eq!(alarms.len(), 1, "{alarms:?}");
    let (index, kind) = alarms[0];
    assert_eq!(kind, Kind::Drift);
    // A period closes with the first record of the next.
    assert!((201..=204).contains(&index), "{index}");
    let last = verdicts[259].alarms[0].clone();
    let change = last.change.expect("a drift has a size");
    // The rod lost 5 % of the force it had at the temperature of its making; the size is a share of the baseline's mean.
    let Truth::Beam { theta, .. } = &scenario.rod.truth else {
        panic!("a beam");
    };
    let records = scenario.history(12);
    let baseline_n = records[..30]
        .iter()
        .map(|record| record.axial_force_n)
        .sum::<f64>()
        / 30.0;
    let truth = -0.05 * theta[0] / baseline_n;
    assert!(
        change.size.q025 < truth && truth < change.size.q975,
        "{truth}: {change:?}"
    );
    assert!(change.size.sd < 0.005, "{change:?}");
    assert!(change.step_probability > 0.5, "{change:?}");
    let onset_d = change.onset.seconds_since(scenario.simulation.start) / DAY_S;
    assert!((onset_d - 200.0).abs() < 3.0, "{onset_d}");
    assert_eq!(verdicts[259].state, RodState::Alarm);
    // Repeated every week, with the same id.
    let repeats = told(&verdicts, What::Repeated);
    assert_eq!(repeats.len(), (259 - index) / 7, "{repeats:?}");
}

#[test]
fn a_large_loss_exceeds_the_limit_too() {
    let scenario = Scenario::new(240).step(200.0, -0.12);
    let (_, verdicts) = scenario.follow(&scenario.observations(13));
    let kinds: Vec<Kind> = raised(&verdicts).into_iter().map(|(_, kind)| kind).collect();
    // The first record is suspected, the second beyond the limit; the drift comes at the end of the period.
    assert_eq!(kinds, [Kind::Suspected, Kind::Limit, Kind::Drift]);
}

#[test]
fn a_mass_at_mid_span_is_not_axial_and_no_drift() {
    for (seed, mass_kg) in [(21, 3.0), (22, 6.0), (25, 15.0)] {
        let mut scenario = Scenario::new(260);
        scenario.rod.added_mass = Some(AddedMass {
            mass_kg,
            at: 0.5,
            start_d: 200.0,
        });
        let (_, verdicts) = scenario.follow(&scenario.observations(seed));
        let kinds: Vec<Kind> = raised(&verdicts).into_iter().map(|(_, kind)| kind).collect();
        assert_eq!(kinds, [Kind::NotAxial], "{mass_kg} kg");
    }
}

#[test]
fn without_a_temperature_nothing_is_charted_and_everything_says_so() {
    let scenario = Scenario::new(200);
    let mut observations = scenario.observations(31);
    for observation in &mut observations {
        observation.readings.clear();
    }
    let (_, verdicts) = scenario.follow(&observations);
    let RodState::NotMonitoring { reason } = &verdicts[100].state else {
        panic!("{:?}", verdicts[100].state);
    };
    assert!(
        reason.contains("uncompensated") && reason.contains("above about"),
        "{reason}"
    );
    assert!(verdicts.iter().all(|verdict| verdict.at_reference.is_none()));
    assert!(verdicts[50].relative.is_some());
    assert!(!raised(&verdicts).iter().any(|(_, kind)| *kind == Kind::Drift));
    // A rod known to be free to expand may be charted without compensation.
    let mut free = Scenario::new(200).step(150.0, -0.02);
    free.rod.thermal.restraint = 0.0;
    free.track.temperature = TemperatureUse::Ignore;
    let (_, verdicts) = free.follow(&free.observations(32));
    let alarms = raised(&verdicts);
    assert!(matches!(alarms[..], [(151..=158, Kind::Drift)]), "{alarms:?}");
}

#[test]
fn single_records_without_a_temperature_leave_holes_only() {
    let scenario = Scenario::new(300);
    let mut observations = scenario.observations(33);
    for observation in observations.iter_mut().skip(100).step_by(10) {
        observation.readings.clear();
    }
    let (tracker, verdicts) = scenario.follow(&observations);
    assert_eq!(raised(&verdicts), []);
    let uncharted = tracker
        .state()
        .periods
        .iter()
        .filter(|period| period.charted.is_none())
        .count();
    assert!(uncharted <= 22, "{uncharted}");
}

#[test]
fn weeks_of_silence_are_told_and_are_no_drift() {
    let scenario = Scenario::new(330);
    let mut observations = scenario.observations(43);
    observations.drain(150..180);
    let (_, verdicts) = scenario.follow(&observations);
    assert_eq!(raised(&verdicts), [(150, Kind::NoData)]);
    assert_eq!(told(&verdicts, What::Cleared), [(150, Kind::NoData)]);
    assert_eq!(verdicts[299].state, RodState::Monitoring);
}

#[test]
fn the_clock_alone_tells_that_there_is_no_data() {
    let scenario = Scenario::new(60);
    let observations = scenario.observations(42);
    let (mut tracker, _) = scenario.follow(&observations);
    let last = observations[59].start;
    assert_eq!(tracker.look_at_clock(last.plus_seconds(2.0 * DAY_S)), []);
    let events = tracker.look_at_clock(last.plus_seconds(5.0 * DAY_S));
    assert_eq!(events.len(), 1);
    assert_eq!(events[0].alarm.kind, Kind::NoData);
    assert!(matches!(tracker.rod_state(), RodState::NotMonitoring { .. }));
    assert!(
        events[0].alarm.message.contains("look at its sensor (power, aim"),
        "{}",
        events[0].alarm.message
    );
    assert_eq!(tracker.look_at_clock(last.plus_seconds(6.0 * DAY_S)), []);

    // Other settings have nothing to do with it, and neither have those that come back.
    let alarms = tracker.state().alarms.clone();
    let shelved = tracker.state().clone();
    let (mut tracker, events) = Tracker::resume(scenario.plan("other key"), shelved.clone());
    assert_eq!(
        (events, tracker.state().segment.number, &tracker.state().alarms),
        (Vec::new(), 2, &alarms)
    );
    assert_eq!(tracker.look_at_clock(last.plus_seconds(6.5 * DAY_S)), []);
    let (mut tracker, events) = Tracker::take_up(scenario.plan("key"), shelved, tracker.state().clone());
    assert_eq!(
        (events, tracker.state().segment.number, &tracker.state().alarms),
        (Vec::new(), 1, &alarms)
    );
    assert_eq!(tracker.look_at_clock(last.plus_seconds(7.0 * DAY_S)), []);
    // A baseline that is asked for begins without alarms.
    let events = tracker.rebaseline(None);
    assert_eq!(
        events.iter().map(|event| event.what).collect::<Vec<_>>(),
        [What::Cleared]
    );
}

#[test]
fn order_within_the_window_does_not_matter() {
    let mut scenario = Scenario::new(24 * 70);
    scenario.simulation.interval_s = 3600.0;
    scenario.track.reorder_window_s = 4.0 * 3600.0;
    let observations = scenario.observations(51);
    let (straight, _) = scenario.follow(&observations);
    let mut shuffled = observations;
    // Each record at most three places off; the last ones stay.
    let count = shuffled.len() - 6;
    for chunk in shuffled[..count].chunks_exact_mut(4) {
        chunk.reverse();
    }
    let (mixed, verdicts) = scenario.follow(&shuffled);
    assert!(verdicts.iter().all(|verdict| verdict.set_aside.is_none()));
    assert!(straight.state().periods.len() > 60);
    assert_eq!(straight.state().periods, mixed.state().periods);
    assert_eq!(straight.state().segment, mixed.state().segment);
}

#[test]
fn a_change_of_unit_a_wrong_clock_and_a_swapped_channel_have_names() {
    let scenario = Scenario::new(200);
    let good = scenario.observations(61);

    let mut unit = good.clone();
    for observation in &mut unit[100..120] {
        observation.rms *= 1000.0;
    }
    let (_, verdicts) = scenario.follow(&unit);
    assert!(
        verdicts[100..120]
            .iter()
            .all(|v| v.set_aside == Some(SetAside::Amplitude))
    );
    assert!(verdicts[100..120].iter().all(|v| v.relative.is_none()));
    assert_eq!(raised(&verdicts)[0], (104, Kind::Sensor));
    let RodState::NotMonitoring { reason } = &verdicts[110].state else {
        panic!("{:?}", verdicts[110].state);
    };
    assert!(reason.contains("unit"), "{reason}");
    assert!(!raised(&verdicts).iter().any(|(_, kind)| kind.is_latched()));
    assert_eq!(verdicts[199].state, RodState::Monitoring);

    // A clock that is at 1970, jumps to 2100, or is a month behind.
    for shift_d in [-20_000.0, 27_000.0, -30.0] {
        let mut clock = good.clone();
        for observation in &mut clock[100..110] {
            observation.start = observation.start.plus_seconds(shift_d * DAY_S);
            for reading in &mut observation.readings {
                reading.time = reading.time.plus_seconds(shift_d * DAY_S);
            }
        }
        let (_, verdicts) = scenario.follow(&clock);
        assert!(
            matches!(verdicts[100].set_aside, Some(SetAside::Clock | SetAside::Late)),
            "{shift_d}"
        );
        assert!(
            raised(&verdicts).iter().any(|(_, kind)| *kind == Kind::Sensor),
            "{shift_d}: {:?}",
            raised(&verdicts)
        );
        assert!(
            !raised(&verdicts).iter().any(|(_, kind)| kind.is_latched()),
            "{shift_d}: {:?}",
            raised(&verdicts)
        );
    }
}

#[test]
fn a_fold_broken_off_anywhere_goes_on_to_the_same_bits() {
    let scenario = Scenario::new(160).step(110.0, -0.03);
    let observations = scenario.observations(71);
    let (straight, whole) = scenario.follow(&observations);
    let plan = scenario.plan("key");
    let mut tracker = Tracker::new(Arc::clone(&plan));
    let mut verdicts = Vec::new();
    for observation in &observations {
        verdicts.push(tracker.step(&Input::Identified(observation.clone()), &[]));
        let text = serde_json::to_string(tracker.state()).expect("it serialises");
        let mut state: State = serde_json::from_str(&text).expect("it reads back");
        state.periods.clone_from(&tracker.state().periods);
        let (resumed, events) = Tracker::resume(Arc::clone(&plan), state);
        assert_eq!(events, []);
        tracker = resumed;
    }
    assert_eq!(straight.state(), tracker.state());
    assert_eq!(whole, verdicts);
}

#[test]
fn a_new_baseline_on_request_or_with_a_new_meaning() {
    let scenario = Scenario::new(260).step(100.0, -0.05);
    let observations = scenario.observations(81);
    let (mut tracker, verdicts) = scenario.follow(&observations[..150]);
    let id = verdicts[149].alarms[0].id.clone();
    let now = observations[149].start;
    assert_eq!(tracker.acknowledge("unknown", now), []);
    let events = tracker.acknowledge(&id, now);
    assert_eq!(events.len(), 1);
    assert_eq!(events[0].what, What::Acknowledged);
    let events = tracker.rebaseline(Some(now));
    assert_eq!(
        events.iter().map(|event| event.what).collect::<Vec<_>>(),
        [What::Cleared]
    );
    assert_eq!(tracker.state().segment.number, 2);
    let verdicts = follow_on(&mut tracker, &observations[150..]);
    assert_eq!(raised(&verdicts), []);
    assert_eq!(verdicts[109].state, RodState::Monitoring);
    // The loss is part of the new baseline.
    let ratio = verdicts[109].at_reference.expect("compensated").ratio;
    assert!((ratio.mean - 1.0).abs() < 0.02, "{ratio:?}");

    // An upgrade with an unacknowledged alarm: a new segment, and the alarm stays active.
    let (tracker, _) = scenario.follow(&observations[..150]);
    let (tracker, events) = Tracker::resume(scenario.plan("other key"), tracker.state().clone());
    assert_eq!(
        events.iter().map(|event| event.what).collect::<Vec<_>>(),
        [What::Cleared]
    );
    assert_eq!(tracker.state().segment.number, 2);
    assert_eq!(tracker.state().alarms.len(), 1);
    assert_eq!(tracker.rod_state(), RodState::Alarm);
}

#[test]
fn modes_come_and_go_without_a_trace() {
    let scenario = Scenario::new(300);
    let mut observations = scenario.observations(91);
    for (index, observation) in observations.iter_mut().enumerate() {
        // A node of mode 2 is aimed at in half of the records, mode 3 fades in every fifth.
        if index % 2 == 0 {
            observation.modes.retain(|mode| mode.order != 2);
        }
        if index % 5 == 0 {
            observation.modes.retain(|mode| mode.order != 3);
        }
    }
    let (_, verdicts) = scenario.follow(&observations);
    assert_eq!(raised(&verdicts), []);
    assert_eq!(verdicts[299].state, RodState::Monitoring);
}

#[test]
fn rejections_in_a_row_are_told() {
    let scenario = Scenario::new(80);
    let (mut tracker, _) = scenario.follow(&scenario.observations(95));
    let start = tracker.state().latest.expect("records came");
    let rejected = |hour: f64| Input::Rejected {
        start: Some(start.plus_seconds(hour * 3600.0)),
        reason: "no peak stands out".to_owned(),
        readings: Vec::new(),
    };
    let verdicts: Vec<Verdict> = (1..=6)
        .map(|hour| tracker.step(&rejected(f64::from(hour)), &[]))
        .collect();
    assert_eq!(raised(&verdicts), [(4, Kind::Sensor)]);
    assert!(verdicts[5].alarms[0].message.contains("no peak"));
}

#[test]
fn a_record_before_time_began_or_after_it_ends_is_survived() {
    let scenario = Scenario::new(60);
    let mut observations = scenario.observations(97);
    observations[20].start = Timestamp::from_nanos(i64::MIN);
    observations[30].start = Timestamp::from_nanos(i64::MAX);
    observations[31].readings.clear();
    let (_, verdicts) = scenario.follow(&observations);
    assert_eq!(verdicts.len(), 60);
    assert!(!raised(&verdicts).iter().any(|(_, kind)| kind.is_latched()));
}
