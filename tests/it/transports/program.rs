//! One sequence program and one NC program, each transport.

use std::sync::{Arc, Mutex};

use plc_api::{Alarm, AuxOutput, Execution, Params, Plc, SequenceProgram};
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::state::Reason;
use tokio::sync::Notify;

use super::{Reached, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::wait::{until, within};

/// Handles M100 with parameters: progress is visible while the program waits; after the reset the program
/// completes.
async fn an_m_code_is_handled(reached: &Reached) {
    let plc = reached.plc.clone();
    let (seen, go_on) = (Arc::new(Mutex::new(None)), Arc::new(Notify::new()));
    let (handler_seen, handler_go_on) = (Arc::clone(&seen), Arc::clone(&go_on));
    let change_tool = move |output: AuxOutput, plc: Plc| {
        let (seen, go_on) = (Arc::clone(&handler_seen), Arc::clone(&handler_go_on));
        async move {
            *seen.lock().unwrap() = Some((output.m(), *output.params(), output.program(), output.line()));
            output.progress("the magazine turns", 40.0).await?;
            go_on.notified().await;
            plc.coordinate_system(output.coordinate_system())
                .select_tool(7)
                .await?;
            Ok::<(), Alarm>(())
        }
    };
    let serving = plc.clone();
    let handlers =
        tokio::spawn(async move { SequenceProgram::new().on(100, change_tool).run(&serving).await });

    let system = plc.coordinate_system(1);
    within("load", system.load(50)).await.expect("load");
    within("start", system.start()).await.expect("start");
    let with_progress = system.wait_for(|state| {
        let progress = state
            .waiting_on
            .as_ref()
            .and_then(|waiting| waiting.progress.as_ref());
        progress
            .is_some_and(|progress| progress.text == "the magazine turns" && progress.percent == Some(40.0))
    });
    let state = within("progress", with_progress).await.expect("a state");
    assert_eq!(state.execution, Execution::Wait);
    assert_eq!(state.wait_state.as_deref(), Some("TOOL_LOAD"));
    let params = Params {
        a: Some(7.0),
        b: Some(-0.5),
        ..Params::default()
    };
    assert_eq!(seen.lock().unwrap().take(), Some((100, params, 50, 2)));

    go_on.notify_one();
    let completed = system.wait_until(Execution::ProgramCompleted);
    within("completed", completed).await.expect("a state");
    assert_eq!(within("tool", system.tool()).await.expect("a tool").id, 7);
    assert!(
        within("pending", system.pending())
            .await
            .expect("pending")
            .outputs
            .is_empty()
    );
    handlers.abort();
}

/// A handler that fails: alarm 10000 + code with its text, STOPPED.
async fn a_handler_error_is_an_alarm(reached: &Reached) {
    let plc = reached.plc.clone();
    let fail = |_: AuxOutput| async { Err::<(), _>(Alarm::user(7, "the magazine is empty: ä€")) };
    let serving = plc.clone();
    let handlers = tokio::spawn(async move { SequenceProgram::new().on(100, fail).run(&serving).await });
    let system = plc.coordinate_system(1);
    within("load", system.load(50)).await.expect("load");
    within("start", system.start()).await.expect("start");
    let stopped = system.wait_for(|state| state.reason == Some(Reason::Alarm) && state.transition.is_none());
    let state = within("STOPPED", stopped).await.expect("a state");
    assert_eq!((state.execution, state.alarm_count), (Execution::Stopped, 1));

    let alarms = within("alarms", plc.alarms()).await.expect("alarms");
    let [alarm] = alarms.as_slice() else {
        panic!("{alarms:?}");
    };
    assert_eq!(
        (alarm.number, alarm.text.as_str()),
        (10_007, "the magazine is empty: ä€")
    );
    assert_eq!(
        (alarm.cs, alarm.program, alarm.line),
        (Some(1), Some(50), Some(2))
    );
    let seen = system.acknowledge_alarm(alarm.id);
    within("acknowledged", seen).await.expect("acknowledged");
    until("somebody has seen it", async || {
        plc.alarms().await.ok()?[0].acknowledged_by.clone()
    })
    .await;
    let unknown = system.acknowledge_alarm(alarm.id + 1);
    assert!(within("acknowledged", unknown).await.is_err(), "no such alarm");
    // Over MQTT positions arrive ten times a second: this is the rest position.
    until("X rests at 5", async || {
        let position = system.position().await.expect("a position");
        ((position.machine["X"] - 5.0).abs() < 1e-9 && position.feedrate == 0.0).then_some(())
    })
    .await;
    within("reset", system.reset()).await.expect("reset");
    until("no alarm stands", async || {
        plc.alarms().await.ok()?.is_empty().then_some(())
    })
    .await;
    handlers.abort();
}

/// P is one array for all coordinate systems, Q one for each; a range is accepted or refused as a whole.
async fn variables_are_read_and_written_by_range(reached: &Reached) {
    let (one, two) = (reached.plc.coordinate_system(1), reached.plc.coordinate_system(2));
    let all: Vec<f64> = (0..1024).map(|n| f64::from(n) / 3.0).collect();
    let p = reached.plc.variables();
    within("write", p.write(31_744, &all))
        .await
        .expect("the last of P");
    assert_eq!(within("read", p.read(31_744, 1024)).await.expect("P"), all);
    one.variables()
        .write(5, &[f64::INFINITY, 2.5])
        .await
        .expect("Q of 1");
    two.variables().set(5, -1.0).await.expect("Q of 2");
    assert_eq!(
        one.variables().read(4, 3).await.expect("Q of 1"),
        [0.0, f64::INFINITY, 2.5]
    );
    assert_eq!(two.variables().get(5).await.expect("Q of 2"), -1.0);
    for (refused, code) in [
        (p.write(32_767, &[1.0, 2.0]).await, RefusalCode::Invalid),
        (p.write(0, &[0.0; 1025]).await, RefusalCode::TooLarge),
        (p.write(0, &[]).await, RefusalCode::Invalid),
        (one.variables().set(4096, 1.0).await, RefusalCode::Invalid),
        (
            reached.plc.coordinate_system(3).variables().set(0, 1.0).await,
            RefusalCode::NotFound,
        ),
    ] {
        let Err(plc_api::Error::Refused(refusal)) = refused else {
            panic!("{refused:?}");
        };
        assert_eq!(refusal.code, code, "{refusal}");
    }
    assert_eq!(p.get(32_767).await.expect("P32767"), all[1023]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn variables_are_read_and_written_by_range_over_every_transport() {
    let reached = in_process().await;
    variables_are_read_and_written_by_range(&reached).await;
    reached.end().await;
    let reached = over_the_embedded_broker().await;
    variables_are_read_and_written_by_range(&reached).await;
    let (reached, _broker) = over_mosquitto().await;
    variables_are_read_and_written_by_range(&reached).await;
    let reached = over_rest().await;
    variables_are_read_and_written_by_range(&reached).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_process_an_m_code_is_handled_and_a_handler_error_is_an_alarm() {
    let reached = in_process().await;
    an_m_code_is_handled(&reached).await;
    a_handler_error_is_an_alarm(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn embedded_broker_m_code_is_handled_and_a_handler_error_is_an_alarm() {
    let reached = over_the_embedded_broker().await;
    an_m_code_is_handled(&reached).await;
    a_handler_error_is_an_alarm(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_an_m_code_is_handled_and_a_handler_error_is_an_alarm() {
    let (reached, _broker) = over_mosquitto().await;
    an_m_code_is_handled(&reached).await;
    a_handler_error_is_an_alarm(&reached).await;
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_rest_an_m_code_is_handled_and_a_handler_error_is_an_alarm() {
    let reached = over_rest().await;
    an_m_code_is_handled(&reached).await;
    a_handler_error_is_an_alarm(&reached).await;
    reached.end().await;
}
