//! Parameters are checked when a program is loaded.

use plc_api::fake::FakePort;
use plc_api::{Alarm, AuxOutput, Params, SequenceProgram};

use crate::{serve, va};

fn pocket(params: &Params) -> Result<f64, Alarm> {
    let tool = params.a().ok_or(Alarm::user(1, "M100 needs VA"))?;
    if (1.0..=8.0).contains(&tool) {
        Ok(tool)
    } else {
        Err(Alarm::user(2, "no such pocket"))
    }
}

async fn nothing(_output: AuxOutput) -> Result<(), Alarm> {
    Ok(())
}

#[tokio::test]
async fn a_handler_refuses_parameters_with_its_own_words() {
    let fake = FakePort::new([1, 2]);
    let program = SequenceProgram::new()
        .on([100, 101, 102], nothing)
        .validate(100, pocket)
        .validate(102, |_: &Params| -> Result<(), Alarm> { panic!("a mistake") })
        .in_coordinate_system(2, |cs| cs.on(100, nothing));
    let _task = serve(&fake, program.handler_id("h")).await;
    assert!(fake.handlers()["h"].validates);
    assert_eq!(fake.validate(1, 100, va(3.0)).await, Ok(()));
    assert_eq!(
        fake.validate(1, 100, va(9.0)).await,
        Err("no such pocket".to_owned())
    );
    assert_eq!(
        fake.validate(1, 100, Params::default()).await,
        Err("M100 needs VA".to_owned())
    );
    assert_eq!(
        fake.validate(1, 101, Params::default()).await,
        Ok(()),
        "the M code has no check"
    );
    let panicked = fake.validate(1, 102, Params::default()).await.unwrap_err();
    assert!(panicked.contains("a mistake"), "{panicked}");
    // coordinate system 2 has a separate handler without a check
    assert_eq!(fake.validate(2, 100, va(9.0)).await, Ok(()));
}

#[tokio::test]
async fn a_program_without_checks_does_not_say_that_it_validates() {
    let fake = FakePort::new([1]);
    let _task = serve(&fake, SequenceProgram::new().on(100, nothing).handler_id("h")).await;
    assert!(!fake.handlers()["h"].validates);
}

#[test]
fn two_checks_of_one_code_and_a_check_without_a_handler_are_mistakes() {
    let program = SequenceProgram::new()
        .on(100, nothing)
        .validate(100, pocket)
        .validate(99..=100, pocket)
        .validate(7, pocket);
    let mistakes = program.check().unwrap_err().to_string();
    for mistake in ["M100 is validated twice", "M7 is validated and has no handler"] {
        assert!(mistakes.contains(mistake), "{mistake} in {mistakes}");
    }
}
