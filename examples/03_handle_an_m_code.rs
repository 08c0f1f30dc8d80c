//! An M code handled in the runtime's own process: `cargo run --example 03_handle_an_m_code`.
//!
//! The NC program moves, outputs M12 with a clamping force, and waits until the handler has returned.

#![allow(clippy::print_stdout, reason = "it shows what happens")]

use plc_api::types::request::typed::WriteProgram;
use plc_api::{Execution, Plc, SequenceProgram};
use tandem_runtime::{Config, Runtime};

#[path = "handlers/clamp.rs"]
mod clamp;

const PROGRAM: &str = "\
G54 G90
G01 X10 Y5 F3000
M12 VA5
G01 X0 Y0
M30
";

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let data = tempfile::tempdir()?;
    let mut config = Config::demo();
    config.machine.data_dir = data.path().to_owned();
    let runtime = Runtime::start(config).await?;
    let plc = Plc::in_process(runtime.port());

    // the sequence program serves the machine as long as it runs
    let serving = plc.clone();
    let handlers =
        tokio::spawn(async move { SequenceProgram::new().on(12, clamp::clamp).run(&serving).await });

    plc.port().ask(WriteProgram(50, PROGRAM.to_owned())).await?;
    let mill = plc.coordinate_system(1);
    mill.load(50).await?;
    mill.start().await?;
    let state = mill.wait_until(Execution::Wait).await?;
    println!(
        "the program waits for {:?}",
        state.waiting_on.map(|output| output.m)
    );
    mill.wait_until(Execution::ProgramCompleted).await?;
    println!("completed at {:?}", mill.position().await?.work);

    runtime.shutdown().await;
    handlers.abort();
    Ok(())
}
