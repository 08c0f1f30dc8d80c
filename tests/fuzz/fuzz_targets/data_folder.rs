//! The files of the data folder: whatever is in one of them, no value is read that was not kept.
#![no_main]

#[path = "../../../runtime/tests/readers/mod.rs"]
mod readers;

libfuzzer_sys::fuzz_target!(|data: &[u8]| readers::data_folder(data));
