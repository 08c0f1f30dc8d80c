//! Manual data input and homing.

use plc_api::{Error, Execution};
use plc_protocol::types::request::RefusalCode;
use plc_protocol::types::state::Reason;

use super::rig::{close, on_machine, refused};

#[test]
fn mdi_runs_lines_to_their_end_and_leads_to_ready() {
    on_machine("", |rig| async move {
        assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::NoProgram)));
        rig.cs.mdi("G01 X10 F6000\nY5").await.unwrap();
        assert_eq!(rig.state().await, (Execution::Ready, None));
        close(rig.at().await, [10.0, 5.0, 0.0]);
        let place = rig.cs.program().await.unwrap();
        assert_eq!(
            (place.number, place.line, place.block.as_str()),
            (Some(0), 3, "M30")
        );
        // M30 in the input also ends it, and so does M99.
        rig.cs.mdi("G00 X1\nM30").await.unwrap();
        rig.cs.mdi("G00 X2 M99").await.unwrap();
        close(rig.at().await, [2.0, 5.0, 0.0]);
        assert_eq!(rig.state().await, (Execution::Ready, None));
    });
}

#[test]
fn mdi_is_allowed_where_load_is_and_says_else_what_is() {
    on_machine("", |rig| async move {
        rig.start("G00 X50\nM30\n").await;
        let refusal = refused(rig.cs.mdi("G00 X1").await, RefusalCode::NotAllowed);
        assert_eq!(refusal.state, Some(Execution::Active));
        rig.until(Execution::ProgramCompleted).await;
        rig.cs.mdi("G00 X1").await.unwrap();
        // An alarm ends it, and must be reset first.
        match rig.cs.mdi("G00 X2\nG00 X999").await {
            Err(Error::CommandFailed { code, text, .. }) => {
                assert_eq!(code, "alarm");
                assert!(
                    text.starts_with("the motion covered X 1.000 mm: alarm 102, "),
                    "{text}"
                );
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(rig.alarms().await, [102]);
        close(rig.at().await, [2.0, 0.0, 0.0]);
        let refusal = refused(rig.cs.mdi("G00 X1").await, RefusalCode::NotAllowed);
        assert!(refusal.text.contains("reset first"), "{}", refusal.text);
        rig.cs.reset().await.unwrap();
        rig.cs.mdi("G00 X1").await.unwrap();
    });
}

#[test]
fn mdi_text_is_checked_first_and_moves_nothing_when_it_has_errors() {
    on_machine("", |rig| async move {
        for (text, code, line) in [
            ("G00 X5\nG05", "E0101", 2),
            ("G00 X5 X6", "E0105", 1),
            ("G00 A5", "E0114", 1),
            ("G01 X1 R5", "E0108", 1),
        ] {
            let refusal = refused(rig.cs.mdi(text).await, RefusalCode::ProgramHasErrors);
            let first = &refusal.diagnostics[0];
            assert_eq!((first.code.as_str(), first.line), (code, line), "{first:?}");
        }
        let long = format!("/* {} */ G00 X1", "x".repeat(32 * 1024));
        refused(rig.cs.mdi(long).await, RefusalCode::TooLarge);
        close(rig.at().await, [0.0; 3]);
        assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::NoProgram)));
    });
}

#[test]
fn modal_state_stays_between_inputs_but_not_across_a_program() {
    on_machine("", |rig| async move {
        // G54 puts X at 10, Y at 20, Z at 30.
        rig.cs.mdi("G54 G91 F6000").await.unwrap();
        rig.cs.mdi("G90 G01 X1 Y0 Z0").await.unwrap();
        close(rig.at().await, [11.0, 20.0, 30.0]);
        rig.cs.mdi("G91").await.unwrap();
        rig.cs.mdi("X1").await.unwrap();
        close(rig.at().await, [12.0, 20.0, 30.0]);
        let modal = rig.cs.modal().await.unwrap();
        assert_eq!((modal.work_offset.as_deref(), modal.f), (Some("G54"), 6000.0));
        // A jog changes nothing but the position.
        rig.cs.jog('X', 600.0, Some(1.0), "j").await.unwrap();
        rig.cs.mdi("G90 Y1").await.unwrap();
        close(rig.at().await, [13.0, 21.0, 30.0]);
        // The state does not carry over into a program: without G54 and F the start-up state is in force.
        rig.start("G00 X1\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        close(rig.at().await, [1.0, 21.0, 30.0]);
        // The state of a program does not carry over to an input, either.
        rig.start("G54 G91 G00 X0\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        rig.cs.mdi("G00 X3 Y4 Z5").await.unwrap();
        close(rig.at().await, [3.0, 4.0, 5.0]);
        // A reset ends it.
        rig.cs.mdi("G54").await.unwrap();
        rig.cs.reset().await.unwrap();
        assert_eq!(rig.cs.modal().await.unwrap().work_offset, None);
        rig.cs.mdi("G00 X3").await.unwrap();
        close(rig.at().await, [3.0, 4.0, 5.0]);
    });
}

#[test]
fn d22_a_tool_length_of_one_input_holds_in_the_next() {
    let more = "\n[m_code.6]\nstock = \"select_tool\"\n\n[[tool]]\nid = 1\nradius = 5.0\nlength = 8.0\n";
    on_machine(more, |rig| async move {
        rig.cs.mdi("M6 VA1\nG43").await.unwrap();
        close(rig.at().await, [0.0; 3]);
        rig.cs.mdi("G00 X1").await.unwrap();
        close(rig.at().await, [1.0, 0.0, 8.0]);
        rig.cs.mdi("G00 Z-10").await.unwrap();
        close(rig.at().await, [1.0, 0.0, -2.0]);
    });
}

#[test]
fn m_codes_subprograms_and_single_block_work_in_mdi_as_in_programs() {
    let more = "\n[m_code.20]\nunhandled = \"auto_reset\"\nsimulated_ms = 500\n";
    on_machine(more, |rig| async move {
        let write = plc_protocol::types::request::Request::WriteProgram(1000, "G91 G00 X1\nM99\n".into());
        rig.plc.port().request(write).await.unwrap();
        let begun_s = rig.plc.now_s();
        rig.cs.mdi("M20\nM98 P1000 L3").await.unwrap();
        assert!(rig.plc.now_s() - begun_s >= 0.5);
        close(rig.at().await, [3.0, 0.0, 0.0]);
        rig.cs.set_single_block(true).await.unwrap();
        let cs = rig.plc.coordinate_system(1);
        let waiting = tokio::spawn(async move { cs.mdi("G90 G00 X10\nX20").await });
        for x in [10.0, 20.0] {
            rig.interrupted(Reason::SingleBlock).await;
            close(rig.at().await, [x, 0.0, 0.0]);
            rig.cs.resume().await.unwrap();
        }
        waiting.await.unwrap().unwrap();
        assert_eq!(rig.state().await, (Execution::Ready, None));
    });
}

#[test]
fn a_stop_ends_mdi_and_tells_who_waits_for_it() {
    on_machine("", |rig| async move {
        let cs = rig.plc.coordinate_system(1);
        let waiting = tokio::spawn(async move { cs.mdi("G01 X100 F600").await });
        rig.until(Execution::Active).await;
        rig.sleep(0.5).await;
        rig.cs.stop().await.unwrap();
        match waiting.await.unwrap() {
            Err(Error::CommandFailed { code, .. }) => assert_eq!(code, "stop"),
            other => panic!("{other:?}"),
        }
        assert_eq!(rig.state().await, (Execution::Stopped, Some(Reason::Stop)));
    });
}

#[test]
fn home_takes_named_motors_or_all_to_their_first_reference_points() {
    on_machine("", |rig| async move {
        // Reference points are 0 in this machine.
        rig.cs.mdi("G54 G00 X20 Y10 Z5").await.unwrap();
        close(rig.at().await, [30.0, 30.0, 35.0]);
        rig.cs.home(&['y', 'Z']).await.unwrap();
        close(rig.at().await, [30.0, 0.0, 0.0]);
        rig.cs.mdi("G00 X5 Y5").await.unwrap();
        rig.cs.home(&[]).await.unwrap();
        close(rig.at().await, [0.0; 3]);
        assert_eq!(rig.state().await, (Execution::Ready, None));
        let refusal = refused(rig.cs.home(&['A']).await, RefusalCode::Invalid);
        assert!(refusal.text.contains("X, Y, Z"), "{}", refusal.text);
        rig.start("G00 X50\nM30\n").await;
        refused(rig.cs.home(&[]).await, RefusalCode::NotAllowed);
    });
}
