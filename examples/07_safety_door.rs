//! A door that holds the machine while it is open: `cargo run --example 07_safety_door`
//!
//! This is how a sequence program follows a door contact: by a source of the interlock, which holds motion on its path and
//! lets nothing that moves begin or go on while the door is open. When it is closed, the operator resumes. The source is
//! the program's: it is written again when the machine has been started anew, nobody else clears it, and while the program
//! has gone the interlock is on, since the configuration declares it. It keeps the program in order. It protects nobody:
//! that is the safety controller's.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use plc_api::{Execution, SequenceProgram};
use tandem_runtime::test::{Bench, TestError};
use tokio::sync::watch;

const MILL: u8 = 1;

/// `true`: open.
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
