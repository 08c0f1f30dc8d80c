//! The built-in demo machine.

use std::collections::BTreeMap;

use super::Config;

const DEMO_TOML: &str = include_str!("demo/demo.toml");

/// NC programs of the demo machine: path in its configuration, and text.
const DEMO_PROGRAMS: [(&str, &str); 7] = [
    ("../nc/plate.nc", include_str!("demo/nc/plate.nc")),
    ("../nc/holes.nc", include_str!("demo/nc/holes.nc")),
    ("../nc/transfer.nc", include_str!("demo/nc/transfer.nc")),
    ("../nc/flange.nc", include_str!("demo/nc/flange.nc")),
    ("../nc/1000.nc", include_str!("demo/nc/1000.nc")),
    ("../nc/1001.nc", include_str!("demo/nc/1001.nc")),
    ("../nc/loader.nc", include_str!("demo/nc/loader.nc")),
];

impl Config {
    /// Returns the built-in demo machine. Coordinate system 1 is a mill with three linear axes, a spindle and
    /// a tool magazine; coordinate system 2 is a loader with two axes. The text is
    /// `examples/config/demo.toml`.
    ///
    /// # Panics
    /// Never panics, because the text is part of the executable and its tests check it.
    #[allow(
        clippy::expect_used,
        reason = "the text is part of the program; a test reads it"
    )]
    pub fn demo() -> Config {
        let mut config = Config::from_toml(DEMO_TOML, "").expect("the demo configuration is valid");
        config.embedded_programs = BTreeMap::from(DEMO_PROGRAMS);
        config.is_demo = true;
        config
    }
}
