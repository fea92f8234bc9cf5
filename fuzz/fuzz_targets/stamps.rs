//! Any stamps and samples: the assembler neither panics nor makes samples up.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tirante::analysis::signal::record::{Assembler, Cut, Event, RecordSettings, RodId, Timestamp};

fuzz_target!(|bytes: &[u8]| {
    let Some((&kind, rest)) = bytes.split_first() else { return };
    let cut = match kind % 3 {
        0 => Cut::File,
        1 => Cut::Window { length_s: 0.3 },
        _ => Cut::FreeDecay { ratio: 4.0, length_s: 0.3 },
    };
    let settings = RecordSettings { cut, min_duration_s: 0.05, max_duration_s: 2.0, ..Default::default() };
    let declared = (kind & 4 != 0).then_some(200.0);
    let mut assembler = Assembler::new(RodId("r".into()), settings, declared, false);
    let mut time = 1_700_000_000_000_000_000i64;
    let mut pushed = 0usize;
    for step in rest.chunks_exact(3) {
        let [jump, size, value] = [step[0], step[1], step[2]];
        time = match jump {
            0..=199 => time.saturating_add(5_000_000),
            200..=229 => time.saturating_add(i64::from(jump) * 100_000),
            230..=239 => time.saturating_sub(i64::from(value) * 1_000_000),
            240..=249 => time,
            250 => i64::MIN,
            251 => i64::MAX,
            252 => 0,
            _ => time.saturating_add(i64::from(value) * 1_000_000_000_000),
        };
        let sample = if value == 255 { f64::NAN } else { f64::from(value) };
        let count = usize::from(size % 4) * usize::from(kind >> 5) + 1;
        let values: Vec<f64> = (0..count).map(|i| sample + i as f64).collect();
        assembler.push(Timestamp::from_nanos(time), &values);
        pushed += count;
    }
    assembler.finish(kind & 8 != 0);
    let mut delivered = 0;
    for event in assembler.events() {
        if let Event::Record(record) = event {
            assert!(record.samples.iter().all(|x| x.is_finite()));
            delivered += record.samples.len();
        }
    }
    // Holes are filled only up to a small share.
    assert!(delivered as f64 <= 1.05 * pushed as f64 + 1.0, "{delivered} of {pushed}");
});
