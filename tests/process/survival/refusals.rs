//! A failing disk: an error ends the daemon with 1, a full disk is waited for; nothing is lost either way.

use super::campaign::{Campaign, Material};
use super::steps::{Files, Found, SWEEPS, has_strace, injecting, prepare, run, sweep};
use std::fs;
use std::path::PathBuf;
use std::process::{Command, ExitStatus};
use std::time::Instant;

/// Calls to fail besides those that make data durable: opening files, those of SQLite among them.
const OPENS: [(Files, Found, &str); 4] = [
    (Files::Store, Found::Nothing, "openat"),
    (Files::Store, Found::Begun, "openat"),
    (Files::Journal, Found::Nothing, "openat"),
    (Files::Suspects, Found::Begun, "openat"),
];

/// Result of a failed call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Came {
    /// The daemon reported the error and ended with 1.
    Ended,
    /// It waited and continued.
    Waited,
    /// Nothing was reported: there was no such call, or its failure is harmless.
    Nothing,
}

/// Makes the `number`th such call fail.
fn refuse(files: Files, found: Found, calls: &str, error: &str, number: usize) -> Came {
    let what = format!("{error} at {files:?}, {found:?}, {calls} {number}");
    let campaign = Campaign::new(Material::short(), "");
    let mut feed = campaign.feed();
    prepare(&campaign, &mut feed, found);
    let injection = format!("error={error}:when={number}");
    let words = injecting(&campaign, files, calls, &injection);
    let (status, log) = run(&campaign, &mut feed, &words);
    let came = came_of(status, &log).unwrap_or_else(|| panic!("{what}: {status}\n{log}"));
    // The content of a failing disk is not known, so the daemon may wait only for free space.
    assert!(error == "ENOSPC" || came != Came::Waited, "{what}:\n{log}");
    campaign.finish(&mut feed);
    campaign.check(&what, found == Found::Damaged);
    came
}

/// Result of a run; `None` for a forbidden one: an end without report, or another exit code.
fn came_of(status: ExitStatus, log: &str) -> Option<Came> {
    let state = ["site.db", "journal"];
    let is_named = log
        .lines()
        .any(|line| !line.contains(" INFO ") && state.iter().any(|name| line.contains(name)));
    match status.code()? {
        1 if is_named => Some(Came::Ended),
        0 if log.contains("no room") => Some(Came::Waited),
        0 => Some(Came::Nothing),
        _ => None,
    }
}

#[test]
fn a_disk_that_fails_ends_it_and_nothing_is_lost() {
    if !has_strace() {
        return;
    }
    for (files, calls, number) in [
        (Files::Store, "pwrite64", 20),
        (Files::Journal, "write", 3),
        (Files::Journal, "fsync,fdatasync", 3),
    ] {
        let came = refuse(files, Found::Begun, calls, "EIO", number);
        assert_eq!(came, Came::Ended, "{files:?} {calls} {number}");
    }
    // SQLite does not report every failed flush: some have no effect, depending on the content of the commit.
    let came =
        [2, 3, 4, 5].map(|number| refuse(Files::Store, Found::Begun, "fsync,fdatasync", "EIO", number));
    assert!(came.contains(&Came::Ended), "{came:?}");
}

#[test]
fn a_disk_without_room_for_a_moment_is_waited_for() {
    if !has_strace() {
        return;
    }
    for (files, calls, number) in [(Files::Store, "pwrite64", 20), (Files::Journal, "write", 3)] {
        let came = refuse(files, Found::Begun, calls, "ENOSPC", number);
        assert_eq!(came, Came::Waited, "{files:?} {calls} {number}");
    }
}

/// Fails every write in turn; `SWEEP=9` for one of them only.
#[test]
#[ignore = "every write, twice: hours"]
fn every_write_may_be_refused() {
    assert!(has_strace());
    let only: Option<usize> = std::env::var("SWEEP").ok().map(|text| text.parse().unwrap());
    for (index, (files, found, calls)) in SWEEPS.into_iter().chain(OPENS).enumerate() {
        if only.is_some_and(|only| only != index) {
            continue;
        }
        for error in ["EIO", "ENOSPC"] {
            let begun = Instant::now();
            // Some that are refused cost nothing; ten in a row are the end.
            let came = sweep(
                |number| refuse(files, found, calls, error, number),
                |came: &[Came]| came.ends_with(&[Came::Nothing; 10]),
            );
            let count = |wanted: Came| came.iter().filter(|came| **came == wanted).count();
            println!(
                "{index}: {error} at {files:?}, {found:?}, {calls}: of {} steps {} ended it, {} were waited for, {:?}",
                came.len() - 10,
                count(Came::Ended),
                count(Came::Waited),
                begun.elapsed()
            );
        }
    }
}

/// A small file system, gone when it is dropped.
struct SmallDisk(PathBuf);

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

#[test]
fn a_disk_that_fills_up_and_is_freed_again_and_again_costs_nothing() {
    let campaign = Campaign::new(Material::long(), "");
    let state = campaign.path("state");
    let mount = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=32m", "tmpfs"])
        .arg(&state)
        .status();
    if !mount.is_ok_and(|status| status.success()) {
        eprintln!("skipped: no file system can be mounted here");
        return;
    }
    let _disk = SmallDisk(state.clone());
    let mut feed = campaign.feed();
    let mut daemon = campaign.start(&[]);
    daemon.wait_until("it is ready", |log| log.contains("ready"));
    for time in 1..=3 {
        // As much as there is.
        let _ = fs::write(state.join("ballast"), vec![1; 32 << 20]);
        feed.offer(f64::from(time) / 4.0);
        // Reported once a minute at most, so the later times are not reported again.
        daemon.wait_until("it waits for room", |log| log.contains("no room"));
        let before = campaign.records();
        fs::remove_file(state.join("ballast")).unwrap();
        daemon.wait_until("work goes on", |_| campaign.records() > before);
    }
    campaign.finish_with(&mut feed, daemon);
    campaign.check("full disk", false);
}
