//! Tests of what a plan settles, and of its errors.

use super::*;
use tirante_analysis::signal::record::{Channel, RodChannels, RodId, TimeSource};

fn signal(name: &str, unit: Option<&str>, timing: Timing) -> Signal {
    Signal {
        name: name.into(),
        number: 1,
        unit: unit.map(str::to_owned),
        timing,
        values: vec![0.5; 10],
    }
}

fn steady(start: Option<Timestamp>) -> Timing {
    Timing::Rate {
        fs_hz: 200.0,
        rounding: 0.0,
        start,
    }
}

fn planned(signals: Vec<Signal>, asked: &Asked<'_>) -> Result<Vec<Planned>, String> {
    let plan = Plan::new(signals, asked, Encoding::Protobuf);
    plan.map(|plan| plan.channels).map_err(|error| error.to_string())
}

const START: Timestamp = Timestamp::from_nanos(1_772_344_800_000_000_000);

fn reads(topic: &str, unit: Unit, field: &str, fs_hz: f64) -> RodChannels {
    RodChannels {
        rod: RodId("nave".into()),
        displacement: Channel {
            topic: topic.into(),
            field: field.into(),
            unit,
            time: TimeSource::Log,
            fs_hz: Some(fs_hz),
        },
        temperature: None,
        beside: None,
    }
}

#[test]
fn what_is_missing_is_named_with_the_next_step() {
    let asked = Asked::default();
    let refused = |signal: Signal| planned(vec![signal], &asked).unwrap_err();
    assert!(refused(signal("d", None, steady(Some(START)))).contains("--unit"));
    assert!(refused(signal("d", Some("V"), steady(Some(START)))).contains("\"V\""));
    assert!(refused(signal("d", Some("mm"), steady(None))).contains("--start"));
    assert!(refused(signal("d", Some("mm"), Timing::Unknown)).contains("--rate"));
    let good = planned(vec![signal("d", Some("mm"), steady(Some(START)))], &asked).unwrap();
    assert_eq!(
        (good[0].unit, good[0].fs_hz, good[0].topic.as_str()),
        (Unit::Millimetre, 200.0, "d")
    );
}

/// 200 Hz in ms would be 0.2 Hz in seconds: slower than any rod moves, but right for a thermometer.
#[test]
fn times_of_an_unknown_unit_are_not_taken_for_seconds_of_a_motion() {
    let stamped = |unit: Option<&str>, says_unit: bool| {
        let stamps = Stamps {
            nanos: (0..10).map(|i| i * 5_000_000_000).collect(),
            absolute: false,
            resolution_ns: 1_000_000_000,
            says_unit,
            lines: Vec::new(),
        };
        let asked = Asked {
            start: Some(START),
            any_unit: true,
            ..Asked::default()
        };
        planned(vec![signal("d", unit, Timing::Stamps(Arc::new(stamps)))], &asked)
    };
    for unit in [Some("mm"), None] {
        let said = stamped(unit, false).unwrap_err();
        assert!(
            said.contains("s: 0.2 Hz, ms: 200 Hz, us: 200000 Hz") && said.contains("--time-unit"),
            "{said}"
        );
    }
    assert_eq!(stamped(Some("mm"), true).unwrap()[0].fs_hz, 0.2);
    assert_eq!(stamped(Some("\u{b0}C"), false).unwrap()[0].fs_hz, 0.2);
}

#[test]
fn contradictions_name_both_sides() {
    let one = || vec![signal("d", Some("mm"), steady(Some(START)))];
    let asked = Asked {
        unit: Some(Unit::Metre),
        ..Asked::default()
    };
    assert_eq!(
        planned(one(), &asked).unwrap_err(),
        "channel 1 (d) is in mm by the file, in m by the command line"
    );
    let asked = Asked {
        rate_hz: Some(256.0),
        ..Asked::default()
    };
    assert!(
        planned(one(), &asked)
            .unwrap_err()
            .contains("200 Hz by the file, 256 Hz by --rate")
    );
    let rods = [reads("d", Unit::Micrometre, "values", 200.0)];
    let asked = Asked {
        rods: &rods,
        ..Asked::default()
    };
    let error = planned(one(), &asked).unwrap_err();
    assert!(
        error.contains("is in mm") && error.contains("of rod nave in um"),
        "{error}"
    );
    for (rod, word) in [
        (
            reads("e", Unit::Millimetre, "values", 200.0),
            "--channel SOURCE=TOPIC",
        ),
        (reads("d", Unit::Millimetre, "value", 200.0), "\"value\""),
        (reads("d", Unit::Millimetre, "values", 100.0), "fs_hz = 100"),
    ] {
        let rods = [rod];
        let error = planned(
            one(),
            &Asked {
                rods: &rods,
                ..Asked::default()
            },
        )
        .unwrap_err();
        assert!(error.contains(word), "{error}");
    }
    let rods = [reads("d", Unit::Millimetre, "values", 200.0)];
    assert!(
        planned(
            one(),
            &Asked {
                rods: &rods,
                ..Asked::default()
            }
        )
        .is_ok()
    );
}

#[test]
fn the_configuration_says_a_unit_the_file_does_not_say() {
    let rods = [reads("d", Unit::Micrometre, "values", 200.0)];
    let asked = Asked {
        rods: &rods,
        ..Asked::default()
    };
    let found = planned(vec![signal("d", None, steady(Some(START)))], &asked).unwrap();
    assert_eq!(found[0].unit, Unit::Micrometre);
}

#[test]
fn a_unit_for_all_is_not_the_thermometers() {
    let asked = Asked {
        unit: Some(Unit::Millimetre),
        ..Asked::default()
    };
    let signals = vec![
        signal("d", None, steady(Some(START))),
        signal("air", Some("°C"), steady(Some(START))),
    ];
    let found = planned(signals, &asked).unwrap();
    assert_eq!((found[0].unit, found[1].unit), (Unit::Millimetre, Unit::Celsius));
    assert_eq!(found[1].layout, Layout::Sample);
}

#[test]
fn channels_are_chosen_renamed_and_numbered_when_alike() {
    let signals = || {
        let mut second = signal("d", Some("mm"), steady(Some(START)));
        second.number = 2;
        vec![signal("d", Some("mm"), steady(Some(START))), second]
    };
    let topics = |found: Vec<Planned>| found.into_iter().map(|channel| channel.topic).collect::<Vec<_>>();
    assert_eq!(
        topics(planned(signals(), &Asked::default()).unwrap()),
        ["d", "d-2"]
    );
    let wanted = [Wanted::parse("2=/nave,mm").unwrap()];
    let asked = Asked {
        channels: &wanted,
        ..Asked::default()
    };
    assert_eq!(topics(planned(signals(), &asked).unwrap()), ["/nave"]);
    let wanted = [Wanted::parse("x").unwrap()];
    let asked = Asked {
        channels: &wanted,
        ..Asked::default()
    };
    assert!(
        planned(signals(), &asked)
            .unwrap_err()
            .contains("there is: 1 (d), 2 (d)")
    );
    assert!(Wanted::parse("2=/nave,parsec").is_err() && Wanted::parse("=x").is_err());
    assert_eq!(
        Wanted::parse("a b=,um").unwrap(),
        Wanted {
            source: "a b".into(),
            topic: None,
            unit: Some(Unit::Micrometre)
        }
    );
}

#[test]
fn a_rate_of_six_digits_is_the_round_one() {
    let timing = Timing::Rate {
        fs_hz: 1.0 / 9.76562e-4,
        rounding: 0.5e-5 / 9.76562,
        start: Some(START),
    };
    let found = planned(vec![signal("d", Some("mm"), timing)], &Asked::default()).unwrap();
    assert_eq!(found[0].fs_hz, 1024.0);
}

#[test]
fn a_rate_of_few_digits_is_the_round_one_or_none() {
    let read = |step_s: f64, last_digit_s: f64| {
        let timing = Timing::Rate {
            fs_hz: 1.0 / step_s,
            rounding: 0.5 * last_digit_s / step_s,
            start: Some(START),
        };
        let found = planned(vec![signal("d", Some("mm"), timing)], &Asked::default())?;
        Ok::<f64, String>(found[0].fs_hz)
    };
    for (step_s, last_digit_s, fs_hz) in [
        (0.000_977, 1e-6, 1024.0),
        (0.005, 1e-6, 200.0),
        (0.006_667, 1e-6, 150.0),
        (0.003_333, 1e-6, 300.0),
        (0.000_625, 1e-6, 1600.0),
        (1.953_13e-3, 1e-8, 512.0),
    ] {
        assert_eq!(read(step_s, last_digit_s).unwrap(), fs_hz, "{step_s}");
    }
    // 1117 to 1119 Hz: nothing round; 0.0005 to one digit: 1000 to 2000 Hz.
    for (step_s, last_digit_s) in [(0.000_894_4, 1e-6), (0.000_5, 1e-4)] {
        let error = read(step_s, last_digit_s).unwrap_err();
        assert!(
            error.contains("so few digits") && error.contains("--rate"),
            "{error}"
        );
    }
    // The configuration's rate within the rounding counts.
    let rods = [reads("d", Unit::Millimetre, "values", 1023.7)];
    let timing = Timing::Rate {
        fs_hz: 1.0 / 0.000_977,
        rounding: 5e-7 / 0.000_977,
        start: Some(START),
    };
    let asked = Asked {
        rods: &rods,
        ..Asked::default()
    };
    let found = planned(vec![signal("d", Some("mm"), timing)], &asked).unwrap();
    assert_eq!(found[0].fs_hz, 1023.7);
}

#[test]
fn a_start_that_contradicts_the_files_is_refused() {
    let asked = Asked {
        start: Some(START.plus_seconds(60.0)),
        ..Asked::default()
    };
    let error = planned(vec![signal("d", Some("mm"), steady(Some(START)))], &asked).unwrap_err();
    assert!(
        error.contains("by the file") && error.contains("--start"),
        "{error}"
    );
    assert!(planned(vec![signal("d", Some("mm"), steady(None))], &asked).is_ok());
}
