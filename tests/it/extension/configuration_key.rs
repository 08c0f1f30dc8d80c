//! A configuration key costs a field with its meaning, its range, and the setting that takes its value: no
//! code outside of the configuration contains the word that users write.

use std::path::PathBuf;

use tandem_runtime::Config;

use super::{costs, files_where};

const FIELDS: &str = "runtime/config/src/lib.rs";
const RANGES: &str = "runtime/config/src/resolve";

/// Product files that name a key, as a whole word.
fn naming(key: &str) -> Vec<PathBuf> {
    let is_letter = |letter: char| letter.is_alphanumeric() || letter == '_';
    let names_it = |code: &str| code.split(|letter| !is_letter(letter)).any(|word| word == key);
    let mut found = files_where("runtime", ".rs", names_it);
    found.extend(files_where("plc-api", ".rs", names_it));
    found
}

#[test]
fn a_key_is_named_by_its_field_and_by_its_range_and_nowhere_else() {
    for key in ["dry_run_feedrate", "simulated_ms"] {
        let found = naming(key);
        assert_eq!(found.len(), 2, "{key}: {found:?}");
        assert!(found.contains(&FIELDS.into()), "{key}: {found:?}");
        let range = found
            .iter()
            .find(|path| path.to_str().unwrap().starts_with(RANGES));
        assert!(range.is_some(), "{key}: {found:?}");
    }
}

#[test]
fn the_setting_that_takes_a_value_is_a_stages_or_the_coordinators() {
    let (stages, coordinators) = ("runtime/model/src/settings.rs", "runtime/config/src/machine.rs");
    for (setting, file) in [
        ("pub dry_run_feedrate_mm_min: f64,", stages),
        ("pub simulated_s: f64,", coordinators),
    ] {
        let found = files_where("runtime", ".rs", |code| code.contains(setting));
        assert_eq!(found, [PathBuf::from(file)], "{setting}");
    }
    assert_eq!(
        costs("a configuration key"),
        [FIELDS, RANGES, stages, coordinators]
    );
}

#[test]
fn a_key_that_has_a_field_is_read_and_one_that_has_none_is_refused() {
    let demo = include_str!("../../../examples/config/demo.toml");
    let with = |key: &str| {
        demo.replacen(
            "[[coordinate_system]]\n",
            &format!("[[coordinate_system]]\n{key} = 1234.5\n"),
            1,
        )
    };
    let read = |text: &str| Config::from_toml(text, "examples/config");
    let machine = read(&with("dry_run_feedrate")).unwrap().resolve().unwrap();
    let settings = &machine.coordinate_systems[0].settings;
    assert_eq!(settings.motion.dry_run_feedrate_mm_min, 1234.5);
    assert!(read(&with("dry_run_speed")).is_err());
}
