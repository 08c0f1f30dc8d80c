//! Runs an NC program in simulated time, as fast as the computer can, and prints the position of the machine.
//!
//! ```text
//! cargo run --example 01_simulate_a_program
//! ```

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::error::Error;
use std::time::Duration;

use plc_api::types::request::typed::WriteProgram;
use plc_api::{Execution, Plc};
use tandem_runtime::journal::Journal;
use tandem_runtime::simulation::{self, SimulationOptions};
use tandem_runtime::{Config, Runtime};

const PROGRAM: &str = "
G90 G17 G54
M03 S3000
G00 X20 Y10
G01 Z-5 F600
X60 F2400
Y40
G04 P500
G00 Z50
M05
M30
";

fn main() -> Result<(), Box<dyn Error>> {
    simulation::run(simulate())?
}

async fn simulate() -> Result<(), Box<dyn Error>> {
    // the demo machine: three axes and a spindle in coordinate system 1
    let machine = Config::demo().resolve()?;
    let runtime = Runtime::start_simulated(machine, Journal::to_log(), SimulationOptions::default())?;
    let plc = Plc::in_process(runtime.port());
    plc.port().ask(WriteProgram(500, PROGRAM.to_owned())).await?;
    let mill = plc.coordinate_system(1);
    mill.load(500).await?;
    mill.start().await?;
    loop {
        let position = mill.position().await?;
        let line = mill.program().await?.line;
        let axis = |letter: &str| position.work.get(letter).copied().unwrap_or_default();
        println!(
            "{:6.3} s   line {line:>2}   X{:8.3}  Y{:8.3}  Z{:8.3}   F{:7.1} mm/min",
            plc.now_s(),
            axis("X"),
            axis("Y"),
            axis("Z"),
            position.feedrate,
        );
        let state = mill.state().await?;
        match state.execution {
            Execution::Active | Execution::Wait => plc.sleep(Duration::from_millis(250)).await,
            Execution::ProgramCompleted => return Ok(()),
            other => return Err(format!("the program ended in {other:?}, {:?}", state.reason).into()),
        }
    }
}
