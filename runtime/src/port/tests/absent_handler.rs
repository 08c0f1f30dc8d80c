//! Declarations of a handler that is absent while a run issues its M code.

use plc_protocol::types::m_code::{MCodeDeclaration, ParamDeclaration, ParamLetter};

use super::*;

/// Returns the presence of a handler that serves M60 and accepts A from 0 to 5.
fn declares_a_up_to_5() -> HandlerPresence {
    let a = ParamDeclaration::in_unit("kN").within(Some(0.0), Some(5.0));
    HandlerPresence {
        online: true,
        instance: Some("first".to_owned()),
        handles: vec![HandledCode { cs: 1, m: 60 }],
        m_codes: vec![MCodeDeclaration {
            m: 60,
            params: Some([(ParamLetter::A, a)].into()),
            ..MCodeDeclaration::default()
        }],
        ..HandlerPresence::default()
    }
}

#[test]
fn p14_range_of_an_absent_handler_raises_alarm_11_before_the_output() {
    with_machine(async move |port| {
        let handler = |presence| port.ask(typed::Handler("clamp".into(), presence));
        handler(declares_a_up_to_5()).await.unwrap();
        let text = "P3=7\nG04 X1\nM60 VA[P3]\nM30\n".to_owned();
        port.ask(typed::WriteProgram(60, text)).await.unwrap();
        port.ask(command(Command::Load { program: 60 }, "load-60", "test"))
            .await
            .unwrap();
        port.ask(start("go")).await.unwrap();
        let leaves = HandlerPresence {
            returns_within_ms: Some(60_000),
            ..HandlerPresence::offline(Some("first".to_owned()))
        };
        handler(leaves).await.unwrap();
        port.sleep(Duration::from_secs(5)).await;
        assert_eq!(execution(&port).await, Execution::Stopped);
        let history = port.ask(typed::AlarmHistory).await.unwrap();
        let numbers: Vec<u16> = history.iter().map(|alarm| alarm.number).collect();
        assert_eq!(numbers, [11], "{history:?}");
        let pending = port.read(&Topic::cs(1, CsTopic::Pending)).await.unwrap();
        let Payload::Pending(pending) = &pending.payload else {
            panic!("{pending:?}");
        };
        assert!(pending.outputs.is_empty(), "no output was issued: {pending:?}");
    });
}
