//! Starts a machine in this process, runs a program, and prints each change of its state until the program ends.
//!
//! ```text
//! cargo run --example 02_watch_the_state
//! ```

#![allow(clippy::print_stdout, reason = "an example shows what it does")]

use std::error::Error;

use plc_api::hub::Filter;
use plc_api::types::message::Payload;
use plc_api::types::request::typed::WriteProgram;
use plc_api::types::topic::{CsTopic, Topic};
use plc_api::{Execution, Plc};
use tandem_runtime::{Config, Runtime, demo_sequence_program};

const PROGRAM: &str = "
G90 G01 X40 F6000
M10 VA1 VB40    // a clamp: the program waits for its handler
G01 X0
M30
";

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let mut config = Config::demo();
    config.machine.data_dir = folder.path().to_owned();
    let runtime = Runtime::start(config).await?;

    let handlers = Plc::in_process(runtime.port());
    tokio::spawn(async move { demo_sequence_program().run(&handlers).await });

    let plc = Plc::in_process(runtime.port());
    plc.port().ask(WriteProgram(500, PROGRAM.to_owned())).await?;
    // the current value first, then every change
    let topic = Topic::cs(1, CsTopic::State);
    let mut states = plc.port().subscribe(Filter::Topics(vec![topic]));
    let mill = plc.coordinate_system(1);
    mill.load(500).await?;
    mill.start().await?;

    while let Some(message) = states.next().await {
        let Payload::State(state) = &message.payload else {
            continue;
        };
        print!("{}   {:?}", message.ts.0, state.execution);
        if let Some(waiting) = &state.waiting_on {
            print!(": waits for the reset of M{:02}", waiting.m);
            if let Some(progress) = &waiting.progress {
                print!(" ({})", progress.text);
            }
        }
        println!();
        match state.execution {
            Execution::ProgramCompleted => break,
            Execution::Stopped if state.alarm_count > 0 => return Err("an alarm stopped the program".into()),
            _ => {}
        }
    }
    runtime.shutdown().await;
    Ok(())
}
