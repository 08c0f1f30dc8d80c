//! A door that holds the machine while it is open: `cargo run --example 07_safety_door`
//!
//! This is how a sequence program follows a door contact: with the interlock, which holds motion on its path and lets
//! nothing that moves begin or go on while the door is open. When it is closed, the operator resumes. It keeps the
//! program in order. It protects nobody: that is the safety controller's.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use plc_api::{Execution, Plc};
use tandem_runtime::test::{Bench, TestError};
use tokio::sync::watch;

const MILL: u8 = 1;

/// Follows the door contact until it has gone. `true`: open.
async fn follow_door(plc: Plc, mut open: watch::Receiver<bool>) -> plc_api::Result<()> {
    let mill = plc.coordinate_system(MILL);
    loop {
        let is_open = *open.borrow_and_update();
        mill.set_interlock(is_open, if is_open { "the door is open" } else { "" })
            .await?;
        if open.changed().await.is_err() {
            return Ok(());
        }
    }
}

fn main() -> Result<(), TestError> {
    let (door, contact) = watch::channel(false);
    let closing = door.clone();
    let run = Bench::new()
        .at_s(0.0, move |scene| follow_door(scene.plc().clone(), contact))
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
            mill.resume().await
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
