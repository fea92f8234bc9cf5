//! Surroundings of the examples that need more than a folder: the folders of an installation, a daemon that listens, a terminal, an
//! archive of sites, a centre. They run with a root and a loopback of their own (bubblewrap), so that paths and ports stand as printed.
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use crate::examples::{FACTS, FOLLOWED, finished, quiet, replace_recording, surroundings};
use crate::site::*;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::LazyLock;

/// Sections of a daemon that can be sent to at the examples' addresses.
const SOCKETS: &str = "\n[store]\npath = \"sent.db\"\n[ingest]\nlisten = [\"tcp://127.0.0.1:7415\", \"unix:///run/tirante/ingest.sock\"]\n";
const MAIL: &str = "\n[[sink]]\nid = \"mail\"\nkind = \"email\"\nurl = \"smtp://127.0.0.1:2525\"\nfrom = \"rods@example.org\"\nto = [\"office@example.org\"]\n";
/// Folders that examples name, and those that stand in for them.
const FOLDERS: [(&str, &str); 8] = [
    ("/archive", "archive"),
    ("/configs", "configs"),
    ("/results", "made"),
    ("/shared/results", "results"),
    ("/new", "configs"),
    ("/data", "data"),
    ("/run/tirante", "sockets"),
    ("/media/backup", "backup"),
];
/// Keys of a daemon that wants certificates.
const TLS: &str = "[ingest.tls]\ncertificate = \"tower.pem\"\nkey = \"tower.key\"\nclient_ca = \"ca.pem\"\n";
const NATS: &str = "listen: \"127.0.0.1:4222\"\nhttp: \"127.0.0.1:8222\"\njetstream { store_dir: \"jetstream\", sync_interval: always, max_file_store: 64GB }\n";
const SITES: [&str; 4] = ["badia", "duomo", "gubbio", "todi"];

/// An archive of four sites, planned, with the result of every task.
static FLEET: LazyLock<Site> = LazyLock::new(|| {
    let site = Site::new(SITE);
    fs::create_dir_all(site.path("configs")).unwrap();
    for name in SITES {
        fs::create_dir_all(site.path(&format!("archive/{name}"))).unwrap();
        fs::write(site.path(&format!("configs/{name}.toml")), SITE).unwrap();
        site.simulate(&format!("{name}/first"), &Part::new(0, 1));
    }
    let at = site.folder.path();
    let plan = "fleet plan archive --configs configs --out plan.jsonl";
    quiet(at, &plan.split(' ').collect::<Vec<_>>());
    for index in 0..SITES.len() {
        let task = format!("fleet task plan.jsonl --index {index} --out results");
        quiet(at, &task.split(' ').collect::<Vec<_>>());
    }
    site
});

/// Prepares what an example needs; returns the shell's line that runs it, or `None` if a folder is enough.
pub fn staged(at: &Path, example: &str) -> Option<String> {
    let has = |part: &str| example.contains(part);
    match () {
        () if has("tirante measure laser.csv\n") || example == "tirante measure laser.csv" => {
            Some(asked(at, example, "9.5\nd45\niron\n", "axial force"))
        }
        () if example == "tirante init laser.mcap --out site.toml" => {
            Some(asked(at, example, "9.5\nd45\niron\n\n\n", "written"))
        }
        () if has("tirante fleet") || has("results/duomo") => Some(fleet(at, example)),
        () if has("tirante hub") => Some(hub(at, example)),
        () if has("--from-store") => {
            quiet(
                at,
                &[&["init", "laser.mcap", "--out", "site.toml"][..], &FACTS].concat(),
            );
            let replay = "replay laser.mcap --config site.toml --store site.db";
            quiet(at, &replay.split(' ').collect::<Vec<_>>());
            for name in ["new.toml", "new-prior.toml"] {
                let config = fs::read_to_string(at.join("site.toml")).unwrap();
                // Another prior needs the recordings where it moves the band; another seed of the draws never.
                fs::write(at.join(name), config.replace("[site]\n", "[site]\nseed = 7\n")).unwrap();
            }
            Some(example.to_owned())
        }
        () if has("tirante serve ") => {
            follow(at);
            Some(until_ready(example, "http://"))
        }
        () if has("tirante run ") => {
            fs::create_dir_all(at.join("site/recordings")).unwrap();
            follow(at);
            Some(until_ready(example, "ready"))
        }
        () if has("tirante send ") => Some(sent(at, example)),
        () if has("--config config/daemon.toml") => {
            fs::create_dir_all(at.join("site")).unwrap();
            fs::copy(FOLLOWED.path("site.db"), at.join("site/site.sqlite")).unwrap();
            Some(example.to_owned())
        }
        () if has("/etc/tirante") || has("alarm test") => {
            follow(at);
            for name in ["etc", "var", "backup"] {
                fs::create_dir_all(at.join(name)).unwrap();
            }
            fs::copy(at.join("site.db"), at.join("var/site.sqlite")).unwrap();
            let config = fs::read_to_string(at.join("site.toml")).unwrap() + MAIL;
            fs::write(at.join("site.toml"), &config).unwrap();
            let config = config.replace("\"site.db\"", "\"/var/lib/tirante/site.sqlite\"");
            fs::write(at.join("etc/tirante.toml"), config).unwrap();
            // No service is running here that could be reloaded.
            let example = example.replace("systemctl reload tirante", "true");
            if has("alarm test") {
                let server = ended_by_signal(
                    "/usr/bin/python3 -m aiosmtpd -n -l 127.0.0.1:2525 -c aiosmtpd.handlers.Debugging stdout",
                );
                let listens =
                    "python3 -c 'import socket; socket.create_connection((\"127.0.0.1\", 2525))' 2>mail.err";
                return Some(beside(&server, listens, &example));
            }
            Some(example)
        }
        () if has("/data/2026") => {
            fs::create_dir_all(at.join("data/2026")).unwrap();
            fs::copy(at.join("laser.mcap"), at.join("data/2026/laser.mcap")).unwrap();
            Some(example.to_owned())
        }
        () => None,
    }
}

/// A terminal at which these lines are typed; what is shown must contain `wanted`.
fn asked(at: &Path, example: &str, typed: &str, wanted: &str) -> String {
    fs::write(at.join("typed"), typed).unwrap();
    format!(
        "script -qec '{example}' /dev/null <typed >shown && grep -q '{wanted}' shown || {{ cat shown; exit 90; }}"
    )
}

/// The store of a site with alarms under the names of the examples.
fn follow(at: &Path) {
    for name in ["site.db", "todi.db", "campaign.db"] {
        fs::copy(FOLLOWED.path("site.db"), at.join(name)).unwrap();
    }
    fs::copy(FOLLOWED.path("site.toml"), at.join("site.toml")).unwrap();
    write_private(&at.join("token"), "0123456789abcdef-secret\n");
    fs::create_dir_all(at.join("var")).unwrap();
}

/// Runs what serves until it is stopped, stops it once its log has a word, and gives its exit code.
fn until_ready(example: &str, word: &str) -> String {
    let last = example.rfind("tirante ").unwrap();
    let (before, serving) = example.split_at(last);
    let service = format!("{before}exec {serving}");
    beside(&service, &format!("grep -q '{word}' $log"), "true")
}

/// Runs an example beside a service, which is waited for and stopped: both must end well.
fn beside(service: &str, ready: &str, example: &str) -> String {
    format!(
        "log=$(mktemp -p .)
         ({service}\n) >$log 2>&1 & pid=$!
         for try in $(seq 600); do {ready} && break; kill -0 $pid 2>/dev/null || break; sleep 0.1; done
         {ready} || {{ cat $log; kill -TERM $pid; exit 91; }}
         ({example}\n); code=$?
         kill -TERM $pid; wait $pid; ended=$?
         [ $ended = 0 ] || {{ cat $log; exit $ended; }}
         exit $code"
    )
}

/// A recording sent to a daemon.
fn sent(at: &Path, example: &str) -> String {
    fs::create_dir_all(at.join("sockets")).unwrap();
    fs::create_dir_all(at.join("site/recordings")).unwrap();
    let config = if example.contains("campaign-2025") {
        "config/daemon.toml"
    } else {
        // It is played as fast as it was measured: some seconds.
        let long = fs::read_to_string(at.join("laser.csv")).unwrap();
        let short: Vec<&str> = long.lines().take(800).collect();
        fs::write(at.join("short.csv"), short.join("\n")).unwrap();
        let import = "import short.csv --channel Laser=/laser --out short.mcap";
        quiet(at, &import.split(' ').collect::<Vec<_>>());
        for name in ["day.mcap", "recording.mcap"] {
            fs::copy(at.join("short.mcap"), at.join(name)).unwrap();
        }
        replace_recording(at, "todi-pull.mcap", &at.join("short.mcap"));
        let played = "short.mcap";
        let words = ["init", played, "--out", "sent.toml", "--length", "14"];
        quiet(
            at,
            &[&words[..], &["--section", "s70", "--material", "iron"]].concat(),
        );
        let mut text = fs::read_to_string(at.join("sent.toml")).unwrap() + SOCKETS;
        if example.contains("tower.example") {
            certificates(at);
            text = text.replace("127.0.0.1:7415", "127.0.0.2:7415") + TLS;
            fs::write(at.join("hosts"), "127.0.0.1 localhost\n127.0.0.2 tower.example\n").unwrap();
        }
        fs::write(at.join("sent.toml"), text).unwrap();
        "sent.toml"
    };
    let daemon = format!("exec tirante run --config {config}");
    beside(&daemon, "grep -q ready $log", example)
}

/// Certificates of the daemon and of two senders, of one authority.
fn certificates(at: &Path) {
    let mut params = rcgen::CertificateParams::new(Vec::<String>::new()).unwrap();
    params.is_ca = rcgen::IsCa::Ca(rcgen::BasicConstraints::Unconstrained);
    let key = rcgen::KeyPair::generate().unwrap();
    let issuer = rcgen::CertifiedIssuer::self_signed(params, key).unwrap();
    fs::write(at.join("ca.pem"), issuer.pem()).unwrap();
    for name in ["tower", "north-laser", "me"] {
        let key = rcgen::KeyPair::generate().unwrap();
        let mut params = rcgen::CertificateParams::new(vec!["tower.example".to_owned()]).unwrap();
        params.distinguished_name.push(rcgen::DnType::CommonName, name);
        let certificate = params.signed_by(&key, &issuer).unwrap();
        fs::write(at.join(format!("{name}.pem")), certificate.pem()).unwrap();
        write_private(&at.join(format!("{name}.key")), &key.serialize_pem());
    }
}

/// A file that only its owner can read.
fn write_private(path: &Path, text: &str) {
    use std::os::unix::fs::PermissionsExt;
    fs::write(path, text).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o600)).unwrap();
}

/// A centre with one site, folded from its post.
static CENTRE: LazyLock<Site> = LazyLock::new(|| {
    let site = Site::new("");
    let at = site.folder.path();
    let followed = fs::read_to_string(FOLLOWED.path("site.toml")).unwrap();
    let post = "\n[http]\nlisten = \"off\"\n[forward]\nto = \"nats://127.0.0.1:4222\"\nsite = \"todi\"\n";
    fs::write(at.join("site.toml"), followed + post).unwrap();
    for name in ["site.db", "replayed.db"] {
        fs::copy(FOLLOWED.path("site.db"), at.join(name)).unwrap();
    }
    fs::write(at.join("nats.conf"), NATS).unwrap();
    let hub = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/fleet/hub.toml");
    fs::copy(hub, at.join("hub.toml")).unwrap();
    let compare = "tirante hub compare todi --store replayed.db --config hub.toml";
    let folded = format!(
        "for try in $(seq 300); do {compare} >compared 2>&1 && exit 0; sleep 0.2; done; cat compared; exit 92"
    );
    let by_the_site = beside(
        "exec tirante run --config site.toml",
        "grep -q ready $log",
        &folded,
    );
    let by_the_hub = beside(
        "exec tirante hub --config hub.toml",
        "grep -q ready $log",
        &by_the_site,
    );
    finished(sandboxed(at), &beside_nats(&by_the_hub), &[0]).unwrap();
    site
});

/// A foreign server whose way to end is a signal.
fn ended_by_signal(server: &str) -> String {
    format!("{server} & server=$!; trap 'kill -TERM $server; wait $server; exit 0' TERM; wait $server")
}

/// Runs an example beside a NATS server.
fn beside_nats(example: &str) -> String {
    let service = ended_by_signal("nats-server -c nats.conf");
    beside(&service, "grep -q 'Server is ready' $log", example)
}

/// The centre's commands beside its post.
fn hub(at: &Path, example: &str) -> String {
    copy_tree(CENTRE.folder.path(), at);
    match example.starts_with("tirante hub --config") {
        true => beside_nats(&until_ready(example, "ready")),
        false => beside_nats(example),
    }
}

/// An archive, its plan and its results, as far as the example finds them there.
fn fleet(at: &Path, example: &str) -> String {
    for name in ["archive", "configs", "results"] {
        copy_tree(&FLEET.path(name), &at.join(name));
    }
    fs::create_dir_all(at.join("made")).unwrap();
    if !example.contains("--out plan.jsonl") {
        fs::copy(FLEET.path("plan.jsonl"), at.join("plan.jsonl")).unwrap();
    }
    let result = fs::read_dir(at.join("results/duomo"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let result = result.file_name().into_string().unwrap();
    // The schedulers set their variable, and a loop the example's.
    format!(
        "export i=1 SLURM_ARRAY_TASK_ID=2\n{}",
        example.replace("1f0c….db", &result)
    )
}

fn copy_tree(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_tree(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).unwrap();
        }
    }
}

/// True if the programs are there that the examples run beside, or must be there.
pub fn has_peers() -> bool {
    let is_missing = |program: &&str| Command::new(program).arg("--version").output().is_err();
    let peers = ["bwrap", "script", "python3", "nats-server", "jq"];
    let missing: Vec<&str> = peers.into_iter().filter(is_missing).collect();
    assert!(
        missing.is_empty() || std::env::var_os("TIRANTE_REAL_PEERS").is_none(),
        "not installed: {missing:?}"
    );
    missing.is_empty()
}

/// A shell with its own root, in which the folders of the examples stand, and its own loopback.
pub fn sandboxed(at: &Path) -> Command {
    let mut command = Command::new("bwrap");
    surroundings(&mut command, at);
    command.args([
        "--unshare-net",
        "--die-with-parent",
        "--proc",
        "/proc",
        "--dev-bind",
        "/dev",
        "/dev",
    ]);
    let own = [
        "proc", "dev", "var", "run", "media", "archive", "configs", "results", "shared", "data", "new", "etc",
    ];
    let mut bind = |folder: &Path, but: &[&str]| {
        for entry in fs::read_dir(folder).unwrap().filter_map(Result::ok) {
            let (path, name) = (entry.path(), entry.file_name());
            if but.iter().any(|one| name == *one) {
                continue;
            }
            match fs::read_link(&path) {
                Ok(target) => command.arg("--symlink").arg(target).arg(&path),
                Err(_) => command.arg("--dev-bind-try").args([&path, &path]),
            };
        }
    };
    bind(Path::new("/"), &own);
    bind(Path::new("/etc"), &["tirante", "hosts"]);
    // Wherever the project, its build and the example's folder stand.
    let here = Path::new(env!("CARGO_BIN_EXE_tirante")).parent().unwrap();
    for path in [
        Path::new(env!("CARGO_MANIFEST_DIR")),
        Path::new(env!("CARGO_TARGET_TMPDIR")),
        here,
        at,
    ] {
        command.arg("--dev-bind").args([path, path]);
    }
    let installed = [("/etc/tirante", "etc"), ("/var/lib/tirante", "var")];
    for (path, name) in FOLDERS.iter().chain(&installed) {
        if at.join(name).is_dir() {
            command.arg("--bind").arg(at.join(name)).arg(path);
        }
    }
    if at.join("hosts").exists() {
        command.arg("--ro-bind").arg(at.join("hosts")).arg("/etc/hosts");
    }
    command.arg("--chdir").arg(at).arg("sh");
    command
}

/// A minute of samples as the files of other programs' own formats.
pub fn foreign_files(at: &Path, samples: &[f64]) {
    fs::write(at.join("hammer.tdms"), tdms("Acc 3", samples)).unwrap();
    fs::write(at.join("tuesday.tdms"), tdms("Laser", samples)).unwrap();
    fs::write(at.join("laser.mat"), mat("laser", samples)).unwrap();
}

/// A LabVIEW file of one segment with one channel of doubles at 100 Hz, from 2026-03-03 06:00 UTC.
fn tdms(channel: &str, samples: &[f64]) -> Vec<u8> {
    let text = |words: &str| [&(words.len() as u32).to_le_bytes()[..], words.as_bytes()].concat();
    let property =
        |name: &str, kind: u32, value: &[u8]| [&text(name)[..], &kind.to_le_bytes(), value].concat();
    // 2^-64 s and seconds since 1904.
    let start = [
        0_u64.to_le_bytes(),
        (1_772_517_600_u64 + 2_082_844_800).to_le_bytes(),
    ]
    .concat();
    let properties = [
        property("wf_increment", 10, &0.01_f64.to_le_bytes()),
        property("wf_start_time", 0x44, &start),
        property("unit_string", 0x20, &text("mm")),
    ];
    let mut object = text(&format!("/'run'/'{channel}'"));
    for word in [20_u32, 10, 1] {
        object.extend(word.to_le_bytes());
    }
    object.extend((samples.len() as u64).to_le_bytes());
    object.extend((properties.len() as u32).to_le_bytes());
    object.extend(properties.concat());
    let metadata = [&1_u32.to_le_bytes()[..], &object].concat();
    let raw: Vec<u8> = samples
        .iter()
        .flat_map(|value| (1e3 * value).to_le_bytes())
        .collect();
    let mut bytes = b"TDSm".to_vec();
    // Metadata, raw data and a new list of objects.
    bytes.extend([0x0e_u32.to_le_bytes(), 4713_u32.to_le_bytes()].concat());
    bytes.extend(((metadata.len() + raw.len()) as u64).to_le_bytes());
    bytes.extend((metadata.len() as u64).to_le_bytes());
    bytes.extend(metadata);
    bytes.extend(raw);
    bytes
}

/// A MATLAB file (version 5) of one column of doubles.
fn mat(name: &str, samples: &[f64]) -> Vec<u8> {
    let element = |kind: u32, data: &[u8]| {
        let mut bytes = [kind.to_le_bytes(), (data.len() as u32).to_le_bytes()].concat();
        bytes.extend(data);
        bytes.resize(bytes.len().next_multiple_of(8), 0);
        bytes
    };
    let raw: Vec<u8> = samples.iter().flat_map(|value| value.to_le_bytes()).collect();
    let shape = [(samples.len() as i32).to_le_bytes(), 1_i32.to_le_bytes()].concat();
    // Class 6 is an array of doubles.
    let flags = [6_u32.to_le_bytes(), 0_u32.to_le_bytes()].concat();
    let parts = [
        element(6, &flags),
        element(5, &shape),
        element(1, name.as_bytes()),
        element(9, &raw),
    ];
    let mut bytes = format!("{:<124}", "MATLAB 5.0 MAT-file").into_bytes();
    bytes.extend([0x00, 0x01, b'I', b'M']);
    bytes.extend(element(14, &parts.concat()));
    bytes
}
