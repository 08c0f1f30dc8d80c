//! A sequence program and its tests, as written against commit 71e10300.

use std::time::Duration;

use plc_protocol::alarm::USER_ALARM_BASE;
use plc_api::extract::ParamValue;
use plc_api::fake::FakePort;
use plc_api::fake::OutputOutcome;
use plc_api::hub::Filter;
use plc_api::types::handler::HandlerPresence;
use plc_api::types::m_code::{ParamDeclaration, ParamLetter};
use plc_api::{Alarm, AuxOutput, CancelReason, MCode, Params, Plc, SequenceProgram, HandlerState};

const CLAMP: MCode = MCode::new(12, "close the clamp");

/// The clamp that a program closes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

impl ParamValue for Side {
    fn declaration() -> ParamDeclaration {
        ParamDeclaration {
            whole: true,
            ..ParamDeclaration::default().within(Some(1.0), Some(2.0))
        }
    }

    fn from_number(number: Option<f64>) -> Option<Self> {
        Some(if number? < 2.0 { Side::Left } else { Side::Right })
    }
}

#[derive(Clone)]
struct Valve(&'static str);

async fn clamp(output: AuxOutput, HandlerState(valve): HandlerState<Valve>, plc: Plc) -> Result<(), Alarm> {
    let force = ParamLetter::A.value_in(output.params()).unwrap_or(10.0);
    if force > 20.0 {
        return Err(Alarm::user(2, format!("{} cannot give {force} kN", valve.0)));
    }
    plc.sleep(Duration::from_millis(400)).await;
    Ok(())
}

fn program() -> SequenceProgram {
    let clamps = SequenceProgram::new().state(Valve("V1")).on(CLAMP, clamp);
    SequenceProgram::new().merge_at(12..=19, clamps)
}

#[test]
fn a_parameter_of_an_own_type_is_declared() {
    assert!(!Side::declaration().optional);
    assert_eq!(HandlerPresence::offline(None).instance, None);
}

#[tokio::test]
async fn a_force_out_of_range_is_an_alarm() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    let mut messages = plc.port().subscribe(Filter::All);
    tokio::spawn(async move { program().run(&plc).await });
    let force = Params {
        a: Some(21.0),
        ..Params::default()
    };
    let seq = fake.issue_output(1, 12, force);
    fake.settle().await;
    let alarm = Alarm::user(2, "V1 cannot give 21 kN");
    assert_eq!(alarm.number, USER_ALARM_BASE + 2);
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Failed { alarm }));
    assert!(messages.try_next().is_some());
    assert_eq!(messages.dropped_events(), 0);
}

#[tokio::test]
async fn a_stop_cancels_the_output() {
    let fake = FakePort::new([1]);
    let plc = fake.plc();
    let served = plc.clone();
    tokio::spawn(async move { program().run(&served).await });
    let heartbeat = plc.heartbeat(Duration::from_secs(2)).await;
    if let Ok(heartbeat) = heartbeat {
        heartbeat.release().await.unwrap();
    }
    let seq = fake.issue_output_within(1, 12, Params::default(), None);
    fake.settle().await;
    fake.cancel(1, CancelReason::Stop);
    assert_eq!(fake.closed(1, seq), Some(OutputOutcome::Cancelled(CancelReason::Stop)));
    fake.end_program(1);
}
