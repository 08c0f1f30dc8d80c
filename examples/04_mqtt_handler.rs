//! The same M code handled in another process: `cargo run --example 04_mqtt_handler`, until Ctrl-C.
//!
//! It serves a machine over MQTT, and continues after the broker or the machine was offline. To test it:
//! ```text
//! tandem serve
//! printf 'G54 G90\nG01 X10 F3000\nM12 VA5\nM30\n' | curl -T - http://127.0.0.1:8080/api/v1/programs/50
//! curl -X POST --json '{"program":50}' http://127.0.0.1:8080/api/v1/cs/1/load
//! curl -X POST http://127.0.0.1:8080/api/v1/cs/1/start
//! ```

#![allow(clippy::print_stdout, reason = "it shows what happens")]

use plc_api::{Plc, SequenceProgram, stop_signal};

#[path = "handlers/clamp.rs"]
mod clamp;

#[tokio::main]
async fn main() -> Result<(), Box<dyn std::error::Error>> {
    let address = std::env::args().nth(1);
    let address = address.as_deref().unwrap_or("mqtt://127.0.0.1:1883/mill-1");
    let plc = Plc::connect(address).await?;
    println!("M12 of {address} is handled here; Ctrl-C ends");

    let program = SequenceProgram::new().handler_id("clamp").on(12, clamp::clamp);
    Ok(program.run_until(&plc, stop_signal()).await?)
}
