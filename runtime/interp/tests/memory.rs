//! Memory for a long program: at most three times its text and 30 MB. A separate test binary, because the
//! peak is measured for the whole process.

#![cfg(target_os = "linux")]

use std::fmt::Write as _;

use tandem_interp::dialects::nj;
use tandem_interp::{CheckContext, check_source};

const BLOCKS: usize = 1_000_000;

/// Returns the highest resident memory of the process so far, bytes.
fn peak_bytes() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib: usize = line
        .and_then(|line| line.split_whitespace().next()?.parse().ok())
        .unwrap_or(usize::MAX / 1024);
    kib * 1024
}

#[test]
fn a_million_blocks_take_three_times_their_text_and_30_mb() {
    let mut text = String::with_capacity(16 * BLOCKS);
    text.push_str("G01 F3000\n");
    for i in 2..BLOCKS {
        let _ = writeln!(text, "X{:.3}Y{:.3}", (i % 997) as f64 * 0.1, (i % 13) as f64);
    }
    text.push_str("M30\n");
    let limit = 3 * text.len() + 30_000_000;
    let (program, check) = check_source(text, nj(), &CheckContext::default());
    assert!(check.diagnostics.is_empty());
    assert_eq!(program.blocks().len(), BLOCKS);
    let peak = peak_bytes();
    assert!(peak <= limit, "peak {peak} bytes, at most {limit}");
}
