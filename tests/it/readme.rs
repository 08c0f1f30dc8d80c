//! The Rust code of the README, compiled and run unchanged.
#![allow(dead_code, reason = "its main function connects to a machine")]

use plc_api::units::KiloNewton;
use plc_api::{Alarm, AuxOutput, MCode, Plc, SequenceProgram, Va};
use std::time::Duration;

const CLAMP: MCode = MCode::new(12, "clamp");

/// VA: the force. A program with a force out of this range is refused when it is loaded, with line and column.
async fn clamp(Va(force): Va<KiloNewton<0, 20>>, output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    output.progress(format!("the clamp closes with {force}"), 50.0).await?;
    plc.sleep(Duration::from_millis(400)).await; // the machine's own work
    Ok(()) // resets M12; an Err stops the program with its text, as alarm 10000 + code
}

#[tokio::main]
async fn main() -> plc_api::Result<()> {
    let plc = Plc::connect("mqtt://127.0.0.1:1883/mill-1").await?;
    SequenceProgram::new().on(CLAMP, clamp).run(&plc).await
}

use tandem_testing::{Bench, TestError};

#[test]
fn m12_closes_the_clamp_before_the_motion_goes_on() -> Result<(), TestError> {
    let bench = Bench::new().serve(SequenceProgram::new().on(CLAMP, clamp));
    let run = bench.run("M12 VA5\nG01 X10 F3000\nM30")?.completed()?;
    assert_eq!(run.order(1), ["output M12 VA5", "reset M12", "block 2", "end"]);
    assert!(run.output(12)?.took_s()? >= 0.4);
    Ok(())
}

#[test]
fn the_readme_shows_code_that_is_tested_here() {
    let (readme, tested) = (include_str!("../../README.md"), include_str!("readme.rs"));
    let mut blocks = readme.split("```rust\n").skip(1).filter_map(|rest| rest.split_once("```"));
    assert!(blocks.all(|(block, _)| tested.contains(block)));
    assert_eq!(readme.matches("```rust\n").count(), 2);
}
