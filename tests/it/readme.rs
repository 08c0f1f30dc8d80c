//! The Rust of the README, compiled and run as it stands there.
#![allow(dead_code, reason = "its main function connects to a machine")]

use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use std::time::Duration;

async fn clamp(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let force_kn = output.params().a().ok_or(Alarm::user(1, "M12 needs VA: the clamping force in kN"))?;
    if !(0.0..=20.0).contains(&force_kn) {
        return Err(Alarm::user(2, format!("a clamping force of {force_kn} kN is not in 0 to 20")));
    }
    output.progress("the clamp closes", 50.0).await?;
    plc.sleep(Duration::from_millis(400)).await; // the machine's own work
    Ok(()) // resets M12; an Err stops the program with its text, as alarm 10000 + code
}

#[tokio::main]
async fn main() -> plc_api::Result<()> {
    let plc = Plc::connect("mqtt://127.0.0.1:1883/mill-1").await?;
    SequenceProgram::new().on(12, clamp).run(&plc).await
}

use tandem_runtime::test::{Bench, TestError};

#[test]
fn m12_closes_the_clamp_before_the_motion_goes_on() -> Result<(), TestError> {
    let run = Bench::new().serve(SequenceProgram::new().on(12, clamp)).run("M12 VA5\nG01 X10 F3000\nM30")?.completed()?;
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
