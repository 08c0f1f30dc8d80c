//! Lexer and parser: every text gives a program, and findings within the text.
#![no_main]

use libfuzzer_sys::fuzz_target;
use tandem_syntax::{Grammar, Header, compile, parse};

fuzz_target!(|data: &[u8]| {
    let text = String::from_utf8_lossy(data);
    let (program, findings) = parse(text.as_ref(), Grammar::nj());
    for finding in findings {
        assert!(finding.span.start <= finding.span.end && finding.span.end as usize <= text.len().max(1));
    }
    let _ = compile(&program, Header::Program(1));
});
