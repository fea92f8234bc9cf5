//! The copy of journal parts to object storage, against a server that verifies signatures with code of its own (`s3.py`).
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::common::motion;
use crate::fault_kinds::{Daemon, daemon_site, told};
use crate::listeners::wait_for;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tempfile::TempDir;
use tirante::config::settings::bucket::BucketSettings;
use tirante::config::settings::credential::CredentialPath;
use tirante::config::settings::journal::JournalSettings;
use tirante::recording::part;
use tirante::service::alert::Pace;
use tirante::service::bucket::{S3, SINK, Uploader};
use tirante::service::journal::{Around, Batch, Entry, Journal};
use tirante::service::telemetry::{Fault, Health, Telemetry};

const KEY: &str = "AKIDOFTHETESTS000042";
const SECRET: &str = "of+the/tests+and/nobody+else/0123456789";
const REGION: &str = "eu-south-1";
/// 2026-03-01T23:59:59Z, the last write of every part.
const WRITTEN: u64 = 1_772_409_599;
const DAY: &str = "2026/03/01";
/// No wait outgrows the patience of a test, however long the failures lasted on a loaded machine.
const PACE: Pace = Pace {
    first: Duration::from_millis(100),
    longest: Duration::from_secs(1),
    deadline: Duration::from_secs(10),
};

/// The server, ended when this is dropped; it ends by itself with the test's process, whose pipe is its input.
struct Server {
    data: TempDir,
    address: String,
    child: Child,
}

impl Server {
    fn start() -> Self {
        Self::with(0, "")
    }

    /// Starts it on a port; it fails from its begin on as [`Server::fails`] says.
    fn with(port: u16, fails: &str) -> Self {
        let data = tempfile::tempdir().unwrap();
        for bucket in ["monuments", "other"] {
            fs::create_dir(data.path().join(bucket)).unwrap();
        }
        fs::write(data.path().join(".fails"), fails).unwrap();
        let mut child = Command::new("python3")
            .arg(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/service/s3.py"))
            .arg(data.path())
            .envs([("S3_KEY", KEY), ("S3_SECRET", SECRET), ("S3_REGION", REGION)])
            .env("S3_PORT", port.to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("python3: {error}"));
        let mut line = String::new();
        let mut said = BufReader::new(child.stdout.take().unwrap());
        said.read_line(&mut line).unwrap();
        Self {
            data,
            address: format!("http://127.0.0.1:{}", line.trim().parse::<u16>().unwrap()),
            child,
        }
    }

    /// From now on fails: `503 HEAD PUT`, `half PUT`; nothing if this is empty.
    fn fails(&self, how: &str) {
        let (new, fails) = (self.data.path().join(".new"), self.data.path().join(".fails"));
        fs::write(&new, how).unwrap();
        fs::rename(new, fails).unwrap();
    }

    /// Requests since the last call: `PUT monuments/NAME 200`.
    fn requests(&self) -> Vec<String> {
        let log = self.data.path().join(".log");
        let text = fs::read_to_string(&log).unwrap_or_default();
        let _ = fs::remove_file(log);
        text.lines().map(str::to_owned).collect()
    }

    /// Names and bytes of the objects of a bucket.
    fn objects(&self, bucket: &str) -> BTreeMap<String, Vec<u8>> {
        let root = self.data.path().join(bucket);
        let (mut found, mut folders) = (BTreeMap::new(), vec![root.clone()]);
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(&root).unwrap().to_str().unwrap().to_owned();
                    found.insert(name, fs::read(path).unwrap());
                }
            }
        }
        found
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A folder with parts, and the settings of their copy.
struct Site {
    folder: TempDir,
    settings: BucketSettings,
}

impl Site {
    fn new(server: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let site = Self {
            settings: BucketSettings {
                server: server.to_owned(),
                bucket: "monuments".to_owned(),
                prefix: "todi/san-fortunato".to_owned(),
                region: REGION.to_owned(),
                credentials: CredentialPath::new(folder.path().join("keys").to_str().unwrap()),
                ca: None,
            },
            folder,
        };
        site.keys(KEY, SECRET);
        fs::create_dir(site.journal()).unwrap();
        site
    }

    fn journal(&self) -> PathBuf {
        self.folder.path().join("journal")
    }

    fn keys(&self, key: &str, secret: &str) {
        let (new, keys) = (self.folder.path().join("new"), self.folder.path().join("keys"));
        fs::write(&new, format!("{key}\n{secret}\n")).unwrap();
        fs::set_permissions(&new, fs::Permissions::from_mode(0o600)).unwrap();
        fs::rename(new, keys).unwrap();
    }

    /// Writes a part, whose bytes and length are its number's.
    fn part(&self, number: u32) {
        let bytes = motion(1000 * number as usize);
        let bytes: Vec<u8> = bytes.iter().flat_map(|value| value.to_le_bytes()).collect();
        let path = part::path(&self.journal(), number);
        fs::write(&path, bytes).unwrap();
        let written = UNIX_EPOCH + Duration::from_secs(WRITTEN);
        let file = File::options().write(true).open(path).unwrap();
        file.set_modified(written).unwrap();
    }

    /// Name of the object of a part, as the docs give it, and its bytes.
    fn object(&self, number: u32) -> (String, Vec<u8>) {
        let bytes = fs::read(part::path(&self.journal(), number)).unwrap();
        let sum: String = Sha256::digest(&bytes)
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        let name = format!(
            "{}/{DAY}/journal.{number:06}-{}.mcap",
            self.settings.prefix,
            &sum[..16]
        );
        (name, bytes)
    }

    /// Answers of the server to a part that it did not have.
    fn sent(&self, number: u32) -> [String; 3] {
        let (name, _) = self.object(number);
        ["HEAD 404", "PUT 200", "HEAD 200"].map(|pair| {
            let (method, status) = pair.split_once(' ').unwrap();
            format!("{method} {}/{name} {status}", self.settings.bucket)
        })
    }

    fn start(&self) -> Running {
        let (held, telemetry) = (Arc::<AtomicU32>::default(), Telemetry::default());
        // Whatever it was before is overwritten at the start.
        held.store(u32::MAX, Ordering::Relaxed);
        let copied = Arc::clone(&held);
        Running {
            _uploader: Uploader::start(PACE, &self.settings, &self.journal(), copied, telemetry.clone())
                .unwrap(),
            held,
            telemetry,
        }
    }
}

/// A running copy.
struct Running {
    _uploader: Uploader,
    held: Arc<AtomicU32>,
    telemetry: Telemetry,
}

impl Running {
    fn held(&self) -> u32 {
        self.held.load(Ordering::Relaxed)
    }

    fn wait_for_part(&self, number: u32) {
        wait_for(&format!("part {number} is held"), || self.held() == number);
    }

    /// Waits until the condition holds with these words in it.
    fn wait_for_failure(&self, words: &[&str]) {
        let mut told = None;
        wait_for(&format!("a failure with {words:?}"), || {
            let conditions = self.telemetry.health.conditions();
            told = conditions
                .into_iter()
                .find(|lasting| lasting.fault == Fault::Forward && lasting.about == SINK)
                .map(|lasting| lasting.detail);
            let told = told.as_deref().unwrap_or_default();
            words.iter().all(|word| told.contains(word))
        });
    }

    /// Waits until the condition is over, and checks that nothing told over all the time lets anybody in.
    fn wait_for_success(&self) {
        let health = &self.telemetry.health;
        wait_for("the failure is over", || !health.lasts(Fault::Forward, SINK));
        assert_private(&serde_json::to_string(&health.report()).unwrap());
        assert_private(&self.telemetry.metrics.text());
    }
}

/// No key and no signature is in a text.
fn assert_private(text: &str) {
    for private in [SECRET, KEY, "X-Amz-", "SignatureProvided"] {
        assert!(!text.contains(private), "{private}: {text}");
    }
}

#[test]
fn complete_parts_arrive_in_order_and_once() {
    let server = Server::start();
    let mut site = Site::new(&server.address);
    (1..=4).for_each(|number| site.part(number));
    let copy = site.start();
    copy.wait_for_part(3);
    // The fourth is the one being written.
    let expected: Vec<String> = (1..=3).flat_map(|number| site.sent(number)).collect();
    assert_eq!(server.requests(), expected);
    assert_eq!(
        server.objects("monuments"),
        (1..=3).map(|number| site.object(number)).collect()
    );
    let mark = site.journal().join(".bucket");
    let mark_text = fs::read_to_string(&mark).unwrap();
    let address = format!("{}/monuments/todi/san-fortunato", server.address);
    assert_eq!(
        serde_json::from_str::<serde_json::Value>(&mark_text).unwrap(),
        serde_json::json!({"to": address, "through": 3})
    );
    wait_for("all are counted", || {
        let metrics = copy.telemetry.metrics.text();
        metrics.contains("tirante_outbox_waiting{sink=\"copy/bucket\"} 0")
            && metrics.contains("tirante_deliveries_total{sink=\"copy/bucket\",outcome=\"delivered\"} 3")
    });
    drop(copy);

    // After a restart only what is new is asked for.
    site.part(5);
    let copy = site.start();
    copy.wait_for_part(4);
    assert_eq!(server.requests(), site.sent(4));
    drop(copy);

    // Without the mark every part is asked for by its name, and none is sent again.
    fs::remove_file(&mark).unwrap();
    let copy = site.start();
    copy.wait_for_part(4);
    let asked = |number| format!("HEAD monuments/{} 200", site.object(number).0);
    assert_eq!(server.requests(), (1..=4).map(asked).collect::<Vec<_>>());
    drop(copy);

    // Another bucket begins anew, and the first one keeps what it has.
    let first = server.objects("monuments");
    server.fails("503 HEAD PUT");
    site.settings.bucket = "other".to_owned();
    let copy = site.start();
    assert_eq!(copy.held(), 0);
    copy.wait_for_failure(&[&site.settings.address(), "503"]);
    assert_eq!(copy.held(), 0);
    server.fails("");
    copy.wait_for_part(4);
    copy.wait_for_success();
    assert_eq!(server.objects("other"), first);
    assert_eq!(server.objects("monuments"), first);
}

#[test]
fn the_mark_of_a_journal_that_is_gone_holds_nothing() {
    let server = Server::start();
    let site = Site::new(&server.address);
    (1..=4).for_each(|number| site.part(number));
    let copy = site.start();
    copy.wait_for_part(3);
    drop(copy);
    // The parts go by hand, the hidden mark stays, and the new journal begins with number 1.
    (1..=4).for_each(|number| fs::remove_file(part::path(&site.journal(), number)).unwrap());
    for number in 1..=3 {
        fs::write(part::path(&site.journal(), number), format!("new {number}")).unwrap();
    }
    let copy = site.start();
    wait_for("the new parts are there", || {
        server.objects("monuments").len() == 5
    });
    copy.wait_for_part(2);
}

#[test]
fn an_absent_server_is_told_and_waited_for() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    drop(listener);
    let site = Site::new(&format!("http://127.0.0.1:{port}"));
    (1..=3).for_each(|number| site.part(number));
    let copy = site.start();
    copy.wait_for_failure(&[&site.settings.address(), "refused"]);
    let server = Server::with(port, "503 PUT");
    copy.wait_for_failure(&[&site.settings.address(), "answers 503", "SlowDown"]);
    assert_eq!(copy.held(), 0);
    assert!(server.objects("monuments").is_empty());
    server.fails("");
    copy.wait_for_part(2);
    copy.wait_for_success();
    assert_eq!(
        server.objects("monuments"),
        [1, 2].map(|number| site.object(number)).into()
    );
}

#[test]
fn half_an_object_is_none() {
    let server = Server::with(0, "half PUT");
    let site = Site::new(&server.address);
    (1..=2).for_each(|number| site.part(number));
    let (name, bytes) = site.object(1);
    let copy = site.start();
    let half = format!("{} bytes, and has {} bytes of it", bytes.len(), bytes.len() / 2);
    copy.wait_for_failure(&[&site.settings.address(), &name, &half]);
    assert_eq!(copy.held(), 0);
    assert_eq!(server.objects("monuments")[&name].len(), bytes.len() / 2);
    server.fails("");
    copy.wait_for_part(1);
    copy.wait_for_success();
    assert_eq!(server.objects("monuments"), [(name, bytes)].into());
}

#[test]
fn wrong_keys_are_told_and_read_anew() {
    let server = Server::start();
    let site = Site::new(&server.address);
    site.keys(KEY, "another secret");
    (1..=2).for_each(|number| site.part(number));
    let copy = site.start();
    copy.wait_for_failure(&[&site.settings.address(), "403"]);
    assert_eq!(copy.held(), 0);
    site.keys(KEY, SECRET);
    copy.wait_for_part(1);
    copy.wait_for_success();
    assert_eq!(server.objects("monuments"), [site.object(1)].into());
}

#[test]
fn requests_are_signed_and_bytes_are_compared() {
    let server = Server::start();
    let mut site = Site::new(&server.address);
    site.part(1);
    let path = part::path(&site.journal(), 1);
    let bytes = fs::read(&path).unwrap();
    let (length, sum) = (bytes.len() as u64, Sha256::digest(&bytes));
    let put = |site: &Site, sum: &[u8]| {
        let bucket = S3::new(&site.settings).unwrap();
        bucket
            .put("a.mcap", File::open(&path).unwrap(), length, sum)
            .map_err(|error| error.to_string())
    };
    let refused = |site: &Site, sum: &[u8], words: [&str; 2]| {
        let told = put(site, sum).unwrap_err();
        assert!(words.iter().all(|word| told.contains(word)), "{told}");
        for private in [SECRET, KEY, "AKIDOFSOMEBODY", "X-Amz-", "SignatureProvided"] {
            assert!(!told.contains(private), "{told}");
        }
        assert!(server.objects("monuments").is_empty());
    };
    // Bytes that changed on their way do not have the sum that came with them.
    refused(&site, &Sha256::digest("others"), ["400", "BadDigest"]);
    site.settings.region = "eu-south-2".to_owned();
    refused(&site, &sum, ["403", "SignatureDoesNotMatch"]);
    site.settings.region = REGION.to_owned();
    site.settings.bucket = "none".to_owned();
    refused(&site, &sum, ["404", "NoSuchBucket"]);
    site.settings.bucket = "monuments".to_owned();
    site.keys("AKIDOFSOMEBODY", SECRET);
    refused(&site, &sum, ["403", "InvalidAccessKeyId"]);
    site.keys(KEY, SECRET);
    assert_eq!(S3::new(&site.settings).unwrap().length("a.mcap").unwrap(), None);
    put(&site, &sum).unwrap();
    assert_eq!(
        S3::new(&site.settings).unwrap().length("a.mcap").unwrap(),
        Some(length)
    );
    assert_eq!(server.objects("monuments"), [("a.mcap".to_owned(), bytes)].into());
}

/// Writes parts of a journal.
fn record(journal: &Journal, parts: u32, folder: &Path) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_time()
        .build()
        .unwrap();
    runtime.block_on(async {
        let mut line = journal.handle().connect(Some("laser")).await.unwrap();
        let mut durable = line.durable();
        let channel = Entry::Channel {
            id: 1,
            topic: "/laser".to_owned(),
            encoding: "json".to_owned(),
            schema: None,
        };
        let mut entries = vec![channel];
        for through in 1.. {
            entries.push(Entry::Message {
                channel: 1,
                log_time: through,
                publish_time: through,
                data: motion(1000 + through as usize)
                    .iter()
                    .flat_map(|value| value.to_le_bytes())
                    .collect(),
            });
            let entries = std::mem::take(&mut entries);
            line.append(Batch { entries, through }).await.unwrap();
            durable.wait_for(|count| *count >= through).await.unwrap();
            if part::list(folder).unwrap().last() >= Some(&parts) {
                break;
            }
        }
    });
}

#[test]
fn a_journal_removes_no_part_that_the_bucket_lacks() {
    let server = Server::with(0, "503 PUT");
    let site = Site::new(&server.address);
    let folder = site.journal();
    let copy = site.start();
    let health = Arc::<Health>::default();
    let around = Around {
        beat: Arc::default(),
        copied: Some(Arc::clone(&copy.held)),
        health: Arc::clone(&health),
        halted: Arc::default(),
        vouch: Box::new(|parts| parts.iter().map(|_| 0.0).collect()),
    };
    let settings = JournalSettings {
        part_bytes: 5_000,
        keep_s: None,
        keep_bytes: Some(1),
        ..Default::default()
    };
    let journal = Journal::start(&folder, &settings, 3600.0, around, |error| panic!("{error}")).unwrap();
    record(&journal, 6, &folder);
    let sums: BTreeMap<u32, Vec<u8>> = (1..=5)
        .map(|number| (number, fs::read(part::path(&folder, number)).unwrap()))
        .collect();
    // All of them may go by the journal's own rules, and none does.
    journal.results_kept().store(3, Ordering::Relaxed);
    wait_for("the parts wait for the copy", || {
        health.lasts(Fault::Backup, "journal")
    });
    assert_eq!(part::list(&folder).unwrap()[0], 1);
    server.fails("");
    copy.wait_for_part(5);
    journal.results_kept().store(4, Ordering::Relaxed);
    wait_for("the parts go", || part::list(&folder).unwrap()[0] == 5);
    wait_for("none waits any more", || !health.lasts(Fault::Backup, "journal"));
    journal.stop();
    let objects = server.objects("monuments");
    // The entry of the sender's end opens a seventh part, so the sixth may have been copied, too.
    assert!((5..=6).contains(&objects.len()), "{}", objects.len());
    for ((number, bytes), (name, object)) in sums.iter().zip(&objects) {
        assert!(name.contains(&format!("/journal.{number:06}-")), "{name}");
        assert!(bytes == object, "part {number} differs");
    }
}

/// `tirante run` with a `[bucket]`: a part that is complete is there, byte for byte, under the name that the docs give.
#[test]
fn a_daemon_copies_the_parts_of_its_journal() {
    let server = Server::start();
    let site = daemon_site();
    let keys = site.path("keys");
    fs::write(&keys, format!("{KEY}\n{SECRET}\n")).unwrap();
    fs::set_permissions(&keys, fs::Permissions::from_mode(0o600)).unwrap();
    let config = fs::read_to_string(site.path("site.toml")).unwrap();
    let bucket = format!(
        "[bucket]\nto = \"{}/monuments/todi\"\nregion = \"{REGION}\"\ncredentials = {keys:?}\n",
        server.address
    );
    fs::write(site.path("site.toml"), config + &bucket).unwrap();
    let send = |second: u64| {
        let time = (1_767_268_800 + second) * 1_000_000_000;
        let line = format!("{{\"topic\":\"/north\",\"time\":{time},\"values\":[1e-5]}}\n{{\"end\":true}}\n");
        assert!(told(&site, &line).contains("done"));
    };
    let mut daemon = Daemon::ready(&site);
    send(0);
    daemon.signal("-TERM");
    assert_eq!(daemon.child.wait().unwrap().code(), Some(0));
    // The next data go into the next part, which completes the first.
    let _daemon = Daemon::ready(&site);
    send(1);
    wait_for("the first part is there", || {
        !server.objects("monuments").is_empty()
    });
    let part = fs::read(part::path(&site.path("journal"), 1)).unwrap();
    let sum: String = Sha256::digest(&part)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let (name, object) = server.objects("monuments").pop_first().unwrap();
    assert!(
        name.starts_with("todi/2") && name.ends_with(&format!("/journal.000001-{}.mcap", &sum[..16])),
        "{name}"
    );
    assert!(object == part);
}

/// A server of others: `TIRANTE_S3_SERVER=http://127.0.0.1:4568/BUCKET TIRANTE_S3_KEYS="KEY SECRET"`, and
/// `TIRANTE_S3_REGION` if it is not us-east-1.
#[test]
#[ignore = "wants a server with the S3 interface in TIRANTE_S3_SERVER"]
fn a_server_of_others_takes_the_parts() {
    let said = |name| std::env::var(name).ok();
    let (Some(address), Some(keys)) = (said("TIRANTE_S3_SERVER"), said("TIRANTE_S3_KEYS")) else {
        eprintln!("left out: no TIRANTE_S3_SERVER and TIRANTE_S3_KEYS");
        return;
    };
    let (server, bucket) = address.rsplit_once('/').unwrap();
    let (key, secret) = keys.split_once(' ').unwrap();
    let mut site = Site::new(server);
    site.settings.bucket = bucket.to_owned();
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    site.settings.prefix = format!("tests/{}", now.as_nanos());
    site.settings.region = said("TIRANTE_S3_REGION").unwrap_or_else(|| "us-east-1".to_owned());
    // Not every server compares signatures; all of them know their keys.
    site.keys("AKIDOFNOBODY", secret);
    (1..=4).for_each(|number| site.part(number));
    let copy = site.start();
    copy.wait_for_failure(&[&site.settings.address(), "403"]);
    site.keys(key, secret);
    copy.wait_for_part(3);
    copy.wait_for_success();
    let bucket = S3::new(&site.settings).unwrap();
    for number in 1..=3 {
        let (name, bytes) = site.object(number);
        assert_eq!(bucket.length(&name).unwrap(), Some(bytes.len() as u64));
    }
    assert_eq!(bucket.length(&site.object(4).0).unwrap(), None);
}
