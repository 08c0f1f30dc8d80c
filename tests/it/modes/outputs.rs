//! Auxiliary function outputs while a program is operated: waits, their durations, and notifications (D16, D18, D32 to
//! D36).

use std::sync::{Arc, Mutex};
use std::time::Duration;

use plc_api::{Alarm, AuxOutput, CancelReason, Cancellation, Execution, Plc, SequenceProgram};
use plc_protocol::types::command::{Command, CommandMeta};
use plc_protocol::types::output::{OutputState, PendingOutput};
use plc_protocol::types::request::typed;
use plc_protocol::types::state::Reason;

use super::rig::{Rig, close, on_machine};

/// M20 and M21 are issued with the motion, M22 waits; a sequence program resets them, if there is one.
const M_CODES: &str = r#"
[m_code.20]
timing = "with_motion"
unhandled = "wait"

[m_code.21]
timing = "with_motion"
unhandled = "wait"

[m_code.22]
unhandled = "wait"
"#;

async fn serve(rig: &Rig, program: SequenceProgram) {
    let plc = rig.plc.clone();
    tokio::spawn(async move { program.run(&plc).await });
    rig.sleep(0.01).await;
}

async fn open(rig: &Rig) -> Vec<PendingOutput> {
    rig.cs.pending().await.unwrap().outputs
}

async fn reset(rig: &Rig, m: u16) {
    let mut outputs = rig.plc.outputs().on(m);
    outputs.next().await.unwrap().reset().await.unwrap();
}

#[test]
fn d18_under_hold_no_output_is_made_and_it_is_made_at_the_resume() {
    on_machine(M_CODES, |rig| async move {
        // The second M20 waits for the reset of the first, which arrives during the hold.
        rig.start("M20\nG01 X10 F600\nM20\nM30\n").await;
        rig.sleep(0.5).await;
        rig.cs.hold().await.unwrap();
        reset(&rig, 20).await;
        rig.sleep(1.0).await;
        let outputs = open(&rig).await;
        assert!(
            outputs.iter().all(|output| output.state == OutputState::Queued),
            "{outputs:?}"
        );
        rig.cs.resume().await.unwrap();
        rig.sleep(0.01).await;
        assert_eq!(open(&rig).await[0].state, OutputState::Output);
    });
}

#[test]
fn d18_behind_m00_no_output_is_made_before_the_resume() {
    on_machine(M_CODES, |rig| async move {
        rig.start("G01 X10 F600\nM00\nM20\nG01 X20\nM30\n").await;
        rig.until(Execution::ProgramStopped).await;
        rig.sleep(1.0).await;
        assert_eq!(open(&rig).await, []);
        rig.cs.resume().await.unwrap();
        rig.sleep(0.01).await;
        assert_eq!(open(&rig).await[0].state, OutputState::Output);
    });
}

#[test]
fn d32_m02_m30_and_m99_of_a_main_program_wait_and_show_for_what() {
    for end in ["M02", "M30", "M99"] {
        on_machine(M_CODES, move |rig| async move {
            rig.start(&format!("M20\nG01 X1 F600\nM21\n{end}\n")).await;
            let state = rig.until(Execution::Wait).await;
            close(rig.at().await, [1.0, 0.0, 0.0]);
            assert_eq!(state.waiting_on.unwrap().m, 20, "{end}");
            reset(&rig, 20).await;
            let state = rig.until(Execution::Wait).await;
            assert_eq!(state.waiting_on.unwrap().m, 21, "{end}");
            reset(&rig, 21).await;
            rig.until(Execution::ProgramCompleted).await;
            assert_eq!(open(&rig).await, []);
        });
    }
}

#[test]
fn d33_an_output_carries_its_run_and_numbers_go_on_from_run_to_run() {
    on_machine(M_CODES, |rig| async move {
        let mut seen = Vec::new();
        rig.load("M22\nM30\n").await;
        for _ in 0..3 {
            rig.cs.start().await.unwrap();
            let state = rig.until(Execution::Wait).await;
            let notice = open(&rig).await[0].output.clone();
            assert_eq!(Some(&notice.run_id), state.run_id.as_ref());
            assert_eq!(state.waiting_on.unwrap().seq, notice.seq);
            seen.push((notice.run_id, notice.seq));
            rig.cs.reset().await.unwrap();
        }
        assert!(
            seen.windows(2)
                .all(|two| two[0].0 != two[1].0 && two[0].1 < two[1].1),
            "{seen:?}"
        );
    });
}

#[test]
fn d34_alarm_of_the_coordinate_system_cancels_the_handler_with_reason() {
    /// Records the reason why its handler ended.
    struct Guard(Cancellation, Arc<Mutex<Vec<Option<CancelReason>>>>);

    impl Drop for Guard {
        fn drop(&mut self) {
            self.1.lock().unwrap().push(self.0.reason());
        }
    }

    on_machine(M_CODES, |rig| async move {
        let ended = Arc::new(Mutex::new(Vec::new()));
        let noted = Arc::clone(&ended);
        let works = move |output: AuxOutput, plc: Plc| {
            let guard = Guard(output.cancellation(), Arc::clone(&noted));
            async move {
                plc.sleep(Duration::from_secs(1000)).await;
                drop(guard);
                Ok::<(), Alarm>(())
            }
        };
        serve(&rig, SequenceProgram::new().on(20, works)).await;
        rig.start("M20\nG01 X1 F600\nX900\nM30\n").await;
        let state = rig.until(Execution::Stopped).await;
        assert_eq!(state.reason, Some(Reason::Alarm));
        rig.sleep(0.01).await;
        assert_eq!(*ended.lock().unwrap(), [Some(CancelReason::Alarm)]);
        assert_eq!(open(&rig).await, []);
    });
}

#[test]
fn d35_spindle_code_handler_commands_the_spindle_stock_does_the_rest() {
    on_machine("", |rig| async move {
        let idle = |_: AuxOutput| async { Ok(()) };
        serve(&rig, SequenceProgram::new().on(3, idle)).await;
        let turns = async || rig.cs.spindle().await.unwrap().rpm;
        rig.start("S1000 M03\nM00\nM04\nM00\nM05\nM30\n").await;
        rig.until(Execution::ProgramStopped).await;
        assert_eq!(turns().await, 0.0, "the handler of M03 leaves it at rest");
        rig.cs.resume().await.unwrap();
        rig.sleep(5.0).await;
        assert_eq!(turns().await, 1000.0, "M04 is the stock program's");
        assert!(rig.cs.spindle().await.unwrap().actual_rpm < -999.0);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        rig.sleep(5.0).await;
        assert_eq!(rig.cs.spindle().await.unwrap().actual_rpm, 0.0);
    });
}

#[test]
fn a_handler_takes_the_place_of_the_stock_programs_select_tool() {
    let more = "\n[m_code.6]\nstock = \"select_tool\"\n[[tool]]\nid = 1\nradius = 2.0\nlength = 8.0\n";
    on_machine(more, |rig| async move {
        rig.start("M6 VA1\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        assert_eq!(rig.cs.tool().await.unwrap().id, 1);
        let other = |output: AuxOutput, plc: Plc| async move {
            let system = plc.coordinate_system(output.coordinate_system());
            system.select_tool(7).await?;
            Ok(())
        };
        serve(&rig, SequenceProgram::new().on(6, other)).await;
        rig.start("M6 VA1\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        assert_eq!(rig.cs.tool().await.unwrap().id, 7);
    });
}

#[test]
fn d36_without_timeout_ms_a_wait_never_ends_and_the_state_shows_since() {
    on_machine(M_CODES, |rig| async move {
        rig.start("G01 X10 F600\nM22\nM30\n").await;
        let state = rig.until(Execution::Wait).await;
        let since = |state: plc_protocol::types::state::State| state.waiting_on.unwrap().since;
        let first = since(state);
        assert_eq!(first, open(&rig).await[0].since);
        rig.sleep(600.0).await;
        // the state is published again
        rig.cs.set_optional_stop(true).await.unwrap();
        let state = rig.cs.state().await.unwrap();
        assert_eq!(state.execution, Execution::Wait);
        assert_eq!(since(state), first, "ten minutes later it waits since then");
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn d36_timeout_ms_counts_under_hold_too() {
    let more = "\n[m_code.22]\nunhandled = \"wait\"\ntimeout_ms = 1000\n";
    on_machine(more, |rig| async move {
        rig.start("M22\nM30\n").await;
        rig.until(Execution::Wait).await;
        let begun_s = rig.plc.now_s();
        rig.sleep(0.5).await;
        rig.cs.hold().await.unwrap();
        assert_eq!(rig.state().await.0, Execution::FeedHold);
        let state = rig.until(Execution::Stopped).await;
        assert_eq!(state.reason, Some(Reason::Alarm));
        let waited_s = rig.plc.now_s() - begun_s;
        assert!((0.999..1.002).contains(&waited_s), "{waited_s}");
    });
}

#[test]
fn m_codes_that_nobody_handles_are_listed_when_the_program_is_loaded() {
    on_machine(M_CODES, |rig| async move {
        let load = async |command_id: &str| {
            let meta = CommandMeta {
                command_id: command_id.to_owned(),
                client_id: "panel".to_owned(),
                ..CommandMeta::default()
            };
            let load = typed::Command {
                cs: 1,
                command: Command::Load { program: 50 },
                meta,
                wait: true,
            };
            rig.plc.port().ask(load).await.unwrap().text
        };
        // M05 is the stock program's, and M00 and M30 are the runtime's own.
        rig.load("M05\nM00\nM21\nM22 VA1\nM20\nM30\n").await;
        assert_eq!(load("a").await, "no handler is registered for M20, M21, M22");
        serve(
            &rig,
            SequenceProgram::new().on(20..=21, |_: AuxOutput| async { Ok(()) }),
        )
        .await;
        assert_eq!(load("b").await, "no handler is registered for M22");
        let mut outputs = rig.plc.outputs().on(22);
        let asked = tokio::spawn(async move { outputs.next().await });
        rig.sleep(0.01).await;
        assert_eq!(load("c").await, "");
        asked.abort();
    });
}
