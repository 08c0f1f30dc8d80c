//! Machines for tests: a configuration and NC programs in a folder of their own.

use std::path::{Path, PathBuf};

use tandem_testing::Bench;
use tempfile::TempDir;

/// Three linear axes with limits that differ, a spindle, and a second coordinate system with one axis. Speeds and
/// accelerations are round numbers, so that formulas can be followed by hand.
pub const MOTORS: &str = r#"
[[motor]]
number = 1
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0
rapid_velocity = 100.0
rapid_acceleration = 1000.0
soft_limits = [-100.0, 300.0]

[[motor]]
number = 2
kind = "linear"
max_velocity = 50.0
max_acceleration = 5000.0
rapid_velocity = 50.0
rapid_acceleration = 250.0

[[motor]]
number = 3
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0
rapid_velocity = 100.0
rapid_acceleration = 1000.0

[[motor]]
number = 4
kind = "spindle"
max_velocity = 3000.0
max_acceleration = 3000.0

[[motor]]
number = 5
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0
rapid_velocity = 100.0
rapid_acceleration = 1000.0
"#;

/// The coordinate systems that go with [`MOTORS`]. The second one ends the text without a table, so that a test can add
/// keys to it or append tables.
pub const COORDINATE_SYSTEMS: &str = r"
[[coordinate_system]]
number = 1
axes = { X = 1, Y = 2, Z = 3 }
spindle = 4
max_feedrate = 12000.0

[coordinate_system.work_offset]
G54 = { X = 10.0, Y = 20.0, Z = 30.0 }
G55 = { X = 11.0 }
G56 = { X = 12.0 }
G57 = { X = 13.0 }
G58 = { X = 14.0 }
G59 = { X = 15.0 }

[[coordinate_system]]
number = 2
axes = { X = 5 }
";

/// The machine of [`MOTORS`] and [`COORDINATE_SYSTEMS`] with `more` in its configuration, in simulated time.
pub fn bench(more: &str) -> Bench {
    Bench::with_config(Machine::new(more).config()).expect("a good configuration")
}

/// A folder with a configuration and programs; it is removed when dropped.
pub struct Machine {
    folder: TempDir,
}

impl Machine {
    /// Returns the machine of [`MOTORS`] and [`COORDINATE_SYSTEMS`] with `more` appended, such as `[m_code.N]` tables.
    /// Tests run in parallel, so a servo that is late by less than `servo_late_ms` is not a failure.
    pub fn new(more: &str) -> Self {
        Self::with_config(&format!(
            "[machine]\nname = \"test-1\"\nservo_late_ms = 1500\n{MOTORS}{COORDINATE_SYSTEMS}{more}"
        ))
    }

    /// A machine of a whole configuration.
    pub fn with_config(config: &str) -> Self {
        let machine = Self {
            folder: TempDir::new().expect("a folder"),
        };
        machine.write("tandem.toml", config);
        machine
    }

    /// Writes a file of the folder and returns its path.
    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, text).expect("a file in a folder of ours");
        path
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn config(&self) -> PathBuf {
        self.path("tandem.toml")
    }

    pub fn folder(&self) -> &Path {
        self.folder.path()
    }
}
