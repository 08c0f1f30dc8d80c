use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::*;
use crate::fake::FakePort;
use plc_protocol::alarm::Alarm;
use plc_protocol::handshake::OutputOutcome;
use plc_protocol::types::output::{CancelReason, HandshakeStatus, OutputState, Params};
use plc_protocol::types::refusal::RefusalCode;
use plc_protocol::types::request::typed;
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

/// Loses a handler that has claimed the returned output, and serves again under its id.
async fn after_a_death() -> (FakePort, u64) {
    let fake = FakePort::new([1]);
    let first = serve(&fake, SequenceProgram::new().on(100, slow).handler_id("h")).await;
    let seq = fake.issue_output(1, 100, params(1000.0));
    fake.settle().await;
    assert_eq!(fake.pending(1)[0].state, OutputState::Claimed);
    first.abort();
    fake.settle().await;
    let pending = &fake.pending(1)[0];
    assert!(pending.lost && pending.state == OutputState::Output && pending.output.redelivered);
    let _task = serve(&fake, SequenceProgram::new().on(100, nothing).handler_id("h")).await;
    fake.advance(seconds(1)).await;
    (fake, seq)
}

#[tokio::test]
async fn lost_output_is_withheld_from_its_handler_but_not_from_manual_reset() {
    let (fake, seq) = after_a_death().await;
    let port = fake.plc();
    let claim = plc_protocol::types::output::Claim {
        boot_id: port.port().boot_id(),
        seq,
        handler_id: "h".into(),
        instance: fake.handlers()["h"].instance.clone(),
    };
    let claimed = port.port().ask(typed::Claim(1, None, claim)).await.unwrap();
    assert_eq!(claimed.status, HandshakeStatus::Withheld);
    let reset = plc_protocol::handshake::reset_of(&port.port().boot_id(), seq, "h", None);
    let done = port
        .port()
        .ask(typed::Reset(1, None, reset.clone()))
        .await
        .unwrap();
    assert_eq!(done.status, HandshakeStatus::Withheld);
    let by_hand = plc_protocol::types::output::Reset {
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
