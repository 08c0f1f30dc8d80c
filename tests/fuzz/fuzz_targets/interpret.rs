//! Interpreter: see the property.
#![no_main]

#[path = "../../../runtime/interp/tests/properties/mod.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| properties::what_checks_clean_runs_clean(&String::from_utf8_lossy(data)));
