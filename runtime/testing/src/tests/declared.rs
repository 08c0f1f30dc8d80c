//! Tests of M codes that handlers and the configuration declare, on a whole machine.

use std::time::Duration;

use plc_api::units::KiloNewton;
use plc_api::{Alarm, MCode, Plc, Va};
use plc_protocol::types::machine::Birth;
use plc_protocol::types::message::Payload;
use plc_protocol::types::topic::Topic;
use tandem_model::alarm::VALUE_OUT_OF_RANGE;

use super::super::*;

const CLAMP: MCode = MCode::new(12, "clamp");

async fn clamp(Va(_force): Va<KiloNewton<1, 20>>) -> Result<(), Alarm> {
    Ok(())
}

fn bench() -> Bench {
    Bench::new().serve(SequenceProgram::new().handler_id("cell").on(CLAMP, clamp))
}

async fn birth(plc: &Plc) -> Birth {
    match &plc.port().read(&Topic::Birth).await.unwrap().payload {
        Payload::Birth(birth) => birth.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_program_with_parameters_that_are_not_declared_is_not_loaded() {
    let text = "G01 X10 F3000\nM12 VA50\nM98 P1000\nM30";
    let refused = bench().subprogram(1000, "N1 M12\nM99").run(text);
    let refused = refused.unwrap_err().to_string();
    for line in [
        "line 2: E0191 M12 clamp: VA is 50 kN; write 1 to 20 kN",
        "line 1: E0191 in program 1000, which is called: M12 clamp needs VA (1 to 20 kN)",
    ] {
        assert!(refused.contains(line), "{line} in {refused}");
    }
}

#[test]
fn what_a_variable_holds_is_refused_before_the_handler_is_begun() {
    let run = bench().run("P3 = 50\nM12 VA[P3]\nG01 X10 F3000\nM30").unwrap();
    let alarm = run.alarm().unwrap();
    assert_eq!(alarm.number, VALUE_OUT_OF_RANGE.number);
    assert!(
        alarm.text.contains("M12 clamp: VA is 50 kN; write 1 to 20 kN"),
        "{}",
        alarm.text
    );
    assert_eq!(alarm.line, Some(2));
    bench()
        .run("P3 = 5\nM12 VA[P3]\nM30")
        .unwrap()
        .completed()
        .unwrap();
}

#[test]
fn an_mdi_input_with_other_parameters_is_refused_at_its_place() {
    let run = bench().at_s(0.0, |scene| async move {
        let mill = scene.cs(1);
        mill.stop().await?;
        let refused = mill.mdi("M12 VA0").await.unwrap_err();
        let plc_api::Error::Refused(refusal) = refused else {
            panic!("{refused}");
        };
        let found = &refusal.diagnostics[0];
        assert_eq!((found.code.as_str(), found.line, found.column), ("E0191", 1, 5));
        assert_eq!(found.help, "handler cell declares M12 clamp VA (1 to 20 kN).");
        Ok(())
    });
    run.run("G04 P100\nM30").unwrap();
}

#[test]
fn birth_lists_served_m_codes_with_parameters_while_handlers_online() {
    let run = bench().at_s(0.1, |scene| async move {
        let told = birth(scene.plc()).await;
        let one = told.serves.iter().find(|one| one.m == 12).unwrap();
        assert_eq!(
            (one.cs.as_slice(), one.handler_id.as_deref()),
            (&[1, 2][..], Some("cell"))
        );
        assert_eq!(one.declaration().text(), "M12 clamp VA (1 to 20 kN)");
        scene.kill_handlers();
        scene.plc().sleep(Duration::from_millis(100)).await;
        let told = birth(scene.plc()).await;
        assert!(told.serves.iter().all(|one| one.m != 12), "{:?}", told.serves);
        Ok(())
    });
    run.run("G04 P500\nM30").unwrap();
}
