//! The raw queue: it owns a claimed output like any handler, and releases the output when the queue ends.

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::{Alarm, CancelReason, Error, Outputs, Params, RawOutput, Redelivery};
use plc_protocol::types::output::{HandshakeStatus, OutputState};
use tokio::task::JoinHandle;

use crate::serve_raw;

/// Claims the output, and never answers.
async fn claim_and_work_for_ever(output: RawOutput) {
    output.claim().await.unwrap();
    std::future::pending::<()>().await;
}

async fn begin(fake: &FakePort) -> JoinHandle<()> {
    serve_raw(fake, |outputs| outputs.handler_id("raw"), claim_and_work_for_ever).await
}

fn state(fake: &FakePort) -> (OutputState, bool) {
    let pending = fake.pending(1);
    (pending[0].state, pending[0].lost)
}

#[tokio::test]
async fn who_dies_with_a_claim_of_the_raw_queue_gives_it_back() {
    let fake = FakePort::new([1]);
    let task = begin(&fake).await;
    fake.issue_output(1, 100, Params::default());
    fake.settle().await;
    assert_eq!(state(&fake), (OutputState::Claimed, false));
    task.abort();
    fake.settle().await;
    assert_eq!(state(&fake), (OutputState::Output, true));
}

#[tokio::test]
async fn a_raw_output_is_owned_as_long_as_it_or_its_queue_is_there() {
    let fake = FakePort::new([1]);
    let seq = fake.issue_output(1, 100, Params::default());
    let plc = fake.plc();
    let mut outputs = plc.outputs();
    let output = outputs.next().await.unwrap();
    output.claim().await.unwrap();
    drop(outputs);
    fake.settle().await;
    assert_eq!(state(&fake), (OutputState::Claimed, false));
    output.reset().await.unwrap();
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    drop(output);
    fake.settle().await;
    assert!(fake.handlers().values().all(|presence| !presence.online));
}

#[tokio::test]
async fn a_raw_output_that_fails_stops_the_program_with_its_alarm() {
    let fake = FakePort::new([1]);
    let seq = fake.issue_output(1, 100, Params::default());
    let output = fake.plc().outputs().next().await.unwrap();
    let alarm = Alarm::user(7, "the magazine is empty");
    output.fail(alarm.clone()).await.unwrap();
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Failed { alarm }));
}

/// Returns the outputs that a queue offers now, each with true if the receiver must check the machine first.
async fn given(fake: &FakePort, outputs: &mut Outputs) -> Vec<(u64, bool)> {
    let mut given = Vec::new();
    loop {
        tokio::select! {
            biased;
            output = outputs.next() => {
                let output = output.unwrap();
                given.push((output.notice().seq, output.redelivered()));
            }
            () = fake.settle() => return given,
        }
    }
}

/// Issues an output, and ends the program that has claimed the output. Returns its `seq`.
async fn lost(fake: &FakePort) -> u64 {
    let seq = fake.issue_output(1, 100, Params::default());
    let task = begin(fake).await;
    task.abort();
    fake.settle().await;
    assert_eq!(state(fake), (OutputState::Output, true));
    seq
}

#[tokio::test]
async fn a_raw_queue_with_ask_leaves_a_lost_output_until_an_operator_decides() {
    for (how, verify) in [(Redelivery::Redo, false), (Redelivery::Verify, true)] {
        let fake = FakePort::new([1]);
        let seq = lost(&fake).await;
        let mut outputs = fake.plc().outputs();
        assert_eq!(given(&fake, &mut outputs).await, []);
        fake.redeliver(1, seq, how);
        assert_eq!(given(&fake, &mut outputs).await, [(seq, verify)]);
    }
}

#[tokio::test]
async fn a_raw_queue_with_redo_or_verify_gives_a_lost_output_at_once() {
    for (how, verify) in [(Redelivery::Redo, false), (Redelivery::Verify, true)] {
        let fake = FakePort::new([1]);
        let seq = lost(&fake).await;
        let mut outputs = fake.plc().outputs().on_redelivery(how);
        assert_eq!(given(&fake, &mut outputs).await, [(seq, verify)]);
    }
}

#[tokio::test]
async fn a_raw_queue_for_some_codes_gives_these_and_tells_the_machine() {
    let fake = FakePort::new([1, 2]);
    fake.issue_output(1, 99, Params::default());
    let first = fake.issue_output(1, 100, Params::default());
    let second = fake.issue_output(1, 120, Params::default());
    let mut outputs = fake.plc().outputs().on(100).on(110..=500).handler_id("raw");
    assert_eq!(
        given(&fake, &mut outputs).await,
        [(first, false), (second, false)]
    );
    let handles = &fake.handlers()["raw"].handles;
    let told = handles.iter().map(|code| (code.cs, code.m));
    let codes = || std::iter::once(100).chain(110..=191);
    assert!(told.eq([1, 2].into_iter().flat_map(|cs| codes().map(move |m| (cs, m)))));
}

#[tokio::test]
async fn raw_queue_reclaims_after_connection_loss_without_yielding_it_again() {
    let fake = FakePort::new([1]);
    let seq = fake.issue_output(1, 100, Params::default());
    let mut outputs = fake.plc().outputs().on(100).on_redelivery(Redelivery::Redo);
    let output = outputs.next().await.unwrap();
    output.claim().await.unwrap();
    let id = fake.pending(1)[0].handler_id.clone().unwrap();
    fake.disconnect_handler(&id);
    assert_eq!(state(&fake), (OutputState::Output, true));
    assert_eq!(given(&fake, &mut outputs).await, []);
    assert_eq!(fake.pending(1)[0].handler_id, Some(id));
    output.reset().await.unwrap();
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn a_raw_queue_serves_the_next_boot_too() {
    let fake = FakePort::new([1]);
    let mut outputs = fake.plc().outputs().on(100).handler_id("raw");
    assert_eq!(given(&fake, &mut outputs).await, []);
    fake.restart();
    let seq = fake.issue_output(1, 100, Params::default());
    let output = outputs.next().await.unwrap();
    output.reset().await.unwrap();
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    fake.settle().await;
    assert!(fake.handlers()["raw"].online);
}

#[tokio::test]
async fn a_raw_queue_by_a_name_that_is_none_is_refused() {
    let fake = FakePort::new([1]);
    for id in ["", "a/b", &"a".repeat(65)] {
        let refused = fake.plc().outputs().handler_id(id).next().await;
        assert!(matches!(refused, Err(Error::SequenceProgram(_))), "{id:?}");
    }
}

#[tokio::test]
async fn a_raw_output_is_given_out_once_and_again_only_after_it_was_dropped() {
    let fake = FakePort::new([1]);
    let seq = fake.issue_output(1, 100, Params::default());
    let mut outputs = fake.plc().outputs();
    let output = outputs.next().await.unwrap();
    fake.redeliver(1, seq, Redelivery::Redo);
    assert_eq!(given(&fake, &mut outputs).await, []);
    drop(output);
    fake.redeliver(1, seq, Redelivery::Redo);
    assert_eq!(given(&fake, &mut outputs).await, [(seq, false)]);
}

#[tokio::test]
async fn what_has_ended_before_it_was_asked_for_is_not_given_out() {
    let fake = FakePort::new([1]);
    let mut outputs = fake.plc().outputs();
    fake.issue_output(1, 100, Params::default());
    fake.issue_output(1, 101, Params::default());
    let first = outputs.next().await.unwrap();
    fake.cancel(1, CancelReason::Stop);
    let next = fake.issue_output(1, 102, Params::default());
    assert_eq!(given(&fake, &mut outputs).await, [(next, false)]);
    let Err(Error::Handshake { status, .. }) = first.claim().await else {
        panic!("a cancelled output was claimed");
    };
    assert_eq!(status, HandshakeStatus::Stale);
}
