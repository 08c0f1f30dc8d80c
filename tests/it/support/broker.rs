//! A Mosquitto of the test's own.

use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::served::Process;
use super::wait::PATIENCE;

/// A broker on a port that was free. It can be killed and started again there.
pub struct Mosquitto {
    folder: TempDir,
    port: u16,
    process: Option<Process>,
}

impl Mosquitto {
    pub fn start() -> Self {
        let free = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let port = free.local_addr().expect("its address").port();
        drop(free);
        let folder = TempDir::new().expect("a folder");
        let config =
            format!("listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\nlog_dest stderr\n");
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

    /// As kill -9.
    pub fn kill(&mut self) {
        self.process = None;
    }

    pub fn start_again(&mut self) {
        let config = self.folder.path().join("mosquitto.conf");
        let arguments = ["-c", config.to_str().expect("a path in UTF-8")];
        let end = Instant::now() + PATIENCE;
        let mut process = Process::start(&program(), Path::new("/"), &arguments);
        while TcpStream::connect(self.address()).is_err() {
            if let Some(code) = process.exit_code_within(Duration::from_millis(20)) {
                panic!("mosquitto ends with {code}:\n{}", process.output);
            }
            assert!(Instant::now() < end, "mosquitto does not listen");
        }
        self.process = Some(process);
    }
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
