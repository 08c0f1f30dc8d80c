//! Tests of the memory of commands, jogs and orders.

use plc_protocol::types::run::{RunOrder, RunQuery};

use super::*;

fn jog(command_id: &str, refresh_id: &str) -> typed::Command {
    let jog = Command::Jog {
        axis: 'X',
        velocity: 60.0,
        distance: None,
        refresh_id: refresh_id.into(),
    };
    typed::Command {
        wait: false,
        ..command(jog, command_id, "hmi")
    }
}

fn order(command_id: &str, program: u16, parts: u32) -> typed::Command {
    let program = Some(program);
    command(Command::Run(RunOrder { program, parts }), command_id, "mes")
}

async fn runs(port: &Arc<dyn Port>) -> usize {
    let query = RunQuery {
        cs: None,
        from: 0,
        count: 100,
    };
    port.ask(typed::Runs(query)).await.unwrap().runs.len()
}

#[test]
fn refreshes_of_a_jog_are_not_remembered_and_its_begin_is() {
    with_machine(async move |port| {
        port.ask(jog("begin", "a")).await.unwrap();
        for n in 0..300 {
            port.sleep(Duration::from_millis(10)).await;
            let refreshed = port.ask(jog(&format!("refresh-{n}"), "a")).await;
            assert_eq!(status(&refreshed), Some(CommandStatus::Done), "{n}");
        }
        let known = port.ask(typed::CommandStatus("begin".into())).await;
        assert_eq!(status(&known), Some(CommandStatus::Accepted));
        let unknown = port.ask(typed::CommandStatus("refresh-7".into())).await;
        assert_eq!(unknown.unwrap_err().code, RefusalCode::NotFound);
    });
}

#[test]
fn a_refresh_that_comes_minutes_after_the_end_of_its_jog_moves_nothing() {
    with_machine(async move |port| {
        for n in 0..20 {
            let refresh_id = format!("jog-{n}");
            port.ask(jog(&format!("begin-{n}"), &refresh_id)).await.unwrap();
            port.sleep(Duration::from_millis(50)).await;
            let end = Command::JogEnd { refresh_id };
            port.ask(command(end, &format!("end-{n}"), "hmi")).await.unwrap();
        }
        port.sleep(Duration::from_secs(590)).await;
        let late = port.ask(jog("late", "jog-0")).await.unwrap_err();
        assert_eq!(late.code, RefusalCode::NotAllowed, "{}", late.text);
        assert_eq!(execution(&port).await, Execution::Ready);
    });
}

#[test]
fn an_order_is_known_by_its_key_as_long_as_its_run_is_kept() {
    with_machine(async move |port| {
        port.ask(typed::WriteProgram(51, "G04 X1\nM30\n".into()))
            .await
            .unwrap();
        let first = port.ask(order("job-1", 51, 1)).await.unwrap();
        // longer than the command memory keeps commands
        port.sleep(Duration::from_secs(700)).await;
        let again = port.ask(order("job-1", 51, 1)).await.unwrap();
        assert_eq!((again.status, again.run_id), (CommandStatus::Done, first.run_id));
        assert_eq!(runs(&port).await, 1);
        for other in [order("job-1", 51, 2), order("job-1", 50, 1)] {
            let refusal = port.ask(other).await.unwrap_err();
            assert_eq!(refusal.code, RefusalCode::CommandIdReused, "{}", refusal.text);
        }
        port.ask(order("job-2", 51, 1)).await.unwrap();
        port.sleep(Duration::from_secs(2)).await;
        assert_eq!(runs(&port).await, 2);
    });
}
