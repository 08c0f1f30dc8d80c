use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::*;
use crate::alarm::Alarm;
use crate::fake::FakePort;
use crate::handshake::OutputOutcome;
use crate::hub::Filter;
use crate::types::message::Payload;
use crate::types::output::{CancelReason, HandshakeStatus, OutputAct, OutputState, Params, Pending};
use crate::types::refusal::RefusalCode;
use crate::types::request::typed;
use crate::types::topic::{CsTopic, Topic};
use tokio::task::JoinHandle;

fn params(a: f64) -> Params {
    Params {
        a: Some(a),
        ..Params::default()
    }
}

async fn serve(fake: &FakePort, program: SequenceProgram) -> JoinHandle<Result<()>> {
    let plc = fake.plc();
    let task = tokio::spawn(async move { program.run(&plc).await });
    fake.settle().await;
    task
}

fn seconds(seconds: u64) -> Duration {
    Duration::from_secs(seconds)
}

async fn nothing(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

/// A handler that works for VA seconds.
async fn slow(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let time_s = output.params().a().ok_or(Alarm::user(1, "VA is missing"))?;
    plc.sleep(Duration::from_secs_f64(time_s)).await;
    Ok(())
}

#[tokio::test]
async fn a_handler_claims_runs_and_resets_once() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(100, slow).handler_id("magazine")).await;
    let seq = fake.issue_output(1, 100, params(5.0));
    fake.advance(seconds(4)).await;
    let pending = fake.pending(1);
    assert_eq!(pending[0].state, OutputState::Claimed);
    assert_eq!(pending[0].handler_id.as_deref(), Some("magazine"));
    assert_eq!(fake.closed(1, seq), None);
    fake.advance(seconds(1)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    assert_eq!(fake.pending(1), []);
}

/// Returns a program with a handler that works for VA seconds, and the number of its starts.
fn counted() -> (Arc<AtomicUsize>, SequenceProgram) {
    let begun = Arc::new(AtomicUsize::new(0));
    let count = Arc::clone(&begun);
    let program = SequenceProgram::new().on(100, move |output: AuxOutput, plc: Plc| {
        count.fetch_add(1, Ordering::Relaxed);
        slow(output, plc)
    });
    (begun, program)
}

#[tokio::test]
async fn h20_output_claimed_by_the_machine_starts_once_without_a_claim() {
    let fake = FakePort::new([1]);
    let (begun, program) = counted();
    let _task = serve(&fake, program).await;
    let results = Filter::Topics(vec![Topic::cs(1, CsTopic::Result(100))]);
    let mut results = fake.plc().port().subscribe(results);
    let seq = fake.issue_output(1, 100, params(5.0));
    let outputs = fake.pending(1);
    assert_eq!(outputs[0].state, OutputState::Claimed);
    fake.advance(seconds(5)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    let told = results.try_next().unwrap();
    assert!(matches!(&told.payload, Payload::Result(told) if told.of == Some(OutputAct::Reset)));
    assert_eq!(results.try_next(), None);
    // an earlier message arrives again, as from a broker that has retained the message
    fake.publish_message(1, CsTopic::Pending, Payload::Pending(Pending { outputs }));
    fake.advance(seconds(9)).await;
    assert_eq!(begun.load(Ordering::Relaxed), 1);
}

#[tokio::test]
async fn h20_what_is_claimed_for_another_instance_is_left_alone() {
    let fake = FakePort::new([1]);
    let (begun, program) = counted();
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 100, params(5.0));
    let mut outputs = fake.pending(1);
    fake.settle().await;
    assert_eq!(begun.load(Ordering::Relaxed), 1);
    outputs[0].output.seq = seq + 1;
    outputs[0].instance = Some("another".to_owned());
    fake.publish_message(1, CsTopic::Pending, Payload::Pending(Pending { outputs }));
    fake.advance(seconds(9)).await;
    assert_eq!(begun.load(Ordering::Relaxed), 1);
}

#[tokio::test]
async fn an_output_made_before_the_handler_came_is_served() {
    let fake = FakePort::new([1]);
    let seq = fake.issue_output(1, 100, params(0.0));
    let _task = serve(&fake, SequenceProgram::new().on(100, slow)).await;
    fake.advance(seconds(1)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn an_error_is_a_fault_with_code_and_text_unchanged() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(100, slow)).await;
    let seq = fake.issue_output(1, 100, Params::default());
    fake.settle().await;
    let alarm = Alarm::user(1, "VA is missing");
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Failed { alarm }));
}

#[tokio::test]
async fn a_panic_is_a_fault_with_its_text_and_the_program_goes_on() {
    async fn broken(output: AuxOutput) -> Result<(), Alarm> {
        assert!(output.params().a().is_some(), "no VA in line {}", output.line());
        Ok(())
    }
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(7, broken)).await;
    let bad = fake.issue_output(1, 7, Params::default());
    fake.settle().await;
    let alarm = Alarm::user(
        Alarm::CODE_OF_PANIC,
        "the handler of M7 panicked: no VA in line 1",
    );
    assert_eq!(fake.closed(1, bad), Some(OutputOutcome::Failed { alarm }));
    let good = fake.issue_output(1, 7, params(1.0));
    fake.settle().await;
    assert_eq!(fake.closed(1, good), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn d34_a_cancel_drops_the_future_and_tells_why() {
    type Log = Arc<Mutex<Vec<(bool, Option<CancelReason>)>>>;
    struct CancelRecorder(Cancellation, Log);
    impl Drop for CancelRecorder {
        fn drop(&mut self) {
            self.1
                .lock()
                .unwrap()
                .push((self.0.is_cancelled(), self.0.reason()));
        }
    }
    let fake = FakePort::new([1]);
    let dropped = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&dropped);
    let waits = move |output: AuxOutput, plc: Plc| {
        let guard = CancelRecorder(output.cancellation(), Arc::clone(&log));
        async move {
            plc.sleep(seconds(1000)).await;
            drop(guard);
            Ok(())
        }
    };
    let _task = serve(&fake, SequenceProgram::new().on(100, waits)).await;
    let seq = fake.issue_output(1, 100, Params::default());
    fake.advance(seconds(1)).await;
    fake.cancel(1, CancelReason::Stop);
    fake.settle().await;
    assert_eq!(*dropped.lock().unwrap(), [(true, Some(CancelReason::Stop))]);
    assert_eq!(
        fake.closed(1, seq),
        Some(OutputOutcome::Cancelled(CancelReason::Stop))
    );
}

#[tokio::test]
async fn d34_cancel_reason_is_reported_even_if_pending_shows_it_first() {
    let fake = FakePort::new([1]);
    let reason = Arc::new(Mutex::new(None));
    let told = Arc::clone(&reason);
    let program = SequenceProgram::new().on(100, move |output: AuxOutput, plc: Plc| {
        let (told, cancellation) = (Arc::clone(&told), output.cancellation());
        tokio::spawn(async move { *told.lock().unwrap() = cancellation.cancelled().await });
        async move {
            plc.sleep(seconds(1000)).await;
            Ok(())
        }
    });
    let _task = serve(&fake, program).await;
    fake.issue_output(1, 100, Params::default());
    fake.settle().await;
    // another output changes `pending`; the cancel arrives before the program reads that `pending`
    fake.issue_output(1, 101, Params::default());
    fake.cancel(1, CancelReason::Abort);
    fake.settle().await;
    assert_eq!(*reason.lock().unwrap(), Some(CancelReason::Abort));
}

#[tokio::test]
async fn a_panic_while_a_cancelled_handler_is_dropped_leaves_the_others_alone() {
    struct Fragile;
    impl Drop for Fragile {
        fn drop(&mut self) {
            panic!("the clean-up");
        }
    }
    let fragile = |_output: AuxOutput, plc: Plc| async move {
        let _fragile = Fragile;
        plc.sleep(seconds(1000)).await;
        Ok(())
    };
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(7, fragile).on(100, slow)).await;
    fake.issue_output(1, 7, Params::default());
    fake.settle().await;
    fake.cancel(1, CancelReason::Stop);
    fake.settle().await;
    let after = fake.issue_output(1, 100, params(1.0));
    fake.advance(seconds(1)).await;
    assert_eq!(fake.closed(1, after), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn d36_a_timed_out_output_drops_its_handler() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(100, slow)).await;
    let seq = fake.issue_output_within(1, 100, params(60.0), Some(seconds(30)));
    fake.advance(seconds(29)).await;
    assert_eq!(fake.closed(1, seq), None);
    fake.advance(seconds(60)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::TimedOut));
}

#[tokio::test]
async fn open_outputs_of_one_coordinate_system_run_at_the_same_time() {
    let fake = FakePort::new([1]);
    let (now, most) = (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)));
    let (counted, peak) = (Arc::clone(&now), Arc::clone(&most));
    let program = SequenceProgram::new().on(10..=13, move |_output: AuxOutput, plc: Plc| {
        let (now, most) = (Arc::clone(&counted), Arc::clone(&peak));
        async move {
            most.fetch_max(now.fetch_add(1, Ordering::Relaxed) + 1, Ordering::Relaxed);
            plc.sleep(seconds(2)).await;
            now.fetch_sub(1, Ordering::Relaxed);
            Ok(())
        }
    });
    let _task = serve(&fake, program).await;
    let seqs: Vec<u64> = (10..=13)
        .map(|m| fake.issue_output(1, m, Params::default()))
        .collect();
    fake.advance(seconds(2)).await;
    assert_eq!(most.load(Ordering::Relaxed), 4);
    for seq in seqs {
        assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    }
}

#[tokio::test]
async fn an_operators_reset_cancels_the_handler_with_reason_operator() {
    let fake = FakePort::new([1]);
    let reason = Arc::new(Mutex::new(None));
    let told = Arc::clone(&reason);
    let program = SequenceProgram::new().on(100, move |output: AuxOutput, plc: Plc| {
        let (told, cancellation) = (Arc::clone(&told), output.cancellation());
        tokio::spawn(async move { *told.lock().unwrap() = cancellation.cancelled().await });
        async move {
            plc.sleep(seconds(1000)).await;
            Ok(())
        }
    });
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 100, Params::default());
    fake.settle().await;
    let mut reset = crate::claim::reset_of(&fake.plc().port().boot_id(), seq, "hmi", None);
    reset.force = Some(true);
    let request = crate::types::request::Request::Reset(1, None, reset);
    fake.plc().port().request(request).await.unwrap();
    fake.settle().await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    assert_eq!(*reason.lock().unwrap(), Some(CancelReason::Operator));
}

/// Loses a handler that has claimed output `seq`. The next handler records `redelivered()` in the log.
async fn after_a_death(program: SequenceProgram) -> (FakePort, u64, Arc<Mutex<Vec<bool>>>) {
    let fake = FakePort::new([1]);
    let first = serve(&fake, SequenceProgram::new().on(100, slow).handler_id("h")).await;
    let seq = fake.issue_output(1, 100, params(1000.0));
    fake.settle().await;
    assert_eq!(fake.pending(1)[0].state, OutputState::Claimed);
    first.abort();
    fake.settle().await;
    let pending = &fake.pending(1)[0];
    assert!(pending.lost && pending.state == OutputState::Output && pending.output.redelivered);
    let log = Arc::new(Mutex::new(Vec::new()));
    let noted = Arc::clone(&log);
    let program = program.on(100, move |output: AuxOutput| {
        noted.lock().unwrap().push(output.redelivered());
        async { Ok(()) }
    });
    let _task = serve(&fake, program.handler_id("h")).await;
    fake.advance(seconds(1)).await;
    (fake, seq, log)
}

#[tokio::test]
async fn on_redelivery_ask_leaves_it_until_an_operator_decides() {
    for (how, redelivered) in [(Redelivery::Redo, false), (Redelivery::Verify, true)] {
        let (fake, seq, log) = after_a_death(SequenceProgram::new()).await;
        assert_eq!(fake.closed(1, seq), None);
        fake.redeliver(1, seq, how);
        fake.settle().await;
        assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
        assert_eq!(*log.lock().unwrap(), [redelivered]);
    }
}

#[tokio::test]
async fn on_redelivery_redo_and_verify_take_it_up_at_once() {
    for (how, redelivered) in [(Redelivery::Redo, false), (Redelivery::Verify, true)] {
        let (fake, seq, log) = after_a_death(SequenceProgram::new().on_redelivery(how)).await;
        assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
        assert_eq!(*log.lock().unwrap(), [redelivered]);
    }
}

#[tokio::test]
async fn lost_output_is_withheld_from_its_handler_but_not_from_manual_reset() {
    let (fake, seq, _) = after_a_death(SequenceProgram::new()).await;
    let port = fake.plc();
    let claim = crate::types::output::Claim {
        boot_id: port.port().boot_id(),
        seq,
        handler_id: "h".into(),
        instance: fake.handlers()["h"].instance.clone(),
    };
    let claimed = port.port().ask(typed::Claim(1, None, claim)).await.unwrap();
    assert_eq!(claimed.status, HandshakeStatus::Withheld);
    let reset = crate::claim::reset_of(&port.port().boot_id(), seq, "h", None);
    let done = port
        .port()
        .ask(typed::Reset(1, None, reset.clone()))
        .await
        .unwrap();
    assert_eq!(done.status, HandshakeStatus::Withheld);
    let by_hand = crate::types::output::Reset {
        handler_id: "hmi".into(),
        ..reset
    };
    let done = port.port().ask(typed::Reset(1, None, by_hand)).await.unwrap();
    assert_eq!(
        (done.status, fake.closed(1, seq)),
        (HandshakeStatus::Accepted, Some(OutputOutcome::Reset))
    );
}

#[tokio::test]
async fn second_program_with_the_same_id_is_refused_and_outputs_run_once() {
    let fake = FakePort::new([1]);
    let done = Arc::new(Mutex::new(0));
    let program = || {
        let done = Arc::clone(&done);
        SequenceProgram::new()
            .handler_id("cell")
            .on(60, move |_output: AuxOutput| {
                *done.lock().unwrap() += 1;
                async { Ok(()) }
            })
    };
    let first = serve(&fake, program()).await;
    let second = serve(&fake, program()).await;
    for _ in 0..3 {
        fake.issue_output(1, 60, Params::default());
        fake.settle().await;
    }
    fake.advance(seconds(10)).await;
    assert_eq!(*done.lock().unwrap(), 3);
    let Err(Error::Refused(refusal)) = second.await.unwrap() else {
        panic!("it serves");
    };
    assert_eq!(refusal.code, RefusalCode::HandlerTaken);
    assert!(
        refusal.text.contains("cell") && refusal.text.contains("take_over"),
        "{refusal}"
    );
    fake.issue_output(1, 60, Params::default());
    fake.settle().await;
    assert_eq!(*done.lock().unwrap(), 4, "the first is still there");
    first.abort();
    fake.settle().await;
    let _third = serve(&fake, program()).await;
    fake.issue_output(1, 60, Params::default());
    fake.settle().await;
    assert_eq!(*done.lock().unwrap(), 5, "whoever comes after it is the only one");
}

#[tokio::test]
async fn take_over_ends_the_other_program_and_withholds_its_started_output() {
    let fake = FakePort::new([1]);
    let program = || SequenceProgram::new().handler_id("cell").on(100, slow);
    let first = serve(&fake, program()).await;
    let seq = fake.issue_output(1, 100, params(1000.0));
    fake.settle().await;
    let _second = serve(&fake, program().take_over()).await;
    let Err(Error::TakenOver { handler_id, text }) = first.await.unwrap() else {
        panic!("it goes on");
    };
    assert!(handler_id == "cell" && text.contains("has taken over"), "{text}");
    let pending = &fake.pending(1)[0];
    assert_eq!((pending.state, pending.lost), (OutputState::Output, true));
    fake.advance(seconds(10)).await;
    assert_eq!(
        fake.pending(1)[0].handler_id,
        None,
        "nobody does it again unasked"
    );
    fake.redeliver(1, seq, Redelivery::Redo);
    fake.settle().await;
    assert_eq!(fake.pending(1)[0].state, OutputState::Claimed);
}

#[tokio::test]
async fn a_handler_that_lost_only_its_connection_takes_its_claim_back() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(100, slow).handler_id("h")).await;
    let seq = fake.issue_output(1, 100, params(10.0));
    fake.advance(seconds(5)).await;
    fake.disconnect_handler("h");
    fake.settle().await;
    let pending = &fake.pending(1)[0];
    assert_eq!((pending.state, pending.lost), (OutputState::Claimed, false));
    fake.advance(seconds(5)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn a_restart_of_the_runtime_drops_handlers_of_the_boot_before() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(100, slow)).await;
    fake.issue_output(1, 100, params(10.0));
    fake.advance(seconds(1)).await;
    fake.restart();
    fake.settle().await;
    let seq = fake.issue_output(1, 100, params(20.0));
    fake.advance(seconds(10)).await;
    assert_eq!(fake.closed(1, seq), None);
    fake.advance(seconds(10)).await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
}

#[tokio::test]
async fn a_coordinate_systems_own_handler_comes_before_that_for_all() {
    async fn eject(_output: AuxOutput) -> Result<(), Alarm> {
        Err(Alarm::user(2, "eject"))
    }
    let fake = FakePort::new([1, 2]);
    let program = SequenceProgram::new()
        .on(20, nothing)
        .in_coordinate_system(2, |cs| cs.on(20, eject));
    let task = serve(&fake, program).await;
    let (first, second) = (
        fake.issue_output(1, 20, Params::default()),
        fake.issue_output(2, 20, Params::default()),
    );
    fake.settle().await;
    assert_eq!(fake.closed(1, first), Some(OutputOutcome::Reset));
    let alarm = Alarm::user(2, "eject");
    assert_eq!(fake.closed(2, second), Some(OutputOutcome::Failed { alarm }));
    task.abort();
}

#[tokio::test]
async fn presence_is_told_with_all_codes_and_taken_back_when_the_program_ends() {
    let fake = FakePort::new([1, 2]);
    let program = SequenceProgram::new()
        .on(10..12, nothing)
        .in_coordinate_system(2, |cs| cs.on(20, nothing));
    let task = serve(&fake, program.handler_id("h")).await;
    let presence = &fake.handlers()["h"];
    let handled: Vec<_> = presence.handles.iter().map(|code| (code.cs, code.m)).collect();
    assert!(presence.online);
    assert_eq!(handled, [(1, 10), (1, 11), (2, 10), (2, 11), (2, 20)]);
    task.abort();
    fake.settle().await;
    assert!(!fake.handlers()["h"].online);
}

#[tokio::test]
async fn progress_stands_in_pending() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new().on(100, |output: AuxOutput, plc: Plc| async move {
        output.progress("magazine turns", 40.0).await?;
        plc.sleep(seconds(1)).await;
        Ok(())
    });
    let _task = serve(&fake, program).await;
    fake.issue_output(1, 100, Params::default());
    fake.settle().await;
    let progress = fake.pending(1)[0].progress.clone().unwrap();
    assert_eq!(
        (progress.text.as_str(), progress.percent),
        ("magazine turns", Some(40.0))
    );
}

#[tokio::test]
async fn a_wrongly_built_program_is_refused_with_every_mistake() {
    let plc = FakePort::new([1]).plc();
    let program = SequenceProgram::new()
        .on(100, nothing)
        .on(98..=101, nothing)
        .on(192, nothing)
        .handler_id("a/b");
    let Err(Error::SequenceProgram(mistakes)) = program.run(&plc).await else {
        panic!("it ran");
    };
    for mistake in [
        "M100 has two handlers",
        "M98: the runtime",
        "M99: the runtime",
        "M192",
        "a/b",
    ] {
        assert!(mistakes.contains(mistake), "{mistake} in {mistakes}");
    }
    let same_in_one = SequenceProgram::new().in_coordinate_system(2, |cs| cs.on(5, nothing).on(5, nothing));
    assert_eq!(
        same_in_one.check(),
        Err(Error::SequenceProgram(
            "M5 in coordinate system 2 has two handlers".to_owned()
        ))
    );
}
