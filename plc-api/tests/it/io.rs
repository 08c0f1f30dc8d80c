//! Inputs and outputs of the plant.

use std::sync::{Arc, Mutex};

use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::{Alarm, AuxOutput, Error, Params, Plc, SequenceProgram};
use plc_protocol::types::io::{IoDeclaration, IoPoint, IoState, IoValue};
use plc_protocol::types::refusal::RefusalCode;

use crate::{ms, serve};

fn plant() -> FakePort {
    let fake = FakePort::new([1]);
    fake.declare_io(IoPoint::input("door_closed"), IoDeclaration::new(false));
    fake.declare_io(IoPoint::output("valve"), IoDeclaration::new(false));
    let pressure = IoDeclaration {
        min: Some(0.0),
        max: Some(6.0),
        ..IoDeclaration::new(0.0)
    };
    fake.declare_io(IoPoint::output("pressure"), pressure);
    fake
}

async fn valve(fake: &FakePort) -> IoState {
    fake.plc().io_out("valve").state().await.unwrap()
}

fn refusal(error: Error) -> (RefusalCode, String) {
    match error {
        Error::Refused(refusal) => (refusal.code, refusal.text),
        other => panic!("{other}"),
    }
}

async fn opens(_output: AuxOutput, plc: Plc) -> Result<(), Alarm> {
    plc.io_out("valve").set(true).await?;
    Ok(())
}

fn program(handler_id: &str) -> SequenceProgram {
    SequenceProgram::new().handler_id(handler_id).on(8, opens)
}

#[tokio::test]
async fn handler_write_is_owned_by_its_program_and_repeated_after_restart() {
    let fake = plant();
    let _task = serve(&fake, program("cell")).await;
    let seq = fake.issue_output(1, 8, Params::default());
    fake.settle().await;
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Reset));
    let state = valve(&fake).await;
    assert_eq!((state.value, state.owner.as_deref()), (true.into(), Some("cell")));
    fake.restart();
    assert_eq!(valve(&fake).await.value, false, "safe at a start");
    fake.settle().await;
    let state = valve(&fake).await;
    assert_eq!((state.value, state.owner.as_deref()), (true.into(), Some("cell")));
}

#[tokio::test]
async fn without_its_program_an_output_has_its_safe_value() {
    let fake = plant();
    let task = serve(&fake, program("cell")).await;
    fake.issue_output(1, 8, Params::default());
    fake.settle().await;
    assert!(valve(&fake).await.value.is_on());
    task.abort();
    fake.settle().await;
    let state = valve(&fake).await;
    assert_eq!((state.value, state.lost), (false.into(), true));
}

#[tokio::test]
async fn another_program_and_a_client_are_refused_in_words_that_name_the_owner() {
    let fake = plant();
    let _cell = serve(&fake, program("cell")).await;
    fake.issue_output(1, 8, Params::default());
    fake.settle().await;
    let error = fake.plc().io_out("valve").set(false).await.unwrap_err();
    let (code, text) = refusal(error);
    assert_eq!(code, RefusalCode::NotAllowed);
    assert!(text.contains("io/out/valve") && text.contains("cell"), "{text}");
    let said = Arc::new(Mutex::new(None));
    let heard = Arc::clone(&said);
    let other = SequenceProgram::new().handler_id("other").task(move |plc| {
        let heard = Arc::clone(&heard);
        async move {
            let refused = plc.io_out("valve").set(false).await;
            *heard.lock().unwrap() = refused.err();
            Ok(())
        }
    });
    let _other = serve(&fake, other).await;
    let error = said.lock().unwrap().take().unwrap();
    assert!(refusal(error).1.contains("cell"));
    assert!(valve(&fake).await.value.is_on());
}

#[tokio::test]
async fn a_value_is_waited_for_and_one_that_is_there_already_is_not() {
    let fake = plant();
    let plc = fake.plc();
    let door = plc.io_in("door_closed");
    let waits = tokio::spawn({
        let door = door.clone();
        async move { door.wait_until(|value| value == true).await }
    });
    fake.settle().await;
    assert!(!waits.is_finished());
    door.set(true).await.unwrap();
    assert_eq!(waits.await.unwrap(), Ok(true.into()));
    assert_eq!(door.wait_until(|value| value == true).await, Ok(true.into()));
    door.set(false).await.unwrap();
    let wait = door.wait_until(IoValue::is_on);
    let wait = plc.timeout(ms(100), wait);
    let (ended, ()) = tokio::join!(wait, fake.advance(ms(200)));
    assert!(matches!(ended, Err(Error::TimedOut { .. })), "{ended:?}");
}

#[tokio::test]
async fn changes_are_the_value_of_now_and_each_other_one() {
    let fake = plant();
    let pressure = fake.plc().io_out("pressure");
    let mut changes = pressure.changes();
    let mut seen = vec![changes.next().await];
    for value in [2.5, 2.5, 4.0] {
        pressure.set(value).await.unwrap();
        fake.plc().io_in("door_closed").set(true).await.unwrap();
        if seen.last() != Some(&Some(value.into())) {
            seen.push(changes.next().await);
        }
    }
    let expected = [0.0, 2.5, 4.0].map(|value| Some(value.into()));
    assert_eq!(seen, expected);
}

#[tokio::test]
async fn forced_value_is_read_by_all_and_release_restores_the_written_one() {
    let fake = plant();
    let _task = serve(&fake, program("cell")).await;
    fake.issue_output(1, 8, Params::default());
    fake.settle().await;
    let of_operator = fake.plc().io_out("valve");
    of_operator.force(false).await.unwrap();
    let state = valve(&fake).await;
    assert_eq!((state.value, state.written), (false.into(), true.into()));
    assert!(state.forced.is_some());
    of_operator.release().await.unwrap();
    let state = valve(&fake).await;
    assert_eq!((state.value, state.forced), (true.into(), None));
    of_operator.force(false).await.unwrap();
    fake.restart();
    fake.settle().await;
    let state = valve(&fake).await;
    assert_eq!(
        (state.value, state.forced),
        (true.into(), None),
        "a restart ends the forcing"
    );
}

#[tokio::test]
async fn what_is_not_declared_or_out_of_its_range_is_refused() {
    let fake = plant();
    let plc = fake.plc();
    for (io, says) in [
        (plc.io_out("valv").set(true).await, "there are pressure, valve"),
        (plc.io_out("pressure").set(6.5).await, "0 to 6"),
        (plc.io_out("pressure").set(true).await, "a number"),
        (plc.io_in("door_closed").force(1.0).await, "true or false"),
    ] {
        let (_, text) = refusal(io.unwrap_err());
        assert!(text.contains(says), "{text}");
    }
    for unknown in [
        plc.io_in("valve").value().await.err(),
        plc.io_in("valve").wait_until(|_| true).await.err(),
    ] {
        assert_eq!(refusal(unknown.unwrap()).0, RefusalCode::NotFound);
    }
}
