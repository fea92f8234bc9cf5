//! Killed by `strace` when it is about to take a durable step, one after another.

use super::campaign::{Campaign, Material, RODS};
use super::feed::Feed;
use super::process::DEADLINE;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

/// Durable files, by their writer.
///
/// `strace` counts the calls of every thread by itself, and the thread that comes first to a number is hit. So each group is swept
/// alone: the journal's few calls would never be the first among the store's many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Files {
    /// Written by the thread that opens the store, then by the core.
    Store,
    /// Written by the journal's thread.
    Journal,
    /// Written by workers and reader, and by the thread that starts them.
    Suspects,
    /// All of them. `strace` knows a renamed file by its old name only, and that has the number of the process.
    Every,
}

impl Files {
    fn names(self) -> &'static [&'static str] {
        match self {
            Self::Store => &[
                "",
                "site.db",
                "site.db-wal",
                "site.db-shm",
                "site.db-journal",
                "site.db.lock",
                "site.db.new",
                "site.db.new-wal",
                "site.db.new-shm",
                "site.db.new-journal",
            ],
            Self::Journal => &[
                "journal",
                "journal/.lock",
                "journal/journal.000001.mcap",
                "journal/journal.000002.mcap",
                "journal/journal.000003.mcap",
            ],
            Self::Suspects => &["site.db.working", "site.db.suspects"],
            Self::Every => &[],
        }
    }
}

/// State that the daemon finds when it is started with an injection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// Nothing yet.
    Nothing,
    /// An empty store and an empty journal.
    Begun,
    /// Files left by a daemon that was killed amid a step.
    Marks,
    /// The same, with the step marked as a suspect.
    Suspect,
    /// A finished store overwritten with zeros.
    Damaged,
}

/// Calls that make data durable, or lead to it, with their files.
pub const SWEEPS: [(Files, Found, &str); 15] = [
    (Files::Store, Found::Nothing, "write"),
    (Files::Store, Found::Nothing, "pwrite64"),
    (Files::Store, Found::Nothing, "fsync,fdatasync"),
    (Files::Store, Found::Nothing, "ftruncate,unlink,unlinkat"),
    (Files::Every, Found::Nothing, "rename,renameat,renameat2"),
    (Files::Store, Found::Begun, "pwrite64"),
    (Files::Store, Found::Begun, "fsync,fdatasync"),
    (Files::Store, Found::Begun, "ftruncate,unlink,unlinkat"),
    (Files::Every, Found::Damaged, "rename,renameat,renameat2"),
    (Files::Journal, Found::Nothing, "write"),
    (Files::Journal, Found::Begun, "write"),
    (Files::Journal, Found::Begun, "fsync,fdatasync"),
    (Files::Suspects, Found::Nothing, "pwrite64"),
    (Files::Every, Found::Marks, "rename,renameat,renameat2"),
    (Files::Every, Found::Suspect, "rename,renameat,renameat2"),
];

pub fn has_strace() -> bool {
    let has = Command::new("strace").arg("-V").output().is_ok();
    assert!(
        has || std::env::var_os("TIRANTE_REAL_PEERS").is_none(),
        "no strace"
    );
    if !has {
        eprintln!("skipped: no strace");
    }
    has
}

/// `strace` with an injection into calls on these files.
pub fn injecting(campaign: &Campaign, files: Files, calls: &str, injection: &str) -> Vec<String> {
    let mut words: Vec<String> = ["strace", "-f", "-qq", "-o", "/dev/null"]
        .map(str::to_owned)
        .into();
    for name in files.names() {
        words.push("-P".to_owned());
        let path = campaign.path("state").join(name);
        words.push(path.to_str().unwrap().trim_end_matches('/').to_owned());
    }
    words.extend(["-e".to_owned(), format!("trace={calls}")]);
    words.extend(["-e".to_owned(), format!("inject={calls}:{injection}")]);
    words
}

/// Prepares the state that the daemon is to find.
pub fn prepare(campaign: &Campaign, feed: &mut Feed, found: Found) {
    match found {
        Found::Nothing => {}
        Found::Begun => {
            let mut daemon = campaign.start(&[]);
            daemon.wait_until("it is ready", |log| log.contains("ready"));
            daemon.stop("-TERM");
        }
        Found::Marks | Found::Suspect => {
            // Killed when it would wipe out the mark of the second step of a thread.
            let words = injecting(campaign, Files::Suspects, "pwrite64", "signal=KILL:when=4");
            assert!(is_killed(run(campaign, feed, &words).0));
            let working = campaign.path("state/site.db.working");
            let marks = String::from_utf8(fs::read(&working).unwrap()).unwrap();
            let mut steps = marks.split('\0').filter_map(|mark| mark.split_once('\t'));
            let (_, step) = steps.find(|(kind, _)| *kind != "boot").unwrap();
            if found == Found::Suspect {
                let suspects = serde_json::json!({ step: 0 }).to_string();
                fs::write(campaign.path("state/site.db.suspects"), suspects).unwrap();
                fs::write(working, "").unwrap();
            }
        }
        Found::Damaged => {
            campaign.finish(feed);
            let path = campaign.path("state/site.db");
            let length = usize::try_from(fs::metadata(&path).unwrap().len()).unwrap();
            fs::write(path, vec![0; length]).unwrap();
        }
    }
}

/// Runs a daemon under `strace` with all data, until it ends or all is stored and it is stopped.
pub fn run(campaign: &Campaign, feed: &mut Feed, words: &[String]) -> (ExitStatus, String) {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let mut daemon = campaign.start(&words);
    feed.offer(1.0);
    let until = Instant::now() + DEADLINE;
    let all = campaign.material.days * RODS.len();
    while daemon.is_running() {
        if feed.is_done() && campaign.records() >= all {
            daemon.signal("-TERM");
            break;
        }
        assert!(
            Instant::now() < until,
            "neither ends nor comes through:\n{}",
            daemon.log()
        );
        thread::sleep(Duration::from_millis(20));
    }
    (daemon.wait(), daemon.log())
}

pub fn is_killed(status: ExitStatus) -> bool {
    status.signal() == Some(9) || status.code() == Some(137)
}

/// Kills at the `number`th such call; returns true if there was one.
fn kill_at(files: Files, found: Found, calls: &str, number: usize) -> bool {
    let what = format!("killed at {files:?}, {found:?}, {calls} {number}");
    let campaign = Campaign::new(Material::short(), "");
    let mut feed = campaign.feed();
    prepare(&campaign, &mut feed, found);
    let words = injecting(&campaign, files, calls, &format!("signal=KILL:when={number}"));
    let (status, log) = run(&campaign, &mut feed, &words);
    let was_killed = is_killed(status);
    assert!(was_killed || status.code() == Some(0), "{what}: {status}\n{log}");
    campaign.finish(&mut feed);
    campaign.check(&what, found == Found::Damaged);
    was_killed
}

#[test]
fn killed_at_some_durable_steps_it_loses_nothing() {
    if !has_strace() {
        return;
    }
    for (files, found, calls, number) in [
        (Files::Every, Found::Nothing, "rename,renameat,renameat2", 1),
        (Files::Store, Found::Begun, "pwrite64", 30),
        (Files::Store, Found::Begun, "fsync,fdatasync", 3),
        (Files::Journal, Found::Begun, "write", 3),
        (Files::Every, Found::Suspect, "rename,renameat,renameat2", 1),
    ] {
        assert!(kill_at(files, found, calls, number), "{files:?} {calls} {number}");
    }
}

/// Does something at every call from the first on, four side by side (`SIDE_BY_SIDE`), until the results say that it is over; with
/// `EVERY=7` at every seventh only.
pub fn sweep<T: Send>(at: impl Fn(usize) -> T + Sync, is_over: impl Fn(&[T]) -> bool) -> Vec<T> {
    let number_of = |name: &str, default: usize| std::env::var(name).map_or(default, |n| n.parse().unwrap());
    let (beside, every) = (number_of("SIDE_BY_SIDE", 4), number_of("EVERY", 1));
    let mut results = Vec::new();
    while !is_over(&results) {
        let first = results.len();
        let at = &at;
        thread::scope(|scope| {
            let taken: Vec<_> = (first..first + beside)
                .map(|index| scope.spawn(move || at(1 + index * every)))
                .collect();
            results.extend(taken.into_iter().map(|one| one.join().unwrap()));
        });
    }
    results
}

/// Kills at every durable step in turn; `SWEEP=9` for one of them only.
#[test]
#[ignore = "every step: half an hour"]
fn killed_at_every_durable_step_it_loses_nothing() {
    assert!(has_strace());
    let only: Option<usize> = std::env::var("SWEEP").ok().map(|text| text.parse().unwrap());
    for (index, (files, found, calls)) in SWEEPS.into_iter().enumerate() {
        if only.is_some_and(|only| only != index) {
            continue;
        }
        let begun = Instant::now();
        let killed = sweep(
            |number| kill_at(files, found, calls, number),
            |killed: &[bool]| killed.last() == Some(&false),
        );
        let steps = killed.iter().filter(|was_killed| **was_killed).count();
        let took = begun.elapsed();
        println!("{index}: {files:?}, {found:?}, {calls}: killed at each of {steps} steps, {took:?}");
        assert!(steps > 0, "there is no such step");
    }
}
