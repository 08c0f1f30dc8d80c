//! Parts of programs: devices, nested parts, guards, redelivery by M code, checkpoints.

use std::sync::{Arc, Mutex};

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::units::Number;
use plc_api::{
    Alarm, AuxOutput, CancelReason, Execution, HandlerState, MCode, Params, Plc, Redelivery, SequenceProgram,
    Va,
};

use crate::{ms, serve, va};

type CallLog = Arc<Mutex<Vec<String>>>;

fn note(heard: &CallLog, what: impl Into<String>) {
    heard.lock().unwrap().push(what.into());
}

fn all(heard: &CallLog) -> Vec<String> {
    heard.lock().unwrap().clone()
}

async fn nothing(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

struct Magazine {
    pocket: u8,
    heard: CallLog,
}

impl Magazine {
    /// A method of the device that works for one second at each call.
    async fn turn(&mut self, _output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
        note(&self.heard, format!("from {}", self.pocket));
        plc.sleep(ms(1000)).await;
        self.pocket += 1;
        note(&self.heard, format!("at {}", self.pocket));
        Ok(())
    }

    async fn home(&mut self, output: AuxOutput) -> Result<(), Alarm> {
        output.progress("home", None).await?;
        self.pocket = 1;
        note(&self.heard, "home");
        Ok(())
    }
}

const HOME: MCode = MCode::new(7, "magazine home");

fn magazine(heard: &CallLog) -> SequenceProgram {
    let magazine = Magazine {
        pocket: 1,
        heard: Arc::clone(heard),
    };
    SequenceProgram::new().device(magazine, |magazine| {
        magazine.on(6, Magazine::turn).on(HOME, Magazine::home)
    })
}

#[tokio::test]
async fn methods_of_a_device_take_turns_in_the_order_in_which_they_are_begun() {
    let (fake, heard) = (FakePort::new([1, 2]), CallLog::default());
    serve(&fake, magazine(&heard)).await;
    let mut outputs = Vec::new();
    for (cs, m) in [(1, 6), (2, 6), (1, 7)] {
        outputs.push((cs, fake.issue_output(cs, m, Params::default())));
        fake.settle().await;
    }
    fake.advance(ms(1500)).await;
    assert_eq!(all(&heard), ["from 1", "at 2", "from 2"]);
    fake.advance(ms(1000)).await;
    assert_eq!(all(&heard), ["from 1", "at 2", "from 2", "at 3", "home"]);
    for (cs, seq) in outputs {
        assert_eq!(fake.closed(cs, seq), Some(OutputOutcome::Reset));
    }
    assert_eq!(
        fake.handlers().values().next().unwrap().m_codes[0]
            .name
            .as_deref(),
        Some("magazine home")
    );
}

#[tokio::test]
async fn a_method_that_is_cancelled_gives_its_turn_to_the_next() {
    let (fake, heard) = (FakePort::new([1, 2]), CallLog::default());
    serve(&fake, magazine(&heard)).await;
    fake.issue_output(1, 6, Params::default());
    let waits = fake.issue_output(2, 7, Params::default());
    fake.advance(ms(500)).await;
    assert_eq!(fake.closed(2, waits), None);
    fake.cancel(1, CancelReason::Stop);
    fake.settle().await;
    assert_eq!(
        (all(&heard), fake.closed(2, waits)),
        (vec!["from 1".into(), "home".into()], Some(OutputOutcome::Reset))
    );
}

#[derive(Clone)]
struct Side(&'static str);

const CLOSE: MCode = MCode::new(10, "close the clamp");

async fn close(
    Va(force): Va<Number<1, 20>>,
    HandlerState(side): HandlerState<Side>,
    output: AuxOutput,
) -> Result<(), Alarm> {
    Err(Alarm::user(1, format!("M{} {} by {force}", output.m(), side.0)))
}

/// Returns a part with handlers of M10 and M11.
fn clamp(side: &'static str) -> SequenceProgram {
    SequenceProgram::new()
        .on(CLOSE, close)
        .on(11, nothing)
        .state(Side(side))
        .on_redelivery(Redelivery::Redo)
}

async fn failed(fake: &FakePort, m: u16, a: f64) -> String {
    let seq = fake.issue_output(1, m, va(a));
    fake.settle().await;
    match fake.closed(1, seq) {
        Some(OutputOutcome::Failed { alarm }) => alarm.text,
        other => panic!("M{m}: {other:?}"),
    }
}

#[tokio::test]
async fn a_part_that_is_nested_twice_serves_both_ranges_each_with_its_state() {
    let fake = FakePort::new([1]);
    let program = SequenceProgram::new()
        .merge_at(10..=11, clamp("left"))
        .merge_at(20..=29, clamp("right"))
        .on(60, nothing);
    serve(&fake, program).await;
    assert!(failed(&fake, 10, 5.0).await.starts_with("M10 left by 5"));
    assert!(failed(&fake, 20, 5.0).await.starts_with("M20 right by 5"));
    let declared = failed(&fake, 20, 21.0).await;
    assert!(
        declared.starts_with("M20 close the clamp"),
        "the declaration is moved with the M code: {declared}"
    );
    let presence = fake.handlers().into_values().next().unwrap();
    let said = [10, 11, 20, 21, 60].map(|m| (m, presence.redelivery_of(1, m)));
    let redo = Some(Redelivery::Redo);
    assert_eq!(said, [(10, redo), (11, redo), (20, redo), (21, redo), (60, None)]);
}

#[test]
fn a_part_that_does_not_fit_its_range_is_refused_with_each_m_code() {
    let refused = |program: SequenceProgram| program.check().unwrap_err().to_string();
    assert_eq!(
        refused(SequenceProgram::new().merge_at(20..=20, clamp("left"))),
        "merge_at(20..=20): M11 of the part would be M21, which is not allowed there"
    );
    assert_eq!(
        refused(SequenceProgram::new().merge_at(29..=31, clamp("left"))),
        "merge_at(29..=31): M11 of the part would be M30, which is not allowed there"
    );
    assert_eq!(
        refused(SequenceProgram::new().merge_at(20..=29, SequenceProgram::new())),
        "merge_at(20..=29) got a program without handlers"
    );
    assert_eq!(
        refused(
            SequenceProgram::new()
                .on(21, nothing)
                .merge_at(20..=29, clamp("left"))
        ),
        "M21 has two handlers"
    );
}

#[tokio::test]
async fn a_guard_locks_starts_until_the_last_one_of_its_source_has_gone() {
    let fake = FakePort::new([1]);
    let mill = fake.plc().coordinate_system(1);
    let first = mill
        .start_lock_while_here("pallet", "the pallet moves")
        .await
        .unwrap();
    let second = mill
        .start_lock_while_here("pallet", "the pallet turns")
        .await
        .unwrap();
    assert_eq!(mill.start_lock().await.unwrap().text, "the pallet turns");
    drop(first);
    fake.settle().await;
    assert!(mill.start_lock().await.unwrap().value);
    second.release().await.unwrap();
    assert!(!mill.start_lock().await.unwrap().value);
    let held = mill.interlock_while_here("arm", "the arm is out").await.unwrap();
    assert_eq!(mill.interlock().await.unwrap().text, "the arm is out");
    drop(held);
    fake.settle().await;
    assert!(!mill.interlock().await.unwrap().value);
}

async fn move_pallet(output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    let mill = plc.coordinate_system(output.coordinate_system());
    let _lock = mill.start_lock_while_here("pallet", "the pallet moves").await?;
    plc.sleep(ms(10_000)).await;
    Ok(())
}

#[tokio::test]
async fn a_guard_of_a_handler_that_is_cancelled_takes_its_lock_away() {
    let fake = FakePort::new([1]);
    serve(&fake, SequenceProgram::new().on(60, move_pallet)).await;
    let mill = fake.plc().coordinate_system(1);
    fake.issue_output(1, 60, Params::default());
    fake.advance(ms(1000)).await;
    let lock = mill.start_lock().await.unwrap();
    assert_eq!((lock.value, lock.text.as_str()), (true, "the pallet moves"));
    fake.cancel(1, CancelReason::Stop);
    fake.settle().await;
    assert!(!mill.start_lock().await.unwrap().value);
    assert_ne!(mill.state().await.unwrap().execution, Execution::Active);
}

/// A handler that works for five minutes, less the minutes that the last checkpoint records as done.
async fn wash(output: AuxOutput, plc: Plc, heard: CallLog) -> Result<(), Alarm> {
    let done: u32 = output.last_checkpoint()?.unwrap_or(0);
    note(&heard, format!("from minute {done}"));
    for minute in done..5 {
        output.checkpoint(&minute).await?;
        plc.sleep(ms(60_000)).await;
    }
    Ok(())
}

fn washer(heard: &CallLog) -> SequenceProgram {
    let heard = Arc::clone(heard);
    SequenceProgram::new()
        .handler_id("washer")
        .on(90, move |output, plc| wash(output, plc, Arc::clone(&heard)))
        .on(10, nothing)
        .redelivery(90, Redelivery::Redo)
}

#[tokio::test]
async fn work_goes_on_at_the_checkpoint_of_the_handler_that_was_lost() {
    let (fake, heard) = (FakePort::new([1]), CallLog::default());
    let first = serve(&fake, washer(&heard)).await;
    let seq = fake.issue_output(1, 90, Params::default());
    fake.advance(ms(200_000)).await;
    first.abort();
    fake.settle().await;
    serve(&fake, washer(&heard)).await;
    fake.advance(ms(119_000)).await;
    assert_eq!(fake.closed(1, seq), None);
    fake.advance(ms(1000)).await;
    assert_eq!(
        (all(&heard), fake.closed(1, seq)),
        (
            vec!["from minute 0".into(), "from minute 3".into()],
            Some(OutputOutcome::Reset)
        )
    );
}

#[tokio::test]
async fn a_checkpoint_of_another_form_is_an_error_and_none_is_none() {
    let fake = FakePort::new([1]);
    let text = |output: AuxOutput| async move {
        assert_eq!(output.last_checkpoint::<String>()?, None, "nothing was noted");
        output.checkpoint(&"three").await?;
        std::future::pending().await
    };
    let first = serve(&fake, SequenceProgram::new().handler_id("washer").on(90, text)).await;
    let seq = fake.issue_output(1, 90, Params::default());
    fake.settle().await;
    first.abort();
    fake.settle().await;
    serve(&fake, washer(&CallLog::default())).await;
    fake.settle().await;
    let Some(OutputOutcome::Failed { alarm }) = fake.closed(1, seq) else {
        panic!("{:?}", fake.closed(1, seq))
    };
    assert!(
        alarm.text.contains("the checkpoint of M90 has another type"),
        "{}",
        alarm.text
    );
}

#[test]
fn a_redelivery_is_of_a_code_that_is_served_and_said_once() {
    let refused = |program: SequenceProgram| program.check().unwrap_err().to_string();
    let one = || {
        SequenceProgram::new()
            .on(60, nothing)
            .redelivery(60, Redelivery::Redo)
    };
    assert_eq!(one().check(), Ok(()));
    assert_eq!(
        refused(one().redelivery(60, Redelivery::Verify)),
        "M60 has two redeliveries"
    );
    assert_eq!(
        refused(one().redelivery(61, Redelivery::Verify)),
        "M61 has a redelivery and no handler"
    );
}

#[tokio::test]
async fn what_is_said_of_an_m_code_in_one_coordinate_system_counts_there() {
    let fake = FakePort::new([1, 2]);
    let program = SequenceProgram::new()
        .on(60, nothing)
        .redelivery(60, Redelivery::Redo)
        .in_coordinate_system(2, |two| two.redelivery(60, Redelivery::Verify));
    serve(&fake, program).await;
    let presence = fake.handlers().into_values().next().unwrap();
    assert_eq!(presence.redelivery_of(1, 60), Some(Redelivery::Redo));
    assert_eq!(presence.redelivery_of(2, 60), Some(Redelivery::Verify));
}
