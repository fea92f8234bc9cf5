//! Open samples between the files of the watched folder: what goes on with them, and when they end.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::common::{FS, START, motion, spec};
use crate::folder::{Run, generation, measured};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::Event;
use tirante::recording::read::Step;
use tirante::recording::read::folder::recordings;
use tirante::recording::read::recordings::Recordings;
use tirante::recording::write::{Encoding, Layout, RecordingWriter, WriterOptions};
use tirante::service::daemon::reader::{Remembered, Sources};
use tirante::service::daemon::supervision::Unwatched;
use tirante::service::telemetry::Fault;
use tirante::site::driver::Job;

/// Longer than any test.
const LONG_S: f64 = 3600.0;

fn run(folder: &Path, join_s: f64, remembered: Remembered) -> Run {
    let sources = Sources {
        folder: Some(folder.to_owned()),
        subfolders: false,
        settle_s: 600.0,
        join_s,
        journal: None,
    };
    Run::of(sources, remembered, Arc::default(), Box::new(Unwatched))
}

/// One recording of 65 s, cut into files at these seconds; windows are 10 s.
fn cut(folder: &Path, at_s: &[f64]) {
    let whole = measured(0.0, 65.0);
    let messages: Vec<mcap::Message<'_>> = mcap::MessageStream::new(&whole)
        .unwrap()
        .map(|message| message.unwrap())
        .collect();
    let start = u64::try_from(START.as_nanos()).unwrap();
    let second = |message: &mcap::Message<'_>| (message.log_time - start) as f64 * 1e-9;
    let ends = at_s.iter().copied().chain([f64::MAX]);
    let mut from = f64::MIN;
    for (number, to) in ends.enumerate() {
        let file = fs::File::create(folder.join(format!("{number}.mcap"))).unwrap();
        let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).unwrap();
        let mine = messages
            .iter()
            .filter(|message| (from..to).contains(&second(message)));
        mine.for_each(|message| writer.write(message).unwrap());
        writer.finish().unwrap();
        from = to;
    }
}

fn identities(run: &Run) -> Vec<[u8; 32]> {
    run.records.iter().map(|(_, record)| record.identity()).collect()
}

/// Records of a replay of the folder.
fn replayed(folder: &Path) -> Vec<[u8; 32]> {
    let generation = generation(10.0);
    let channels = generation.config.rods.iter().map(|rod| rod.channels.clone());
    let read = Recordings::new(
        recordings(&[folder.to_owned()]),
        channels.collect(),
        generation.config.record,
        false,
        Arc::default(),
    );
    let records = read.filter_map(|step| match step {
        Step::Event(Event::Record(record), _) => Some(record.identity()),
        _ => None,
    });
    records.collect()
}

/// Writes a file of another topic beside the others, from second 5 to 40.
fn beside(folder: &Path) {
    let mut writer = RecordingWriter::new(
        fs::File::create(folder.join("beside.mcap")).unwrap(),
        WriterOptions::default(),
    )
    .unwrap();
    let id = writer
        .add_channel(spec("/beside", Encoding::Json, Layout::Batch(50)))
        .unwrap();
    let samples = motion((35.0 * FS) as usize);
    writer
        .write_samples(id, START.plus_seconds(5.0), FS, &samples)
        .unwrap();
    writer.finish().unwrap();
}

#[test]
fn a_restart_at_any_job_gives_the_records_of_the_replay() {
    let folder = tempfile::tempdir().unwrap();
    cut(folder.path(), &[7.3, 18.1, 33.3, 50.0]);
    restarted(folder.path(), 5);
}

#[test]
fn files_side_by_side_are_done_together_over_a_restart_at_any_job() {
    let folder = tempfile::tempdir().unwrap();
    cut(folder.path(), &[7.3, 18.1, 33.3, 50.0]);
    beside(folder.path());
    let mut run = run(folder.path(), LONG_S, Remembered::default());
    let expected = [
        "record 0",
        "record 10",
        "record 20",
        "record 30",
        "0.mcap 1.mcap 2.mcap beside.mcap 3.mcap",
        "record 40",
        "record 50",
        "4.mcap",
    ];
    assert_eq!(told(&mut run), expected);
    run.reader.stop();
    restarted(folder.path(), 6);
}

/// The next job that comes within a time and says more than that there is nothing to read.
fn next(run: &Run, within: Duration) -> Option<Job> {
    let until = Instant::now() + within;
    std::iter::from_fn(|| {
        let left = until.saturating_duration_since(Instant::now());
        run.jobs.recv_timeout(left).ok()
    })
    .find(|job| !matches!(job, Job::Look(_)))
}

/// Restarts the reader after every number of jobs.
fn restarted(folder: &Path, files: usize) {
    let expected = replayed(folder);
    assert_eq!(expected.len(), 6);
    let first = run(folder, LONG_S, Remembered::default());
    let mut count = 0;
    while next(&first, Duration::from_millis(1500)).is_some() {
        count += 1;
    }
    first.reader.stop();
    for killed_after in 0..=count {
        let mut first = run(folder, LONG_S, Remembered::default());
        for _ in 0..killed_after {
            let job = next(&first, Duration::from_secs(30)).unwrap();
            first.take(job);
        }
        let (mut found, remembered) = (identities(&first), first.remembered.clone());
        first.reader.stop();
        let mut second = run(folder, LONG_S, remembered);
        second.until("the rest", |second| second.remembered.files.len() == files);
        for identity in identities(&second) {
            if !found.contains(&identity) {
                found.push(identity);
            }
        }
        assert_eq!(found, expected, "killed after job {killed_after}");
        assert_eq!(second.health.count(Fault::Recording), 0);
        second.reader.stop();
    }
}

/// Kinds of the jobs until there is none for a while.
fn told(run: &mut Run) -> Vec<String> {
    let mut told = Vec::new();
    while let Ok(job) = run.jobs.recv_timeout(Duration::from_millis(2500)) {
        told.extend(match &job {
            Job::Event { event, .. } => match event {
                Event::Record(record) => Some(format!("record {:.0}", record.start.seconds_since(START))),
                Event::Rejected { rejection, .. } => Some(rejection.code().to_owned()),
                _ => Some("other".to_owned()),
            },
            Job::Files { marks, .. } if !marks.is_empty() => {
                let names: Vec<&str> = marks.iter().map(|mark| mark.name.as_str()).collect();
                Some(names.join(" "))
            }
            Job::Files { carry, .. } => Some(format!("{} {}", carry[0].journal, carry[0].body.len())),
            Job::Reload(_) => Some("reload".to_owned()),
            _ => None,
        });
        run.take(job);
    }
    told
}

#[test]
fn what_nothing_goes_on_with_ends_by_itself_and_what_comes_later_begins_anew() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.mcap"), measured(0.0, 15.0)).unwrap();
    let mut run = run(folder.path(), 1.0, Remembered::default());
    let ended = told(&mut run);
    assert_eq!(ended, ["record 0", "a.mcap", "too-short", "folder/laser 0"]);
    assert!(run.remembered.open.is_empty());
    // Without a gap, but too late.
    fs::write(folder.path().join("b.mcap"), measured(15.0, 15.0)).unwrap();
    assert_eq!(
        told(&mut run),
        ["record 15", "b.mcap", "too-short", "folder/laser 0"]
    );
}

#[test]
fn a_copy_and_an_older_file_take_nothing_over() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, after, length| {
        fs::write(folder.path().join(name), measured(after, length)).unwrap();
    };
    write("a.mcap", 100.0, 15.0);
    let mut run = run(folder.path(), LONG_S, Remembered::default());
    assert_eq!(told(&mut run), ["record 100", "a.mcap"]);
    // The older one ends with its file, the copy replaces what it copies, and the last one goes on.
    write("older.mcap", 50.0, 15.0);
    assert_eq!(told(&mut run), ["record 50", "too-short", "older.mcap"]);
    write("copy.mcap", 100.0, 15.0);
    assert_eq!(told(&mut run), ["record 100", "copy.mcap"]);
    let kept = run.remembered.open.clone();
    assert_eq!(kept.len(), 1);
    write("b.mcap", 115.0, 15.0);
    assert_eq!(told(&mut run), ["record 110", "b.mcap"]);
    // A gap ends the record as in one file.
    write("c.mcap", 200.0, 15.0);
    assert_eq!(told(&mut run), ["record 120", "record 200", "c.mcap"]);
}

#[test]
fn another_cut_ends_what_is_open_before_it_holds() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.mcap"), measured(0.0, 15.0)).unwrap();
    let mut first = run(folder.path(), LONG_S, Remembered::default());
    assert_eq!(told(&mut first), ["record 0", "a.mcap"]);
    let remembered = first.remembered.clone();
    first.reader.reload(generation(10.0));
    assert_eq!(told(&mut first), ["reload"]);
    first.reader.reload(generation(12.0));
    assert_eq!(told(&mut first), ["too-short", "folder/laser 0", "reload"]);
    first.reader.stop();

    // What a store of before holds, and what cannot be read, is told and left out.
    let mut torn = remembered.clone();
    torn.open[0].body[0] ^= 1;
    let mut second = run(folder.path(), LONG_S, torn);
    assert_eq!(told(&mut second), ["folder/laser 0"]);
    assert!(second.remembered.open.is_empty());
    assert_eq!(second.health.count(Fault::Recording), 1);
    fs::write(folder.path().join("b.mcap"), measured(15.0, 15.0)).unwrap();
    assert_eq!(told(&mut second), ["record 15", "b.mcap"]);
}
