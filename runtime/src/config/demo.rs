//! The built-in demo machine.

use std::collections::BTreeMap;

use super::Config;

const DEMO_TOML: &str = include_str!("demo/demo.toml");

/// The demo's NC programs, by their path in its configuration.
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
    /// The built-in demo machine: a mill with three linear axes, a spindle and a tool magazine in coordinate system
    /// 1, and a loader with two axes in coordinate system 2. Its text is `examples/config/demo.toml`.
    ///
    /// # Panics
    /// Never panics: the text is part of the program and checked by its tests.
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
