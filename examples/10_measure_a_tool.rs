//! A probe cycle that measures the wear of a tool: `cargo run --example 10_measure_a_tool`
//!
//! G31 moves the tool onto a setter and ends at its signal. M101 reads the captured position, writes the length into
//! the tool table, and rejects a tool that is too worn. The following G43 uses the new length.

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use plc_api::types::data::ToolData;
use plc_api::{Alarm, AuxOutput, Plc, SequenceProgram};
use tandem_testing::{Bench, TestError};

const MILL: u8 = 1;
const Z_MOTOR: u16 = 3;

/// Machine position of Z at which a tool without length would touch the setter, mm.
const SETTER: f64 = -200.0;

/// Wear from which a tool must be changed, mm.
const WEAR_MAX: f64 = 0.2;

/// M101: the preceding G31 has touched the setter with the tool in the spindle.
async fn measure(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let system = plc.coordinate_system(output.coordinate_system());
    let captured = system.captured().await?;
    let motors = captured.motors.iter().zip(&captured.positions);
    let touched = motors
        .zip(&captured.captured)
        .find_map(|((motor, z), came)| (*motor == Z_MOTOR && *came).then_some(*z))
        .ok_or(Alarm::user(1, "the tool did not touch the setter"))?;
    let id = system.tool().await?.id;
    let tools = plc.tools().await?;
    let tool = tools
        .into_iter()
        .find(|tool| tool.id == id)
        .ok_or(Alarm::user(2, "there is no tool in the spindle"))?;
    let length = touched - SETTER;
    let wear = tool.length - length;
    println!("  tool {id}: {length:.3} mm, worn by {wear:.3} mm");
    if wear > WEAR_MAX {
        return Err(Alarm::user(3, format!("tool {id} is worn by {wear:.3} mm")));
    }
    Ok(plc.set_tool(ToolData { length, ..tool }).await?)
}

fn machine() -> Result<Bench, TestError> {
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/config/probe.toml");
    Ok(Bench::with_config(config)?.serve(SequenceProgram::new().on(101, measure)))
}

fn main() -> Result<(), TestError> {
    println!("a tool that is worn a little");
    let run = machine()?
        .run("M06 VA1\nG90 G00 Z-100\nG31 Z-140 F200\nM101\nG00 Z0\nG43 G00 Z-150\nM30")?
        .completed()?;
    let z = run.system(MILL)?.machine["Z"];
    println!("  Z-150 with its length is {z:.3} mm of the machine");
    assert!((z + 150.0 - 79.95).abs() < 1e-6, "the length of the table counts");

    println!("a way that ends above the setter");
    let run = machine()?.run("M06 VA1\nG90 G00 Z-100\nG31 Z-110 F200\nM101\nM30")?;
    println!("  alarm: {}", run.alarm()?.text);

    println!("a tool that is worn too much");
    let run = machine()?
        .at_line(2, |scene| async move {
            let new = ToolData {
                id: 1,
                radius: 5.0,
                length: 81.0,
            };
            scene.plc().set_tool(new).await
        })
        .run("M06 VA1\nG90 G00 Z-100\nG31 Z-140 F200\nM101\nM30")?;
    println!("  alarm: {}", run.alarm()?.text);
    Ok(())
}
