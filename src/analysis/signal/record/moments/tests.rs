//! Tests of moments: whatever is read first, sensors that die, temperatures shared.

use super::*;
use rand::rngs::ChaCha8Rng;
use rand::{RngExt, SeedableRng};

const WAIT_S: f64 = 3600.0;

fn time(seconds: i64) -> Timestamp {
    Timestamp::from_nanos(seconds * 1_000_000_000)
}

/// A record of one sample a second, with a temperature that tells the sensor.
fn record(sensor: usize, (from, to): (i64, i64)) -> Event {
    Event::Record(Record {
        rod: RodId::from("a"),
        start: time(from),
        fs_hz: 1.0,
        samples: vec![0.0; usize::try_from(to - from).unwrap()],
        temperature_c: Some(sensor as f64),
        readings: vec![Reading {
            time: time(from),
            celsius: sensor as f64,
        }],
        excitation: None,
        clock_sd: 0.0,
        flags: Vec::new(),
    })
}

fn refused((from, to): (i64, i64)) -> Event {
    Event::Rejected {
        rod: RodId::from("a"),
        start: Some(time(from)),
        duration_s: (to - from) as f64,
        fs_hz: None,
        waveform: None,
        rejection: Rejection::Clipped {
            share: 0.5,
            allowed: 0.1,
        },
    }
}

fn moments(sensors: usize) -> Moments {
    Moments::new(RodId::from("a"), sensors, WAIT_S)
}

/// A sensor's progress, as its assembler tells it: an event and, behind it, samples of the next from its end on.
fn comes(moments: &mut Moments, sensor: usize, event: Event) -> Option<String> {
    let end = Span::of(&event).map_or(time(0), |span| span.end);
    let alone = moments.push(sensor, end, event);
    moments.note(sensor, end, end.plus_seconds(1.0));
    alone.map(|(_, moment)| shown(&moment))
}

fn shown(moment: &Moment) -> String {
    let seen = moment.seen.iter().map(|(sensor, event)| {
        let span = Span::of(event).map_or(0, |span| span.start.as_nanos() / 1_000_000_000);
        match event {
            Event::Record(_) => format!("{sensor}@{span}"),
            Event::Rejected { rejection, .. } => format!("{sensor}@{span}:{}", rejection.code()),
            _ => "?".to_owned(),
        }
    });
    let seen: Vec<String> = seen.collect();
    format!("{} -{:?}", seen.join(" "), moment.absent)
}

fn closed(moments: &mut Moments, all: bool) -> Vec<String> {
    std::iter::from_fn(|| moments.next(all).map(|(_, moment)| shown(&moment))).collect()
}

#[test]
fn what_is_of_one_time_is_one_moment_whatever_is_read_first() {
    // Windows of three sensors at offsets of their own; the second has two holes, the third refuses one.
    let mut events: Vec<(usize, (i64, i64), bool)> = Vec::new();
    for i in 0..40 {
        events.push((0, (600 * i, 600 * i + 600), true));
        if i % 13 != 5 {
            events.push((1, (600 * i + 20, 600 * i + 610), true));
        }
        events.push((2, (600 * i - 30, 600 * i + 569), i != 7));
    }
    let run = |seed: u64| {
        let (mut rng, mut moments) = (ChaCha8Rng::seed_from_u64(seed), moments(3));
        let (mut left, mut found) = (events.clone(), Vec::new());
        left.sort_by_key(|(sensor, (_, end), _)| (*end, *sensor));
        while !left.is_empty() {
            // Any sensor may be ahead of the others by up to three records, and a restart may come at any time.
            let sensor = left[rng.random_range(0..left.len().min(4))].0;
            let at = left.iter().position(|(own, ..)| *own == sensor).unwrap();
            let (sensor, span, is_good) = left.remove(at);
            let event = if is_good {
                record(sensor, span)
            } else {
                refused(span)
            };
            assert_eq!(comes(&mut moments, sensor, event), None);
            if rng.random_bool(0.2) {
                let saved = moments.save().unwrap();
                moments = self::moments(3);
                moments.resume(&saved).unwrap();
            }
            found.extend(closed(&mut moments, false));
        }
        found.extend(closed(&mut moments, true));
        found
    };
    let expected = run(0);
    assert_eq!(expected.len(), 40);
    assert_eq!(expected[3], "0@1800 1@1820 2@1770 -[]");
    assert_eq!(expected[5], "0@3000 2@2970 -[1]");
    assert_eq!(expected[7], "0@4200 1@4220 2@4170:clipped -[]");
    for seed in 1..60 {
        assert_eq!(run(seed), expected, "seed {seed}");
    }
}

#[test]
fn a_sensor_that_dies_is_waited_for_once_and_its_late_records_are_named() {
    let mut moments = moments(2);
    let mut found = Vec::new();
    for i in 0..12 {
        let span = (600 * i, 600 * i + 600);
        comes(&mut moments, 0, record(0, span));
        if i < 2 {
            comes(&mut moments, 1, record(1, span));
        }
        found.push(closed(&mut moments, false).len());
    }
    // The second was heard until 1201 s: it is more than an hour behind from 4801 s on.
    assert_eq!(found, [1, 1, 0, 0, 0, 0, 0, 0, 7, 1, 1, 1]);
    let late = comes(&mut moments, 1, record(1, (1800, 2400)));
    assert_eq!(late.as_deref(), Some("1@1800:late-sensor -[]"));
    // What nobody had at that time is no less worth for being late.
    assert_eq!(comes(&mut moments, 1, record(1, (-5000, -4400))), None);
    // It goes on beside the other.
    comes(&mut moments, 1, record(1, (7200, 7800)));
    comes(&mut moments, 0, record(0, (7200, 7800)));
    assert_eq!(closed(&mut moments, false), ["1@-5000 -[0]", "0@7200 1@7200 -[]"]);
}

#[test]
fn one_that_never_comes_is_behind_from_the_first_sample_on() {
    let mut moments = moments(2);
    comes(&mut moments, 1, record(1, (0, 1800)));
    assert!(closed(&mut moments, false).is_empty() && moments.is_waiting());
    comes(&mut moments, 1, record(1, (1800, 3600)));
    assert_eq!(closed(&mut moments, false), ["1@0 -[0]", "1@1800 -[0]"]);
    // One that ended is not waited for.
    let mut moments = self::moments(2);
    comes(&mut moments, 0, record(0, (0, 600)));
    moments.end(0);
    comes(&mut moments, 1, record(1, (100, 500)));
    comes(&mut moments, 1, record(1, (500, 1000)));
    assert_eq!(closed(&mut moments, false), ["0@0 1@100 -[]", "1@500 -[0]"]);
    comes(&mut moments, 0, record(0, (900, 1500)));
    comes(&mut moments, 1, record(1, (1000, 1400)));
    assert_eq!(closed(&mut moments, false), ["0@900 1@1000 -[]"]);
}

#[test]
fn a_refused_stretch_belongs_to_the_record_beside_it_or_is_told_alone() {
    let mut moments = moments(2);
    // Ten seconds that are too short, before the record of the same sensor.
    comes(&mut moments, 1, refused((-1, 9)));
    comes(&mut moments, 1, record(1, (12, 600)));
    comes(&mut moments, 0, record(0, (0, 600)));
    comes(&mut moments, 0, record(0, (600, 1200)));
    comes(&mut moments, 1, record(1, (600, 1200)));
    let found = closed(&mut moments, false);
    assert_eq!(found, ["0@0 1@12 -[]", "1@-1:clipped -[]", "0@600 1@600 -[]"]);
    // Both are refused.
    comes(&mut moments, 0, refused((1200, 1800)));
    comes(&mut moments, 1, refused((1201, 1801)));
    assert_eq!(closed(&mut moments, false), ["0@1200:clipped 1@1201:clipped -[]"]);
    // One of no length has no moment.
    let alone = comes(&mut moments, 0, refused((1800, 1800)));
    assert_eq!(alone.as_deref(), Some("0@0:clipped -[]"));
}

#[test]
fn one_motion_makes_one_moment_whatever_is_read_first() {
    // The second sensor's record is in two pieces; it may be read far ahead of the first, or in step.
    for is_ahead in [false, true] {
        let mut moments = moments(2);
        let mut found = Vec::new();
        if !is_ahead {
            comes(&mut moments, 1, record(1, (0, 250)));
        }
        comes(&mut moments, 0, record(0, (0, 600)));
        if is_ahead {
            comes(&mut moments, 1, record(1, (0, 250)));
        }
        found.extend(closed(&mut moments, false));
        comes(&mut moments, 1, record(1, (255, 855)));
        found.extend(closed(&mut moments, false));
        comes(&mut moments, 0, record(0, (600, 1200)));
        comes(&mut moments, 1, record(1, (855, 1455)));
        found.extend(closed(&mut moments, false));
        assert_eq!(found, ["0@0 1@255 -[]", "1@0:late-sensor -[]", "0@600 1@855 -[]"]);
    }
}

#[test]
fn older_data_are_taken_after_any_number_of_moments_without_a_sensor() {
    let mut moments = moments(2);
    for i in 0..2 * REMEMBERED as i64 {
        comes(&mut moments, 0, record(0, (600 * i, 600 * i + 600)));
        closed(&mut moments, false);
    }
    assert_eq!(comes(&mut moments, 0, record(0, (-6000, -5400))), None);
    assert_eq!(closed(&mut moments, true)[0], "0@-6000 -[1]");
}

#[test]
fn whichever_record_leads_has_the_temperature_of_the_first() {
    let mut moments = moments(3);
    for sensor in [2, 1] {
        comes(&mut moments, sensor, record(sensor, (0, 600)));
    }
    let (_, moment) = moments.next(true).unwrap();
    let celsius: Vec<_> = moment
        .records()
        .map(|(_, record)| (record.temperature_c, record.readings[0].celsius))
        .collect();
    assert_eq!(celsius, [(Some(1.0), 1.0); 2]);
}

#[test]
fn every_reading_is_handed_out_once_whichever_sensor_leads() {
    let mut moments = moments(2);
    let readings = |to: i64| -> Vec<Reading> {
        (0..to)
            .map(|s| Reading {
                time: time(s),
                celsius: 12.0,
            })
            .collect()
    };
    let mut given = Vec::new();
    let mut of_record = |moments: &mut Moments, sensor, span: (i64, i64)| {
        let mut event = record(sensor, span);
        if let Event::Record(record) = &mut event {
            record.readings = readings(span.1);
        }
        comes(moments, sensor, event);
        let (_, moment) = moments.next(true).unwrap();
        let (_, record) = moment.records().next().unwrap();
        given.extend(record.readings.iter().map(|reading| reading.time));
    };
    of_record(&mut moments, 0, (0, 100));
    // Between two records the lane that led brings what came since; then the other leads, whose lane has all of it.
    let since = readings(150).split_off(100);
    assert!(!moments.takes_readings(1, &since) && moments.takes_readings(0, &since));
    let saved = moments.save().unwrap();
    let mut moments = self::moments(2);
    moments.resume(&saved).unwrap();
    of_record(&mut moments, 1, (150, 300));
    let expected = (0..100).chain(150..300).map(time);
    assert_eq!(given, expected.collect::<Vec<_>>());
}

#[test]
fn a_moment_that_closes_to_make_room_says_so() {
    let mut moments = moments(2);
    comes(&mut moments, 0, record(0, (0, 600)));
    assert!(moments.next(false).is_none());
    let (_, moment) = moments.release().unwrap();
    assert!(moment.is_early && moment.absent == [1]);
    // At the end of the data a sensor without a record has none.
    comes(&mut moments, 0, record(0, (600, 1200)));
    assert!(!moments.next(true).unwrap().1.is_early);
}
