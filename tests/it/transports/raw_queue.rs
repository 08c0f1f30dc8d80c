//! The raw queue over each transport: a claimed output has an owner, and is released when its owner dies.

use std::time::Duration;

use plc_api::{CoordinateSystem, Execution, Plc, RawOutput, Redelivery};
use plc_protocol::types::output::{OutputState, Redeliver};
use plc_protocol::types::request::Request;
use tokio::sync::oneshot;

use super::{Reached, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::wait::{until, within};

async fn claim(plc: &Plc) -> RawOutput {
    let mut outputs = plc.outputs().on(100).handler_id("raw");
    let output = within("an output", outputs.next()).await.expect("an output");
    within("a claim", output.claim()).await.expect("a claim");
    output
}

/// Claims the next output on a separate connection, which breaks without notice.
async fn claim_and_die(url: String) {
    let (claimed, is_claimed) = oneshot::channel();
    let (die, must_die) = std::sync::mpsc::channel::<()>();
    let process = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .expect("a runtime");
        let kept = runtime.block_on(async {
            let plc = Plc::connect(&url).await.expect("a machine there");
            let output = claim(&plc).await;
            (plc, output)
        });
        claimed.send(()).expect("the test waits");
        let _ended = must_die.recv();
        // all tasks end at once, and with them the connection: messages of destructors are too late
        runtime.shutdown_background();
        drop(kept);
    });
    within("a claim", is_claimed).await.expect("a claim");
    drop(die);
    process.join().expect("it has died");
}

async fn lost(system: &CoordinateSystem) {
    until("the claim is given back", async || {
        let pending = system.pending().await.ok()?;
        let output = pending.outputs.first()?;
        (output.state == OutputState::Output && output.lost).then_some(())
    })
    .await;
    let state = within("state", system.state()).await.expect("a state");
    assert_eq!(state.execution, Execution::Wait);
}

async fn who_dies_with_a_claim_gives_it_back(reached: &Reached) {
    let system = reached.plc.coordinate_system(1);
    within("load", system.load(50)).await.expect("load");
    within("start", system.start()).await.expect("start");
    if reached.url.is_empty() {
        drop(claim(&reached.plc).await);
    } else {
        claim_and_die(reached.url.clone()).await;
    }
    lost(&system).await;

    // it is online again, and does not receive the output again
    let mut outputs = reached.plc.outputs().on(100).handler_id("raw");
    let unasked = tokio::time::timeout(Duration::from_millis(300), outputs.next()).await;
    assert!(unasked.is_err(), "a lost output was given out unasked");
    let seq = system.pending().await.expect("pending").outputs[0].output.seq;
    let redeliver = Redeliver {
        boot_id: reached.plc.port().boot_id(),
        seq,
        how: Redelivery::Verify,
    };
    let redeliver = Request::Redeliver(1, Some(100), redeliver);
    within("redeliver", reached.plc.port().request(redeliver))
        .await
        .expect("redeliver");
    let again = within("the output again", outputs.next())
        .await
        .expect("an output");
    assert!(again.redelivered());
    within("a reset", again.reset()).await.expect("a reset");
    let completed = system.wait_until(Execution::ProgramCompleted);
    within("completed", completed).await.expect("a state");
}

#[tokio::test]
async fn in_process_who_dies_with_a_claim_of_the_raw_queue_gives_it_back() {
    let reached = in_process().await;
    who_dies_with_a_claim_gives_it_back(&reached).await;
    reached.end().await;
}

#[tokio::test]
async fn embedded_broker_dead_raw_queue_client_releases_its_claim() {
    who_dies_with_a_claim_gives_it_back(&over_the_embedded_broker().await).await;
}

#[tokio::test]
async fn over_mosquitto_who_dies_with_a_claim_of_the_raw_queue_gives_it_back() {
    let (reached, _broker) = over_mosquitto().await;
    who_dies_with_a_claim_gives_it_back(&reached).await;
}

#[tokio::test]
async fn over_rest_who_dies_with_a_claim_of_the_raw_queue_gives_it_back() {
    who_dies_with_a_claim_gives_it_back(&over_rest().await).await;
}
