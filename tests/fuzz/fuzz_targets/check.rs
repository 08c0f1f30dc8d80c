//! Checker: see the property.
#![no_main]

#[path = "../../../runtime/interp/tests/properties/mod.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| properties::checking_gives_bounded_findings(&String::from_utf8_lossy(data)));
