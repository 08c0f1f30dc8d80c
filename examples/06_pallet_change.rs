//! Two coordinate systems meet at M codes and change pallets: `cargo run --example 06_pallet_change`
//!
//! Mill (coordinate system 1) and loader (2) run their own programs. Both output M70 at the pallet changer; the first
//! one waits. When both have arrived, the pallets turn, and both programs continue.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use plc_api::handlers::with;
use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use tandem_testing::{Bench, TestError};
use tokio::sync::watch;

const MILL: u8 = 1;
const LOADER: u8 = 2;

/// Number of turns of the pallets. Cancelled handlers do not change it.
type Turns = watch::Sender<u32>;

/// The mill's M70: the mill is clear of the pallet. It waits for the loader, then the pallets turn.
async fn turn_pallets(output: AuxOutput, plc: Plc, turns: Turns) -> Result<(), Alarm> {
    output
        .progress("the mill is clear, and waits for the loader", None)
        .await?;
    let is_there = |waiting: &plc_api::types::state::WaitingOn| waiting.m == 70;
    let loader = plc.coordinate_system(LOADER);
    loader
        .wait_for(|state| state.waiting_on.as_ref().is_some_and(is_there))
        .await?;
    for percent in [0.0, 50.0] {
        output.progress("the pallets turn", percent).await?;
        plc.sleep(Duration::from_secs(2)).await;
    }
    turns.send_modify(|turns| *turns += 1);
    Ok(())
}

/// The loader's M70: the loader is clear of the pallet. It waits until the pallets have turned.
async fn until_turned(output: AuxOutput, _plc: Plc, turns: Turns) -> Result<(), Alarm> {
    output
        .progress("the loader is clear, and waits for the mill", None)
        .await?;
    let ended = turns.subscribe().changed().await;
    ended.map_err(|_| Alarm::user(70, "the pallet changer has gone"))
}

fn main() -> Result<(), TestError> {
    let turns = Turns::default();
    let program = SequenceProgram::new()
        .in_coordinate_system(MILL, |mill| mill.on(70, with(turns.clone(), turn_pallets)))
        .in_coordinate_system(LOADER, |loader| loader.on(70, with(turns.clone(), until_turned)));
    let mill = "G00 Z50\nG01 X100 F3000\nG00 X0\nM70\nG01 Z0 F3000\nM30\n";
    let loader = "G00 X800\nG00 Z-200\nG00 Z0\nM70\nG00 X0\nM30\n";
    let run = Bench::new()
        .serve(program)
        .beside(LOADER, 20, loader)
        .run(mill)?
        .completed()?;
    for output in &run.outputs {
        println!(
            "coordinate system {} is at the changer at {:.3} s, goes on at {:.3} s",
            output.cs,
            output.output_s,
            output.output_s + output.took_s()?
        );
    }
    println!(
        "the pallets turned {} time; both programs ended after {:.3} s",
        *turns.borrow(),
        run.time_s
    );
    Ok(())
}
