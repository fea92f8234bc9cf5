//! Real servers, started for one test and ended with it.

use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// A program of Debian, or `None` with a line that reports it missing. With TIRANTE_REAL_PEERS=1 it must be there.
pub fn program(name: &str, package: &str) -> Option<PathBuf> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&folders).chain(["/usr/sbin".into(), "/usr/local/sbin".into()]);
    let found = folders
        .map(|folder| folder.join(name))
        .find(|path| path.is_file());
    if found.is_none() {
        missing(package);
    }
    found
}

/// Reports that a test is skipped, or fails it.
pub fn missing(package: &str) {
    let must = std::env::var_os("TIRANTE_REAL_PEERS").is_some_and(|value| value == "1");
    assert!(
        !must,
        "{package} is not installed, and TIRANTE_REAL_PEERS=1 wants it"
    );
    eprintln!("skipped: {package} is not installed (apt-get install {package})");
}

/// A process that ends with the test.
pub struct Server {
    child: Child,
    pub address: SocketAddr,
}

impl Server {
    /// Starts a program that listens on the port that `arguments` are made for, and waits until it does.
    pub fn start(program: &Path, address: SocketAddr, arguments: &[String]) -> Option<Self> {
        let child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut server = Self { child, address };
        let until = Instant::now() + Duration::from_secs(20);
        while Instant::now() < until {
            if server.child.try_wait().unwrap().is_some() {
                return None;
            }
            if TcpStream::connect(address).is_ok() {
                return Some(server);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        panic!("{} does not listen on {address}", program.display());
    }

    /// Starts a program on a port that the system chooses; on another one if that port was taken meanwhile.
    pub fn start_anywhere(program: &Path, arguments: impl Fn(SocketAddr) -> Vec<String>) -> Self {
        for _ in 0..5 {
            let address = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
            if let Some(server) = Self::start(program, address, &arguments(address)) {
                return server;
            }
        }
        panic!("{} ends at once", program.display());
    }

    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args([name, &pid])
                .status()
                .unwrap()
                .success()
        );
    }

    /// kill -9, and waits until it is gone.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}
