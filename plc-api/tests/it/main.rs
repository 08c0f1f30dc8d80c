//! Sequence programs on the scripted machine, through the public interface only.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "this crate is tests and nothing else"
)]

mod alarms;
mod ask;
mod changes;
mod companions;
mod composed;
mod io;
mod locks;
mod outputs;
mod scan;
mod scan_operator;
mod validate;

use std::time::Duration;

use plc_api::fake::FakePort;
use plc_api::{Outputs, Params, RawOutput, SequenceProgram};
use tokio::task::JoinHandle;

/// Runs a sequence program in a separate task.
async fn serve(fake: &FakePort, program: SequenceProgram) -> JoinHandle<plc_api::Result<()>> {
    let plc = fake.plc();
    let task = tokio::spawn(async move { program.run(&plc).await });
    fake.settle().await;
    task
}

/// Works on the outputs of the raw queue, one after the other, in a separate task.
async fn serve_raw<Work>(
    fake: &FakePort,
    set: impl FnOnce(Outputs) -> Outputs,
    work: impl Fn(RawOutput) -> Work + Send + 'static,
) -> JoinHandle<()>
where
    Work: Future<Output = ()> + Send,
{
    let mut outputs = set(fake.plc().outputs());
    let task = tokio::spawn(async move {
        while let Ok(output) = outputs.next().await {
            work(output).await;
        }
    });
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
