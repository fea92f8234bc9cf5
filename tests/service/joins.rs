//! Open samples between the files of the watched folder: what goes on with them, and when they end.
#![allow(clippy::unwrap_used, reason = "tests")]

use crate::common::{FS, START, motion, spec};
use crate::folder::{Run, generation, measured};
use std::fs;
use std::io::Write;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tirante::analysis::signal::record::{Event, Record};
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
    settling(folder, 600.0, join_s, remembered)
}

fn settling(folder: &Path, settle_s: f64, join_s: f64, remembered: Remembered) -> Run {
    let sources = Sources {
        folder: Some(folder.to_owned()),
        subfolders: false,
        settle_s,
        join_s,
        journal: None,
    };
    Run::of(sources, remembered, Arc::default(), Box::new(Unwatched))
}

/// One recording of 65 s, cut into files at these seconds; windows are 10 s.
fn cut(folder: &Path, at_s: &[f64]) {
    cut_of(65.0, folder, at_s);
}

/// One recording of so many seconds, cut into files of small chunks.
fn cut_of(seconds: f64, folder: &Path, at_s: &[f64]) {
    let whole = measured(0.0, seconds);
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
        let options = mcap::WriteOptions::new().chunk_size(Some(4000));
        // Chunks that can be read while the file grows.
        let options = options.disable_seeking(true);
        let mut writer = options.create(mcap::write::NoSeek::new(file)).unwrap();
        let mine = messages
            .iter()
            .filter(|message| (from..to).contains(&second(message)));
        mine.for_each(|message| writer.write(message).unwrap());
        writer.finish().unwrap();
        from = to;
    }
}

/// Beginning in seconds, and hash.
fn identity(record: &Record) -> String {
    let [a, b, c, ..] = record.identity();
    format!("{:.3} {a:02x}{b:02x}{c:02x}", record.start.seconds_since(START))
}

fn identities(run: &Run) -> Vec<String> {
    run.records.iter().map(|(_, record)| identity(record)).collect()
}

/// Records of a replay of the folder.
fn replayed(folder: &Path) -> Vec<String> {
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
        Step::Event(Event::Record(record), _) => Some(identity(&record)),
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
fn a_part_of_a_file_does_not_hide_what_the_file_left_open() {
    // A piece, all samples, and all of it.
    for share in [0.6, 0.9, 1.0] {
        for name in ["0-part.mcap", "0b.mcap"] {
            let folder = tempfile::tempdir().unwrap();
            let at = |name: &str| folder.path().join(name);
            cut(folder.path(), &[17.3]);
            let expected = replayed(folder.path());
            fs::rename(at("1.mcap"), at("1.later")).unwrap();
            let mut first = run(folder.path(), LONG_S, Remembered::default());
            assert_eq!(told(&mut first), ["record 0", "0.mcap"]);
            let (mut found, remembered) = (identities(&first), first.remembered.clone());
            first.reader.stop();

            // Another rod's file keeps the next one and the copy together.
            beside(folder.path());
            fs::rename(at("1.later"), at("1.mcap")).unwrap();
            fs::copy(at("0.mcap"), at(name)).unwrap();
            shorten(&at(name), share);
            let new = |found: &[String], records: Vec<String>| -> Vec<String> {
                let is_new = |record: &String| !found.contains(record);
                records.into_iter().filter(is_new).collect()
            };
            let mut second = settling(folder.path(), 0.0, LONG_S, remembered);
            second.until("all", |run| run.remembered.files.len() == 4);
            found.extend(new(&found, identities(&second)));
            assert_eq!(found, expected, "{share} of the first as {name}");
            let mut all = replayed(folder.path());
            all.dedup();
            assert_eq!(all, expected, "{share} of the first as {name}, replayed");
        }
    }
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

/// Rows of open samples that are kept, without the times of files.
fn kept(run: &Run) -> Vec<String> {
    let named = |row: &str| {
        let words = row.split('/').filter(|word| word.parse::<u64>().is_err());
        words.collect::<Vec<_>>().join("/")
    };
    let open = &run.remembered.open;
    open.iter().map(|carry| named(&carry.journal)).collect()
}

/// Leaves a part of a file in the folder; returns the whole.
fn shorten(path: &Path, part: f64) -> Vec<u8> {
    let whole = fs::read(path).unwrap();
    fs::write(path, &whole[..(whole.len() as f64 * part) as usize]).unwrap();
    whole
}

/// Adds what a file lacks.
fn grow(path: &Path, whole: &[u8]) {
    let mut file = fs::OpenOptions::new().append(true).open(path).unwrap();
    let length = file.metadata().unwrap().len() as usize;
    file.write_all(&whole[length..]).unwrap();
}

/// A run up to the rest of the second file, which is cut short, and its path.
fn rested(folder: &Path) -> (Run, PathBuf) {
    cut(folder, &[17.3]);
    let path = folder.join("1.mcap");
    shorten(&path, 0.6);
    let mut run = settling(folder, 1.5, LONG_S, Remembered::default());
    run.until("its rest", |run| run.done("1.mcap"));
    (run, path)
}

#[test]
fn a_file_that_rested_and_grows_on_begins_again_with_what_it_had_gone_on_with() {
    for is_restarted in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("1.mcap");
        cut(folder.path(), &[17.3]);
        let expected = replayed(folder.path());
        assert_eq!(expected.len(), 6);
        let whole = shorten(&path, 0.6);
        let mut run = settling(folder.path(), 1.5, LONG_S, Remembered::default());
        run.until("its rest", |run| run.done("1.mcap"));
        assert_eq!(kept(&run), ["begun/laser/1.mcap"]);
        let mut found = identities(&run);
        assert!(found.len() > 2 && expected.starts_with(&found));
        if is_restarted {
            let remembered = run.remembered.clone();
            run.reader.stop();
            run = settling(folder.path(), 1.5, LONG_S, remembered);
        }
        fs::write(&path, &whole).unwrap();
        let size = whole.len() as u64;
        run.until("its end", |run| run.remembered.files["1.mcap"].size == size);
        for identity in identities(&run) {
            if !found.contains(&identity) {
                found.push(identity);
            }
        }
        assert_eq!(found, expected);
        assert_eq!(kept(&run), ["folder/laser"]);
    }
}

#[test]
fn what_a_file_that_is_gone_began_with_is_forgotten() {
    let folder = tempfile::tempdir().unwrap();
    let (mut run, path) = rested(folder.path());
    fs::remove_file(&path).unwrap();
    run.until("no row", |run| run.remembered.open.is_empty());
}

#[test]
fn another_file_of_the_name_begins_afresh() {
    let folder = tempfile::tempdir().unwrap();
    let (first, path) = rested(folder.path());
    let remembered = first.remembered.clone();
    assert_eq!(kept(&first), ["begun/laser/1.mcap"]);
    first.reader.stop();
    fs::write(&path, measured(100.0, 30.0)).unwrap();
    let mut second = run(folder.path(), LONG_S, remembered);
    assert_eq!(told(&mut second), ["record 100", "record 110", "1.mcap"]);
    assert_eq!(kept(&second), ["folder/laser"]);
}

#[test]
fn a_file_that_was_read_beside_others_and_grows_on_begins_as_it_did() {
    let folder = tempfile::tempdir().unwrap();
    cut(folder.path(), &[17.3]);
    beside(folder.path());
    let expected = replayed(folder.path());
    let path = folder.path().join("1.mcap");
    let whole = shorten(&path, 0.6);
    // What was not written to for long is not taken to grow.
    let mut run = settling(folder.path(), 0.0, LONG_S, Remembered::default());
    run.until("all files", |run| run.remembered.files.len() == 3);
    let mut found = identities(&run);
    assert!(found.len() > 2 && expected.starts_with(&found));
    assert_eq!(kept(&run), ["folder/laser", "begun/laser/1.mcap"]);
    fs::write(&path, &whole).unwrap();
    let size = whole.len() as u64;
    run.until("its end", |run| run.remembered.files["1.mcap"].size == size);
    found.extend(identities(&run));
    found.sort();
    found.dedup();
    assert_eq!(found, expected);
}

#[test]
fn a_younger_growing_file_waits_for_an_elder_one_that_is_read_when_it_is_finished() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    cut_of(65.0, folder.path(), &[33.3]);
    let expected = replayed(folder.path());
    // A writer that goes back: the length of the latest chunk is not there yet.
    let elder = fs::read(at("0.mcap")).unwrap();
    let chunks = |bytes: &[u8]| {
        let mut at = 8;
        let mut chunks = Vec::new();
        while bytes[at] != mcap::records::op::DATA_END {
            if bytes[at] == mcap::records::op::CHUNK {
                chunks.push(at);
            }
            at += 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        }
        chunks
    };
    let latest = *chunks(&elder).last().unwrap();
    let mut begun = elder[..latest + 200].to_vec();
    begun[latest + 1..latest + 9].fill(0xff);
    fs::write(at("0.mcap"), &begun).unwrap();
    let younger = fs::read(at("1.mcap")).unwrap();
    fs::remove_file(at("1.mcap")).unwrap();
    let mut run = run(folder.path(), LONG_S, Remembered::default());
    run.until("the elder's first records", |run| run.records.len() >= 2);
    run.until_quiet();
    // Both within one look into the folder, most likely; in any order the records are the same.
    fs::write(at("1.mcap"), &younger[..younger.len() / 2]).unwrap();
    grow(&at("0.mcap"), &elder);
    let patched = fs::OpenOptions::new().write(true).open(at("0.mcap")).unwrap();
    patched
        .write_all_at(&elder[latest..latest + 9], latest as u64)
        .unwrap();
    run.until("the elder", |run| run.done("0.mcap"));
    grow(&at("1.mcap"), &younger);
    run.until("the younger", |run| run.done("1.mcap"));
    let mut found = identities(&run);
    found.sort();
    found.dedup();
    assert_eq!(found, expected);
}

#[test]
fn a_growing_file_waits_for_a_finished_one_that_began_before_it() {
    let away = tempfile::tempdir().unwrap();
    cut_of(205.0, away.path(), &[133.3]);
    let expected = replayed(away.path());
    let younger = fs::read(away.path().join("1.mcap")).unwrap();
    shorten(&away.path().join("1.mcap"), 0.5);
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut run = run(folder.path(), LONG_S, Remembered::default());
    run.until_quiet();
    // Most likely both are found in one look into the folder, as after it was away.
    for name in ["1.mcap", "0.mcap"] {
        fs::rename(away.path().join(name), at(name)).unwrap();
    }
    run.until("the elder", |run| run.done("0.mcap"));
    grow(&at("1.mcap"), &younger);
    run.until("both", |run| run.done("1.mcap"));
    assert_eq!(identities(&run), expected);
}

#[test]
fn a_younger_growing_file_waits_for_what_an_elder_one_has_not_told_yet() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    // The elder has the later name.
    cut_of(205.0, folder.path(), &[133.3]);
    fs::rename(at("1.mcap"), at("a.mcap")).unwrap();
    fs::rename(at("0.mcap"), at("b.mcap")).unwrap();
    let expected = replayed(folder.path());
    assert_eq!(expected.len(), 20);
    let (elder, younger) = (shorten(&at("b.mcap"), 0.95), fs::read(at("a.mcap")).unwrap());
    fs::remove_file(at("a.mcap")).unwrap();
    let mut run = run(folder.path(), LONG_S, Remembered::default());
    // Nobody takes the jobs: reading stands still within the elder, and goes on with a look into the folder.
    std::thread::sleep(Duration::from_millis(1500));
    grow(&at("b.mcap"), &elder);
    fs::write(at("a.mcap"), &younger[..younger.len() / 2]).unwrap();
    run.until("records of both", |run| run.records.len() > 14);
    grow(&at("a.mcap"), &younger);
    run.until("both", |run| run.done("a.mcap") && run.done("b.mcap"));
    assert_eq!(identities(&run), expected);
}

#[test]
fn files_that_are_cut_short_give_the_records_of_the_replay_growing_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    cut(folder.path(), &[17.3, 42.0]);
    beside(folder.path());
    // The elder has the later name.
    fs::rename(at("2.mcap"), at("a.mcap")).unwrap();
    fs::rename(at("1.mcap"), at("b.mcap")).unwrap();
    shorten(&at("b.mcap"), 0.7);
    let finished = replayed(folder.path());
    let starts: Vec<&str> = finished
        .iter()
        .filter_map(|record| record.split(' ').next())
        .collect();
    assert_eq!(starts, ["0.000", "10.000", "20.000", "42.000", "52.000"]);
    // What was not written to for long is not taken to grow.
    let mut whole = settling(folder.path(), 0.0, LONG_S, Remembered::default());
    whole.until("all files", |run| run.remembered.files.len() == 4);
    assert_eq!(identities(&whole), finished);

    shorten(&at("a.mcap"), 0.7);
    let expected = replayed(folder.path());
    let away = tempfile::tempdir().unwrap();
    for name in ["a.mcap", "b.mcap"] {
        fs::rename(at(name), away.path().join(name)).unwrap();
    }
    let mut first = run(folder.path(), LONG_S, Remembered::default());
    first.until("the first files", |run| run.remembered.files.len() == 2);
    let (mut found, remembered) = (identities(&first), first.remembered.clone());
    first.reader.stop();
    // The recorder ended within one and began another, and the daemon starts anew.
    for name in ["a.mcap", "b.mcap"] {
        fs::copy(away.path().join(name), at(name)).unwrap();
    }
    let mut second = run(folder.path(), LONG_S, remembered);
    second.until_quiet();
    found.extend(identities(&second));
    assert_eq!(found, expected);
}
