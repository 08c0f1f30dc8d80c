//! A door that holds the machine while it is open: `cargo run --example 07_safety_door`
//!
//! A sequence program follows a door contact with a source of the interlock. While the door is open, the source holds
//! motion on its path and prevents the start of any motion. After the door is closed, the operator resumes. The source
//! belongs to the program: the program sets it again after a restart of the machine, and no other client clears it.
//! While the program is offline, the interlock is on, as the configuration declares. The source protects the process,
//! not people: that is the task of the safety controller.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use plc_api::{Execution, SequenceProgram};
use tandem_testing::{Bench, TestError};
use tokio::sync::watch;

const MILL: u8 = 1;

/// True while the door is open.
fn program(contact: watch::Receiver<bool>) -> SequenceProgram {
    SequenceProgram::new().interlock(MILL, "door", contact, "the door is open")
}

fn main() -> Result<(), TestError> {
    let (door, contact) = watch::channel(false);
    let closing = door.clone();
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/config/door.toml");
    let run = Bench::with_config(config)?
        .serve(program(contact))
        .at_s(1.0, move |_scene| async move {
            door.send_replace(true);
            Ok(())
        })
        .at_state(MILL, Execution::Interrupted, move |scene| async move {
            let (plc, mill) = (scene.plc(), scene.cs(MILL));
            let x = mill.position().await?.machine["X"];
            println!("{:6.3} s  door open: held at X {x:.3}", plc.now_s());
            if let Err(refusal) = mill.resume().await {
                println!("{:6.3} s  not resumed: {refusal}", plc.now_s());
            }
            plc.sleep(Duration::from_secs(5)).await;
            closing.send_replace(false);
            plc.sleep(Duration::from_millis(500)).await;
            println!("{:6.3} s  door closed: the operator resumes", plc.now_s());
            mill.resume().await?;
            mill.wait_until(Execution::ProgramCompleted).await?;
            scene.kill_handlers();
            plc.sleep(Duration::from_millis(1)).await;
            println!(
                "{:6.3} s  without the program: {}",
                plc.now_s(),
                mill.interlock().await?.text
            );
            Ok(())
        })
        .run("G90 G01 X100 F3000\nX0\nM30\n")?
        .completed()?;
    for change in &run.states {
        println!("{:6.3} s  {:?}", change.at_s, change.execution);
    }
    println!(
        "{:6.3} s  completed at {:?}",
        run.time_s,
        run.system(MILL)?.machine
    );
    Ok(())
}
