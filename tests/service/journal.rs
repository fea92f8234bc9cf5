//! The journal: it keeps all acknowledged data, whatever happens, and its replay gives the records of the
//! data sent.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::common::{FS, START, field, motion, recording, rod, spec, windows};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant, SystemTime};
use tirante::analysis::signal::record::{
    Assembler, Cut, Event, Flag, RecordSettings, RodChannels, RodId, Timestamp,
};
use tirante::config::settings::journal::JournalSettings;
use tirante::recording::part;
use tirante::recording::read::{self, Recordings, Source, Step};
use tirante::recording::write::{Encoding, Layout, RecordingWriter, WriterOptions};
use tirante::service::journal::retention::Kept;
use tirante::service::journal::{Around, Batch, Closed, End, Entry, Handle, Journal, JournalError, Line};
use tirante::service::telemetry::{Fault, Health};

const LAYOUT: Layout = Layout::Batch(50);
const RESUME_S: f64 = 3600.0;

fn start(folder: &Path) -> (Journal, Arc<Health>) {
    start_with(folder, &JournalSettings::default(), RESUME_S)
}

fn start_with(folder: &Path, settings: &JournalSettings, resume_s: f64) -> (Journal, Arc<Health>) {
    let health = Arc::<Health>::default();
    let failed = |error| panic!("the journal failed: {error}");
    // A process that another test starts at this moment holds the lock of the last journal until it runs its own program.
    let until = Instant::now() + Duration::from_secs(5);
    let journal = loop {
        match Journal::start(folder, settings, resume_s, around(&health), failed) {
            Err(JournalError::Held { .. }) if Instant::now() < until => {
                std::thread::sleep(Duration::from_millis(10))
            }
            journal => break journal.unwrap(),
        }
    };
    (journal, health)
}

/// Partners of a journal that confirm every part, with its age by the machine's clock.
fn around(health: &Arc<Health>) -> Around {
    let age_s = |kept: &Kept| {
        let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
        now.as_secs_f64() - kept.modified_ns as f64 * 1e-9
    };
    Around {
        beat: Arc::default(),
        copied: None,
        health: Arc::clone(health),
        halted: Arc::default(),
        vouch: Box::new(move |parts| parts.iter().map(age_s).collect()),
    }
}

fn block_on<T>(future: impl Future<Output = T>) -> T {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .unwrap();
    runtime.block_on(async {
        tokio::time::timeout(Duration::from_secs(60), future)
            .await
            .unwrap()
    })
}

/// A recording as a sender would send it.
struct Sent {
    channels: Vec<Entry>,
    messages: Vec<Entry>,
}

fn sent(bytes: &[u8]) -> Sent {
    let mut channels = BTreeMap::new();
    let mut messages = Vec::new();
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        channels
            .entry(message.channel.id)
            .or_insert_with(|| Entry::Channel {
                id: message.channel.id,
                topic: message.channel.topic.clone(),
                encoding: message.channel.message_encoding.clone(),
                schema: message.channel.schema.as_ref().map(|schema| {
                    Arc::new((schema.name.clone(), schema.encoding.clone(), schema.data.to_vec()))
                }),
            });
        messages.push(Entry::Message {
            channel: message.channel.id,
            log_time: message.log_time,
            publish_time: message.publish_time,
            data: message.data.to_vec(),
        });
    }
    Sent {
        channels: channels.into_values().collect(),
        messages,
    }
}

/// Sends messages `from..to` in batches.
async fn send(line: &mut Line, sent: &Sent, from: usize, to: usize, batch: usize) -> Result<(), Closed> {
    let mut through = from as u64;
    line.append(Batch {
        entries: sent.channels.clone(),
        through,
    })
    .await?;
    for messages in sent.messages[from..to].chunks(batch) {
        through += messages.len() as u64;
        line.append(Batch {
            entries: messages.to_vec(),
            through,
        })
        .await?;
    }
    Ok(())
}

async fn durable(line: &Line, messages: u64) {
    let mut durable = line.durable();
    durable.wait_for(|count| *count >= messages).await.unwrap();
}

async fn send_all(handle: &Handle, sender: Option<&str>, sent: &Sent, how: End) {
    let mut line = handle.connect(sender).await.unwrap();
    let from = usize::try_from(line.begins_at()).unwrap();
    send(&mut line, sent, from, sent.messages.len(), 7).await.unwrap();
    line.end(how).await.unwrap();
}

/// Events of a replay of the folder, and the faults it reported.
fn replay(folder: &Path, rods: &[RodChannels], settings: &RecordSettings) -> (Vec<Event>, Vec<String>) {
    let files = read::recordings(&[folder.to_owned()]);
    let steps = Recordings::new(files, rods.to_vec(), *settings, false, Arc::default());
    let (mut events, mut faults) = (Vec::new(), Vec::new());
    for step in steps {
        match step {
            Step::Event(event, _) => events.push(event),
            Step::File(result) => faults.extend(result.unwrap().faults()),
            Step::More | Step::Wait | Step::End => {}
        }
    }
    (events, faults)
}

fn direct(bytes: &[u8], rods: &[RodChannels], settings: &RecordSettings) -> Vec<Event> {
    crate::common::read(bytes.to_vec(), rods, settings).0
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

fn laser() -> Vec<RodChannels> {
    vec![rod("laser", "/laser", field(Encoding::Json, LAYOUT))]
}

fn measured(count: usize) -> Vec<u8> {
    recording(Encoding::Json, LAYOUT, WriterOptions::default(), count)
}

fn decay() -> RecordSettings {
    RecordSettings {
        cut: Cut::FreeDecay {
            ratio: 5.0,
            length_s: 12.0,
        },
        ..Default::default()
    }
}

#[test]
fn a_replay_of_the_journal_gives_the_records_of_the_recording() {
    let bytes = measured(20_000);
    let sent = sent(&bytes);
    for settings in [RecordSettings::default(), windows(13.0), decay()] {
        let folder = tempfile::tempdir().unwrap();
        let (journal, _) = start(folder.path());
        block_on(async {
            let handle = journal.handle();
            let mut line = handle.connect(Some("laser")).await.unwrap();
            let mut from = 0;
            // Parts begin in the middle of records.
            for to in [60, 61, 200, 399, 400] {
                send(&mut line, &sent, from, to, 7).await.unwrap();
                handle.rotate();
                from = to;
            }
            line.end(End::Complete).await.unwrap();
        });
        journal.stop();
        assert!(part::list(folder.path()).unwrap().len() >= 6);
        let (events, faults) = replay(folder.path(), &laser(), &settings);
        assert_eq!(events, direct(&bytes, &laser(), &settings));
        assert_eq!(faults, Vec::<String>::new());
    }
}

#[test]
fn a_kill_loses_nothing_acknowledged_and_the_sender_goes_on() {
    let bytes = measured(12_000);
    let sent = sent(&bytes);
    let last = sent.messages.len();
    let folder = tempfile::tempdir().unwrap();
    let alive = folder.path().join("alive");
    let (journal, _) = start(&alive);
    let mut killed = Vec::new();
    block_on(async {
        let mut line = journal.handle().connect(Some("laser")).await.unwrap();
        for to in (10..=last).step_by(10) {
            send(&mut line, &sent, to - 10, to, 3).await.unwrap();
            if to % 60 == 0 {
                durable(&line, to as u64).await;
            }
            let acknowledged = *line.durable().borrow();
            // State after a kill -9 at this point.
            let dead = folder.path().join(format!("dead{to}"));
            copy(&alive, &dead);
            killed.push((dead, acknowledged, to as u64));
        }
    });
    drop(journal);
    let reference = direct(&bytes, &laser(), &windows(11.0));
    for (dead, acknowledged, sent_until) in killed {
        let (journal, _) = start(&dead);
        block_on(async {
            let handle = journal.handle();
            let line = handle.connect(Some("laser")).await.unwrap();
            let begins_at = line.begins_at();
            assert!(acknowledged <= begins_at && begins_at <= sent_until);
            drop(line);
            send_all(&handle, Some("laser"), &sent, End::Complete).await;
        });
        journal.stop();
        let (events, faults) = replay(&dead, &laser(), &windows(11.0));
        assert_eq!(events, reference);
        assert_eq!(faults, Vec::<String>::new());
    }
}

#[test]
fn torn_at_any_byte_positions_and_messages_agree() {
    let sent = sent(&measured(3_000));
    // In memory where there is such a place: thousands of folders are made durable here.
    let folder = tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap();
    let whole = folder.path().join("whole");
    let (journal, _) = start(&whole);
    block_on(async {
        let handle = journal.handle();
        let mut line = handle.connect(Some("a")).await.unwrap();
        // Three chunks of a few messages.
        for (from, to) in [(0, 2), (2, 5), (5, 9)] {
            send(&mut line, &sent, from, to, 10).await.unwrap();
            durable(&line, to as u64).await;
        }
    });
    let bytes = fs::read(part::path(&whole, 1)).unwrap();
    drop(journal);
    let mut seen = std::collections::BTreeSet::new();
    for length in (0..=bytes.len()).rev() {
        let torn = folder.path().join(format!("torn{length}"));
        fs::create_dir(&torn).unwrap();
        fs::write(part::path(&torn, 1), &bytes[..length]).unwrap();
        let (journal, health) = start(&torn);
        let begins_at = block_on(async { journal.handle().connect(Some("a")).await.unwrap().begins_at() });
        journal.stop();
        assert_eq!(health.count(Fault::Recording), 0, "a torn part is no damage");
        // The sender is told exactly the content of the prefix.
        let (events, _) = replay(
            &torn,
            &laser(),
            &RecordSettings {
                min_duration_s: 0.2,
                ..Default::default()
            },
        );
        let samples: f64 = events
            .iter()
            .map(|event| match event {
                Event::Record(record) => record.samples.len() as f64,
                Event::Rejected { duration_s, .. } => (duration_s * FS).round(),
                _ => 0.0,
            })
            .sum();
        assert_eq!(begins_at as f64 * 50.0, samples.max(0.0), "cut at byte {length}");
        seen.insert(begins_at);
        assert_eq!(
            fs::read(part::path(&torn, 1)).unwrap().len(),
            length,
            "never written again"
        );
        fs::remove_dir_all(&torn).unwrap();
    }
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), [0, 2, 5, 9]);
}

#[test]
fn the_younger_connection_of_a_name_takes_over() {
    let sent = sent(&measured(2_000));
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    block_on(async {
        let handle = journal.handle();
        let mut older = handle.connect(Some("x")).await.unwrap();
        send(&mut older, &sent, 0, 4, 2).await.unwrap();
        let mut younger = handle.connect(Some("x")).await.unwrap();
        assert_eq!(younger.begins_at(), 4, "what it goes on from is durable");
        let refused = send(&mut older, &sent, 4, 9, 2).await;
        assert_eq!(refused, Err(Closed::TakenOver));
        assert_eq!(older.end(End::Complete).await, Err(Closed::TakenOver));
        send(&mut younger, &sent, 4, 6, 2).await.unwrap();
        younger.end(End::Complete).await.unwrap();
        // A stream that was complete is over: the next one counts anew.
        assert_eq!(handle.connect(Some("x")).await.unwrap().begins_at(), 0);
    });
    journal.stop();
}

#[test]
fn a_stopped_journal_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    let handle = journal.handle();
    let mut line = block_on(handle.connect(None)).unwrap();
    journal.stop();
    assert_eq!(block_on(line.append(Batch::default())), Err(Closed::Stopping));
    assert!(matches!(
        block_on(handle.connect(Some("a"))),
        Err(Closed::Stopping)
    ));
}

#[test]
fn one_daemon_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    let again = Journal::start(
        folder.path(),
        &JournalSettings::default(),
        1.0,
        around(&Arc::default()),
        |_| {},
    );
    assert!(again.unwrap_err().to_string().contains("another process writes"));
    journal.stop();
    start(folder.path()).0.stop();
}

fn truncated(events: &[Event]) -> Vec<bool> {
    let is = |record: &&tirante::analysis::signal::record::Record| record.flags.contains(&Flag::Truncated);
    crate::common::records(events).iter().map(is).collect()
}

#[test]
fn broken_streams_end_as_cut_short() {
    let bytes = measured(6_000);
    let sent = sent(&bytes);
    let settings = RecordSettings::default();
    let folder = tempfile::tempdir().unwrap();
    // An anonymous sender that is cut off; one that is killed with the daemon; one that comes to its end.
    let (journal, _) = start(folder.path());
    block_on(send_all(&journal.handle(), None, &sent, End::Broken));
    journal.stop();
    assert_eq!(truncated(&replay(folder.path(), &laser(), &settings).0), [true]);

    let killed = folder.path().join("killed");
    let alive = folder.path().join("alive");
    let (journal, _) = start(&alive);
    block_on(async {
        let mut line = journal.handle().connect(None).await.unwrap();
        send(&mut line, &sent, 0, 60, 9).await.unwrap();
        durable(&line, 60).await;
        copy(&alive, &killed);
    });
    drop(journal);
    let (journal, _) = start(&killed);
    // The same data again: a record of its own, not a continuation.
    block_on(send_all(&journal.handle(), None, &sent, End::Complete));
    journal.stop();
    let (events, _) = replay(&killed, &laser(), &settings);
    assert_eq!(truncated(&events), [true, false]);
}

#[test]
fn a_named_sender_that_does_not_come_back_ends_its_record_but_keeps_its_place() {
    let sent = sent(&measured(6_000));
    let settings = RecordSettings::default();
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start_with(folder.path(), &JournalSettings::default(), 0.5);
    block_on(async {
        let handle = journal.handle();
        let mut line = handle.connect(Some("n")).await.unwrap();
        send(&mut line, &sent, 0, 60, 9).await.unwrap();
        durable(&line, 60).await;
        drop(line);
        let until = Instant::now() + Duration::from_secs(20);
        let says_broken = || {
            let (events, _) = replay(folder.path(), &laser(), &settings);
            // A replay ends open records, so look for the word itself.
            let _ = events;
            notes(folder.path()).iter().any(|note| note.contains("broken"))
        };
        while !says_broken() {
            assert!(Instant::now() < until);
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        let mut line = handle.connect(Some("n")).await.unwrap();
        assert_eq!(line.begins_at(), 60);
        send(&mut line, &sent, 60, 120, 9).await.unwrap();
        line.end(End::Complete).await.unwrap();
    });
    journal.stop();
    let (events, _) = replay(folder.path(), &laser(), &settings);
    assert_eq!(truncated(&events), [true, false]);
}

/// Every note of every part.
fn notes(folder: &Path) -> Vec<String> {
    let mut notes = Vec::new();
    for number in part::list(folder).unwrap() {
        let bytes = fs::read(part::path(folder, number)).unwrap();
        let options = mcap::read::Options::IgnoreEndMagic;
        let Ok(stream) = mcap::read::RawMessageStream::new_with_options(&bytes, options.into()) else {
            continue;
        };
        for message in stream.map_while(Result::ok) {
            let text = String::from_utf8_lossy(&message.data);
            if text.contains("\"streams\"") {
                notes.push(text.into_owned());
            }
        }
    }
    notes
}

#[test]
fn parts_rotate_by_size_and_go_when_their_results_are_kept() {
    let sent = sent(&measured(60_000));
    let settings = JournalSettings {
        part_bytes: 40_000,
        keep_s: None,
        keep_bytes: Some(1),
        ..Default::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start_with(folder.path(), &settings, RESUME_S);
    block_on(async {
        let handle = journal.handle();
        let mut line = handle.connect(Some("big")).await.unwrap();
        for from in (0..1200).step_by(100) {
            send(&mut line, &sent, from, from + 100, 10).await.unwrap();
            durable(&line, from as u64 + 100).await;
        }
    });
    // Nothing goes before its results are kept.
    let parts = part::list(folder.path()).unwrap();
    assert!(parts.len() > 4 && parts[0] == 1, "{parts:?}");
    journal
        .results_kept()
        .store(3, std::sync::atomic::Ordering::Relaxed);
    let until = Instant::now() + Duration::from_secs(20);
    while part::list(folder.path()).unwrap()[0] != 4 {
        assert!(Instant::now() < until);
        std::thread::sleep(Duration::from_millis(20));
    }
    journal.stop();
    // The part that holds the state is never removed, whatever the retention.
    let (journal, _) = start_with(folder.path(), &settings, RESUME_S);
    journal
        .results_kept()
        .store(u32::MAX, std::sync::atomic::Ordering::Relaxed);
    while part::list(folder.path()).unwrap().len() > 2 {
        assert!(Instant::now() < until);
        std::thread::sleep(Duration::from_millis(20));
    }
    journal.stop();
    let (journal, _) = start_with(folder.path(), &settings, RESUME_S);
    assert_eq!(
        block_on(journal.handle().connect(Some("big")))
            .unwrap()
            .begins_at(),
        1200
    );
    journal.stop();
}

#[test]
fn a_blank_end_after_a_power_cut_is_a_torn_end() {
    let bytes = measured(12_000);
    let sent = sent(&bytes);
    let folder = tempfile::tempdir().unwrap();
    let (alive, dead) = (folder.path().join("alive"), folder.path().join("dead"));
    let (journal, _) = start(&alive);
    block_on(async {
        let mut line = journal.handle().connect(Some("laser")).await.unwrap();
        for to in (20..=100).step_by(20) {
            send(&mut line, &sent, to - 20, to, 10).await.unwrap();
            durable(&line, to as u64).await;
        }
        copy(&alive, &dead);
    });
    drop(journal);
    let path = part::path(&dead, 1);
    let mut content = fs::read(&path).unwrap();
    let blank = content.len() * 3 / 4;
    // The chunk in which the blank begins is damaged; one that begins in it is not there.
    content.truncate(blank);
    let whole = whole_records(&content);
    content.truncate(whole);
    content.resize(whole + 10_000, 0);
    fs::write(&path, content).unwrap();
    let (journal, health) = start(&dead);
    block_on(send_all(&journal.handle(), Some("laser"), &sent, End::Complete));
    journal.stop();
    assert_eq!(health.count(Fault::Recording), 0);
    let (events, faults) = replay(&dead, &laser(), &windows(11.0));
    assert_eq!(events, direct(&bytes, &laser(), &windows(11.0)));
    assert_eq!(faults, Vec::<String>::new());
}

/// Bytes up to the end of the last whole record of an MCAP file.
fn whole_records(bytes: &[u8]) -> usize {
    let mut at = 8;
    loop {
        let Some(head) = bytes.get(at + 1..at + 9) else {
            return at;
        };
        let length = u64::from_le_bytes(head.try_into().unwrap()) as usize;
        if at + 9 + length > bytes.len() {
            return at;
        }
        at += 9 + length;
    }
}

#[test]
fn a_missing_part_is_told_and_records_end_there() {
    let bytes = measured(20_000);
    let sent = sent(&bytes);
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    block_on(async {
        let handle = journal.handle();
        let mut line = handle.connect(Some("laser")).await.unwrap();
        for from in [0, 100, 200, 300] {
            send(&mut line, &sent, from, from + 100, 10).await.unwrap();
            handle.rotate();
        }
        line.end(End::Complete).await.unwrap();
    });
    journal.stop();
    fs::remove_file(part::path(folder.path(), 2)).unwrap();
    let (events, faults) = replay(folder.path(), &laser(), &RecordSettings::default());
    assert_eq!(truncated(&events), [true, false]);
    assert!(
        faults
            .iter()
            .any(|fault| fault.contains("journal.000002.mcap, is missing")),
        "{faults:?}"
    );
}

/// The reader of a journal under way has read the first part when the second goes and others are begun.
#[test]
fn a_part_removed_before_it_was_read_does_not_hold_up_the_ones_behind() {
    let sent = sent(&measured(20_000));
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    block_on(async {
        let mut line = journal.handle().connect(Some("laser")).await.unwrap();
        for from in [0, 100, 200, 300] {
            send(&mut line, &sent, from, from + 100, 10).await.unwrap();
            journal.handle().rotate();
        }
        line.end(End::Complete).await.unwrap();
    });
    journal.stop();
    let aside = tempfile::tempdir().unwrap();
    let later = part::list(folder.path()).unwrap().split_off(1);
    for part in &later {
        fs::rename(part::path(folder.path(), *part), part::path(aside.path(), *part)).unwrap();
    }
    let mut series = read::Series::new(
        folder.path(),
        read::Parts::From(1),
        &laser(),
        &RecordSettings::default(),
    );
    let read_on = |series: &mut read::Series| {
        let mut ended = Vec::new();
        loop {
            match series.poll() {
                Step::File(end) => ended.push(end.part),
                Step::Wait => return ended,
                Step::Event(..) | Step::More => {}
                Step::End => panic!("a journal under way does not end"),
            }
        }
    };
    assert!(read_on(&mut series).is_empty());
    for part in &later[1..] {
        fs::rename(part::path(aside.path(), *part), part::path(folder.path(), *part)).unwrap();
    }
    let ended = read_on(&mut series);
    assert_eq!(ended, [&[1], &later[1..later.len() - 1]].concat(), "{later:?}");
    let (part, told) = series.take_lost().unwrap();
    assert!(
        part == part::file_name(2) && told.contains("is missing"),
        "{told}"
    );
    assert!(series.take_lost().is_none());
}

#[test]
fn damage_in_one_part_leaves_the_others() {
    let sent = sent(&measured(20_000));
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    block_on(async {
        let handle = journal.handle();
        let mut line = handle.connect(Some("laser")).await.unwrap();
        for from in [0, 100, 200, 300] {
            send(&mut line, &sent, from, from + 100, 10).await.unwrap();
            handle.rotate();
        }
        line.end(End::Complete).await.unwrap();
    });
    journal.stop();
    let path = part::path(folder.path(), 2);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x10;
    fs::write(&path, bytes).unwrap();
    let (events, faults) = replay(folder.path(), &laser(), &RecordSettings::default());
    let rejected = events
        .iter()
        .filter(|event| matches!(event, Event::Rejected { .. }))
        .count();
    assert_eq!(rejected, 1, "the damage is one rejection");
    // Reading goes on behind the damage: it is a hole, not the end of the stream.
    assert_eq!(truncated(&events), [false, false]);
    assert!(
        faults.iter().any(|fault| fault.contains("journal.000002.mcap")),
        "{faults:?}"
    );
}

/// A small file system of its own; unmounted when dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: &Path, size: &str) -> Option<Self> {
        fs::create_dir_all(at).ok()?;
        let status = std::process::Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={size}"), "tmpfs"])
            .arg(at)
            .stderr(std::process::Stdio::null())
            .status()
            .ok()?;
        status.success().then(|| Self(at.to_owned()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount")
            .arg("-l")
            .arg(&self.0)
            .status();
    }
}

#[test]
fn a_full_disk_is_waited_for_and_nothing_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = SmallDisk::mount(&folder.path().join("small"), "1500k") else {
        return eprintln!("skipped: mounting a small file system needs root");
    };
    let bytes = measured(60_000);
    let sent = sent(&bytes);
    let journal_folder = disk.0.join("journal");
    let (journal, health) = start(&journal_folder);
    let ballast = disk.0.join("ballast");
    fs::write(&ballast, vec![1u8; 1300 << 10]).unwrap();
    let is_full = |health: &Health| {
        health
            .conditions()
            .iter()
            .any(|held| held.fault == Fault::DiskFull)
    };
    block_on(async {
        let handle = journal.handle();
        let mut line = handle.connect(Some("laser")).await.unwrap();
        let last = sent.messages.len();
        send(&mut line, &sent, 0, last, 20).await.unwrap();
        let until = Instant::now() + Duration::from_secs(20);
        while !is_full(&health) {
            assert!(Instant::now() < until, "the disk should be full by now");
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        assert!(
            *line.durable().borrow() < last as u64,
            "what is not on disk is not acknowledged"
        );
        // After a kill at this point, the files are an exact prefix.
        let dead = folder.path().join("dead");
        copy(&journal_folder, &dead);
        let (after, _) = start(&dead);
        let begins_at = after.handle().connect(Some("laser")).await.unwrap().begins_at();
        assert!(begins_at >= *line.durable().borrow());
        drop(after);
        fs::remove_file(&ballast).unwrap();
        durable(&line, last as u64).await;
        line.end(End::Complete).await.unwrap();
    });
    assert!(!is_full(&health) && health.count(Fault::DiskFull) == 1);
    journal.stop();
    let (events, faults) = replay(&journal_folder, &laser(), &windows(11.0));
    assert_eq!(events, direct(&bytes, &laser(), &windows(11.0)));
    assert_eq!(faults, Vec::<String>::new());
}

/// Messages of a realistic stream: holes, late ones, doubled ones, NaN, temperatures between.
#[derive(Debug, Clone)]
enum Came {
    Samples(i64, Vec<f64>),
    Temperature(i64, f64),
}

fn stream(seed: u64, faults: &[(usize, u8)]) -> Vec<Came> {
    let values = motion(9_000);
    let step = (1e9 / FS) as i64;
    let mut came: Vec<Came> = Vec::new();
    let mut shift = 0i64;
    for (at, chunk) in values.chunks(25).enumerate() {
        let mut time = START.as_nanos() + at as i64 * 25 * step + shift;
        let mut chunk = chunk.to_vec();
        let fault = faults
            .iter()
            .find(|(where_, _)| *where_ == at)
            .map(|(_, fault)| *fault);
        match fault {
            Some(0) => continue,
            Some(1) => shift += 3_000_000_000,
            Some(2) => chunk[(seed % 25) as usize] = f64::NAN,
            Some(3) => came.extend(came.last().cloned()),
            Some(4) => time -= 40_000_000_000,
            Some(5) => {
                // Late: it changes places with the one before.
                came.push(Came::Samples(time, chunk));
                let last = came.len() - 1;
                if last > 0 {
                    came.swap(last, last - 1);
                }
                continue;
            }
            _ => {}
        }
        came.push(Came::Samples(time, chunk));
        if at % 4 == 0 {
            came.push(Came::Temperature(time, 10.0 + (at as f64 * 0.1).sin()));
        }
    }
    came
}

fn push(assembler: &mut Assembler, came: &Came) {
    match came {
        Came::Samples(time, values) => assembler.push(Timestamp::from_nanos(*time), values),
        Came::Temperature(time, celsius) => {
            assembler.push_temperature(Timestamp::from_nanos(*time), *celsius)
        }
    }
}

fn bits(event: &Event) -> String {
    match event {
        Event::Record(record) => format!(
            "{} {:?} {:?} {:?} {:?}",
            record.start,
            record.identity(),
            record.temperature_c.map(f64::to_bits),
            record.readings,
            record.flags
        ),
        other => format!("{other:?}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn an_assembler_goes_on_where_it_was_saved(
        seed in 0u64..1000,
        faults in prop::collection::vec((0usize..360, 0u8..6), 0..8),
        cuts in prop::collection::vec(0usize..450, 1..4),
        cut in 0usize..3,
        with_temperature: bool,
        is_unverified: bool,
    ) {
        let settings = [RecordSettings::default(), windows(7.0), decay()][cut];
        let new = || Assembler::new(RodId("a".into()), settings, Some(FS), with_temperature);
        let came = stream(seed, &faults);
        let (mut whole, mut broken) = (new(), new());
        if is_unverified {
            whole.set_unverified(true);
            broken.set_unverified(true);
        }
        let (mut expected, mut found) = (Vec::new(), Vec::new());
        for (at, message) in came.iter().enumerate() {
            push(&mut whole, message);
            push(&mut broken, message);
            expected.extend(whole.events());
            found.extend(broken.events());
            if cuts.contains(&at) {
                broken = Assembler::resume(&broken.save().unwrap(), settings).unwrap();
            }
        }
        for (assembler, events) in [(&mut whole, &mut expected), (&mut broken, &mut found)] {
            assembler.finish(false);
            events.extend(assembler.events());
            let readings = assembler.leftover(Timestamp::MAX);
            events.push(Event::Readings { rod: RodId("a".into()), readings });
        }
        prop_assert_eq!(expected.iter().map(bits).collect::<Vec<_>>(), found.iter().map(bits).collect::<Vec<_>>());
    }
}

/// Two rods with one thermometer, each from its own sender: a stream's end is that of its rod alone.
#[test]
fn a_stream_ends_only_its_own_rods() {
    let on = |topic: &str| {
        let mut writer = RecordingWriter::new(Cursor::new(Vec::new()), WriterOptions::default()).unwrap();
        let id = writer.add_channel(spec(topic, Encoding::Json, LAYOUT)).unwrap();
        writer.write_samples(id, START, FS, &motion(6_000)).unwrap();
        sent(&writer.finish().unwrap().into_inner())
    };
    let value = field(Encoding::Json, LAYOUT);
    let rods = vec![rod("a", "/a", value), rod("b", "/b", value)];
    let folder = tempfile::tempdir().unwrap();
    let (journal, _) = start(folder.path());
    block_on(async {
        let handle = journal.handle();
        let mut a = handle.connect(Some("a")).await.unwrap();
        let mut b = handle.connect(None).await.unwrap();
        let (sent_a, sent_b) = (on("/a"), on("/b"));
        send(&mut a, &sent_a, 0, 60, 10).await.unwrap();
        send(&mut b, &sent_b, 0, 120, 10).await.unwrap();
        b.end(End::Complete).await.unwrap();
        send(&mut a, &sent_a, 60, 120, 10).await.unwrap();
        a.end(End::Complete).await.unwrap();
    });
    journal.stop();
    let (events, _) = replay(folder.path(), &rods, &RecordSettings::default());
    let records = crate::common::records(&events);
    let lengths: Vec<(&str, usize)> = records
        .iter()
        .map(|r| (r.rod.0.as_str(), r.samples.len()))
        .collect();
    assert_eq!(lengths, [("b", 6_000), ("a", 6_000)]);
    assert!(truncated(&events).iter().all(|cut| !cut));
}
