//! Sequences that must not stop between blocks, checked by the motion and not by the progress of reading
//! (M1); G31 with an external skip input.

use plc_api::Execution;
use plc_protocol::types::message::Payload;
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::state::Reason;
use plc_protocol::types::topic::{CsTopic, Topic};

use super::rig::{Point, Rig, close, distance, on_machine, refused};

/// Tool 1 has a radius of 5 mm; M100 VA1 selects it.
const TOOL: &str = "
[[tool]]
id = 1
radius = 5.0
length = 0.0

[m_code.100]
stock = \"select_tool\"
";

/// Lets time pass until the machine is at a position.
async fn until_at(rig: &Rig, is_there: impl Fn(Point) -> bool) {
    for _ in 0..10_000 {
        if is_there(rig.at().await) {
            return;
        }
        rig.sleep(0.01).await;
    }
    panic!("it never gets there: {:?}", rig.at().await);
}

#[test]
fn m1i_single_block_is_refused_during_compensated_motion() {
    on_machine(TOOL, |rig| async move {
        rig.start("M100 VA1\nta20 td20 ts0 F600\nG01 G41\nX10\nX20\nX30\nG40\nX40\nX50\nX60\nM30\n")
            .await;
        for x in [12.0, 22.0] {
            until_at(&rig, |at| at[0] > x).await;
            let refusal = refused(rig.cs.set_single_block(true).await, RefusalCode::NotAllowed);
            assert!(refusal.text.contains("cutter compensation"), "{}", refusal.text);
            assert!(!rig.cs.state().await.unwrap().single_block);
        }
        until_at(&rig, |at| at[0] > 42.0).await;
        let trace = rig.trace();
        // 5 mm next to the line, without a stop there.
        for pair in trace
            .windows(2)
            .filter(|pair| pair[0][0] > 11.0 && pair[1][0] < 29.0)
        {
            assert!((pair[1][1] - 5.0).abs() < 1e-9, "{pair:?}");
            assert!(distance(pair[0], pair[1]) > 0.009, "{pair:?}");
        }
        rig.cs.set_single_block(true).await.unwrap();
        rig.interrupted(Reason::SingleBlock).await;
        rig.cs.resume().await.unwrap();
        rig.interrupted(Reason::SingleBlock).await;
        close(rig.at().await, [60.0, 0.0, 0.0]);
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn m1i_single_block_on_before_a_lead_in_ends_with_an_alarm() {
    on_machine(TOOL, |rig| async move {
        rig.load("M100 VA1\nta20 td20 ts0 F600\nX5\nG01 G41\nX10\nX20\nG40\nX40\nM30\n")
            .await;
        rig.cs.set_single_block(true).await.unwrap();
        rig.cs.start().await.unwrap();
        let state = loop {
            let state = rig
                .cs
                .wait_for(|state| state.execution != Execution::Active && state.execution != Execution::Wait)
                .await
                .unwrap();
            match state.execution {
                Execution::Interrupted => rig.cs.resume().await.unwrap(),
                _ => break state,
            }
        };
        assert_eq!(
            (state.execution, state.reason),
            (Execution::Stopped, Some(Reason::Alarm))
        );
        assert_eq!(rig.alarms().await, [40]);
    });
}

#[test]
fn m1i_single_block_is_refused_while_the_tool_is_in_the_thread() {
    on_machine("", |rig| async move {
        rig.start("F100 S300\nG84 Z-10 R-5 P200\nG80\nG00 X40\nG00 X50\nM30\n")
            .await;
        for (low, high) in [(-9.0, -6.0), (-10.0, -9.9), (-9.0, -6.0)] {
            until_at(&rig, |at| (low..high).contains(&at[2])).await;
            let refusal = refused(rig.cs.set_single_block(true).await, RefusalCode::NotAllowed);
            assert!(refusal.text.contains("tapping cycle"), "{}", refusal.text);
        }
        until_at(&rig, |at| at[0] > 1.0).await;
        rig.cs.set_single_block(true).await.unwrap();
        rig.interrupted(Reason::SingleBlock).await;
        close(rig.at().await, [40.0, 0.0, 0.0]);
        rig.cs.resume().await.unwrap();
        rig.interrupted(Reason::SingleBlock).await;
        rig.cs.resume().await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn m1i_single_block_treats_a_tapping_cycle_with_all_holes_as_one_block() {
    on_machine("", |rig| async move {
        rig.load("F600 S300 G99\nG91 G84 X5 Z-2 R-1 K2\nX10 K1\nG80\nX-20\nM30\n")
            .await;
        rig.cs.set_single_block(true).await.unwrap();
        rig.cs.start().await.unwrap();
        for at in [[0.0; 3], [20.0, 0.0, -1.0], [0.0, 0.0, -1.0]] {
            rig.interrupted(Reason::SingleBlock).await;
            close(rig.at().await, at);
            rig.cs.resume().await.unwrap();
        }
        rig.until(Execution::ProgramCompleted).await;
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}

#[test]
fn d41_external_skip_input_captures_for_program_and_sequence() {
    on_machine("", |rig| async move {
        // The skip velocity of X is a tenth of its maximum velocity, 50 mm/s, its acceleration 1000 mm/s^2.
        rig.start("G31 X200 Y10\nP0=_CNC_CapturedPosition0 P1=_CNC_CapturedPosition1\nG91 G00 X1\nM30\n")
            .await;
        until_at(&rig, |at| at[0] > 50.0).await;
        let before = rig.at().await[0];
        rig.plc.set_skip_input(1, true).await.unwrap();
        rig.until(Execution::ProgramCompleted).await;
        let topic = Topic::CoordinateSystem(1, CsTopic::Captured);
        let message = rig.plc.port().read(&topic).await.unwrap();
        let Payload::Captured(captured) = &message.payload else {
            panic!("{message:?}")
        };
        assert_eq!((captured.line, &captured.motors[..]), (1, &[1, 2, 3][..]));
        assert_eq!(captured.captured, [true, false, false]);
        let x = captured.positions[0];
        // Positions are published ten times a second, and each cycle reads the input.
        assert!(
            (before..=before + 50.0 * 0.105).contains(&x),
            "{x} is not {before}"
        );
        assert_eq!(captured.positions[1..], [10.0, 0.0]);
        // It turned back to there, and the next block counts from there.
        let farthest = rig.trace().iter().fold(0.0_f64, |most, at| most.max(at[0]));
        assert!(
            (farthest - x - 1.25).abs() < 0.06,
            "50^2/(2 1000) = 1.25 mm: {farthest} {x}"
        );
        close(rig.at().await, [x + 1.0, 10.0, 0.0]);
        let read = rig.plc.variables().read(0, 2).await.unwrap();
        assert_eq!(read, [x, 10.0]);
    });
}

/// X is captured at 7.25 mm.
const SKIP: &str = "\n[[simulated_skip]]\nmotor = 1\nabove = 7.25\n";

#[test]
fn m1i_single_block_set_during_g31_ends_each_block_already_read() {
    on_machine(SKIP, |rig| async move {
        rig.start("G31 X40\nG91 G01 X1 F600 G09\nG00 Y2\nM30\n").await;
        until_at(&rig, |at| at[0] > 2.0).await;
        rig.cs.set_single_block(true).await.unwrap();
        for at in [[7.25, 0.0, 0.0], [8.25, 0.0, 0.0], [8.25, 2.0, 0.0]] {
            rig.interrupted(Reason::SingleBlock).await;
            close(rig.at().await, at);
            rig.cs.resume().await.unwrap();
        }
        rig.until(Execution::ProgramCompleted).await;
    });
}

#[test]
fn d15_a_stop_within_a_g31_forgets_what_has_been_read_behind_it() {
    on_machine(SKIP, |rig| async move {
        rig.start("G31 X40\nG91 G01 X1 F600\nG00 Y2\nM30\n").await;
        until_at(&rig, |at| at[0] > 2.0).await;
        rig.cs.stop().await.unwrap();
        let at = rig.at().await;
        rig.cs.reset().await.unwrap();
        rig.cs.mdi("G91 G00 Z1").await.unwrap();
        close(rig.at().await, [at[0], 0.0, 1.0]);
        assert_eq!(rig.alarms().await, [0_u16; 0]);
    });
}
