//! A Mosquitto that only this test uses.

use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU16, Ordering};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::served::Process;
use super::wait::PATIENCE;

/// A broker on a free port. It can be killed and started again on this port.
pub struct Mosquitto {
    folder: TempDir,
    port: u16,
    process: Option<Process>,
}

impl Mosquitto {
    pub fn start() -> Self {
        Self::with(TempDir::new().expect("a folder"), "allow_anonymous true\n")
    }

    /// A broker with a bridge that carries all of Tandem's topics to another one and back.
    pub fn bridged_to(other: &Mosquitto) -> Self {
        let more = format!(
            "allow_anonymous true\nconnection hall\naddress {}\ntopic tandem/# both 1\nrestart_timeout 1\n",
            other.address()
        );
        Self::with(TempDir::new().expect("a folder"), &more)
    }

    /// A broker that keeps sessions and retained messages on disk, every second.
    pub fn that_keeps() -> Self {
        let folder = TempDir::new().expect("a folder");
        let more = format!(
            "allow_anonymous true\npersistence_location {}/\nautosave_interval 1\n",
            folder.path().display()
        );
        Self::with_persistence(folder, &more, true)
    }

    /// Starts a broker with more lines of configuration, which may name files of the folder without a path.
    pub fn with(folder: TempDir, more: &str) -> Self {
        Self::with_persistence(folder, more, false)
    }

    fn with_persistence(folder: TempDir, more: &str, persistence: bool) -> Self {
        let port = free_port();
        // started by root, it would change to a user that may not read the folder
        let config = format!(
            "user root\nlistener {port} 127.0.0.1\npersistence {persistence}\nset_tcp_nodelay true\nlog_dest stderr\n{more}"
        );
        std::fs::write(folder.path().join("mosquitto.conf"), config).expect("its configuration");
        let mut broker = Self {
            folder,
            port,
            process: None,
        };
        broker.start_again();
        broker
    }

    /// `127.0.0.1:port`
    pub fn address(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    /// Kills the broker, as kill -9 does.
    pub fn kill(&mut self) {
        self.process = None;
    }

    /// Returns the folder of its files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    pub fn start_again(&mut self) {
        let config = self.folder.path().join("mosquitto.conf");
        let arguments = ["-c", config.to_str().expect("a path in UTF-8")];
        let end = Instant::now() + PATIENCE;
        let mut process = Process::start(&program(), self.folder.path(), &arguments);
        while TcpStream::connect(self.address()).is_err() {
            if let Some(code) = process.exit_code_within(Duration::from_millis(20)) {
                panic!("mosquitto ends with {code}:\n{}", process.output);
            }
            assert!(Instant::now() < end, "mosquitto does not listen");
        }
        self.process = Some(process);
    }
}

/// Returns a free port below the range that the operating system assigns to clients, so that no client
/// occupies it before the broker.
pub fn free_port() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0);
    let own = u16::try_from(std::process::id() % 300).expect("less than 300") * 64;
    (0..64)
        .map(|_| 10_000 + own + NEXT.fetch_add(1, Ordering::Relaxed) % 64)
        .find(|port| TcpListener::bind(("127.0.0.1", *port)).is_ok())
        .expect("a free port")
}

fn program() -> PathBuf {
    let places = [
        "/usr/sbin/mosquitto",
        "/usr/local/sbin/mosquitto",
        "/opt/homebrew/sbin/mosquitto",
    ];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut all = std::env::split_paths(&path)
        .map(|folder| folder.join("mosquitto"))
        .chain(places.map(PathBuf::from));
    all.find(|place| place.is_file()).expect(
        "mosquitto is not installed; `apt-get install mosquitto`, or run tests/run, which installs what tests need",
    )
}

/// Adds a user to a password file of Mosquitto's.
pub fn add_password(file: &Path, user: &str, password: &str) {
    let mut tool = Command::new("mosquitto_passwd");
    if !file.exists() {
        tool.arg("-c");
    }
    let status = tool.arg("-b").arg(file).args([user, password]).status();
    assert!(status.expect("mosquitto_passwd starts").success());
}
