//! Checker: every text gives a bounded list of findings, the same each time.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tandem_interp::{CheckContext, check_source};

fuzz_target!(|data: &[u8]| {
    let text = String::from_utf8_lossy(data);
    let context = CheckContext {
        without_motion: true,
        ..CheckContext::default()
    };
    let (_, first) = check_source(text.as_ref(), &context);
    let (_, second) = check_source(text.as_ref(), &context);
    assert!(first == second && first.diagnostics.len() <= 4004);
});
