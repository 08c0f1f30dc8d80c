//! Lexer: see the property.
#![no_main]

#[path = "../../../runtime/interp/tests/properties/mod.rs"]
mod properties;

libfuzzer_sys::fuzz_target!(|data: &[u8]| properties::words_are_what_the_text_says(&String::from_utf8_lossy(data)));
