//! Any bytes, in any pieces, from a client of the socket: no panic, bounded memory, and messages counted right.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::sync::Arc;
use tirante::service::ingest::{Protocol, Step, TopicSet};
use tirante::service::journal::Entry;

fuzz_target!(|bytes: &[u8]| {
    let Some((&step, bytes)) = bytes.split_first() else { return };
    let topics: Arc<TopicSet> = Arc::new(["/laser", "/air"].map(str::to_owned).into());
    let mut protocol = Protocol::new(topics);
    let (mut through, mut counted) = (0, 0);
    let mut parts = bytes.chunks(usize::from(step).max(1));
    loop {
        let part = parts.next();
        match part {
            Some(part) => protocol.push(part),
            None => protocol.close(),
        }
        loop {
            let step = protocol.next(1);
            counted += protocol.take_foreign();
            match step {
                Ok(None) => break,
                Ok(Some(Step::Batch(batch))) => {
                    let messages = batch.entries.iter().filter(|entry| matches!(entry, Entry::Message { .. }));
                    counted += messages.count() as u64;
                    assert!(batch.through > through);
                    through = batch.through;
                }
                Ok(Some(Step::Hello(name))) => {
                    assert!((1..=64).contains(&name.len()));
                    protocol.welcome(0);
                }
                Ok(Some(Step::End { messages, .. })) => {
                    assert_eq!(messages, counted);
                    (through, counted) = (0, 0);
                }
                Ok(Some(Step::Cut)) => assert!(part.is_none()),
                // A panic that the reader's own net would catch ends the fuzzer before.
                Err(_) => return,
            }
        }
        assert!(protocol.held() <= 2 * bytes.len() + 64_000);
        if part.is_none() {
            return;
        }
    }
});
