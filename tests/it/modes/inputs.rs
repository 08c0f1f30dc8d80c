//! Inputs and readings: the time from which an input is effective (D13, D14, D16), and the values read.

use plc_api::{AuxOutput, Execution, Plc, SequenceProgram};
use plc_protocol::types::state::Transition;

use super::rig::{close, on_machine};

/// M22 is reset after a second, and a tool of 8 mm.
const MORE: &str = "
[m_code.22]
unhandled = \"auto_reset\"
simulated_ms = 1000

[[tool]]
id = 1
radius = 2.0
length = 8.0
";

#[test]
fn d13_skip_number_acts_from_the_next_interpreted_block_with_its_line() {
    on_machine(MORE, |rig| async move {
        rig.start("G01 X10 F600\n/3 Y5\nM22\n/3 G91\n/3 Y9\n/2 Y7\nX20\nM30\n")
            .await;
        rig.sleep(0.5).await;
        // Lines 1 to 3 have been interpreted, and X moves.
        let skip = rig.cs.optional_skip().await.unwrap();
        assert_eq!((skip.requested, skip.effective), (vec![], vec![]));
        rig.cs.set_optional_skip(3, true).await.unwrap();
        let skip = rig.cs.optional_skip().await.unwrap();
        assert_eq!(
            (skip.requested, skip.effective),
            (vec![3], vec![]),
            "nothing has been read with it"
        );
        assert_eq!(rig.cs.state().await.unwrap().optional_skip, [3]);
        rig.until(Execution::ProgramCompleted).await;
        let skip = rig.cs.optional_skip().await.unwrap();
        assert_eq!((skip.requested, skip.effective), (vec![3], vec![3]));
        assert_eq!(skip.effective_from_line, 4, "the line behind M22");
        close(rig.at().await, [20.0, 7.0, 0.0]);
    });
}

#[test]
fn d13_a_program_starts_with_the_skip_numbers_of_then() {
    on_machine(MORE, |rig| async move {
        rig.load("/3 G01 X10 F600\nM30\n").await;
        rig.cs.set_optional_skip(3, true).await.unwrap();
        rig.cs.start().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        let skip = rig.cs.optional_skip().await.unwrap();
        assert_eq!(
            (skip.requested, skip.effective, skip.effective_from_line),
            (vec![3], vec![3], 1)
        );
        close(rig.at().await, [0.0; 3]);
    });
}

#[test]
fn d14_the_optional_stop_is_read_when_motion_has_come_to_the_block() {
    for (at_first, later, stops) in [(false, true, true), (true, false, false)] {
        on_machine("", move |rig| async move {
            rig.cs.set_optional_stop(at_first).await.unwrap();
            rig.start("G01 X10 F600\nM01\nX20\nM30\n").await;
            rig.sleep(0.5).await;
            rig.cs.set_optional_stop(later).await.unwrap();
            let state = rig
                .cs
                .wait_for(|state| {
                    matches!(
                        state.execution,
                        Execution::OptionalStop | Execution::ProgramCompleted
                    )
                })
                .await
                .unwrap();
            assert_eq!(state.execution == Execution::OptionalStop, stops);
            let x = if stops { 10.0 } else { 20.0 };
            close(rig.at().await, [x, 0.0, 0.0]);
        });
    }
}

#[test]
fn d14_m00_and_m01_end_the_chain_before_them_with_optional_stop_off() {
    let passes = |between: &'static str| {
        on_machine("", move |rig| async move {
            rig.start(&format!("G64 G01 X10 F6000\n{between}\nY10\nM30\n"))
                .await;
            if between == "M00" {
                rig.until(Execution::ProgramStopped).await;
                rig.cs.resume().await.unwrap();
            }
            rig.until(Execution::ProgramCompleted).await;
            let corner = |at: &[f64; 3]| (at[0] - 10.0).abs() < 1e-9 && at[1].abs() < 1e-9;
            rig.trace().iter().any(corner)
        })
    };
    assert!(!passes(""), "a corner of a chain is rounded");
    assert!(passes("M00"));
    assert!(passes("M01"));
}

#[test]
fn d16_tool_and_skip_numbers_set_before_the_reset_reach_next_block() {
    on_machine(MORE, |rig| async move {
        let sets = |output: AuxOutput, plc: Plc| async move {
            let system = plc.coordinate_system(output.coordinate_system());
            system.select_tool(1).await?;
            system.set_optional_skip(3, true).await?;
            Ok(())
        };
        let plc = rig.plc.clone();
        tokio::spawn(async move { SequenceProgram::new().on(31, sets).run(&plc).await });
        rig.sleep(0.01).await;
        rig.start("G00 X1\nM31\n/3 G00 X5\nG43\nG00 Z-10\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        // Line 3 is skipped, and Z ends 8 mm, the tool's length, above where it is programmed.
        close(rig.at().await, [1.0, 0.0, -2.0]);
    });
}

#[test]
fn position_and_feedrate_are_metric_with_g20_from_the_last_cycle() {
    on_machine("", |rig| async move {
        // 1 inch at 24 inches a minute, 10.16 mm/s.
        rig.start("G20\nS600 M03\nG01 X1 F24\nM30\n").await;
        rig.sleep(1.0).await;
        let first = rig.cs.position().await.unwrap();
        assert!((first.feedrate - 609.6).abs() < 1e-6, "{}", first.feedrate);
        assert!((first.spindle_rpm - 600.0).abs() < 1e-6, "{}", first.spindle_rpm);
        rig.sleep(0.001).await;
        let second = rig.cs.position().await.unwrap();
        let moved = second.machine["X"] - first.machine["X"];
        assert!((moved - 0.01016).abs() < 1e-9, "one servo period: {moved}");
        rig.until(Execution::ProgramCompleted).await;
        let end = rig.cs.position().await.unwrap();
        assert!((end.machine["X"] - 25.4).abs() < 1e-9);
        assert!((end.work["X"] - 25.4).abs() < 1e-9);
    });
}

#[test]
fn holding_stopping_and_resetting_are_told_until_they_are_reached() {
    on_machine("", |rig| async move {
        let during = async |command: &'static str| {
            let cs = rig.cs.clone();
            let sent = tokio::spawn(async move {
                match command {
                    "hold" => cs.hold().await,
                    "stop" => cs.stop().await,
                    _ => cs.reset().await,
                }
            });
            let state = rig.cs.wait_for(|state| state.transition.is_some()).await.unwrap();
            sent.await.unwrap().unwrap();
            let after = rig.cs.state().await.unwrap();
            assert_eq!(after.transition, None, "{command}");
            (state.execution, state.transition, after.execution)
        };
        rig.start("G01 X100 F6000\nM30\n").await;
        rig.sleep(0.5).await;
        let held = (Execution::Active, Some(Transition::Holding), Execution::FeedHold);
        assert_eq!(during("hold").await, held);
        rig.cs.resume().await.unwrap();
        rig.sleep(0.2).await;
        let stopped = (Execution::Active, Some(Transition::Stopping), Execution::Stopped);
        assert_eq!(during("stop").await, stopped);
    });
}

#[test]
fn commands_execute_in_accepted_order_each_checked_after_the_previous() {
    on_machine("", |rig| async move {
        rig.load("G04 X1\nM30\n").await;
        let (reset, loaded, started, again) =
            tokio::join!(rig.cs.reset(), rig.cs.load(50), rig.cs.start(), rig.cs.start(),);
        assert_eq!((reset, loaded, started), (Ok(()), Ok(()), Ok(())));
        assert!(again.unwrap_err().to_string().contains("ACTIVE"));
        rig.until(Execution::ProgramCompleted).await;
    });
}
