//! Memory of a machine that repeats the same work.

#![allow(clippy::print_stdout, reason = "what was measured is told")]

use std::fmt::Write as _;

use super::reach::allocated_kib;

/// Number of runs after which all reused memory has been allocated.
const FIRST_RUNS: usize = 20;

/// Runs whose memory is measured.
const RUNS: usize = 150;

/// Blocks of each run.
const BLOCKS: usize = 30;

/// Growth over [`RUNS`], KiB. Reason: a run and its commands are remembered, with less than 4 KiB. If each of the 4500 profiles
/// touched memory that no other one uses, these were 7 MiB.
const GROWTH_MAX_KIB: u64 = 2048;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn memory_does_not_grow_with_the_number_of_blocks_that_were_executed() {
    let (_machine, served) = super::served();
    let mut program = "G90 F12000\n".to_owned();
    for n in 1..=BLOCKS {
        writeln!(program, "G01 X{}", n % 2).expect("a string");
    }
    program.push_str("M30\n");
    served.load(1, 60, &program).await;
    let mut before = 0;
    for n in 0..FIRST_RUNS + RUNS {
        if n == FIRST_RUNS {
            before = allocated_kib(served.process.id());
        }
        served.command(1, "start").await;
        served.execution(1, "PROGRAM_COMPLETED").await;
    }
    let after = allocated_kib(served.process.id());
    println!("{before} KiB after {FIRST_RUNS} runs, {after} KiB after {RUNS} more");
    assert!(
        after.saturating_sub(before) < GROWTH_MAX_KIB,
        "{before} to {after} KiB"
    );
}
