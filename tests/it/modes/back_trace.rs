//! Back trace: from a feed hold back along the passed path of G500, and forward again.

use std::sync::{Arc, Mutex};

use plc_api::types::request::RefusalCode;
use plc_api::types::state::Reason;
use plc_api::{AuxOutput, Execution, Plc, SequenceProgram};

use super::rig::{close, distance, on_machine, refused};
use super::stairs::{STAIRS, assert_on_stairs};

fn g500(program: &str) -> String {
    format!("G64 G500 {program}")
}

#[test]
fn back_trace_that_turns_round_at_once_at_the_end_of_a_block_lets_the_program_go_on() {
    on_machine("", |rig| async move {
        // 0.22 s and up to three periods; a hold just before its end comes when the block is over.
        let mut at_the_end = 0;
        for moment_ms in 210_u32..230 {
            rig.start(&g500("ta20 td20 ts0 G01 F3000 X10\nM00\nX20\nM30\n"))
                .await;
            rig.sleep(f64::from(moment_ms) / 1000.0).await;
            if rig.state().await.0 == Execution::ProgramStopped {
                break;
            }
            rig.cs.hold().await.unwrap();
            at_the_end += u32::from(distance(rig.at().await, [10.0, 0.0, 0.0]) == 0.0);
            rig.cs.back_trace(true).await.unwrap();
            rig.cs.hold().await.unwrap();
            rig.cs.resume().await.unwrap();
            rig.until(Execution::ProgramStopped).await;
            close(rig.at().await, [10.0, 0.0, 0.0]);
            rig.cs.resume().await.unwrap();
            rig.until(Execution::ProgramCompleted).await;
            rig.cs.mdi("G90 G00 X0").await.unwrap();
        }
        assert!(at_the_end > 0);
    });
}

#[test]
fn back_trace_goes_back_on_the_path_and_the_program_goes_on_from_there() {
    on_machine("", |rig| async move {
        for (n, moment_s) in [0.2, 0.55, 0.91, 1.3].into_iter().enumerate() {
            rig.start(&g500(STAIRS)).await;
            rig.sleep(moment_s).await;
            rig.cs.hold().await.unwrap();
            let held_at = rig.at().await;
            rig.cs.back_trace(true).await.unwrap();
            assert_eq!(rig.state().await, (Execution::Active, Some(Reason::BackTrace)));
            rig.sleep(0.15).await;
            rig.cs.hold().await.unwrap();
            assert_eq!(rig.state().await, (Execution::FeedHold, Some(Reason::BackTrace)));
            let back_at = rig.at().await;
            assert!(
                back_at[0] + back_at[1] < held_at[0] + held_at[1] - 1.0,
                "{back_at:?}"
            );
            if n % 2 == 0 {
                rig.cs.back_trace(false).await.unwrap();
            } else {
                rig.cs.back_trace(true).await.unwrap();
                rig.sleep(0.05).await;
                rig.cs.hold().await.unwrap();
                rig.cs.resume().await.unwrap();
            }
            assert_eq!(rig.state().await, (Execution::Active, None));
            rig.until(Execution::ProgramCompleted).await;
            close(rig.at().await, [40.0, 40.0, 0.0]);
            rig.trace().into_iter().for_each(assert_on_stairs);
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            rig.trace();
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_rests_at_the_end_of_its_way_and_says_so() {
    on_machine("", |rig| async move {
        rig.start(&g500(STAIRS)).await;
        rig.sleep(0.7).await;
        rig.cs.hold().await.unwrap();
        rig.cs.back_trace(true).await.unwrap();
        let state = rig.until(Execution::FeedHold).await;
        assert_eq!(state.reason, Some(Reason::BackTraceEnd));
        close(rig.at().await, [0.0, 0.0, 0.0]);
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("no way back"), "{}", refusal.text);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 40.0, 0.0]);
        rig.trace().into_iter().for_each(assert_on_stairs);
    });
}

#[test]
fn stop_and_abort_end_a_back_trace_and_keep_the_position() {
    on_machine("", |rig| async move {
        for abort in [false, true] {
            rig.start(&g500(STAIRS)).await;
            rig.sleep(0.7).await;
            rig.cs.hold().await.unwrap();
            rig.cs.back_trace(true).await.unwrap();
            rig.sleep(0.1).await;
            if abort {
                rig.cs.abort().await.unwrap();
            } else {
                rig.cs.stop().await.unwrap();
            }
            let at = rig.at().await;
            assert_eq!(rig.state().await.0, Execution::Stopped);
            rig.cs.reset().await.unwrap();
            rig.sleep(0.2).await;
            close(rig.at().await, at);
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            assert!(distance(at, [0.0; 3]) > 1.0);
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn back_trace_ends_at_the_last_m_code_and_puts_none_out_again() {
    on_machine("[m_code.60]\ntiming = \"with_motion\"\n", |rig| async move {
        let made = Arc::new(Mutex::new(Vec::new()));
        let sink = Arc::clone(&made);
        let handlers = SequenceProgram::new().on(50..=60, move |output: AuxOutput, _plc: Plc| {
            sink.lock().unwrap().push(output.m());
            async { Ok(()) }
        });
        let plc = rig.plc.clone();
        let running = tokio::spawn(async move { handlers.run(&plc).await });
        rig.sleep(0.01).await;
        rig.start(&g500("ta50 td50 ts0 G01 F3000\nX10\nM50\nX20\nM60\nX40\nM30\n"))
            .await;
        rig.sleep(0.7).await;
        rig.cs.hold().await.unwrap();
        let [x, ..] = rig.at().await;
        assert!((20.0..40.0).contains(&x), "{x}");
        rig.cs.back_trace(true).await.unwrap();
        let state = rig.until(Execution::FeedHold).await;
        assert_eq!(state.reason, Some(Reason::BackTraceEnd));
        close(rig.at().await, [10.0, 0.0, 0.0]);
        rig.cs.back_trace(false).await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 0.0, 0.0]);
        assert_eq!(*made.lock().unwrap(), [50, 60]);
        running.abort();
    });
}

#[test]
fn back_trace_is_refused_where_there_is_no_way_back() {
    on_machine("", |rig| async move {
        refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        rig.start("G64 G501 ta50 td50 ts0 G01 F3000\nX10\nX40\nM30\n")
            .await;
        rig.sleep(0.3).await;
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("hold first"), "{}", refusal.text);
        rig.cs.hold().await.unwrap();
        let refusal = refused(rig.cs.back_trace(true).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("G500"), "{}", refusal.text);
        let refusal = refused(rig.cs.back_trace(false).await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("not on"), "{}", refusal.text);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 0.0, 0.0]);
    });
}
