//! The machine builder's side over the scripted machine, through the public interface only.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "this crate is tests and nothing else"
)]

mod alarms;
mod ask;
mod scan;
mod validate;

use std::time::Duration;

use plc_api::fake::FakePort;
use plc_api::{Params, SequenceProgram};
use tokio::task::JoinHandle;

/// Serves the machine from a task of its own.
async fn serve(fake: &FakePort, program: SequenceProgram) -> JoinHandle<plc_api::Result<()>> {
    let plc = fake.plc();
    let task = tokio::spawn(async move { program.run(&plc).await });
    fake.settle().await;
    task
}

fn va(a: f64) -> Params {
    Params {
        a: Some(a),
        ..Params::default()
    }
}

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}
