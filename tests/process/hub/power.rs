//! Loss of power at the post: a layer below the server forgets what it did not flush (`power.py`, over FUSE).
//!
//! `cargo test --test process hub::power -- --ignored --nocapture`; needs root, `/dev/fuse` and Debian's `python3-fusepy`.

use super::fleet::{Fleet, Storage};
use super::servers::{DEADLINE, Nats, signal};
use rand::RngExt;
use std::cell::RefCell;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};
use tirante::analysis::numerics::random;

/// Losses of power; `LOSSES=100` has more.
const LOSSES: u32 = 24;
/// Messages that the server acknowledges before the power goes.
const MESSAGES: u64 = 50;

/// A disk that forgets, mounted where a server of a folder keeps its streams.
struct Disk {
    layer: Child,
    mount: PathBuf,
    said: PathBuf,
}

impl Disk {
    /// Mounts it for a server that is not begun yet.
    fn under(folder: &Path) -> Self {
        let (mount, backing, said) = (
            folder.join("jetstream"),
            folder.join("flushed"),
            folder.join("said"),
        );
        for path in [&mount, &backing] {
            fs::create_dir_all(path).unwrap();
        }
        let is_mounted = || {
            fs::read_to_string("/proc/mounts")
                .unwrap()
                .contains(&*mount.to_string_lossy())
        };
        let mut layer = Command::new("/usr/bin/python3")
            .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/process/hub/power.py"))
            .args([&backing, &mount])
            .stdin(Stdio::null())
            .stdout(fs::File::create(&said).unwrap())
            .spawn()
            .unwrap();
        let until = Instant::now() + DEADLINE;
        while !is_mounted() {
            let ended = layer.try_wait().unwrap();
            assert!(
                ended.is_none(),
                "FUSE cannot be used here: {ended:?}; needs root and python3-fusepy"
            );
            assert!(Instant::now() < until);
            thread::sleep(Duration::from_millis(20));
        }
        Self { layer, mount, said }
    }

    fn signal(&self, name: &str) {
        signal(&self.layer, name);
    }

    fn losses(&self) -> Vec<u64> {
        let said = fs::read_to_string(&self.said).unwrap();
        let bytes = |line: &str| line.split(' ').nth(1).unwrap().parse().unwrap();
        said.lines().map(bytes).collect()
    }

    /// Loses the power at one of the next operations: `kill` signals the servers, and `end` waits for their end. Returns the bytes forgotten.
    fn lose(disks: &[&Self], kill: impl FnOnce(), end: impl FnOnce()) -> Vec<u64> {
        let counts: Vec<usize> = disks.iter().map(|disk| disk.losses().len()).collect();
        disks.iter().for_each(|disk| disk.signal("-USR1"));
        let is_lost = |place: usize| disks[place].losses().len() > counts[place];
        thread::scope(|scope| {
            for (place, disk) in disks.iter().enumerate() {
                // A server at rest asks for nothing. Whoever asks in the moment of the loss is answered when the servers are killed.
                scope.spawn(move || {
                    while !is_lost(place) {
                        let _ = fs::metadata(disk.mount.join("any"));
                        thread::sleep(Duration::from_millis(2));
                    }
                });
            }
            let until = Instant::now() + DEADLINE;
            while !(0..disks.len()).all(is_lost) {
                assert!(Instant::now() < until);
                thread::sleep(Duration::from_millis(1));
            }
            kill();
            disks.iter().for_each(|disk| disk.signal("-USR2"));
        });
        end();
        disks.iter().for_each(|disk| disk.signal("-USR2"));
        disks.iter().map(|disk| *disk.losses().last().unwrap()).collect()
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.mount).status();
        let _ = self.layer.kill();
        let _ = self.layer.wait();
    }
}

/// Messages that a server has after it lost power behind the acknowledgement of [`MESSAGES`], and what the disk forgot \[bytes\].
fn kept(interval: &str) -> (u64, u64) {
    let folder = tempfile::tempdir().unwrap();
    let disk = Disk::under(folder.path());
    let nats = Nats::with(folder.path(), &format!("sync_interval: {interval}"), "").unwrap();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let port = nats.port;
    let stream = || async move {
        let client = async_nats::connect(format!("127.0.0.1:{port}")).await.unwrap();
        let jetstream = async_nats::jetstream::new(client);
        let config = async_nats::jetstream::stream::Config {
            name: "kept".to_owned(),
            subjects: vec!["kept".to_owned()],
            ..Default::default()
        };
        let stream = jetstream.get_or_create_stream(config).await.unwrap();
        (jetstream, stream)
    };
    runtime.block_on(async {
        let (jetstream, _) = stream().await;
        for _ in 0..MESSAGES {
            let taken = jetstream.publish("kept", "x".repeat(1000).into()).await.unwrap();
            taken.await.unwrap();
        }
    });
    let nats = RefCell::new(nats);
    let lost = Disk::lose(
        &[&disk],
        || nats.borrow().signal("-KILL"),
        || nats.borrow_mut().kill(),
    );
    nats.borrow_mut().again();
    let kept = runtime.block_on(async { stream().await.1.get_info().await.unwrap().state.messages });
    (kept, lost[0])
}

/// The layer is one that a server can lose by, and flushing is what keeps it.
#[test]
#[ignore = "needs FUSE"]
fn a_server_that_flushes_keeps_what_it_acknowledged_and_a_lax_one_does_not() {
    let (lax, flushed) = (kept("2m"), kept("always"));
    eprintln!(
        "of {MESSAGES} acknowledged messages: sync_interval 2m keeps {lax:?}, always {flushed:?} (messages, bytes forgotten)"
    );
    assert!(lax.0 < MESSAGES && lax.1 > 0, "{lax:?}");
    assert_eq!(flushed.0, MESSAGES);
}

/// One server of one, and of three one or all at random, lose power while the sites send: nothing is missing, and the stream alone gives all
/// rows again.
#[test]
#[ignore = "needs FUSE; minutes"]
fn servers_that_lose_power_lose_no_result() {
    let losses = std::env::var("LOSSES").map_or(LOSSES, |text| text.parse().unwrap());
    for count in [1, 3] {
        let folder = tempfile::tempdir().unwrap();
        let place = |server: usize| match count {
            1 => folder.path().to_owned(),
            _ => folder.path().join(format!("n{server}")),
        };
        let disks: Vec<Disk> = (0..count).map(|server| Disk::under(&place(server))).collect();
        let nats = match count {
            1 => vec![Nats::start(folder.path(), "").unwrap()],
            _ => Nats::cluster(folder.path()).unwrap(),
        };
        let mut fleet = Fleet::at(&["todi", "gubbio"], nats, Storage::Sqlite).unwrap();
        let mut generator = random::stream(random::seed(&[b"power"]), count as u64);
        let mut lost = Vec::new();
        fleet.start();
        for _ in 0..losses {
            // New stores, so that there is something to send.
            (0..2).for_each(|site| fleet.renew_edge(site));
            thread::sleep(Duration::from_millis(generator.random_range(0..300)));
            let servers: Vec<usize> = match generator.random_range(0..2) {
                0 => vec![generator.random_range(0..count)],
                _ => (0..count).collect(),
            };
            let of: Vec<&Disk> = servers.iter().map(|server| &disks[*server]).collect();
            fleet.lose_power(&servers, |kill, end| lost.extend(Disk::lose(&of, kill, end)));
            fleet.wait_until_healthy();
        }
        fleet.wait_until_equal();
        fleet.wait_until_still();
        fleet.stop_hub();
        for site in 0..2 {
            fleet.wait_until_rebuilt(site);
        }
        eprintln!(
            "{count} servers, {losses} losses of power, {} bytes forgotten in {} of {}: tables equal, the stream alone gives them again",
            lost.iter().sum::<u64>(),
            lost.iter().filter(|bytes| **bytes > 0).count(),
            lost.len()
        );
        assert!(lost.iter().any(|bytes| *bytes > 0), "the layer forgot nothing");
        drop(fleet);
    }
}
