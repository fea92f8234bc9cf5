//! A disk that refuses: an error ends the daemon with 1, no room is waited for; nothing is lost either way.

use super::campaign::{Campaign, Material};
use super::steps::{has_strace, injecting, run};
use std::fs;
use std::path::PathBuf;
use std::process::Command;

/// Refuses the `number`th call (and `more` after it); whether there was one, by the daemon's log or end.
fn refuse(calls: &str, error: &str, number: usize, more: usize) -> bool {
    let campaign = Campaign::new(Material::short(), "");
    let mut feed = campaign.feed();
    let words = injecting(
        &campaign,
        calls,
        &format!("error={error}:when={number}..{}", number + more),
    );
    let (status, log) = run(&campaign, &mut feed, &words);
    let what = format!("{error} at {calls} {number}");
    // What fails is told, whatever comes of it.
    let is_told = log.contains("no room") || log.contains("cannot be written") || log.contains("site.db");
    match status.code() {
        Some(1) => assert!(is_told, "{what}: {log}"),
        Some(0) => assert!(error == "ENOSPC" || !is_told, "{what}: {log}"),
        _ => panic!("{what}: {status}\n{log}"),
    }
    campaign.finish(&mut feed);
    campaign.check(&what);
    println!("{what}: {status}");
    status.code() == Some(1) || is_told
}

#[test]
#[ignore = "compiles, but has not been run to its end yet: run it with --ignored"]
fn a_disk_that_fails_ends_it_and_nothing_is_lost() {
    if !has_strace() {
        return;
    }
    let some = [
        ("write", 1),
        ("write", 3),
        ("pwrite64", 4),
        ("pwrite64", 30),
        ("fsync,fdatasync", 1),
        ("fsync,fdatasync", 4),
    ];
    let count = some
        .iter()
        .filter(|(calls, number)| refuse(calls, "EIO", *number, 0))
        .count();
    assert!(count >= 4, "only {count} were refused");
}

#[test]
#[ignore = "compiles, but has not been run to its end yet: run it with --ignored"]
fn a_disk_without_room_for_a_moment_is_waited_for() {
    if !has_strace() {
        return;
    }
    let some = [("write", 2), ("pwrite64", 4), ("pwrite64", 30)];
    let count = some
        .iter()
        .filter(|(calls, number)| refuse(calls, "ENOSPC", *number, 1))
        .count();
    assert!(count >= 2, "only {count} were refused");
}

#[test]
#[ignore = "every write: minutes"]
fn every_write_may_be_refused() {
    assert!(has_strace());
    for error in ["EIO", "ENOSPC"] {
        for calls in ["write", "pwrite64", "fsync,fdatasync", "ftruncate"] {
            let mut number = 1;
            // Some that are refused are tried again in silence; a few in a row are the end.
            let mut in_vain = 0;
            while in_vain < 3 {
                in_vain = if refuse(calls, error, number, 0) {
                    0
                } else {
                    in_vain + 1
                };
                number += 1;
            }
            println!("{error} at {calls}: {} steps", number - 1);
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
#[ignore = "compiles, but has not been run to its end yet: run it with --ignored"]
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
        // Told once a minute at most, so the later times are not told again.
        daemon.wait_until("it waits for room", |log| log.contains("no room"));
        let before = campaign.records();
        fs::remove_file(state.join("ballast")).unwrap();
        daemon.wait_until("work goes on", |_| campaign.records() > before);
    }
    campaign.finish_with(&mut feed, daemon);
    campaign.check("full disk");
}
