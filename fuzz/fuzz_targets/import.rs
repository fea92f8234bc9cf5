//! Any bytes as another program's measurement, and as a file of each format by its name: no panic, no endless work, every
//! refusal a sentence; what is read has a bounded size.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::Path;
use tirante::recording::import::{How, MOST_VALUES, Plan, read};
use tirante::recording::write::Encoding;

/// Found from the content, or claimed by a name.
const NAMES: [&str; 8] = ["x", "x.csv", "x.uff", "x.wav", "x.mat", "x.lvm", "x.tdms", "x.npy"];

fuzz_target!(|bytes: &[u8]| {
    let Some((&kind, rest)) = bytes.split_first() else { return };
    let how = How {
        rate_hz: (kind & 8 != 0).then_some(200.0),
        full_scale: (kind & 16 != 0).then_some(1.0),
        ..How::default()
    };
    let contents = match read(rest, Path::new(NAMES[usize::from(kind % 8)]), &how) {
        Ok(Some(contents)) => contents,
        Ok(None) => return,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
    };
    assert!(contents.left_out.iter().all(|sentence| !sentence.is_empty()));
    if let Ok(plan) = Plan::new(contents.signals, &how.asked(&[]), Encoding::Json) {
        let missing: usize = plan.channels.iter().map(|channel| channel.missing()).sum();
        assert!(missing <= MOST_VALUES);
        for channel in &plan.channels {
            assert!(channel.stretches.iter().all(|(_, range)| range.end <= channel.values.len()));
        }
    }
});
