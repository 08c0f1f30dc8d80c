//! Parser: see the property.
#![no_main]

#[path = "../../../runtime/interp/tests/properties/mod.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| properties::parsing_gives_a_sound_tree(&String::from_utf8_lossy(data)));
