//! The files of the data folder: with any content of one of them, only stored values are read.
#![no_main]

#[path = "../../../runtime/tests/readers/mod.rs"]
mod readers;

// The hook of the fuzzer ends the process at every panic. The database library may panic at damage, which the reader
// catches and treats as damage; an uncaught panic is found without the hook, too.
libfuzzer_sys::fuzz_target!(init: drop(std::panic::take_hook()), |data: &[u8]| readers::data_folder(data));
