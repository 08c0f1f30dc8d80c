use std::sync::{Arc, Mutex};

use plc_protocol::error::{Error, Result};
use plc_protocol::handshake::OutputOutcome;
use plc_protocol::types::m_code::{MCodeDeclaration, ParamLetter};
use plc_protocol::types::output::Params;
use tokio::task::JoinHandle;

use super::*;
use crate::fake::FakePort;
use crate::handlers::SequenceProgram;
use crate::m_codes::MCode;
use crate::units::{Bar, KiloNewton, Whole};

const CLAMP: MCode = MCode::new(12, "clamp");

/// Arguments that handlers received.
type ReceivedArguments = Arc<Mutex<Vec<String>>>;

#[derive(crate::Params)]
struct ClampParams {
    #[va(1.0..=20.0, "kN", name = "clamping force")]
    force: f64,
    #[vb(1..=2)]
    left_side: Option<u8>,
}

async fn clamp(
    ClampParams { force, left_side }: ClampParams,
    HandlerState(seen): HandlerState<ReceivedArguments>,
    output: AuxOutput,
) -> Result<(), Alarm> {
    let m = output.m();
    seen.lock().unwrap().push(format!("M{m} {force} {left_side:?}"));
    Ok(())
}

fn params(a: Option<f64>, b: Option<f64>) -> Params {
    Params {
        a,
        b,
        ..Params::default()
    }
}

async fn serve(fake: &FakePort, program: SequenceProgram) -> JoinHandle<Result<()>> {
    let plc = fake.plc();
    let task = tokio::spawn(async move { program.handler_id("cell").run(&plc).await });
    fake.settle().await;
    task
}

/// Runs the handler of M12 with these parameters. Returns how the output ended, and the arguments that the
/// handler received.
async fn end_of(params: Params) -> (Option<OutputOutcome>, Vec<String>) {
    let (fake, seen) = (FakePort::new([1]), ReceivedArguments::default());
    let program = SequenceProgram::new().on(CLAMP, clamp).state(Arc::clone(&seen));
    let _task = serve(&fake, program).await;
    let seq = fake.issue_output(1, 12, params);
    fake.settle().await;
    let seen = seen.lock().unwrap().clone();
    (fake.closed(1, seq), seen)
}

#[tokio::test]
async fn a_handler_gets_its_parameters_its_state_and_the_output() {
    let (end, seen) = end_of(params(Some(5.5), Some(2.0))).await;
    assert_eq!(end, Some(OutputOutcome::Reset));
    assert_eq!(seen, ["M12 5.5 Some(2)"]);
    let (end, seen) = end_of(params(Some(20.0), None)).await;
    assert_eq!(end, Some(OutputOutcome::Reset));
    assert_eq!(seen, ["M12 20 None"]);
}

#[tokio::test]
async fn a_handler_is_not_begun_with_parameters_that_it_does_not_take() {
    let all = "VA (clamping force, 1 to 20 kN), VB (left side, a whole number, 1 to 2; may be left out)";
    let cases = [
        (
            params(Some(50.0), None),
            "M12 clamp: VA (clamping force) is 50 kN; write 1 to 20 kN".to_owned(),
        ),
        (
            params(None, None),
            "M12 clamp needs VA (clamping force, 1 to 20 kN)".to_owned(),
        ),
        (
            params(Some(5.0), Some(0.5)),
            "M12 clamp: VB (left side) is 0.5; write a whole number, 1 to 2".to_owned(),
        ),
        (
            Params {
                h: Some(0.0),
                ..params(Some(5.0), None)
            },
            format!("M12 clamp takes no VH; it takes {all}"),
        ),
    ];
    for (params, text) in cases {
        let (end, seen) = end_of(params).await;
        let alarm = Alarm::user(Alarm::CODE_OF_PARAMS, text);
        assert_eq!(end, Some(OutputOutcome::Failed { alarm }));
        assert_eq!(seen, <[String; 0]>::default());
    }
}

#[tokio::test]
async fn what_a_handler_declares_is_in_its_presence() {
    async fn turn(
        Va(_to): Va<Whole<1, 8>>,
        Vb(_with): Vb<Option<Bar>>,
        Vc(_on): Vc<bool>,
    ) -> std::result::Result<(), Alarm> {
        Ok(())
    }
    async fn free(_output: AuxOutput) -> std::result::Result<(), Alarm> {
        Ok(())
    }
    let fake = FakePort::new([1, 2]);
    let turn_table = MCode::new(15, "turn table");
    let program = SequenceProgram::new()
        .on(turn_table, turn)
        .on(20, free)
        .in_coordinate_system(2, |cs| cs.on(15, free).on(MCode::new(16, "free"), free));
    let _task = serve(&fake, program).await;
    let presence = &fake.handlers()["cell"];
    let json = serde_json::to_value(&presence.m_codes).unwrap();
    let expected = serde_json::json!([
        {"m": 15, "name": "turn table", "params": {
            "A": {"min": 1.0, "max": 8.0, "whole": true},
            "B": {"unit": "bar", "optional": true},
            "C": {"min": 0.0, "max": 1.0, "whole": true}}},
        {"m": 15, "cs": 2},
        {"m": 16, "cs": 2, "name": "free"},
    ]);
    assert_eq!(json, expected);
    let name = |cs, m| presence.declaration(cs, m).and_then(|said| said.name.clone());
    assert_eq!(name(1, 15).as_deref(), Some("turn table"));
    assert_eq!(name(2, 15), None, "its own handler declares nothing");
    assert_eq!(name(1, 16), None, "it is served in 2 only");
    let served: Vec<_> = presence
        .served("cell")
        .into_iter()
        .map(|one| (one.m, one.cs))
        .collect();
    assert_eq!(
        served,
        [(15, vec![1]), (15, vec![2]), (16, vec![2]), (20, vec![1, 2])]
    );
}

#[tokio::test]
async fn a_value_that_a_type_does_not_have_is_an_alarm() {
    struct Odd;
    impl ParamValue for Odd {
        fn declaration() -> plc_protocol::types::m_code::ParamDeclaration {
            Whole::<1, 9>::declaration()
        }
        fn from_number(number: Option<f64>) -> Option<Self> {
            number.filter(|number| number % 2.0 > 0.5).map(|_| Odd)
        }
    }
    async fn odd(Va(_odd): Va<Odd>) -> std::result::Result<(), Alarm> {
        Ok(())
    }
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(CLAMP, odd)).await;
    let (three, four) = (
        fake.issue_output(1, 12, params(Some(3.0), None)),
        fake.issue_output(1, 12, params(Some(4.0), None)),
    );
    fake.settle().await;
    assert_eq!(fake.closed(1, three), Some(OutputOutcome::Reset));
    let alarm = Alarm::user(Alarm::CODE_OF_PARAMS, "M12: VA is 4, which is not allowed");
    assert_eq!(fake.closed(1, four), Some(OutputOutcome::Failed { alarm }));
}

#[test]
fn missing_or_duplicate_state_and_duplicate_parameters_are_errors() {
    async fn twice(Va(_force): Va<KiloNewton<20, 1>>, _clamp: ClampParams) -> std::result::Result<(), Alarm> {
        Ok(())
    }
    let program = SequenceProgram::new()
        .on(CLAMP, clamp)
        .on(MCode::new(13, "twice"), twice)
        .on(MCode::new(14, ""), twice)
        .state(1_u8)
        .state(2_u8);
    let Err(Error::SequenceProgram(mistakes)) = program.check() else {
        panic!("it is right");
    };
    for mistake in [
        "M12 clamp takes HandlerState<alloc::sync::Arc<std::sync",
        "which the program does not have: add it by state(..)",
        "M13 twice: two arguments of its handler take VA",
        "M14: name: write 1 to 40 characters",
        "state() got two states of type u8",
    ] {
        assert!(mistakes.contains(mistake), "{mistake} in {mistakes}");
    }
}

#[test]
fn a_unit_declares_its_bounds_and_is_written_with_its_name() {
    let declared = |declaration: plc_protocol::types::m_code::ParamDeclaration| MCodeDeclaration {
        m: 12,
        params: Some([(ParamLetter::A, declaration)].into()),
        ..MCodeDeclaration::default()
    };
    let text = |declaration| declared(declaration).text();
    assert_eq!(text(KiloNewton::<1, 20>::declaration()), "M12 VA (1 to 20 kN)");
    assert_eq!(text(Bar::<0>::declaration()), "M12 VA (0 bar or more)");
    assert_eq!(
        text(KiloNewton::<{ i64::MIN }>::declaration()),
        "M12 VA (a number in kN)"
    );
    assert_eq!(
        text(Option::<Whole<1, 3>>::declaration()),
        "M12 VA (a whole number, 1 to 3; may be left out)"
    );
    assert_eq!(KiloNewton::<1, 20>(2.5).to_string(), "2.5 kN");
}
