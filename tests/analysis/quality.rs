//! Faults injected at five levels into clean ambient and free-decay records: heavy ones never pass
//! unnoticed, clean ones are never refused.

use tirante::analysis::signal::record::{
    Assembler, Cut, Event, Flag, Record, RecordSettings, Rejection, RodId, Timestamp,
};

/// SplitMix64: seeded noise that needs no generator crate's stability.
struct Noise(u64);

impl Noise {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Three modes driven by white noise, unit standard deviation or so.
fn ambient(seed: u64, seconds: f64, fs_hz: f64, snr: f64) -> Vec<f64> {
    let mut noise = Noise(seed);
    let mut states = [(0.0f64, 0.0f64); 3];
    let modes = [(4.492, 0.01, 1.0), (9.288, 0.008, 0.5), (13.252, 0.01, 0.3)];
    let warm = (20.0 * fs_hz) as usize;
    let count = (seconds * fs_hz) as usize;
    let mut samples = Vec::with_capacity(count);
    for i in 0..warm + count {
        let mut x = 0.0;
        for ((a, b), (f, zeta, weight)) in states.iter_mut().zip(modes) {
            // A damped rotation driven by noise: the exact response of a resonator to white noise.
            let angle = std::f64::consts::TAU * f / fs_hz;
            let decay = (-zeta * angle).exp();
            let drive = weight * (1.0 - decay * decay).sqrt();
            let (sin, cos) = angle.sin_cos();
            let (u, v) = (decay * (cos * *a - sin * *b), decay * (sin * *a + cos * *b));
            *a = u + drive * noise.normal();
            *b = v + drive * noise.normal();
            x += *a;
        }
        let x = x + noise.normal() / snr;
        if i >= warm {
            samples.push(x);
        }
    }
    samples
}

/// A release at t = 0.
fn decay(seed: u64, seconds: f64, fs_hz: f64, zeta: f64, snr: f64) -> Vec<f64> {
    let mut noise = Noise(seed);
    (0..(seconds * fs_hz) as usize)
        .map(|i| {
            let t = i as f64 / fs_hz;
            let mode = |f: f64, a: f64| {
                let omega = std::f64::consts::TAU * f;
                a * (-zeta * omega * t).exp() * (omega * t).cos()
            };
            mode(4.492, 1.0) + mode(9.288, 0.4) + mode(13.252, 0.2) + noise.normal() / snr
        })
        .collect()
}

fn quantised(samples: &[f64], step: f64) -> Vec<f64> {
    samples.iter().map(|x| (x / step).round() * step).collect()
}

const FS: f64 = 200.0;

fn nanos(i: usize) -> i64 {
    1_772_344_800_000_000_000 + (i as f64 / FS * 1e9).round() as i64
}

fn assemble(stamped: impl IntoIterator<Item = (i64, f64)>, settings: RecordSettings) -> Vec<Event> {
    let mut assembler = Assembler::new(RodId("r".into()), settings, Some(FS), false);
    for (time, sample) in stamped {
        assembler.push(Timestamp::from_nanos(time), &[sample]);
    }
    assembler.finish(false);
    assembler.events().collect()
}

fn run(samples: &[f64]) -> Vec<Event> {
    let stamped = samples.iter().enumerate().map(|(i, &x)| (nanos(i), x));
    assemble(stamped, RecordSettings::default())
}

fn only(events: Vec<Event>) -> Result<Record, Rejection> {
    assert_eq!(events.len(), 1, "{:?}", shown(&events));
    match events.into_iter().next() {
        Some(Event::Record(record)) => Ok(record),
        Some(Event::Rejected { rejection, .. }) => Err(rejection),
        _ => unreachable!(),
    }
}

fn shown(events: &[Event]) -> Vec<String> {
    let one = |event: &Event| match event {
        Event::Record(record) => format!("record of {} with {:?}", record.samples.len(), record.flags),
        Event::Rejected {
            duration_s,
            rejection,
            ..
        } => format!("{duration_s}: {rejection}"),
        Event::Readings { readings, .. } => format!("{} readings", readings.len()),
        Event::Moment(_) => unreachable!(),
    };
    events.iter().map(one).collect()
}

fn code(samples: &[f64]) -> &'static str {
    only(run(samples)).map_or_else(|rejection| rejection.code(), |_| "")
}

#[test]
fn clean_records_pass_without_a_flag() {
    let mut refused = Vec::new();
    let mut count = 0;
    let mut check = |name: String, samples: Vec<f64>| {
        count += 1;
        match only(run(&samples)) {
            Ok(record) if record.flags.is_empty() => assert!(record.samples == samples),
            Ok(record) => refused.push(format!("{name}: {:?}", record.flags)),
            Err(rejection) => refused.push(format!("{name}: {rejection}")),
        }
    };
    for seed in 0..40 {
        for snr in [1.0, 10.0, 1000.0] {
            let samples = ambient(seed, 60.0, FS, snr);
            check(format!("ambient {seed} {snr}"), samples.clone());
            for step in [0.3, 0.05, 0.003] {
                check(
                    format!("ambient {seed} {snr} by {step}"),
                    quantised(&samples, step),
                );
            }
            for zeta in [0.001, 0.005, 0.02] {
                let samples = decay(seed, 60.0, FS, zeta, 10.0 * snr);
                check(format!("decay {seed} {snr} {zeta}"), samples.clone());
                for step in [0.1, 0.01, 0.001] {
                    check(
                        format!("decay {seed} {snr} {zeta} by {step}"),
                        quantised(&samples, step),
                    );
                }
            }
        }
    }
    println!("{} of {count} clean records refused or flagged", refused.len());
    assert!(refused.is_empty(), "{} of {count}: {:#?}", refused.len(), refused);
}

#[test]
fn missing_samples_are_filled_or_refused() {
    for seed in 0..5 {
        let clean = ambient(seed, 60.0, FS, 100.0);
        for (share, passes) in [
            (0.001, true),
            (0.01, true),
            (0.05, false),
            (0.2, false),
            (0.6, false),
        ] {
            for absent in [true, false] {
                let mut noise = Noise(seed + 100);
                // Lost on the way, or sent as NaN.
                let stamped =
                    clean
                        .iter()
                        .enumerate()
                        .filter_map(|(i, &x)| match noise.uniform() < share && i > 0 {
                            true if absent => None,
                            true => Some((nanos(i), f64::NAN)),
                            false => Some((nanos(i), x)),
                        });
                let events = assemble(stamped, RecordSettings::default());
                match only(events) {
                    Ok(record) => {
                        assert!(passes, "{share}");
                        assert!(
                            matches!(record.flags[..], [Flag::Filled { .. }]),
                            "{:?}",
                            record.flags
                        );
                        assert!((record.fs_hz - FS).abs() < 1e-6);
                        assert_eq!(record.samples.len(), clean.len());
                    }
                    // So much is lost that the stamps give another rate, or none.
                    Err(Rejection::Missing { .. } | Rejection::Rate { .. } | Rejection::Irregular { .. }) => {
                        assert!(!passes, "{share}");
                    }
                    Err(other) => panic!("{share}: {other}"),
                }
            }
        }
    }
}

#[test]
fn frozen_sensors_are_refused_and_never_bridged() {
    for seed in 0..5 {
        let clean = ambient(seed, 60.0, FS, 1000.0);
        // The sensor sends each value n times.
        for n in [2usize, 3, 5, 10, 50] {
            let held: Vec<f64> = (0..clean.len()).map(|i| clean[i - i % n]).collect();
            assert_eq!(code(&held), "held", "{n}");
        }
        for share in [0.3, 0.4, 0.5, 0.7, 0.9] {
            let mut noise = Noise(seed);
            let mut held = clean.clone();
            for i in 1..held.len() {
                if noise.uniform() < share {
                    held[i] = held[i - 1];
                }
            }
            assert_eq!(code(&held), "held", "{share}");
        }
        assert_eq!(code(&vec![clean[0]; clean.len()]), "constant");
    }
}

#[test]
fn a_long_hold_is_refused_whatever_the_phase_at_which_it_begins() {
    let mut passed = Vec::new();
    for seed in 0..4 {
        // Down to two steps a standard deviation.
        for step in [0.0, 0.002, 0.1, 0.5] {
            let clean = match step {
                0.0 => ambient(seed, 60.0, FS, 1000.0),
                step => quantised(&ambient(seed, 60.0, FS, 1000.0), step),
            };
            // Two periods of the first mode, in the midst and up to the end.
            for phase in 0..89 {
                for end in [0.6, 1.0] {
                    let mut samples = clean.clone();
                    let from = clean.len() / 4 + phase;
                    let to = (clean.len() as f64 * end) as usize;
                    let value = samples[from - 1];
                    samples[from..to].fill(value);
                    let found = code(&samples);
                    if !["held", "level"].contains(&found) {
                        passed.push((seed, step, phase, end, found));
                    }
                }
            }
        }
    }
    assert!(passed.is_empty(), "{} passed: {passed:?}", passed.len());
}

#[test]
fn a_coarse_sensor_at_rest_is_not_held() {
    let mut refused = Vec::new();
    let mut check = |name: String, samples: &[f64]| match only(run(samples)) {
        Err(Rejection::Held { share, .. }) => refused.push((name, share)),
        Err(_) => {}
        Ok(record) => refused.extend(record.flags.iter().find_map(|flag| match flag {
            Flag::Held { share } => Some((name.clone(), *share)),
            _ => None,
        })),
    };
    for seed in 0..8 {
        let mut noise = Noise(seed);
        for zeta in [0.001, 0.005, 0.02] {
            // Three blows of any strength with rests between, without noise.
            let mut blows = vec![0.0; (60.0 * FS) as usize];
            for blow in 0..3 {
                let at = ((2.0 + 19.0 * f64::from(blow) + 4.0 * noise.uniform()) * FS) as usize;
                let strength = 0.2 + 2.0 * noise.uniform();
                let left = (blows.len() - at) as f64 / FS;
                for (sample, x) in blows[at..].iter_mut().zip(decay(0, left, FS, zeta, 1e12)) {
                    *sample += strength * x;
                }
            }
            // A pull by a rope from 5 s on, held still from 8 s on, released at 30 s.
            let fall = decay(0, 30.0, FS, zeta, 1e12);
            let pull: Vec<f64> = (0..blows.len())
                .map(|i| match i as f64 / FS {
                    t if t < 30.0 => 1.5 * ((t - 5.0) / 3.0).clamp(0.0, 1.0),
                    _ => fall[i - (30.0 * FS) as usize],
                })
                .collect();
            for step in [0.003, 0.02, 0.1, 0.3] {
                check(format!("blows {seed} {zeta} {step}"), &quantised(&blows, step));
                check(format!("pull {seed} {zeta} {step}"), &quantised(&pull, step));
            }
        }
        // Ambient motion of a third of a step to three, its level up and down by gusts.
        let gusty: Vec<f64> = ambient(seed, 60.0, FS, 1e6)
            .iter()
            .enumerate()
            .map(|(i, x)| x * (1.5 * (i as f64 / FS * 0.7).sin()).exp())
            .collect();
        for step in [0.3, 1.0, 3.0] {
            check(format!("gusts {seed} {step}"), &quantised(&gusty, step));
        }
    }
    assert!(refused.is_empty(), "{refused:#?}");
}

#[test]
fn a_record_that_waits_for_its_temperature_comes_before_a_rest_that_is_too_short() {
    let clean = ambient(1, 70.0, FS, 1000.0);
    let rod = RodId("r".into());
    let mut assembler = Assembler::new(rod, RecordSettings::default(), Some(FS), true);
    assembler.push_temperature(Timestamp::from_nanos(nanos(0)), 12.0);
    // A hole behind a minute, then two seconds.
    for (i, &x) in clean.iter().enumerate() {
        if (i as f64) < 60.0 * FS || (i as f64) >= 68.0 * FS {
            assembler.push(Timestamp::from_nanos(nanos(i)), &[x]);
        }
    }
    assembler.finish(false);
    let events: Vec<Event> = assembler.events().collect();
    assert!(
        matches!(events[..], [Event::Record(_), Event::Rejected { .. }]),
        "{:?}",
        shown(&events)
    );
}

#[test]
fn clipping_is_flagged_or_refused() {
    for seed in 0..5 {
        for step in [0.0, 0.003, 0.02] {
            let clean = ambient(seed, 60.0, FS, 100.0);
            for rail in [2.0, 1.5, 1.0, 0.5, 0.2] {
                let mut samples = clean.clone();
                if step > 0.0 {
                    samples = quantised(&samples, step);
                }
                for x in &mut samples {
                    *x = x.clamp(-rail, rail);
                }
                assert_eq!(code(&samples), "clipped", "rail {rail} step {step}");
            }
        }
        let fall = decay(seed, 60.0, FS, 0.005, 1000.0);
        for rail in [1.2, 1.0, 0.7, 0.4, 0.2] {
            let samples: Vec<f64> = fall.iter().map(|x| x.clamp(-rail, rail)).collect();
            let outcome = only(run(&samples));
            let noticed = match &outcome {
                Ok(record) => record
                    .flags
                    .iter()
                    .any(|flag| matches!(flag, Flag::Clipped { .. })),
                Err(rejection) => rejection.code() == "clipped",
            };
            assert!(
                noticed,
                "rail {rail}: {outcome:?}",
                outcome = outcome.map(|r| r.flags)
            );
        }
    }
}

#[test]
fn spikes_are_replaced_or_refused() {
    for seed in 0..5 {
        let clean = ambient(seed, 60.0, FS, 100.0);
        for (count, height, refused) in [
            (1, 20.0, false),
            (10, 20.0, false),
            (50, 20.0, true),
            (100, 100.0, true),
            (400, 50.0, true),
        ] {
            for width in [1, 2] {
                let mut noise = Noise(seed + 7);
                let mut samples = clean.clone();
                for n in 0..count {
                    let at = 20 + n * (samples.len() - 40) / count + (noise.uniform() * 10.0) as usize;
                    for sample in &mut samples[at..at + width] {
                        *sample += height;
                    }
                }
                match only(run(&samples)) {
                    Ok(record) => {
                        assert!(!refused, "{count}");
                        assert_eq!(
                            record.flags,
                            [Flag::Despiked {
                                samples: count * width
                            }]
                        );
                        let worst = record
                            .samples
                            .iter()
                            .zip(&clean)
                            .map(|(a, b)| (a - b).abs())
                            .fold(0.0, f64::max);
                        assert!(worst < 1.0, "{worst}");
                    }
                    Err(rejection) => {
                        assert!(refused, "{count}: {rejection}");
                        assert!(matches!(rejection.code(), "spikes" | "missing"), "{rejection}");
                    }
                }
            }
        }
    }
}

/// Ambient motion of unit deviation, a decay from 1, and both beside an offset, with a code far from them.
fn with_codes(seed: u64) -> Vec<(Vec<f64>, f64)> {
    let lifted = |samples: &[f64], by: f64| samples.iter().map(|x| x + by).collect::<Vec<f64>>();
    let (hum, fall) = (
        ambient(seed, 60.0, FS, 100.0),
        decay(seed, 60.0, FS, 0.005, 1000.0),
    );
    vec![
        (lifted(&hum, 50.0), 0.0),
        (lifted(&fall, 6.0), 0.0),
        (quantised(&hum, 0.25), -9999.0),
        (hum, 32767.0),
        (fall, -9999.0),
    ]
}

#[test]
fn error_codes_are_missing_samples() {
    for seed in 0..8 {
        for (clean, value) in with_codes(seed) {
            for (runs, length) in [(1, 4), (1, 19), (6, 5), (30, 1), (3, 15)] {
                let mut noise = Noise(seed + 31);
                let mut samples = clean.clone();
                let mut struck = vec![false; samples.len()];
                for n in 0..runs {
                    let at = 1000 + n * (samples.len() - 2000) / runs + (noise.uniform() * 100.0) as usize;
                    samples[at..at + length].fill(value);
                    struck[at..at + length].fill(true);
                }
                let record =
                    only(run(&samples)).unwrap_or_else(|why| panic!("{value} {runs} x {length}: {why}"));
                let lost = runs * length;
                // Where a straight line meets the motion, a sample may stand out.
                let (spikes, flags): (Vec<_>, Vec<_>) = record
                    .flags
                    .iter()
                    .cloned()
                    .partition(|flag| matches!(flag, Flag::Despiked { samples: 1 }));
                assert_eq!(
                    flags,
                    [
                        Flag::Filled { samples: lost },
                        Flag::ErrorCode {
                            value,
                            runs,
                            samples: lost
                        }
                    ]
                );
                let mut mended = 0;
                for (i, (is, was)) in record.samples.iter().zip(&clean).enumerate() {
                    assert!((is - was).abs() < 8.0, "{i}: {is} {was}");
                    mended += usize::from(is != was && !struck[i]);
                }
                assert!(mended <= spikes.len(), "{mended}");
            }
        }
    }
}

#[test]
fn too_many_error_codes_are_refused_by_their_value() {
    for seed in 0..8 {
        for (clean, value) in with_codes(seed) {
            // Short runs, more than `max_missing`; long ones with less than `min_duration_s` between them.
            for (every, length) in [(200, 12), (1000, 100)] {
                let mut samples = clean.clone();
                for at in (700..samples.len() - 200).step_by(every) {
                    samples[at..at + length].fill(value);
                }
                let refused = only(run(&samples)).unwrap_err();
                let Rejection::ErrorCode {
                    value: found,
                    runs,
                    time_s,
                    share,
                    allowed,
                } = refused
                else {
                    panic!("{value} {every}: {refused}");
                };
                assert_eq!((found, time_s), (value, 700.0 / FS));
                assert_eq!(runs, (samples.len() - 900).div_ceil(every));
                assert!((share - (runs * length) as f64 / samples.len() as f64).abs() < 1e-12);
                assert!(share > allowed);
            }
        }
    }
}

#[test]
fn a_target_lost_for_long_splits_the_record() {
    for (clean, value) in with_codes(4) {
        let mut samples = clean.clone();
        samples[..100].fill(value);
        samples[5000..5060].fill(value);
        let events = run(&samples);
        let [Event::Record(first), Event::Record(second)] = &events[..] else {
            panic!("{:?}", shown(&events));
        };
        assert!(first.samples == clean[100..5000] && second.samples == clean[5060..]);
        let flag = |runs, samples| [Flag::ErrorCode { value, runs, samples }];
        assert_eq!(first.flags, flag(2, 160));
        assert_eq!(second.flags, flag(1, 60));
    }
}

#[test]
fn rods_held_by_a_rope_and_overloaded_sensors_give_no_error_code() {
    let is_code = |flags: &[Flag]| flags.iter().any(|flag| matches!(flag, Flag::ErrorCode { .. }));
    for seed in 0..8 {
        for step in [0.002, 0.05, 0.4] {
            // Pulled from 5 to 8 s, let go at 20 s; the coarse sensor shows one value in between.
            let fall = decay(seed, 40.0, FS, 0.02, 1e4);
            let pulled = (0..(60.0 * FS) as usize).map(|i| match i as f64 / FS {
                t if t < 20.0 => 1.6 * ((t - 5.0) / 3.0).clamp(0.0, 1.0),
                _ => fall[i - (20.0 * FS) as usize],
            });
            let samples = quantised(&pulled.collect::<Vec<f64>>(), step);
            let record = only(run(&samples)).unwrap();
            assert!(!is_code(&record.flags), "{step}: {:?}", record.flags);
            assert!(record.samples == samples);
        }
        // Blows that overload the sensor for six samples, far beyond the motion that follows.
        let mut noise = Noise(seed);
        let mut samples: Vec<f64> = (0..(60.0 * FS) as usize).map(|_| 1e-3 * noise.normal()).collect();
        for blow in 0..4 {
            let at = (400.0 + 2900.0 * f64::from(blow) + 100.0 * noise.uniform()) as usize;
            let left = (samples.len() - at) as f64 / FS;
            for (sample, x) in samples[at..].iter_mut().zip(decay(seed + 9, left, FS, 0.01, 1e4)) {
                *sample += x;
            }
            samples[at..at + 6].fill(30.0);
        }
        let refused = only(run(&samples)).unwrap_err();
        assert_eq!(refused.code(), "clipped", "{refused}");
    }
}

/// The waves that return in a struck rod are as short as spikes, and the quiet before the blow is most of the second about it.
#[test]
fn a_struck_rod_keeps_its_returning_waves() {
    for (first_hz, stiffness) in [(4.492, 1e-2), (1.5, 1e-3), (1.1, 3e-3), (2.3, 1e-2)] {
        for blow_s in [0.4, 0.5, 0.6, 0.7, 0.8] {
            let mut noise = Noise(3);
            let mut samples = vec![0.0; (20.0 * FS) as usize];
            for order in 1..60 {
                let n = f64::from(order);
                let f = first_hz * n * (1.0 + stiffness * n * n).sqrt();
                if f > 0.45 * FS {
                    break;
                }
                let omega = std::f64::consts::TAU * f;
                let shape = (n * 0.31 * std::f64::consts::PI).sin() * (n * 0.12 * std::f64::consts::PI).sin();
                for (i, sample) in samples.iter_mut().enumerate() {
                    let t = i as f64 / FS - blow_s;
                    if t >= 0.0 {
                        *sample += n * shape * (-0.001 * omega * t).exp() * (omega * t).sin();
                    }
                }
            }
            for sample in &mut samples {
                *sample += 1e-3 * noise.normal();
            }
            let record = only(run(&samples)).unwrap();
            assert_eq!(record.flags, [], "{first_hz} Hz struck at {blow_s} s");
            assert_eq!(record.samples, samples);
        }
    }
}

#[test]
fn steps_and_changes_of_level_are_refused() {
    for seed in 0..5 {
        let clean = ambient(seed, 60.0, FS, 100.0);
        for height in [10.0, 20.0, 50.0, 200.0, 1e4] {
            for place in [0.2, 0.5, 0.9] {
                let at = (place * clean.len() as f64) as usize;
                let samples: Vec<f64> = clean
                    .iter()
                    .enumerate()
                    .map(|(i, x)| x + if i < at { 0.0 } else { height })
                    .collect();
                let Err(Rejection::Step {
                    height: found,
                    time_s,
                }) = only(run(&samples))
                else {
                    panic!("a step of {height} passed");
                };
                assert!((found / height - 1.0).abs() < 0.5 && (time_s - at as f64 / FS).abs() < 0.6);
            }
        }
        for ratio in [1e-2, 1e-3, 1e-4, 1e-6, 1e-9] {
            let at = clean.len() / 2;
            let samples: Vec<f64> = clean
                .iter()
                .enumerate()
                .map(|(i, x)| if i < at { *x } else { x * ratio })
                .collect();
            assert!(matches!(code(&samples), "level" | "step"), "{ratio}");
        }
        // Drift and sway are no steps.
        for (sway, period) in [(100.0, 60.0), (30.0, 20.0), (10.0, 5.0)] {
            let samples: Vec<f64> = clean
                .iter()
                .enumerate()
                .map(|(i, x)| x + sway * (std::f64::consts::TAU * i as f64 / FS / period).sin())
                .collect();
            assert_eq!(code(&samples), "", "{sway} {period}");
        }
    }
}

#[test]
fn jitter_is_tolerated_up_to_its_limit() {
    let clean = ambient(3, 60.0, FS, 100.0);
    for (jitter, passes) in [(0.0, true), (0.1, true), (0.3, true), (0.8, false), (3.0, false)] {
        let mut noise = Noise(11);
        let mut stamps: Vec<i64> = (0..clean.len())
            .map(|i| nanos(i) + (jitter * noise.normal() * 5e6) as i64)
            .collect();
        // Recorders stamp in the order of arrival.
        stamps.sort_unstable();
        let events = assemble(
            stamps.into_iter().zip(clean.iter().copied()),
            RecordSettings::default(),
        );
        match only(events) {
            Ok(record) => {
                assert!(passes, "{jitter}");
                assert!(record.samples == clean, "{jitter}");
                assert!((record.fs_hz / FS - 1.0).abs() < 1e-4);
                assert_eq!(
                    jitter > 0.05,
                    record
                        .flags
                        .iter()
                        .any(|flag| matches!(flag, Flag::Jitter { .. }))
                );
            }
            Err(rejection) => assert!(!passes, "{jitter}: {rejection}"),
        }
    }
}

#[test]
fn a_wrong_rate_is_told() {
    let clean = ambient(3, 60.0, FS, 100.0);
    for error in [0.002, 0.01, 0.1, 0.5, 2.0] {
        let stamped = clean
            .iter()
            .enumerate()
            .map(|(i, &x)| (((i as f64 / FS) * (1.0 + error) * 1e9) as i64, x));
        let rejection = only(assemble(stamped, RecordSettings::default())).unwrap_err();
        assert_eq!(rejection.code(), "rate", "{error}");
    }
}

#[test]
fn duplicates_and_late_samples_change_nothing() {
    let clean = ambient(5, 60.0, FS, 100.0);
    let stamped: Vec<(i64, f64)> = clean.iter().enumerate().map(|(i, &x)| (nanos(i), x)).collect();
    let expected = only(assemble(stamped.clone(), RecordSettings::default())).unwrap();
    for reach in [1usize, 2, 5, 10, 15] {
        let mut shuffled = stamped.clone();
        let mut noise = Noise(reach as u64);
        for i in (0..shuffled.len() - reach).step_by(reach + 1) {
            // The first stays, so that the stretch starts where it starts.
            if i > 20 && noise.uniform() < 0.3 {
                shuffled.swap(i, i + reach);
            }
        }
        let record = only(assemble(shuffled, RecordSettings::default())).unwrap();
        assert_eq!(record.identity(), expected.identity(), "{reach}");

        let mut doubled = Vec::new();
        for (i, &sample) in stamped.iter().enumerate() {
            doubled.push(sample);
            if i % (10 * reach) == 5 {
                doubled.push(stamped[i.saturating_sub(reach)]);
            }
        }
        let record = only(assemble(doubled, RecordSettings::default())).unwrap();
        assert_eq!(record.identity(), expected.identity());
        assert!(matches!(record.flags[..], [Flag::Dropped { .. }]));
    }
}

#[test]
fn gaps_and_clock_steps_split() {
    let clean = ambient(5, 60.0, FS, 100.0);
    let half = clean.len() / 2;
    for shift_s in [-1e6, -100.0, -1.0, -0.5, -0.03, 0.5, 1.0, 100.0, 1e6] {
        let stamped = clean
            .iter()
            .enumerate()
            .map(|(i, &x)| (nanos(i) + if i < half { 0 } else { (shift_s * 1e9) as i64 }, x));
        let events = assemble(stamped, RecordSettings::default());
        let [Event::Record(first), Event::Record(second)] = &events[..] else {
            panic!("{shift_s}: {:?}", shown(&events));
        };
        assert!(first.samples == clean[..half], "{shift_s}");
        assert!(second.samples == clean[half..], "{shift_s}");
        assert_eq!(second.start.as_nanos(), nanos(half) + (shift_s * 1e9) as i64);
    }
    // One message with a wild stamp keeps its place in the order of arrival, and is reported.
    for wild in [0, nanos(0) - 5, nanos(0) + 4_000_000_000_000_000_000, i64::MAX] {
        let stamped = clean
            .iter()
            .enumerate()
            .map(|(i, &x)| (if i == 3000 { wild } else { nanos(i) }, x));
        let record = only(assemble(stamped, RecordSettings::default())).unwrap();
        assert_eq!(record.samples.len(), clean.len());
        assert!(record.samples == clean, "{wild}");
        assert!(
            matches!(record.flags[..], [Flag::LateStamps { messages: 1, .. }]),
            "{wild}: {:?}",
            record.flags
        );
    }
}

#[test]
fn windows_are_exact_and_batches_cut_inside() {
    let clean = ambient(5, 95.0, FS, 100.0);
    let settings = RecordSettings {
        cut: Cut::Window { length_s: 30.0 },
        min_duration_s: 2.0,
        ..Default::default()
    };
    let single = assemble(clean.iter().enumerate().map(|(i, &x)| (nanos(i), x)), settings);
    let mut assembler = Assembler::new(RodId("r".into()), settings, Some(FS), false);
    for (i, batch) in clean.chunks(64).enumerate() {
        assembler.push(Timestamp::from_nanos(nanos(i * 64)), batch);
    }
    assembler.finish(true);
    let batched: Vec<Event> = assembler.events().collect();
    assert_eq!(single.len(), 4);
    for (i, (one, other)) in single.iter().zip(&batched).enumerate() {
        let (Event::Record(one), Event::Record(other)) = (one, other) else {
            panic!("{:?}", shown(&batched));
        };
        let expected = &clean[i * 6000..clean.len().min((i + 1) * 6000)];
        for found in [&one.samples, &other.samples] {
            let first = found.iter().zip(expected).position(|(a, b)| a != b);
            assert_eq!((found.len(), first), (expected.len(), None), "{i}");
        }
        assert_eq!(one.start, other.start);
        assert_eq!(other.flags.contains(&Flag::Truncated), i == 3);
        // The end of a record does not determine the motion, which is recognised.
        assert_eq!(one.excitation, None);
    }
}

#[test]
fn free_decays_begin_at_their_onset() {
    let mut samples: Vec<f64> = Vec::new();
    let mut noise = Noise(9);
    let pulls: Vec<usize> = (0..8).map(|n| (1500 + n * 5000) + n * 37).collect();
    let total = 45_000;
    for i in 0..total {
        let mut x = noise.normal() * 0.01;
        for &pull in &pulls {
            if i >= pull {
                let t = (i - pull) as f64 / FS;
                let omega = std::f64::consts::TAU * 4.492;
                x += (-0.01 * omega * t).exp() * (omega * t).cos();
            }
        }
        samples.push(x);
    }
    let settings = RecordSettings {
        cut: Cut::FreeDecay {
            ratio: 5.0,
            length_s: 20.0,
        },
        ..Default::default()
    };
    let events = assemble(samples.iter().enumerate().map(|(i, &x)| (nanos(i), x)), settings);
    assert_eq!(events.len(), pulls.len(), "{:?}", shown(&events));
    for (event, &pull) in events.iter().zip(&pulls) {
        let Event::Record(record) = event else {
            panic!("{:?}", shown(&events))
        };
        let late = record.start.seconds_since(Timestamp::from_nanos(nanos(pull)));
        assert!((-0.011..0.06).contains(&late), "{late}");
        assert_eq!(record.samples.len(), 4000);
    }
    let quiet: Vec<f64> = (0..20_000).map(|_| noise.normal()).collect();
    let events = assemble(quiet.iter().enumerate().map(|(i, &x)| (nanos(i), x)), settings);
    assert!(matches!(
        &events[..],
        [Event::Rejected {
            rejection: Rejection::NoOnset { .. },
            ..
        }]
    ));
}

#[test]
fn hostile_stamps_neither_hang_nor_fill_memory() {
    let mut noise = Noise(1);
    for span in [1u64, 1000, 1 << 30, 1 << 50, 1 << 62] {
        let stamped: Vec<(i64, f64)> = (0..20_000)
            .map(|_| ((noise.bits() % span) as i64, noise.normal()))
            .collect();
        let events = assemble(stamped, RecordSettings::default());
        assert!(
            !events.iter().any(|event| matches!(event, Event::Record(_))),
            "{span}"
        );
        assert!(events.len() < 100, "{span}: {} events", events.len());
    }
    // A nanosecond apart at first, then as far as a gap may be.
    let stamped = (0..2000i64).map(|i| (if i < 20 { i } else { i * 99_000_000 }, i as f64));
    assert!(
        !assemble(stamped, RecordSettings::default())
            .iter()
            .any(|event| matches!(event, Event::Record(_)))
    );
    assert!(assemble((0..5000).map(|i| (0, f64::from(i))), RecordSettings::default()).len() < 3);
}
