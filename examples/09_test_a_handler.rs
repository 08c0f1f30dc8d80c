//! Unit tests of a handler, without a machine: `cargo run --example 09_test_a_handler`, and
//! `cargo test --example 09_test_a_handler` as tests.
//!
//! The first test uses the scripted machine of plc-api, the others a complete runtime in simulated time. In your own
//! project, tandem-runtime is a dev-dependency, and the functions below are in `tests/`.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::types::state::Reason;
use plc_api::{Alarm, Params, Redelivery, SequenceProgram};
use tandem_testing::{Bench, TestError};

#[path = "handlers/clamp.rs"]
mod clamp;

fn program() -> SequenceProgram {
    SequenceProgram::new()
        .on(12, clamp::clamp)
        .on_redelivery(Redelivery::Redo)
}

#[cfg_attr(test, tokio::test)]
#[cfg_attr(not(test), tokio::main(flavor = "current_thread"))]
async fn a_force_that_the_clamp_has_not_is_an_alarm() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    tokio::spawn(async move { program().run(&plc).await });
    let seq = fake.issue_output(
        1,
        12,
        Params {
            a: Some(21.0),
            ..Params::default()
        },
    );
    fake.settle().await;
    let alarm = Alarm::user(2, "a clamping force of 21 kN is not in 0 to 20");
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Failed { alarm }));
}

#[cfg_attr(test, test)]
fn the_motion_waits_for_the_clamp() -> Result<(), TestError> {
    let run = Bench::new()
        .serve(program())
        .run("M12 VA5\nG01 X10 F3000\nM30")?
        .completed()?;
    assert_eq!(run.order(1), ["output M12 VA5", "reset M12", "block 2", "end"]);
    assert!(run.output(12)?.took_s()? >= 0.4);
    Ok(())
}

#[cfg_attr(test, test)]
fn a_clamp_whose_process_dies_closes_again_when_it_is_back() -> Result<(), TestError> {
    let bench = Bench::new().serve(program()).at_s(0.1, |scene| async move {
        scene.kill_handlers();
        scene.plc().sleep(Duration::from_secs(3)).await;
        scene.serve(program());
        Ok(())
    });
    let run = bench.run("M12 VA5\nM30")?.completed()?;
    assert!(
        run.states
            .iter()
            .any(|change| change.reason == Some(Reason::HandlerLost))
    );
    assert!((3.5..3.6).contains(&run.output(12)?.took_s()?));
    Ok(())
}

fn main() -> Result<(), TestError> {
    a_force_that_the_clamp_has_not_is_an_alarm();
    the_motion_waits_for_the_clamp()?;
    a_clamp_whose_process_dies_closes_again_when_it_is_back()?;
    println!("all is as it should be");
    Ok(())
}
