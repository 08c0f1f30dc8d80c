//! Single block and the interlock.

use plc_api::Execution;
use plc_protocol::types::output::OutputState;
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::state::Reason;

use super::rig::{close, on_machine, refused};
use super::stairs::{STAIRS, assert_on_stairs};

#[test]
fn m1i_single_block_ends_each_block_at_its_corner_until_resume() {
    on_machine("", |rig| async move {
        rig.load("ta20 td20 ts0 G64 G01 F6000\nX10\n\nL1=10\nY[L1]\nX20\nM30\n")
            .await;
        rig.cs.set_single_block(true).await.unwrap();
        rig.cs.start().await.unwrap();
        // The blocks with words: the first line moves nothing; program codes and empty lines are no blocks.
        for corner in [[0.0; 3], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0], [20.0, 10.0, 0.0]] {
            rig.interrupted(Reason::SingleBlock).await;
            close(rig.at().await, corner);
            rig.sleep(0.5).await;
            close(rig.at().await, corner);
            rig.cs.resume().await.unwrap();
        }
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn m1i_single_block_reports_the_line_of_the_block_that_ended() {
    on_machine("", |rig| async move {
        rig.load("G90\nG01 X10 F6000\nF3000\n\nG91\nX1\nM30\n").await;
        rig.cs.set_single_block(true).await.unwrap();
        rig.cs.start().await.unwrap();
        for line in [1, 2, 3, 5, 6] {
            rig.interrupted(Reason::SingleBlock).await;
            // the position is published five times a second
            rig.sleep(0.5).await;
            assert_eq!(rig.cs.program().await.unwrap().line, line);
            rig.cs.resume().await.unwrap();
        }
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn m1i_single_block_switched_on_in_a_chain_holds_after_each_block() {
    on_machine("", |rig| async move {
        rig.start(STAIRS).await;
        rig.sleep(0.2).await;
        rig.cs.set_single_block(true).await.unwrap();
        // Half of the blend of 60 ms and of the hold's slew of 200 ms are after the corner, at 50 mm/s at
        // most.
        for (axis, corner) in [(1, 0.0), (0, 20.0), (1, 20.0)] {
            rig.interrupted(Reason::SingleBlock).await;
            let behind = rig.at().await[axis] - corner;
            assert!((0.0..50.0 * (0.03 + 0.1) + 1e-9).contains(&behind), "{behind} mm");
            rig.cs.resume().await.unwrap();
        }
        rig.sleep(0.1).await;
        rig.cs.set_single_block(false).await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [40.0, 40.0, 0.0]);
        rig.trace().into_iter().for_each(assert_on_stairs);
    });
}

#[test]
fn m1i_blocks_that_are_not_begun_when_it_is_switched_on_stop_alone() {
    // M20 is reset after 2 s: the pre-read has not passed it.
    let more = "\n[m_code.20]\nsimulated_ms = 2000\nunhandled = \"auto_reset\"\n";
    on_machine(more, |rig| async move {
        rig.start("ta20 td20 ts0 G01 F6000\nX10\nM20\nX20\nY10\nM30\n")
            .await;
        rig.until(Execution::Wait).await;
        rig.cs.set_single_block(true).await.unwrap();
        for corner in [[10.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 10.0, 0.0]] {
            rig.interrupted(Reason::SingleBlock).await;
            close(rig.at().await, corner);
            rig.cs.resume().await.unwrap();
        }
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn d18_between_blocks_in_single_block_no_output_is_made() {
    let more =
        "\n[m_code.20]\ntiming = \"with_motion\"\nunhandled = \"wait\"\n[m_code.21]\nunhandled = \"wait\"\n";
    on_machine(more, |rig| async move {
        rig.load("G01 F6000 X10\nX20\nM20\nX30 M21\nM30\n").await;
        rig.cs.set_single_block(true).await.unwrap();
        rig.cs.start().await.unwrap();
        for _ in 0..2 {
            rig.interrupted(Reason::SingleBlock).await;
            rig.sleep(0.2).await;
            assert_eq!(rig.cs.pending().await.unwrap().outputs, []);
            rig.cs.resume().await.unwrap();
        }
        // M20 is a separate block: it issues its output, and the block has ended.
        rig.interrupted(Reason::SingleBlock).await;
        let pending = rig.cs.pending().await.unwrap().outputs;
        assert_eq!(
            (pending.len(), pending[0].output.m, pending[0].state),
            (1, 20, OutputState::Output)
        );
        rig.cs.resume().await.unwrap();
        let state = rig.until(Execution::Wait).await;
        assert_eq!(state.waiting_on.unwrap().m, 21);
        close(rig.at().await, [30.0, 0.0, 0.0]);
    });
}

#[test]
fn single_block_goes_with_m00_by_one_resume_and_with_hold() {
    on_machine("", |rig| async move {
        rig.load("G01 F600 X10\nM00\nX20\nM30\n").await;
        rig.cs.set_single_block(true).await.unwrap();
        assert!(rig.cs.state().await.unwrap().single_block);
        rig.cs.start().await.unwrap();
        rig.sleep(0.3).await;
        rig.cs.hold().await.unwrap();
        assert_eq!(rig.state().await.0, Execution::FeedHold);
        rig.cs.resume().await.unwrap();
        rig.interrupted(Reason::SingleBlock).await;
        close(rig.at().await, [10.0, 0.0, 0.0]);
        rig.cs.hold().await.unwrap();
        assert_eq!(
            rig.state().await.0,
            Execution::Interrupted,
            "a hold at rest has no effect"
        );
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramStopped).await;
        rig.cs.resume().await.unwrap();
        rig.interrupted(Reason::SingleBlock).await;
        close(rig.at().await, [20.0, 0.0, 0.0]);
        // Reset ends the run from there.
        rig.cs.reset().await.unwrap();
        assert_eq!(rig.state().await.0, Execution::Ready);
    });
}

#[test]
fn the_interlock_holds_motion_and_refuses_resume_and_start_while_it_is_on() {
    on_machine("", |rig| async move {
        rig.start("G01 F600 X10\nM30\n").await;
        rig.sleep(0.3).await;
        rig.cs.set_interlock(true, "the door is open").await.unwrap();
        rig.interrupted(Reason::Interlock).await;
        let at = rig.at().await;
        assert!(at[0] > 1.0 && at[0] < 9.0, "{at:?}");
        let refusal = refused(rig.cs.resume().await, RefusalCode::StartLocked);
        assert!(refusal.text.contains("the door is open"), "{}", refusal.text);
        rig.cs.set_interlock(false, "").await.unwrap();
        rig.sleep(1.0).await;
        assert_eq!(
            rig.state().await,
            (Execution::Interrupted, Some(Reason::Interlock))
        );
        close(rig.at().await, at);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [10.0, 0.0, 0.0]);
        rig.cs.set_interlock(true, "the door is open").await.unwrap();
        refused(rig.cs.start().await, RefusalCode::StartLocked);
        refused(rig.cs.mdi("G00 X1").await, RefusalCode::StartLocked);
        refused(rig.cs.home(&[]).await, RefusalCode::StartLocked);
        refused(rig.cs.jog('X', 100.0, None, "a").await, RefusalCode::StartLocked);
        rig.cs.set_interlock(false, "").await.unwrap();
        rig.cs.start().await.unwrap();
    });
}

#[test]
fn interlock_in_wait_latches_the_reset_until_resume() {
    let more = "\n[m_code.20]\nunhandled = \"auto_reset\"\nsimulated_ms = 1000\n";
    on_machine(more, |rig| async move {
        rig.start("M20\nG00 X10\nM30\n").await;
        rig.until(Execution::Wait).await;
        rig.cs.set_interlock(true, "the door is open").await.unwrap();
        rig.interrupted(Reason::Interlock).await;
        assert_eq!(rig.cs.state().await.unwrap().waiting_on.unwrap().m, 20);
        rig.sleep(2.0).await;
        assert_eq!(rig.cs.pending().await.unwrap().outputs, []);
        assert_eq!(
            rig.state().await,
            (Execution::Interrupted, Some(Reason::Interlock))
        );
        close(rig.at().await, [0.0; 3]);
        rig.cs.set_interlock(false, "").await.unwrap();
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [10.0, 0.0, 0.0]);
    });
}

#[test]
fn single_block_toggled_at_any_moment_keeps_the_path_and_all_blocks() {
    on_machine("", |rig| async move {
        for n in 0..20 {
            rig.start(STAIRS).await;
            rig.sleep(0.0037 + 0.0811 * f64::from(n)).await;
            for on in [true, false, true, false, true] {
                rig.cs.set_single_block(on).await.unwrap();
                rig.sleep(0.0021 * f64::from(n)).await;
            }
            // From here, resume continues to the end after any number of stops.
            let mut stops = 0;
            loop {
                let waits = |state: &plc_protocol::types::state::State| state.execution != Execution::Active;
                match rig.cs.wait_for(waits).await.unwrap().execution {
                    Execution::Interrupted => rig.cs.resume().await.unwrap(),
                    Execution::ProgramCompleted => break,
                    other => panic!("{other:?}"),
                }
                stops += 1;
            }
            assert!(
                stops <= 5,
                "{stops} stops for four blocks and the line before them"
            );
            rig.trace().into_iter().for_each(assert_on_stairs);
            close(rig.at().await, [40.0, 40.0, 0.0]);
            rig.cs.set_single_block(false).await.unwrap();
            rig.cs.mdi("G90 G00 X0 Y0").await.unwrap();
            rig.trace();
        }
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn the_start_lock_refuses_starts_with_its_text_and_stops_nothing() {
    on_machine("", |rig| async move {
        rig.start("G01 F600 X10\nM30\n").await;
        rig.cs.set_start_lock(true, "no pressure").await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        for refusal in [
            refused(rig.cs.start().await, RefusalCode::StartLocked),
            refused(rig.cs.mdi("G00 X1").await, RefusalCode::StartLocked),
        ] {
            assert!(refusal.text.contains("no pressure"), "{}", refusal.text);
        }
        rig.cs.set_start_lock(false, "").await.unwrap();
        rig.cs.start().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
    });
}
