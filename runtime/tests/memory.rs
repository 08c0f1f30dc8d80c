//! Interpretation needs less than 64 MiB of memory with any program. This is a separate test binary, because
//! the peak is that of the whole process.

#![cfg(target_os = "linux")]

use std::process::Command;
use std::time::Duration;

use tandem_testing::{Bench, TestError};

/// Limit of the memory in addition to that of the machine before it runs a program, bytes.
const LIMIT: usize = 64 << 20;

/// Endless loops: the modal state changes without motion, with motions too small to run, after a G31 with an
/// unknown end, and within chains with look-ahead.
const ENDLESS: [&str; 8] = [
    "G90\nG91",
    "G90 F100\nG91 F200\nS100\nS200\nG54\nG55\nG17\nG18",
    "G51 X0 Y0 I2 J2 K2\nG50\nG68 X0 Y0 R10\nG69\nG52 X1\nG52 X0",
    "G00 X0\nG90\nG91",
    "G500\nG91 G01 X0.001 F6000\nY0.001 F5000\nG90\nG91 X-0.001 F4000\nY-0.001",
    "G64 G91 G01 X0.001 F6000\nY0.001 F5000\nX-0.001 F4000\nY-0.001",
    "G500\nG91 G02 X0.01 I0.005 F6000\nG03 X-0.01 I-0.005 F5000",
    "G91 G31 X0.5 F6000\nP2 = 0\nwhile (P2 < 20000) {\nP2 = P2 + 1\nG01 X0.00001 F[P2]\nX-0.00001 F100\n}",
];

/// Highest resident memory so far, bytes.
fn peak_bytes() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kib: usize = line
        .and_then(|line| line.split_whitespace().next()?.parse().ok())
        .unwrap_or(usize::MAX / 1024);
    kib * 1024
}

/// Runs a program for a second.
fn run(text: String) {
    let bench = Bench::new().subprogram(50, text);
    let played = bench.play(async |scene, _| {
        scene.cs(1).load(50).await?;
        scene.cs(1).start().await?;
        scene.plc().sleep(Duration::from_secs(1)).await;
        Ok::<_, TestError>(())
    });
    assert!(matches!(played, Ok(Ok(()))), "{played:?}");
}

/// Environment variable that names the loop for a separate process.
const OF_LOOP: &str = "TANDEM_MEMORY_OF_LOOP";

#[test]
fn interpretation_takes_less_than_64_mib_whatever_the_program_does() {
    if let Ok(number) = std::env::var(OF_LOOP) {
        run("G01 X1 F6000\nM30\n".to_owned());
        let before = peak_bytes();
        let body = ENDLESS[number.parse::<usize>().unwrap()];
        run(format!("P1 = 1\nwhile (P1 > 0) {{\n{body}\n}}\nM30\n"));
        let peak = peak_bytes() - before;
        assert!(peak < LIMIT, "{} MiB in the loop of\n{body}", peak >> 20);
        return;
    }
    for (number, body) in ENDLESS.iter().enumerate() {
        let mut of_loop = Command::new(std::env::current_exe().unwrap());
        let done = of_loop.env(OF_LOOP, number.to_string()).output().unwrap();
        let said = String::from_utf8_lossy(&done.stdout);
        assert!(done.status.success(), "{body}\n{said}");
    }
}
