//! Killed by `strace` when it is about to take a durable step, one after another.

use super::campaign::{Campaign, Material};
use super::process::DEADLINE;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, ExitStatus};
use std::thread;
use std::time::{Duration, Instant};

/// The system calls that make something durable, or are on the way.
const CALLS: [&str; 7] = [
    "write",
    "pwrite64",
    "fdatasync",
    "fsync",
    "ftruncate",
    "unlink",
    "rename",
];

pub fn has_strace() -> bool {
    let has = Command::new("strace").arg("-V").output().is_ok();
    if !has {
        eprintln!("skipped: no strace");
    }
    has
}

/// `strace` with an injection into calls on the files that last.
pub fn injecting(campaign: &Campaign, calls: &str, injection: &str) -> Vec<String> {
    let mut words: Vec<String> = ["strace", "-f", "-qq", "-o", "/dev/null"]
        .map(str::to_owned)
        .into();
    for name in [
        "site.db",
        "site.db-wal",
        "site.db-shm",
        "site.db.suspects",
        "journal",
        "journal/journal.000001.mcap",
        "journal/journal.000002.mcap",
        "",
    ] {
        words.push("-P".to_owned());
        let path = campaign.path("state").join(name);
        words.push(path.to_str().unwrap().trim_end_matches('/').to_owned());
    }
    words.extend(["-e".to_owned(), format!("trace={calls}")]);
    words.extend(["-e".to_owned(), format!("inject={calls}:{injection}")]);
    words
}

/// A daemon under `strace` that is fed everything, until it ends or all is in and it is told to stop.
pub fn run(campaign: &Campaign, feed: &mut super::feed::Feed, words: &[String]) -> (ExitStatus, String) {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let mut daemon = campaign.start(&words);
    feed.offer(1.0);
    let until = Instant::now() + DEADLINE;
    let all = campaign.material.days * super::campaign::RODS.len();
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

/// Kills at the `number`th such call; whether there was one.
fn kill_at(call: &str, number: usize) -> bool {
    let campaign = Campaign::new(Material::short(), "");
    let mut feed = campaign.feed();
    let words = injecting(&campaign, call, &format!("signal=KILL:when={number}"));
    let (status, log) = run(&campaign, &mut feed, &words);
    let was_killed = status.signal() == Some(9) || status.code() == Some(137);
    assert!(
        was_killed || status.code() == Some(0),
        "{call} {number}: {status}\n{log}"
    );
    campaign.finish(&mut feed);
    campaign.check(&format!("killed at {call} {number}"));
    was_killed
}

#[test]
#[ignore = "compiles, but has not been run to its end yet: run it with --ignored"]
fn killed_at_some_durable_steps_it_loses_nothing() {
    if !has_strace() {
        return;
    }
    let mut count = 0;
    for (call, numbers) in [
        ("write", &[1, 2, 4][..]),
        ("pwrite64", &[1, 9, 40][..]),
        ("fdatasync", &[1, 2, 5][..]),
        ("fsync", &[1, 2][..]),
        ("ftruncate", &[1][..]),
        ("unlink", &[1][..]),
    ] {
        count += numbers.iter().filter(|number| kill_at(call, **number)).count();
    }
    assert!(count >= 8, "only {count} were killed");
}

#[test]
#[ignore = "every step: minutes"]
fn killed_at_every_durable_step_it_loses_nothing() {
    assert!(has_strace());
    for call in CALLS {
        let mut number = 1;
        while kill_at(call, number) {
            number += 1;
        }
        println!("{call}: {} steps", number - 1);
    }
}
