//! On each transport, a cancel with its reason reaches the handler at any of its waits, and a hold keeps the
//! program held during a reset.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{
    Alarm, AuxOutput, CancelReason, Cancellation, CoordinateSystem, Execution, Plc, SequenceProgram,
};
use plc_protocol::types::output::{Reset, ResetResult};
use plc_protocol::types::request::Request;
use serde_json::json;
use tokio::sync::Notify;

use super::{
    Reached, broker_at, connect, in_process, machine, over_mosquitto, over_rest, over_the_embedded_broker,
};
use crate::support::broker::Mosquitto;
use crate::support::served::Served;
use crate::support::wait::{until, within};
use crate::support::wire::Wire;

/// Kind of the handler's wait.
#[derive(Debug, Clone, Copy)]
enum Waits {
    Asleep,
    ForTheOperator,
    ForTheMachine,
    ForItsOwn,
}

#[derive(Default)]
struct Shared {
    waits: Mutex<Option<Waits>>,
    own: Notify,
    dropped: Mutex<Vec<(bool, Option<CancelReason>)>>,
}

/// Records the kind of the handler's end.
struct Guard(Cancellation, Arc<Shared>);

impl Drop for Guard {
    fn drop(&mut self) {
        let seen = (self.0.is_cancelled(), self.0.reason());
        self.1.dropped.lock().unwrap().push(seen);
    }
}

async fn wait(output: AuxOutput, plc: Plc, shared: Arc<Shared>) -> Result<(), Alarm> {
    let _guard = Guard(output.cancellation(), Arc::clone(&shared));
    let waits = shared.waits.lock().unwrap().take();
    output.progress("it waits", None).await?;
    match waits.expect("the test says where") {
        Waits::Asleep => plc.sleep(Duration::from_secs(1000)).await,
        Waits::ForTheOperator => {
            output.ask("Shall it go on?", ["yes"]).await?;
        }
        Waits::ForTheMachine => {
            plc.coordinate_system(2)
                .wait_until(Execution::Interrupted)
                .await?;
        }
        Waits::ForItsOwn => shared.own.notified().await,
    }
    Ok(())
}

/// Runs program 50 until the handler of its M100 waits; returns the number of the output.
async fn until_it_waits(system: &CoordinateSystem, shared: &Shared, waits: Waits) -> u64 {
    *shared.waits.lock().unwrap() = Some(waits);
    within("load", system.load(50)).await.expect("load");
    within("start", system.start()).await.expect("start");
    let waiting = system.wait_for(|state| {
        let progress = state.waiting_on.as_ref().and_then(|on| on.progress.as_ref());
        progress.is_some_and(|progress| progress.text == "it waits")
    });
    let state = within("the handler waits", waiting).await.expect("a state");
    if matches!(waits, Waits::ForTheOperator) {
        within("a question", system.question()).await.expect("a question");
    }
    state.waiting_on.expect("an output").seq
}

async fn a_cancel_reaches_the_handler(reached: &Reached) {
    let (plc, shared) = (reached.plc.clone(), Arc::new(Shared::default()));
    let serving = plc.clone();
    let handler = plc_api::handlers::with(Arc::clone(&shared), wait);
    let program = SequenceProgram::new().on(100, handler).handler_id("waits");
    let handlers = tokio::spawn(async move { program.run(&serving).await });
    let system = plc.coordinate_system(1);
    let ended = async |what: &str, how: (bool, Option<CancelReason>)| {
        let seen = until(what, async || shared.dropped.lock().unwrap().pop()).await;
        assert_eq!(seen, how, "{what}");
        assert!(shared.dropped.lock().unwrap().is_empty(), "{what}: dropped once");
        until("nothing is open", async || {
            system.pending().await.ok()?.outputs.is_empty().then_some(())
        })
        .await;
    };
    let cancelled = |reason| (true, Some(reason));

    until_it_waits(&system, &shared, Waits::Asleep).await;
    within("stop", system.stop()).await.expect("stop");
    ended("a stop", cancelled(CancelReason::Stop)).await;
    within("reset", system.reset()).await.expect("reset");

    until_it_waits(&system, &shared, Waits::ForTheOperator).await;
    within("abort", system.abort()).await.expect("abort");
    ended("an abort", cancelled(CancelReason::Abort)).await;
    assert!(system.questions().await.expect("pending").is_empty());
    within("reset", system.reset()).await.expect("reset");

    until_it_waits(&system, &shared, Waits::ForTheMachine).await;
    within("reset", system.reset()).await.expect("reset");
    ended("a reset", cancelled(CancelReason::Reset)).await;

    let seq = until_it_waits(&system, &shared, Waits::ForItsOwn).await;
    let by_hand = Reset {
        boot_id: plc.port().boot_id(),
        seq,
        handler_id: "operator".into(),
        result: ResetResult::Ok,
        code: None,
        text: None,
        force: Some(true),
        instance: None,
    };
    let request = plc.port().request(Request::Reset(1, Some(100), by_hand));
    within("a reset by hand", request).await.expect("a reset");
    ended("a reset by hand", cancelled(CancelReason::Operator)).await;
    let completed = system.wait_until(Execution::ProgramCompleted);
    within("completed", completed).await.expect("a state");

    until_it_waits(&system, &shared, Waits::ForItsOwn).await;
    within("hold", system.hold()).await.expect("hold");
    shared.own.notify_one();
    ended("its own end under hold", (false, None)).await;
    let state = within("state", system.state()).await.expect("a state");
    assert_eq!(state.execution, Execution::FeedHold, "the reset is latched");
    within("resume", system.resume()).await.expect("resume");
    let completed = system.wait_until(Execution::ProgramCompleted);
    within("completed", completed).await.expect("a state");
    handlers.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_process_a_cancel_reaches_the_handler_wherever_it_waits() {
    let reached = in_process().await;
    a_cancel_reaches_the_handler(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn embedded_broker_cancel_reaches_a_handler_at_any_wait() {
    a_cancel_reaches_the_handler(&over_the_embedded_broker().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_a_cancel_reaches_the_handler_wherever_it_waits() {
    let (reached, _broker) = over_mosquitto().await;
    a_cancel_reaches_the_handler(&reached).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_rest_a_cancel_reaches_the_handler_wherever_it_waits() {
    a_cancel_reaches_the_handler(&over_rest().await).await;
}

/// Number of messages that a client library and the broker hold together: further messages wait where a later
/// value replaces an earlier one.
const ON_THE_WAY_MAX: u32 = 300;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn slow_link_delivers_the_cancel_before_a_later_pending() {
    let broker = Mosquitto::start();
    let wire = Wire::to(&broker.address()).await;
    let machine = machine(&broker_at(wire.address()));
    let served = Served::start(&machine);
    let plc = connect(&format!("mqtt://{}/test-1", broker.address())).await;
    let shared = Arc::new(Shared::default());
    let serving = plc.clone();
    let handler = plc_api::handlers::with(Arc::clone(&shared), wait);
    let program = SequenceProgram::new().on(100, handler).handler_id("waits");
    let handlers = tokio::spawn(async move { program.run(&serving).await });
    let seq = until_it_waits(&plc.coordinate_system(1), &shared, Waits::Asleep).await;

    wire.cut();
    for n in 0..ON_THE_WAY_MAX {
        let feed = json!({"feed": 50 + n % 2});
        served.put("/cs/1/overrides", &feed).await.expect(204);
    }
    // `pending` waits with this message; the cancel follows, then a `pending` without the output
    let boot_id = served.state(1).await["boot_id"].clone();
    let progress = json!({"boot_id": boot_id, "handler_id": "waits", "text": "still"});
    let path = format!("/cs/1/m_codes/{seq}/progress");
    let told = served.post(&path, &progress).await;
    assert!((200..300).contains(&told.status), "{told:?}");
    served.command(1, "stop").await;
    wire.mend();
    let ended = async || shared.dropped.lock().unwrap().pop();
    let seen = until("the handler is dropped", ended).await;
    assert_eq!(seen, (true, Some(CancelReason::Stop)));
    handlers.abort();
}
