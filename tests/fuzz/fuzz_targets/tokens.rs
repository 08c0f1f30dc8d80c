//! A token file: it is read, or refused with a reason that reveals only names.
#![no_main]

use tandem_gateway::Tokens;

libfuzzer_sys::fuzz_target!(|data: &[u8]| match Tokens::parse(&String::from_utf8_lossy(data)) {
    Ok(tokens) => assert!(tokens.users().count() > 0),
    Err(reason) => assert!(!reason.is_empty()),
});
