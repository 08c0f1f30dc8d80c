use std::time::Duration;

use plc_protocol::types::machine::ActiveAlarms;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::{OverrideChange, RefusalCode};
use plc_protocol::types::state::{Execution, Overrides, Reason, State};
use plc_protocol::types::topic::{CsTopic, Topic};

use super::*;
use crate::coordinate_system::CoordinateSystem;
use crate::{Alarm, CancelReason, Error, Params, handlers::AuxOutput, handlers::SequenceProgram};

async fn slow(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    plc.sleep(Duration::from_secs(5)).await;
    Ok(())
}

async fn broken(_output: AuxOutput) -> Result<(), Alarm> {
    Err(Alarm::user(7, "the magazine is empty"))
}

async fn machine() -> (FakePort, CoordinateSystem) {
    let fake = FakePort::new([1, 2]);
    let plc = fake.plc();
    tokio::spawn(async move {
        let program = SequenceProgram::new().on(10, slow).on(11, broken).handler_id("h");
        program.run(&plc).await
    });
    fake.settle().await;
    let system = fake.plc().coordinate_system(1);
    (fake, system)
}

async fn word(system: &CoordinateSystem) -> (Execution, Option<Reason>) {
    let state = system.state().await.unwrap();
    (state.execution, state.reason)
}

fn refused(result: crate::Result<()>) -> RefusalCode {
    match result {
        Err(Error::Refused(refusal)) => refusal.code,
        other => panic!("{other:?}"),
    }
}

#[tokio::test]
async fn the_state_is_wait_while_an_output_is_open_and_active_after_its_reset() {
    let (fake, system) = machine().await;
    assert_eq!(word(&system).await, (Execution::Ready, None));
    system.start().await.unwrap();
    assert_eq!(word(&system).await, (Execution::Active, None));
    let seq = fake.issue_output(1, 10, Params::default());
    fake.settle().await;
    let state = system.state().await.unwrap();
    assert_eq!(state.execution, Execution::Wait);
    let waiting_on = state.waiting_on.unwrap();
    assert_eq!((waiting_on.m, waiting_on.seq), (10, seq));
    fake.advance(Duration::from_secs(5)).await;
    let state = system.state().await.unwrap();
    assert_eq!((state.execution, state.waiting_on), (Execution::Active, None));
    fake.end_program(1);
    assert_eq!(word(&system).await, (Execution::ProgramCompleted, None));
    assert_eq!(
        word(&fake.plc().coordinate_system(2)).await,
        (Execution::Ready, None)
    );
}

#[tokio::test]
async fn the_end_of_a_program_waits_for_its_open_outputs() {
    let (fake, system) = machine().await;
    fake.issue_output(1, 10, Params::default());
    fake.end_program(1);
    assert_eq!(word(&system).await.0, Execution::Wait);
    fake.advance(Duration::from_secs(5)).await;
    assert_eq!(word(&system).await.0, Execution::ProgramCompleted);
}

#[tokio::test]
async fn a_failed_output_is_an_alarm_stops_and_cancels_the_others() {
    let (fake, system) = machine().await;
    let other = fake.issue_output(1, 10, Params::default());
    fake.issue_output(1, 11, Params::default());
    fake.settle().await;
    assert_eq!(word(&system).await, (Execution::Stopped, Some(Reason::Alarm)));
    assert_eq!(
        fake.closed(1, other),
        Some(OutputOutcome::Cancelled(CancelReason::Alarm))
    );
    let active = fake.plc().port().read(&Topic::AlarmActive).await.unwrap();
    let Payload::AlarmActive(ActiveAlarms { alarms }) = &active.payload else {
        panic!("{active:?}");
    };
    assert_eq!(
        (alarms[0].number, alarms[0].text.as_str()),
        (10_007, "the magazine is empty")
    );
    assert_eq!(refused(system.load(1).await), RefusalCode::NotAllowed);
    system.reset().await.unwrap();
    let state = system.state().await.unwrap();
    assert_eq!((state.execution, state.alarm_count), (Execution::Ready, 0));
}

#[tokio::test]
async fn an_output_that_is_not_reset_in_its_time_is_an_alarm() {
    let (fake, system) = machine().await;
    fake.issue_output_within(1, 10, Params::default(), Some(Duration::from_secs(1)));
    fake.advance(Duration::from_secs(2)).await;
    assert_eq!(word(&system).await, (Execution::Stopped, Some(Reason::Alarm)));
}

#[tokio::test]
async fn under_hold_no_output_is_made_and_a_reset_is_latched_until_resume() {
    let (fake, system) = machine().await;
    let first = fake.issue_output(1, 10, Params::default());
    system.hold().await.unwrap();
    assert_eq!(
        system
            .state()
            .await
            .unwrap()
            .waiting_on
            .map(|waiting| waiting.seq),
        Some(first)
    );
    let second = fake.issue_output(1, 11, Params::default());
    fake.advance(Duration::from_secs(6)).await;
    assert_eq!(fake.closed(1, first), Some(OutputOutcome::Reset));
    assert_eq!(fake.closed(1, second), None, "it is queued");
    assert_eq!(word(&system).await, (Execution::FeedHold, None));
    system.resume().await.unwrap();
    fake.settle().await;
    assert!(matches!(
        fake.closed(1, second),
        Some(OutputOutcome::Failed { .. })
    ));
}

#[tokio::test]
async fn stop_abort_and_reset_cancel_and_end_the_run_each_in_its_state() {
    let (fake, system) = machine().await;
    let stopped = |reason| (Execution::Stopped, Some(reason));
    for (command, reason, word_after) in [
        ("stop", CancelReason::Stop, stopped(Reason::Stop)),
        ("abort", CancelReason::Abort, stopped(Reason::Aborted)),
        ("reset", CancelReason::Reset, (Execution::Ready, None)),
    ] {
        let seq = fake.issue_output(1, 10, Params::default());
        fake.settle().await;
        let command = plc_protocol::types::command::Command::parse(command, &serde_json::json!({})).unwrap();
        system.command(command).await.unwrap();
        assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Cancelled(reason)));
        assert_eq!(word(&system).await, word_after);
    }
    assert_eq!(refused(system.resume().await), RefusalCode::NotAllowed);
}

#[tokio::test]
async fn a_lost_handler_leaves_wait_with_its_reason() {
    let (fake, system) = machine().await;
    fake.issue_output(1, 10, Params::default());
    fake.settle().await;
    fake.disconnect_handler("h");
    assert_eq!(word(&system).await, (Execution::Wait, Some(Reason::HandlerLost)));
}

#[tokio::test]
async fn inputs_are_read_back_and_locks_refuse_with_their_text() {
    let (fake, system) = machine().await;
    system.set_optional_skip(3, true).await.unwrap();
    let change = OverrideChange {
        feed: Some(40.0),
        ..OverrideChange::default()
    };
    system.set_overrides(change).await.unwrap();
    assert_eq!(system.state().await.unwrap().optional_skip, [3]);
    let overrides = Overrides {
        feed: 40.0,
        ..Overrides::default()
    };
    assert_eq!(system.overrides().await.unwrap(), overrides);
    system.set_start_lock(true, "no oil").await.unwrap();
    let refusal = system.start().await.unwrap_err().to_string();
    assert!(refusal.contains("no oil"), "{refusal}");
    system.set_start_lock(false, "").await.unwrap();
    fake.issue_output(1, 10, Params::default());
    system.set_interlock(true, "the door is open").await.unwrap();
    assert_eq!(
        word(&system).await,
        (Execution::Interrupted, Some(Reason::Interlock))
    );
    assert_eq!(refused(system.resume().await), RefusalCode::StartLocked);
    system.set_interlock(false, "").await.unwrap();
    system.resume().await.unwrap();
    assert_eq!(word(&system).await.0, Execution::Wait);
}

#[tokio::test]
async fn a_state_that_is_said_is_what_commands_are_judged_by() {
    let (fake, system) = machine().await;
    let paused = State {
        execution: Execution::OptionalStop,
        ..State::default()
    };
    fake.publish_message(1, CsTopic::State, Payload::State(paused));
    system.resume().await.unwrap();
    assert_eq!(word(&system).await.0, Execution::Active);
    fake.restart();
    assert_eq!(word(&system).await, (Execution::Stopped, Some(Reason::Restarted)));
    assert_eq!(refused(system.start().await), RefusalCode::NotAllowed);
}
