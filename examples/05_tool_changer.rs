//! A tool changer with a magazine, tested in simulated time: `cargo run --example 05_tool_changer`
//!
//! M100 VA turns the magazine to tool VA and changes the tool. A program with a tool that is not in the magazine is
//! rejected when it is loaded. A stop during a turn of the magazine stops its motor.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, HandlerState, MCode, Params, Plc, SequenceProgram};
use tandem_testing::{Bench, TestError};

const CHANGE_TOOL: MCode = MCode::new(100, "change tool");
const POCKETS: u16 = 24;
const POCKET_TIME: Duration = Duration::from_millis(250);

/// The pocket at the spindle, shared by all handlers that move the magazine.
type Magazine = Arc<Mutex<u16>>;

#[derive(Params)]
struct Change {
    /// Tool number, also the number of its pocket.
    #[va(1..=POCKETS)]
    tool: u16,
}

async fn change_tool(
    Change { tool }: Change,
    HandlerState(magazine): HandlerState<Magazine>,
    output: AuxOutput,
    plc: Plc,
) -> Result<(), Alarm> {
    // dropped with this future at its end, and when the output is cancelled
    println!("  magazine motor on");
    let _motor = Motor;
    while *here(&magazine) != tool {
        let text = format!("pocket {} of {tool}", here(&magazine));
        output.progress(text, None).await?;
        plc.sleep(POCKET_TIME).await;
        let next = *here(&magazine) % POCKETS + 1;
        *here(&magazine) = next;
    }
    plc.sleep(Duration::from_millis(900)).await; // the arm swaps
    let system = plc.coordinate_system(output.coordinate_system());
    Ok(system.select_tool(tool).await?)
}

fn here(magazine: &Magazine) -> MutexGuard<'_, u16> {
    magazine.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The magazine's motor: on while this value exists.
struct Motor;

impl Drop for Motor {
    fn drop(&mut self) {
        println!("  magazine motor off");
    }
}

fn machine() -> Bench {
    let program = SequenceProgram::new().state(Magazine::new(Mutex::new(1)));
    Bench::new().serve(program.on(CHANGE_TOOL, change_tool))
}

fn main() -> Result<(), TestError> {
    let run = machine().run("G00 Z50\nM100 VA5\nG00 Z0\nM30")?.completed()?;
    let tool = run.system(1)?.tool;
    println!("tool {tool} after {:.2} s", run.output(100)?.took_s()?);
    let stopped = machine().at_s(1.0, |scene| async move { scene.cs(1).stop().await });
    let run = stopped.run("M100 VA12\nM30")?;
    println!("{:?} after {:.2} s", run.output(100)?.ended, run.time_s);
    if let Err(refusal) = machine().run("M100 VA30\nM30") {
        println!("{refusal}");
    }
    Ok(())
}
