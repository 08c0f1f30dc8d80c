//! Reader of MQTT input: see the property.
#![no_main]

#[path = "../../../plc-api/protocol/tests/readers/mod.rs"]
#[allow(dead_code, reason = "each fuzzer calls one of the properties")]
mod readers;

libfuzzer_sys::fuzz_target!(|data: &[u8]| readers::mqtt(data));
