//! Alarms that a sequence program raises, for one coordinate system and for all, each transport.

use plc_api::{Alarm, CancelReason, CoordinateSystem, Error, Execution, Plc, SequenceProgram};
use plc_protocol::types::state::Reason;
use tokio::sync::mpsc;

use super::{Reached, in_process, over_mosquitto, over_rest, over_the_embedded_broker};
use crate::support::wait::{until, within};

/// Waits until the coordinate system is STOPPED by an alarm, with this number of alarms that affect it.
async fn stopped(system: &CoordinateSystem, alarms: u32) {
    let is_stopped = |state: &plc_protocol::types::state::State| {
        (state.execution, state.reason, state.alarm_count)
            == (Execution::Stopped, Some(Reason::Alarm), alarms)
    };
    within("STOPPED", system.wait_for(is_stopped))
        .await
        .expect("a state");
}

/// Returns numbers and coordinate systems of the active alarms, when there are this many.
async fn standing(plc: &Plc, count: usize) -> Vec<(u16, Option<u8>, String)> {
    until("the alarms that stand", async || {
        let alarms = plc.alarms().await.ok()?;
        let told = alarms
            .into_iter()
            .map(|alarm| (alarm.number, alarm.cs, alarm.text));
        Some(told.collect::<Vec<_>>()).filter(|alarms| alarms.len() == count)
    })
    .await
}

async fn alarms_of_one_and_of_all(reached: &Reached) {
    let plc = reached.plc.clone();
    let (first, second) = (plc.coordinate_system(1), plc.coordinate_system(2));
    let (ended, mut ends) = mpsc::unbounded_channel();
    let serving = plc.clone();
    let program = SequenceProgram::new().on(100, move |output: plc_api::AuxOutput, plc: Plc| {
        let (cancellation, ended) = (output.cancellation(), ended.clone());
        tokio::spawn(async move { ended.send(cancellation.cancelled().await) });
        async move {
            plc.sleep(std::time::Duration::from_secs(1000)).await;
            Ok(())
        }
    });
    let handlers = tokio::spawn(async move { program.run(&serving).await });
    let until_claimed = async || {
        within("load", first.load(50)).await.expect("load");
        within("start", first.start()).await.expect("start");
        until("the handler works", async || {
            let pending = first.pending().await.ok()?;
            pending.outputs.first()?.handler_id.clone()
        })
        .await;
    };

    until_claimed().await;
    let low = Alarm::user(20, "the air pressure is low: ä");
    within("raised", plc.raise_alarm(low)).await.expect("an alarm");
    stopped(&first, 1).await;
    stopped(&second, 1).await;
    let cancel = within("the handler is cancelled", ends.recv()).await;
    assert_eq!(cancel, Some(Some(CancelReason::Alarm)));
    let all = (10_020, None, "the air pressure is low: ä".to_owned());
    assert_eq!(standing(&plc, 1).await, std::slice::from_ref(&all));
    assert!(
        within("load", second.load(50)).await.is_err(),
        "an alarm is active"
    );

    let id = within("alarms", plc.alarms()).await.expect("alarms")[0].id;
    within("acknowledged", second.acknowledge_alarm(id))
        .await
        .expect("acknowledged");
    until("somebody has seen it", async || {
        plc.alarms().await.ok()?[0].acknowledged_by.clone()
    })
    .await;

    let jam = Alarm::user(21, "the conveyor is jammed");
    within("raised", second.raise_alarm(jam)).await.expect("an alarm");
    stopped(&second, 2).await;
    let of_second = (10_021, Some(2), "the conveyor is jammed".to_owned());
    assert_eq!(standing(&plc, 2).await, [all, of_second.clone()]);
    // a reset of one clears its own alarms and those of all, and leaves the other unchanged
    within("reset", first.reset()).await.expect("reset");
    assert_eq!(standing(&plc, 1).await, [of_second]);
    stopped(&second, 1).await;
    until_claimed().await;
    within("reset", second.reset()).await.expect("reset");
    assert_eq!(standing(&plc, 0).await, []);
    let state = within("state", first.state()).await.expect("a state");
    assert_eq!(state.execution, Execution::Wait, "it is not touched");
    handlers.abort();
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn in_process_an_alarm_stops_one_coordinate_system_or_all() {
    let reached = in_process().await;
    alarms_of_one_and_of_all(&reached).await;
    let ninth = reached.plc.coordinate_system(9);
    let unknown = ninth.raise_alarm(Alarm::user(1, "x")).await;
    assert!(matches!(unknown, Err(Error::Refused(_))));
    let without_text = reached.plc.raise_alarm(Alarm::user(1, ""));
    assert!(matches!(without_text.await, Err(Error::Refused(_))));
    let of_the_runtime = Alarm {
        number: 102,
        text: "x".into(),
    };
    assert!(matches!(
        reached.plc.raise_alarm(of_the_runtime).await,
        Err(Error::Refused(_))
    ));
    reached.end().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_the_embedded_broker_an_alarm_stops_one_coordinate_system_or_all() {
    alarms_of_one_and_of_all(&over_the_embedded_broker().await).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_mosquitto_an_alarm_stops_one_coordinate_system_or_all() {
    let (reached, _broker) = over_mosquitto().await;
    alarms_of_one_and_of_all(&reached).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn over_rest_an_alarm_stops_one_coordinate_system_or_all() {
    alarms_of_one_and_of_all(&over_rest().await).await;
}
