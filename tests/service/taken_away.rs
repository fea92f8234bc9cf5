//! What a running daemon listens at and reads from is taken away, or gives nothing: it says so, and goes on when it is back.

use crate::fault_kinds::{Daemon, SmallDisk, daemon_site, told};
use crate::site::*;
use std::fs;
use std::os::unix::net::UnixStream;
use std::process::Command;
use tirante::site::store::Reader;

#[test]
fn the_removed_file_of_a_unix_socket_is_made_anew() {
    let site = daemon_site();
    let mut daemon = Daemon::ready(&site);
    let words = "{\"topic\":\"/north\",\"time\":1767268800000000000,\"values\":[1e-5]}\n{\"end\":true}\n";
    let socket = site.path("socket");
    fs::remove_file(&socket).unwrap();
    // The file is there a moment before it listens.
    daemon.wait("it listens again", |_| UnixStream::connect(&socket).is_ok());
    assert!(told(&site, words).contains("done"));
    daemon.expect("refused", 1.0, "degraded");
    // Another file of that name stays, and is told until it goes.
    fs::remove_file(&socket).unwrap();
    fs::write(&socket, "another").unwrap();
    daemon.wait("it is told", |daemon| daemon.conditions("refused") == 1);
    fs::remove_file(&socket).unwrap();
    daemon.wait("it is over", |daemon| daemon.conditions("refused") == 0);
    assert!(told(&site, words).contains("done"));
}

#[test]
fn a_watched_folder_that_is_not_mounted_any_more_is_missed() {
    let site = daemon_site();
    fs::remove_dir(site.path("archive")).unwrap();
    let Some(disk) = SmallDisk::mount(site.path("archive")) else {
        eprintln!("skipped: no file system can be mounted here");
        return;
    };
    let mut daemon = Daemon::ready(&site);
    let is_read = |name: &str| {
        let files = Reader::open(&site.path("site.db")).unwrap().files().unwrap();
        files.keys().any(|read| read.ends_with(name))
    };
    site.simulate("early", &Part::new(0, 1));
    daemon.wait("the folder is read", |_| is_read("early.mcap"));
    assert_eq!(daemon.conditions("folder"), 0);
    drop(disk);
    daemon.wait("it is missed", |daemon| daemon.conditions("folder") == 1);
    fs::remove_dir(site.path("archive")).unwrap();
    let _disk = SmallDisk::mount(site.path("archive"));
    daemon.wait("it is back", |daemon| daemon.conditions("folder") == 0);
    site.simulate("late", &Part::new(1, 1));
    daemon.wait("it is read again", |_| is_read("late.mcap"));
}

/// In the watched folder and from a socket; the other rod, and the right field, are no condition.
#[test]
fn a_mistyped_field_is_told_with_the_first_messages() {
    for is_sent in [false, true] {
        let site = daemon_site();
        for (day, name) in ["first", "second"].into_iter().enumerate() {
            site.simulate(name, &Part::new(day as i64, 1));
            let simulated = site.path(&format!("archive/{name}.mcap"));
            fs::rename(simulated, site.path(&format!("{name}.mcap"))).unwrap();
        }
        let path = site.path("site.toml");
        let right = fs::read_to_string(&path).unwrap();
        fs::write(
            &path,
            right.replacen("field = \"values\"", "field = \"valuez\"", 1),
        )
        .unwrap();
        let mut daemon = Daemon::ready(&site);
        let bring = |name: &str| {
            let recording = site.path(&format!("{name}.mcap"));
            if is_sent {
                let mut send = Command::new(env!("CARGO_BIN_EXE_tirante"));
                send.args(["send", "--speed", "max", "--sender", name, "--to"]);
                send.arg(format!("unix://{}", site.path("socket").display()));
                let output = send.arg(&recording).output().unwrap();
                assert!(matches!(output.status.code(), Some(0 | 3)), "{output:?}");
            } else {
                fs::copy(&recording, site.path(&format!("archive/{name}.mcap"))).unwrap();
            }
        };
        bring("first");
        daemon.wait("it is told", |daemon| daemon.conditions("topic") == 1);
        let health = daemon.health().to_string();
        assert!(health.contains("/north") && health.contains("valuez"), "{health}");
        fs::write(&path, right).unwrap();
        daemon.signal("-HUP");
        daemon.wait("the field is right", |daemon| daemon.log().contains(" holds"));
        bring("second");
        daemon.wait("it is over", |daemon| daemon.conditions("topic") == 0);
    }
}
