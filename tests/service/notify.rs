//! Notifications to systemd, by a child with a socket of the test's as NOTIFY_SOCKET.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command};
use std::time::{Duration, Instant};
use tirante::service::daemon::notify::{self, Watchdog};
use tirante::service::telemetry::{Fault, Phase, Telemetry};

const PATIENCE: Duration = Duration::from_secs(30);

struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs as the child: started by the test below, ignored otherwise.
#[test]
#[ignore = "the child of the other test"]
fn child() {
    let telemetry = Telemetry::default();
    telemetry.enter(Phase::Starting("fitting emulators"));
    let watchdog = Watchdog::start(telemetry.clone()).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    telemetry.enter(Phase::Serving);
    notify::ready("following 2 rods");
    notify::reloading();
    notify::ready("following 3 rods");
    // The work loop beats for a while, then hangs, then beats again.
    let beats = |long: Duration| {
        let begun = Instant::now();
        while begun.elapsed() < long {
            telemetry.beat.pass();
            std::thread::sleep(Duration::from_millis(10));
        }
    };
    beats(Duration::from_millis(600));
    notify::status("hangs");
    let begun = Instant::now();
    while telemetry.health.count(Fault::Stalled) == 0 {
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(telemetry.health.state().code(), "failing");
    notify::status("stalled");
    std::thread::sleep(Duration::from_millis(500));
    notify::status("wakes");
    beats(Duration::from_millis(600));
    assert!(telemetry.health.conditions().is_empty());
    telemetry.enter(Phase::Stopping);
    notify::stopping();
    drop(watchdog);
    notify::status("end");
}

#[test]
fn systemd_hears_when_the_daemon_is_ready_and_the_watchdog_only_while_the_work_loop_beats() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("notify");
    let socket = UnixDatagram::bind(&path).unwrap();
    socket.set_read_timeout(Some(PATIENCE)).unwrap();
    let child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "notify::child", "--ignored", "--nocapture"])
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "400000")
        .env_remove("WATCHDOG_PID")
        .spawn()
        .unwrap();
    let mut child = Killed(child);
    let mut told: Vec<String> = Vec::new();
    while told.last().is_none_or(|last| !last.contains("STATUS=end")) {
        let mut buffer = [0; 4096];
        let length = socket
            .recv(&mut buffer)
            .expect("the child says something in time");
        told.push(String::from_utf8(buffer[..length].to_vec()).unwrap());
    }
    assert!(child.0.wait().unwrap().success());

    let at = |wanted: &str| {
        told.iter()
            .position(|said| said.contains(wanted))
            .unwrap_or_else(|| panic!("no {wanted} in {told:?}"))
    };
    let pings = |from: &str, to: &str| {
        told[at(from)..at(to)]
            .iter()
            .filter(|said| said.contains("WATCHDOG=1"))
            .count()
    };
    assert!(told[at("EXTEND_TIMEOUT_USEC=60000000")].contains("STATUS=fitting emulators"));
    assert!(told[at("READY=1")].contains("STATUS=following 2 rods"));
    assert!(told[at("RELOADING=1")].contains("MONOTONIC_USEC="));
    assert!(at("READY=1") < at("RELOADING=1") && at("RELOADING=1") < at("following 3 rods"));
    assert!(pings("following 3 rods", "STATUS=hangs") >= 3, "{told:?}");
    assert_eq!(
        pings("STATUS=stalled", "STATUS=wakes"),
        0,
        "a hang is not covered up: {told:?}"
    );
    assert!(pings("STATUS=wakes", "STOPPING=1") >= 3, "{told:?}");
}
