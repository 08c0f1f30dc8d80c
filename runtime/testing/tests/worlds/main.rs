//! A simulated world for the whole runtime: tasks, disk, day clock, MQTT broker, operators and handlers. A seed
//! determines all of it.
//!
//! The whole world runs in one thread with the paused clock of a tokio executor: if no task is ready, time advances to
//! the next timer. The machine is the real runtime, from the MQTT end of the gateway to the servo cycle. The disk
//! ([`tandem_testing::simulated_disk`]), the threads ([`threads`]), the clock ([`clock`]) and the broker ([`broker`]) are models. Each seed
//! determines a history ([`history`]): several starts of the machine with faults. Each start ends in order, by a kill,
//! or by a power cut. An oracle ([`oracle`]) checks the answers that clients received against their requests.
//!
//! `TANDEM_SEEDS=7..8 TANDEM_TRACE=1 cargo test -p tandem-testing --test worlds seeds -- --nocapture` repeats seed 7.

#![allow(clippy::unwrap_used, clippy::panic, reason = "tests fail by panicking")]

mod broker;
mod clock;
mod handler;
mod history;
mod operator;
mod oracle;
mod port_observer;
mod process;
pub(crate) mod random;
mod threads;
mod trace;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use history::{History, HistoryOutcome, Mutation};
use oracle::Rule;

/// Name of the simulated machine; below, the root of its topics.
const MACHINE: &str = "mill";
const ROOT: &str = "tandem/v1/mill/";

/// Seeds that the tests run by default. Each takes 1.8 s of processor time without optimisation; `tests/run --long` runs 2,000
/// random seeds with optimisation.
const SEEDS: std::ops::Range<u64> = 0..200;

/// Plays the history of a seed and returns its outcome.
fn play(seed: u64, mutation: Option<Mutation>) -> HistoryOutcome {
    let played = catch_unwind(AssertUnwindSafe(|| History::new(seed, mutation).play()));
    played.unwrap_or_else(|_| HistoryOutcome::panicked())
}

/// Returns the seeds of `TANDEM_SEEDS=A..B`, otherwise the default seeds.
fn wanted() -> std::ops::Range<u64> {
    let Ok(text) = std::env::var("TANDEM_SEEDS") else {
        return SEEDS;
    };
    let ends = text
        .split_once("..")
        .and_then(|(from, to)| Some(from.parse().ok()?..to.parse().ok()?));
    ends.unwrap_or_else(|| panic!("TANDEM_SEEDS={text}: write A..B"))
}

#[test]
fn seeds() {
    let seeds = wanted();
    let (next, done, failed) = (AtomicU64::new(seeds.start), AtomicU64::new(0), AtomicU64::new(0));
    let begun = Instant::now();
    let threads: u64 = std::env::var("TANDEM_SEED_THREADS").map_or(2, |text| text.parse().unwrap());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed >= seeds.end {
                        return;
                    }
                    let outcome = play(seed, None);
                    done.fetch_add(1, Ordering::Relaxed);
                    for broken in &outcome.broken {
                        failed.fetch_add(1, Ordering::Relaxed);
                        print_result(&format!(
                            "seed {seed}: {:?}: {}\nrepeat it: TANDEM_TRACE=1 TANDEM_SEEDS={seed}..{} cargo test -p \
                             tandem-testing --test worlds seeds -- --nocapture",
                            broken.rule,
                            broken.how,
                            seed + 1
                        ));
                    }
                }
            });
        }
    });
    let (done, failed) = (done.into_inner(), failed.into_inner());
    let took_s = begun.elapsed().as_secs_f64();
    print_result(&format!(
        "{done} seeds of {seeds:?} in {took_s:.1} s, {:.1} a second: {failed} broken rules",
        done as f64 / took_s
    ));
    assert_eq!(failed, 0);
}

#[expect(clippy::print_stderr, reason = "the purpose of this test is its output")]
fn print_result(text: &str) {
    eprintln!("{text}");
}

#[test]
fn equal_seeds_give_equal_histories() {
    for seed in 0..8 {
        let (first, second) = (play(seed, None), play(seed, None));
        assert_eq!(first.sum, second.sum, "seed {seed}");
        assert!(first.completed > 0 || seed > 0, "something happens");
    }
}

/// Checks that within 100 seeds this rule detects a world with this defect.
fn is_found(mutation: Mutation, rule: Rule) {
    let found = (1000..1100).find(|seed| {
        let broken = play(*seed, Some(mutation)).broken;
        broken.iter().any(|broken| broken.rule == rule)
    });
    assert!(found.is_some(), "{mutation:?} is never found by {rule:?}");
}

#[test]
fn a_disk_that_lies_about_syncs_is_found() {
    is_found(Mutation::ForgetsSyncs, Rule::Kept);
}

#[test]
fn a_disk_that_goes_back_to_an_older_state_is_found() {
    is_found(Mutation::GoesBack, Rule::Kept);
}

#[test]
fn a_journal_without_its_ring_is_found() {
    is_found(Mutation::ForgetsAhead, Rule::Told);
}

#[test]
fn an_output_of_two_owners_is_found() {
    is_found(Mutation::TakesAllClaims, Rule::Owner);
}

#[test]
fn a_motion_that_nobody_commanded_is_found() {
    is_found(Mutation::Moves, Rule::Motion);
}

#[test]
fn a_machine_that_does_not_start_is_found() {
    is_found(Mutation::NoProgram, Rule::Starts);
}
