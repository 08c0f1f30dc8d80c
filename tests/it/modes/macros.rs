//! MDI as a macro: text that a program or a button generates leaves nothing behind.

use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use plc_api::{Alarm, Execution};
use plc_protocol::types::command::{Command, CommandMeta, CommandReply, CommandStatus};
use plc_protocol::types::request::typed;
use plc_protocol::types::state::{Modal, Reason};

use super::rig::{Rig, close, on_machine};

/// X touches at 5 mm.
const SKIP: &str = "\n[[simulated_skip]]\nmotor = 1\nabove = 5.0\n";

/// A typical macro of the HMI: it changes each relevant modal group before it moves slowly.
const CHANGES: &str = "G54 G91 G20\nG51 X0 Y0 P2\nG68 X0 Y0 R90\nG61 F7 S5\nG01 X0.5\n";

static COMMANDS: AtomicU32 = AtomicU32::new(0);

async fn run_macro(rig: &Rig, text: &str) -> CommandReply {
    run_macro_in(rig, 1, text).await
}

async fn run_macro_in(rig: &Rig, cs: u8, text: &str) -> CommandReply {
    let command = typed::Command {
        cs,
        command: Command::Mdi {
            text: text.to_owned(),
            is_macro: true,
        },
        meta: CommandMeta {
            command_id: format!("macro-{}", COMMANDS.fetch_add(1, Ordering::Relaxed)),
            client_id: "test".to_owned(),
            ..CommandMeta::default()
        },
        wait: true,
    };
    rig.plc.port().ask(command).await.unwrap()
}

/// The state of an operator: absolute in G55, with a feedrate, and the position from which the input counts.
async fn operator_state(rig: &Rig) -> Modal {
    rig.cs.mdi("G55 G90 G01 F777 S300 X0 Y0").await.unwrap();
    close(rig.at().await, [11.0, 0.0, 0.0]);
    rig.cs.modal().await.unwrap()
}

/// The next line of the operator has the same meaning as before the macro: X20 in G55 with G01 F777.
async fn assert_goes_on(rig: &Rig, before: &Modal) {
    assert_eq!(rig.cs.modal().await.unwrap(), *before);
    let [_, y, z] = rig.at().await;
    rig.trace();
    rig.cs.mdi("X20").await.unwrap();
    close(rig.at().await, [31.0, y, z]);
    let trace = rig.trace();
    let fastest = trace
        .windows(2)
        .map(|two| two[1][0] - two[0][0])
        .fold(0.0, f64::max);
    let feed_mm = 777.0 / 60.0 * crate::support::formula::PERIOD_S;
    assert!((fastest - feed_mm).abs() < 1e-6, "{fastest} is not {feed_mm}");
}

#[test]
fn completed_macro_restores_modal_state_feedrate_and_offsets() {
    on_machine("", |rig| async move {
        let before = operator_state(&rig).await;
        let reply = run_macro(&rig, CHANGES).await;
        assert_eq!(reply.status, CommandStatus::Done, "{reply:?}");
        assert_goes_on(&rig, &before).await;
        // an operator's own input stays in force
        rig.cs.mdi("G91").await.unwrap();
        let carried = rig.cs.modal().await.unwrap().mdi;
        assert!(carried.contains(&"G91".to_owned()), "{carried:?}");
        run_macro(&rig, "G90 G00 X0").await;
        let x = rig.at().await[0];
        rig.cs.mdi("X1").await.unwrap();
        assert!((rig.at().await[0] - x - 1.0).abs() < 1e-9);
    });
}

#[test]
fn a_macro_reads_its_numbers_in_the_configured_unit_as_positions() {
    on_machine("units = \"inch\"\n", |rig| async move {
        for (number, size_mm) in [(1, 1.0), (2, 25.4)] {
            let cs = rig.plc.coordinate_system(number);
            for operator in ["G91 G20", "G91 G21"] {
                cs.mdi(operator).await.unwrap();
                let before = cs.modal().await.unwrap();
                for x in [3.0, 2.0] {
                    let reply = run_macro_in(&rig, number, &format!("G00 X{x}")).await;
                    assert_eq!(reply.status, CommandStatus::Done, "{reply:?}");
                    let at = cs.position().await.unwrap().machine["X"];
                    assert!((at - x * size_mm).abs() < 1e-9, "{number}, {operator}: {at}");
                }
                assert_eq!(cs.modal().await.unwrap(), before);
            }
        }
    });
}

#[test]
fn interrupted_macro_restores_modal_state_feedrate_and_offsets() {
    for what in ["stop", "abort", "raised", "refused", "hold and stop"] {
        on_machine("", move |rig| async move {
            let before = operator_state(&rig).await;
            let (ender, plc) = (rig.plc.coordinate_system(1), rig.plc.clone());
            let end = tokio::spawn(async move {
                plc.sleep(Duration::from_millis(500)).await;
                match what {
                    "stop" => ender.stop().await.unwrap(),
                    "abort" => ender.abort().await.unwrap(),
                    "raised" => ender.raise_alarm(Alarm::user(7, "no oil")).await.unwrap(),
                    "hold and stop" => {
                        ender.hold().await.unwrap();
                        ender.stop().await.unwrap();
                    }
                    _ => {}
                }
            });
            let text = match what {
                "refused" => format!("{CHANGES}G69\nG50\nG90 G00 X9999\n"),
                _ => CHANGES.to_owned(),
            };
            let reply = run_macro(&rig, &text).await;
            end.await.unwrap();
            assert_eq!(reply.status, CommandStatus::Failed, "{what}: {reply:?}");
            assert_eq!(rig.cs.modal().await.unwrap(), before, "{what}");
            if rig.state().await != (Execution::Stopped, Some(Reason::Alarm)) {
                assert_goes_on(&rig, &before).await;
            }
        });
    }
}

#[test]
fn a_probe_that_misses_fails_its_macro_and_leaves_nothing_behind() {
    on_machine(SKIP, |rig| async move {
        rig.cs.mdi("G90 G00 X-20").await.unwrap();
        let before = rig.cs.modal().await.unwrap();
        let reply = run_macro(&rig, "G91 F100\nG31 X-5\nG01 X1\n").await;
        assert_eq!(
            (reply.status, reply.code.as_str()),
            (CommandStatus::Failed, "no_touch")
        );
        assert!(reply.text.contains("line 2"), "{}", reply.text);
        assert_eq!(reply.moved.get(&'X'), Some(&-4.0));
        assert_eq!(rig.cs.modal().await.unwrap(), before);
        assert_eq!(rig.state().await, (Execution::Ready, None));
        // -24 + 29 is the touch at 5
        let reply = run_macro(&rig, "G91 F100\nG31 X40\n").await;
        assert_eq!(reply.status, CommandStatus::Done, "{reply:?}");
        rig.cs.mdi("X-20").await.unwrap();
        close(rig.at().await, [-20.0, 0.0, 0.0]);
    });
}

#[test]
fn after_a_program_or_reset_the_start_up_state_applies_despite_macros() {
    on_machine("", |rig| async move {
        rig.start("G54 G91 G00 X1\nM30\n").await;
        rig.until(Execution::ProgramCompleted).await;
        let before = rig.cs.modal().await.unwrap();
        assert!(
            before.mdi.is_empty(),
            "the next input begins in the start-up state: {before:?}"
        );
        run_macro(&rig, CHANGES).await;
        assert_eq!(rig.cs.modal().await.unwrap(), before);
        rig.cs.mdi("G00 X3").await.unwrap();
        assert!((rig.at().await[0] - 3.0).abs() < 1e-9);
        // a reset in a macro
        rig.cs.mdi("G55").await.unwrap();
        let resetter = rig.plc.coordinate_system(1);
        let plc = rig.plc.clone();
        let end = tokio::spawn(async move {
            plc.sleep(Duration::from_millis(500)).await;
            resetter.hold().await.unwrap();
            resetter.reset().await.unwrap();
        });
        let reply = run_macro(&rig, &format!("{CHANGES}X0")).await;
        end.await.unwrap();
        assert_eq!(
            (reply.status, reply.code.as_str()),
            (CommandStatus::Failed, "reset")
        );
        let modal = rig.cs.modal().await.unwrap();
        assert_eq!((modal.work_offset, modal.mdi.len()), (None, 0));
    });
}

#[test]
fn d22_a_tool_length_that_waits_for_its_motion_waits_after_a_macro_too() {
    let more = "\n[m_code.6]\nstock = \"select_tool\"\n\n[[tool]]\nid = 1\nradius = 5.0\nlength = 8.0\n";
    on_machine(more, |rig| async move {
        rig.cs.mdi("M6 VA1\nG43").await.unwrap();
        run_macro(&rig, "G49 G91 G00 Y3").await;
        close(rig.at().await, [0.0, 3.0, 0.0]);
        rig.cs.mdi("G90 G00 X1").await.unwrap();
        close(rig.at().await, [1.0, 3.0, 8.0]);
    });
}
