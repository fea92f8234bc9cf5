//! Stamps as real loggers write them: late blocks, jitter, stalls, holes. No sample is invented or moved for a stamp that the
//! later ones contradict, and a hole that they confirm is filled to the sample.

use tirante::analysis::signal::record::{
    Assembler, Cut, Event, Flag, Record, RecordSettings, RodId, Timestamp,
};

/// A permuted congruential generator, so that the stamps do not depend on other code.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        let word = (((self.0 >> 18) ^ self.0) >> 27) as u32;
        (f64::from(word.rotate_right((self.0 >> 59) as u32)) + 0.5) / 4_294_967_296.0
    }

    fn gaussian(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A minute of samples that are all different.
fn signal(fs_hz: f64) -> Vec<f64> {
    let mut noise = Noise(5);
    (0..(60.0 * fs_hz) as usize)
        .map(|i| (i as f64 / fs_hz * 28.0).sin() + 0.3 * noise.gaussian())
        .collect()
}

/// Blocks of `size`, stamped `off(block)` \[s\] late, in the order in which they were measured.
fn stamped(
    samples: &[f64],
    fs_hz: f64,
    size: usize,
    mut off: impl FnMut(usize) -> f64,
) -> Vec<(i64, Vec<f64>)> {
    samples
        .chunks(size)
        .enumerate()
        .map(|(i, block)| {
            let time = (i * size) as f64 / fs_hz + off(i);
            (
                1_772_344_800_000_000_000 + (time * 1e9).round() as i64,
                block.to_vec(),
            )
        })
        .collect()
}

fn assemble(messages: &[(i64, Vec<f64>)], fs_hz: f64, settings: RecordSettings) -> Vec<Event> {
    let mut assembler = Assembler::new(RodId("r".into()), settings, Some(fs_hz), false);
    for (time, values) in messages {
        assembler.push(Timestamp::from_nanos(*time), values);
    }
    assembler.finish(false);
    assembler.events().collect()
}

fn only(messages: &[(i64, Vec<f64>)], fs_hz: f64, settings: RecordSettings) -> Record {
    let mut events = assemble(messages, fs_hz, settings);
    match (events.pop(), events.len()) {
        (Some(Event::Record(record)), 0) => record,
        (event, more) => panic!("{more} more and {event:?}"),
    }
}

/// First sample that differs, and the lengths.
fn difference(found: &[f64], wanted: &[f64]) -> (usize, usize, Option<usize>) {
    let first = found.iter().zip(wanted).position(|(a, b)| a != b);
    (found.len(), wanted.len(), first)
}

#[test]
fn a_lone_late_stamp_neither_invents_nor_moves_a_sample() {
    let fs_hz = 200.0;
    let clean = signal(fs_hz);
    // Single samples, a hundredth of a second, half a second, two seconds.
    for size in [1, 2, 100, 400] {
        for late in [0.003, 0.02, 0.08, 0.4, -0.003, -0.02] {
            let at = 7400 / size;
            let messages = stamped(&clean, fs_hz, size, |i| if i == at { late } else { 0.0 });
            let record = only(&messages, fs_hz, RecordSettings::default());
            let found = difference(&record.samples, &clean);
            assert_eq!(found, (clean.len(), clean.len(), None), "{size} {late}");
            assert_eq!(record.fs_hz, fs_hz, "{size} {late}");
            assert!(record.clock_sd < 1e-8, "{size} {late}: {}", record.clock_sd);
            let [Flag::LateStamps { messages: 1, worst_s }] = record.flags[..] else {
                panic!("{size} {late}: {:?}", record.flags);
            };
            assert!((worst_s - late).abs() < 1e-6, "{size} {late}: {worst_s}");
        }
    }
}

#[test]
fn what_waited_for_the_line_is_no_hole() {
    let fs_hz = 200.0;
    let clean = signal(fs_hz);
    // From 30 s on nothing arrives for a while; then all of it at once, a tenth of a millisecond apart.
    for stall in [0.02, 0.06, 0.09] {
        let messages = stamped(&clean, fs_hz, 1, |i| {
            let due = i as f64 / fs_hz;
            let arrives = 30.0 + stall + (i as f64 - 30.0 * fs_hz) * 1e-4;
            if due >= 30.0 {
                (arrives - due).max(0.0)
            } else {
                0.0
            }
        });
        let record = only(&messages, fs_hz, RecordSettings::default());
        assert_eq!(difference(&record.samples, &clean).2, None, "{stall}");
        assert_eq!(
            (record.samples.len(), record.fs_hz),
            (clean.len(), fs_hz),
            "{stall}"
        );
        assert!(
            matches!(record.flags[..], [Flag::LateStamps { .. }]),
            "{:?}",
            record.flags
        );
    }
}

#[test]
fn jitter_moves_no_sample_and_its_error_is_stated() {
    for (fs_hz, sizes) in [(100.0, [1, 32]), (200.0, [1, 40])] {
        let clean = signal(fs_hz);
        for size in sizes {
            let (mut inside, trials) = (0, 60);
            for seed in 0..trials {
                let mut noise = Noise(seed * 31 + 1);
                let messages = stamped(&clean, fs_hz, size, |_| 2e-3 * noise.gaussian());
                let record = only(&messages, fs_hz, RecordSettings::default());
                let found = difference(&record.samples, &clean);
                assert_eq!(found, (clean.len(), clean.len(), None), "{fs_hz} {size} {seed}");
                let filled = record
                    .flags
                    .iter()
                    .any(|flag| matches!(flag, Flag::Filled { .. }));
                assert!(!filled, "{:?}", record.flags);
                let error = (record.fs_hz / fs_hz - 1.0).abs();
                inside += usize::from(error < 1.96 * record.clock_sd);
                // The scatter of 2 ms over 60 s in n stamps, sigma sqrt(12 / n) / T: 8.5 ppm with blocks of 32.
                let expected = 2e-3 * (12.0 * size as f64 / clean.len() as f64).sqrt() / 60.0;
                let stated = record.clock_sd / expected;
                assert!((0.7..1.4).contains(&stated), "{fs_hz} {size}: {stated}");
            }
            // Of 60 with 95 % inside, fewer than 52 in one of 200.
            assert!(inside >= 52, "{fs_hz} {size}: {inside} of {trials}");
        }
    }
}

#[test]
fn confirmed_holes_are_found_to_the_sample() {
    let fs_hz = 100.0;
    let clean = signal(fs_hz);
    let settings = RecordSettings {
        max_gap_s: 1.0,
        ..Default::default()
    };
    for jitter in [0.0, 2e-3] {
        for lost in [2usize, 40] {
            for size in [1usize, 32] {
                for seed in 0..25 {
                    let mut noise = Noise(seed * 77 + 3);
                    let at = 1000 + 97 * seed as usize;
                    let kept: Vec<f64> =
                        [&clean[..at / size * size], &clean[at / size * size + lost..]].concat();
                    let messages = stamped(&kept, fs_hz, size, |i| {
                        let hole = if i >= at / size { lost as f64 / fs_hz } else { 0.0 };
                        hole + jitter * noise.gaussian()
                    });
                    let record = only(&messages, fs_hz, settings);
                    let case = format!("{jitter} {lost} {size} {seed}");
                    assert_eq!(record.samples.len(), clean.len(), "{case}: {:?}", record.flags);
                    assert!(
                        record.flags.contains(&Flag::Filled { samples: lost }),
                        "{case}: {:?}",
                        record.flags
                    );
                    let error = (record.fs_hz / fs_hz - 1.0).abs();
                    assert!(
                        error < 4.0 * record.clock_sd + 1e-9,
                        "{case}: {error:e} {:e}",
                        record.clock_sd
                    );
                    if jitter == 0.0 || size > 1 {
                        // Behind the hole every sample is where it was.
                        let behind = at / size * size + lost;
                        let found = difference(&record.samples[behind..], &clean[behind..]);
                        assert_eq!(found.2, None, "{case}");
                    }
                }
            }
        }
    }
}

#[test]
fn a_clock_slower_than_declared_loses_nothing() {
    // Declared rate, error of the clock in ppm, samples in a message, scatter of the stamps in s.
    for (fs_hz, ppm, size, jitter) in [
        (1024.0, -100.0, 1024, 0.0),
        (1024.0, -450.0, 1024, 0.0),
        (1024.0, 450.0, 1024, 0.0),
        (1000.0, -600.0, 500, 0.0),
        (200.0, -1000.0, 1000, 0.0),
        (5000.0, -30.0, 5000, 0.0),
        (1000.0, -40.0, 1000, 3e-4),
        (1000.0, -100.0, 200, 5e-4),
        (200.0, -300.0, 200, 2e-3),
    ] {
        let clean = signal(fs_hz);
        let true_hz = fs_hz * (1.0 + ppm * 1e-6);
        let case = format!("{fs_hz} {ppm} {size} {jitter}");
        for lost in [0usize, 7] {
            let mut noise = Noise(11);
            let at = clean.len() / 2 / size * size;
            let kept = [&clean[..at], &clean[at + lost..]].concat();
            let messages = stamped(&kept, true_hz, size, |i| {
                let hole = if i * size >= at {
                    lost as f64 / true_hz
                } else {
                    0.0
                };
                hole + jitter * noise.gaussian()
            });
            let record = only(&messages, fs_hz, RecordSettings::default());
            let filled: usize = record.flags.iter().map(filled).sum();
            assert_eq!(filled, lost, "{case}: {:?}", record.flags);
            assert_eq!(record.samples.len(), clean.len(), "{case}");
            let error = (record.fs_hz / true_hz - 1.0).abs();
            assert!(
                error < 4.0 * record.clock_sd + 2e-9,
                "{case} {lost}: {error:e} {:e}",
                record.clock_sd
            );
        }
    }
}

fn filled(flag: &Flag) -> usize {
    match flag {
        Flag::Filled { samples } => *samples,
        _ => 0,
    }
}

#[test]
fn the_last_stamp_of_a_window_proves_no_hole() {
    let fs_hz = 200.0;
    let clean = signal(fs_hz);
    let settings = RecordSettings {
        cut: Cut::Window { length_s: 20.0 },
        ..Default::default()
    };
    // The last block of the first window, 15 ms late.
    let messages = stamped(&clean, fs_hz, 100, |i| if i == 39 { 0.015 } else { 0.0 });
    let mut all = Vec::new();
    for event in assemble(&messages, fs_hz, settings) {
        let Event::Record(record) = event else {
            panic!("{event:?}")
        };
        assert!(
            !record
                .flags
                .iter()
                .any(|flag| matches!(flag, Flag::Filled { .. })),
            "{:?}",
            record.flags
        );
        all.extend(record.samples);
    }
    assert_eq!(difference(&all, &clean), (clean.len(), clean.len(), None));
}

#[test]
fn a_message_that_holds_several_records_is_cut_at_once() {
    let settings = RecordSettings {
        cut: Cut::Auto,
        max_duration_s: 60.0,
        ..RecordSettings::default()
    };
    let mut assembler = Assembler::new(RodId("r".into()), settings, Some(100.0), false);
    let block: Vec<f64> = signal(100.0).into_iter().cycle().take(50_000).collect();
    let mut starts = Vec::new();
    let mut take = |assembler: &mut Assembler| {
        for event in assembler.events() {
            let Event::Record(record) = event else {
                panic!("{event:?}")
            };
            assert!(record.samples.len() <= 6000, "{}", record.samples.len());
            starts.push(record.start);
        }
    };
    for number in 0..24 {
        let start = 1_772_344_800_000_000_000 + number * 500_000_000_000;
        assembler.push(Timestamp::from_nanos(start), &block);
        take(&mut assembler);
        // Sixteen messages are waited for to measure the rate; beyond, the last one waits for late ones.
        let held = assembler.held() / 8;
        assert!(number < 16 || held < 2 * 50_000, "{number}: {held}");
    }
    assembler.finish(false);
    take(&mut assembler);
    assert_eq!(starts.len(), 24 * 500 / 60);
    let steady = starts
        .windows(2)
        .all(|pair| (pair[1].seconds_since(pair[0]) - 60.0).abs() < 1e-6);
    assert!(steady, "{starts:?}");
}
