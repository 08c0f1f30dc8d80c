#![allow(clippy::float_cmp, reason = "a motion ends at its end point exactly")]

use std::collections::BTreeMap;
use std::sync::Arc;

use parking_lot::Mutex;
use plc_api::{Alarm, AuxOutput, Error, Plc, SequenceProgram};
use plc_protocol::types::line_start::{Approach, LineStart, LineState};
use plc_protocol::types::refusal::RefusalCode;
use plc_protocol::types::request::typed::Rehearsal;
use plc_protocol::types::state::Execution;

use tandem_runtime::{Config, Machine};
use tandem_store::journal::Event;
use tandem_testing::{Bench, Scene, kept_journal};

/// Shown content of an output: M number, program, line, and the machine position of X, Y and Z.
type Shown = (u16, u16, u32, [f64; 3]);

/// Returns the demo machine. M100 selects tool VA, M08 and M09 control the coolant, M60 is a function of the user.
fn machine() -> Machine {
    let mut machine = Config::demo().resolve().unwrap();
    for system in &mut machine.coordinate_systems {
        system.programs.clear();
    }
    machine
}

/// Runs a test on a machine that has loaded a program, with a list of the outputs so far. A handler answers M60 and M70
/// at once; M70 sets P7.
fn with_program<T: Send + 'static>(
    text: &str,
    act: impl AsyncFnOnce(&Scene, &Mutex<Vec<Shown>>) -> T + Send + 'static,
) -> T {
    let shown = Arc::<Mutex<Vec<Shown>>>::default();
    let kept = Arc::clone(&shown);
    let note = move |output: AuxOutput, plc: Plc| {
        let kept = Arc::clone(&kept);
        async move {
            let at = plc.coordinate_system(1).position().await.unwrap().machine;
            let at = ["X", "Y", "Z"].map(|axis| (at[axis] * 1e6).round() / 1e6);
            kept.lock()
                .push((output.m(), output.program(), output.line(), at));
            if output.m() == 70 {
                plc.variables().set(7, 1.0).await.unwrap();
            }
            Ok::<(), Alarm>(())
        }
    };
    let served = SequenceProgram::new().on([8, 9, 60, 70], note);
    let played = Bench::on_machine(machine())
        .serve(served)
        .subprogram(1, text)
        .subprogram(1000, "G91 G01 X1 F600\nM60\nX1\nG90 M99")
        .play(async move |scene, _| {
            scene.cs(1).load(1).await.unwrap();
            act(&scene, &shown).await
        });
    played.unwrap()
}

async fn run_from(scene: &Scene, from: LineStart) {
    let cs = scene.cs(1);
    cs.start_from(from).await.unwrap();
    cs.wait_until(Execution::ProgramCompleted).await.unwrap();
}

/// Returns the state at a line, or the text of the refusal.
fn state_at(text: &str, from: LineStart) -> Result<LineState, String> {
    with_program(text, async move |scene, _| {
        match scene.cs(1).line_state(from).await {
            Ok(state) => Ok(state),
            Err(Error::Refused(refusal)) => {
                assert_eq!(refusal.code, RefusalCode::LineRefused);
                Err(refusal.text)
            }
            Err(other) => panic!("{other}"),
        }
    })
}

fn refusal(text: &str, from: LineStart) -> String {
    state_at(text, from).unwrap_err()
}

fn positions<const N: usize>(of: [(&str, f64); N]) -> BTreeMap<String, f64> {
    of.map(|(axis, at)| (axis.to_owned(), at)).into()
}

const EVERYTHING: &str = "G17 G90 G54 G64 ta20 td30
M100 VA2
M03 S800
M60
G00 X10 Y5 Z20
L1 = 3
Q4 = L1 + 0.5
G68 X0 Y0 R30
G01 X20 F1200
M60
G91 Y[L1]
M60
G03 X-4 Y4 I-4 J0
M60
G69
G51 X0 Y0 Z0 P2
G90 G01 X4 Y6
M60
G50
G55 G01 X3 Y[Q4] F900
M60
G52 X1 Y1 Z0
X0 Y0
M60
G20 G01 X1
M60
G21 G500
X30
Y4
G501
M60
M98 P1000
M60
M30";

#[test]
fn from_each_line_a_run_goes_on_as_the_whole_one_does() {
    let of_user = |shown: &Mutex<Vec<Shown>>| -> Vec<Shown> {
        let all = shown.lock();
        all.iter().filter(|(m, ..)| *m == 60).copied().collect()
    };
    let whole = with_program(EVERYTHING, async move |scene, shown| {
        run_from(scene, LineStart::line(1)).await;
        of_user(shown)
    });
    assert_eq!(whole.len(), 11);
    let numbered = || (1..).zip(EVERYTHING.lines());
    let (call, _) = numbered().find(|(_, line)| line.starts_with("M98")).unwrap();
    let in_main = |(_, program, line, _): &Shown| if *program == 1 { *line } else { call };
    for (line, _) in numbered().skip(1) {
        let (rest, q4) = with_program(EVERYTHING, async move |scene, shown| {
            run_from(scene, LineStart::line(line)).await;
            (of_user(shown), scene.cs(1).variables().get(4).await.unwrap())
        });
        let rest_of_whole: Vec<_> = whole
            .iter()
            .filter(|shown| in_main(shown) >= line)
            .copied()
            .collect();
        assert_eq!(rest, rest_of_whole, "line {line}");
        assert_eq!(q4, 3.5, "line {line}");
    }
}

#[test]
fn newest_m_code_per_group_is_issued_before_approach_in_settings_order() {
    let text = "M03 S500\nM100 VA1\nM08\nM60\nM09\nM100 VA2\nM04 S900\nM08\nG90 G54 G00 X5\nG01 X9 F600\nM30";
    let state = state_at(text, LineStart::line(10)).unwrap();
    let told = |outputs: &[plc_protocol::types::line_start::RestoredOutput]| -> Vec<_> {
        outputs.iter().map(|output| (output.m, output.line)).collect()
    };
    assert_eq!(
        told(&state.restore),
        [(100, 6), (4, 7), (8, 8)],
        "tool, spindle, coolant"
    );
    assert_eq!(told(&state.not_restored), [(60, 4)]);
    assert_eq!((state.modal.tool, state.modal.s), (Some(2), 900.0));
    let (put_out, at, spindle) = with_program(text, async |scene, shown| {
        run_from(scene, LineStart::line(10)).await;
        let at = scene.cs(1).tool().await.unwrap();
        let spindle = scene.cs(1).spindle().await.unwrap();
        (shown.lock().clone(), at.id, spindle.rpm)
    });
    let outputs: Vec<_> = put_out.iter().map(|(m, _, line, _)| (*m, *line)).collect();
    assert_eq!(outputs, [(8, 8)], "what this program's handlers were given");
    assert_eq!((at, spindle), (2, 900.0));
    assert_eq!(put_out[0].3, [0.0; 3], "nothing has moved yet");
}

#[test]
fn the_settings_of_m_codes_give_group_and_order() {
    let text = "M08\nM60 VA1\nM03 S100\nM60 VA2\nG01 X1 F600\nM30";
    let mut machine = machine();
    let settings = machine.m_codes.entry(60).or_default();
    settings.restore_group = Some("user".into());
    settings.restore_order = Some(99);
    let bench = Bench::on_machine(machine).subprogram(1, text);
    let restored = bench.play(async |scene, _| {
        scene.cs(1).load(1).await.unwrap();
        scene.cs(1).line_state(LineStart::line(5)).await.unwrap().restore
    });
    let restored: Vec<_> = restored
        .unwrap()
        .iter()
        .map(|output| (output.m, output.params.a))
        .collect();
    assert_eq!(restored, [(3, None), (8, None), (60, Some(2.0))]);
}

#[test]
fn the_state_at_a_line_is_that_before_its_block() {
    let text = "G90 G54 G00 X10 Y5\nG01 X20 F600\nG91 Y5\nM30";
    let state = state_at(text, LineStart::line(3)).unwrap();
    assert_eq!((state.program, state.line, state.occurrence), (1, 3, 1));
    assert_eq!(state.block, "G91 Y5");
    assert_eq!(state.modal.g["03"], "G90");
    assert_eq!(state.modal.f, 600.0);
    assert_eq!(state.work, positions([("X", 20.0), ("Y", 5.0), ("Z", 120.0)]));
    // G54 of the demo machine is X60 Y50 Z-120
    assert_eq!(state.machine, positions([("X", 80.0), ("Y", 55.0), ("Z", 0.0)]));
    assert!(state.stack.is_empty() && state.variables.is_empty());
}

#[test]
fn the_axes_come_there_in_the_order_of_the_approach() {
    let text = "G90 G54 G00 X10 Z-5\nG01 X20 F600\nM30";
    let steps = |approach| {
        let from = LineStart {
            approach,
            ..LineStart::line(2)
        };
        state_at(text, from).unwrap().approach
    };
    let (x, z) = (("X", 70.0), ("Z", -125.0));
    assert_eq!(steps(Approach::PlaneFirst), [positions([x]), positions([z])]);
    assert_eq!(steps(Approach::InfeedFirst), [positions([z]), positions([x])]);
    assert_eq!(steps(Approach::Direct), [positions([x, z])]);
    let in_zx = "G18 G90 G54 G00 X10 Z-5\nG01 X20 F600\nM30";
    let state = state_at(in_zx, LineStart::line(2)).unwrap();
    assert_eq!(
        state.approach,
        [positions([x, z])],
        "the infeed axis of G18 is Y, which stands there"
    );
}

#[test]
fn line_reached_several_times_by_loop_or_subprogram_needs_occurrence() {
    let text = "L1 = 0\nG91\nwhile (L1 < 3) {\nL1 = L1 + 1\nG01 X[L1] F600\n}\nM98 P1000 L2\nM30";
    let why = refusal(text, LineStart::line(5));
    assert!(
        why.contains("line 5 3 times") && why.contains("occurrence"),
        "{why}"
    );
    let at = |occurrence| {
        let from = LineStart {
            occurrence: Some(occurrence),
            ..LineStart::line(5)
        };
        state_at(text, from).map(|state| state.machine["X"])
    };
    assert_eq!(at(1), Ok(0.0));
    assert_eq!(at(3), Ok(1.0 + 2.0));
    assert!(at(4).unwrap_err().contains("3 times, not 4"));
    let in_subprogram = |occurrence| LineStart {
        program: Some(1000),
        occurrence,
        ..LineStart::line(3)
    };
    let why = refusal(text, in_subprogram(None));
    assert!(why.contains("line 3 2 times"), "{why}");
    let state = state_at(text, in_subprogram(Some(2))).unwrap();
    assert_eq!((state.program, state.machine["X"]), (1000, 6.0 + 2.0 + 1.0));
    let callers: Vec<_> = state.stack.iter().map(|call| (call.program, call.line)).collect();
    assert_eq!(callers, [(1, 7)]);
}

#[test]
fn what_the_program_sets_on_its_way_is_set_at_the_start() {
    let text = "P5 = 2\nQ1 = P5 * 3\nG01 X[Q1] F600\nM30";
    let state = state_at(text, LineStart::line(3)).unwrap();
    assert_eq!(state.variables, positions([("P5", 2.0), ("Q1", 6.0)]));
    let set = with_program(text, async |scene, _| {
        run_from(scene, LineStart::line(3)).await;
        (
            scene.plc().variables().get(5).await.unwrap(),
            scene.cs(1).position().await.unwrap().machine["X"],
        )
    });
    assert_eq!(set, (2.0, 6.0));
}

#[test]
fn what_the_text_does_not_decide_is_refused_by_its_name() {
    for (text, line, words) in [
        ("M70\nG01 X[P7] F600\nX2\nM30", 3, ["P7", "M70 in line 1"]),
        ("G31 X5 F100\nX2\nM30", 2, ["skip input", "line 1"]),
        (
            "G01 X[_CNC_CapturedPosition1] F600\nX2\nM30",
            2,
            ["captured position", "line 1"],
        ),
        (
            "M100 VA1\nG41 G01 X20 F600\nX30\nG40 X40\nM30",
            3,
            ["cutter compensation", "line 3"],
        ),
        (
            "F600 S100\nM19\nG84 X5 Z-5 R2\nX9\nG80\nM30",
            4,
            ["fixed cycle", "line 4"],
        ),
        ("G01 X1 F600\n\nX2\nM30", 2, ["no block", "is 3"]),
        ("G01 X1 F600\nX2\nM30", 9, ["no block", "line 9"]),
        ("if (0 > 1)\n{\nX5\n}\nM30", 3, ["does not reach", "line 3"]),
        ("G01 X9000 F600\nX2\nM30", 2, ["soft limit", "in line 1"]),
    ] {
        let why = refusal(text, LineStart::line(line));
        for word in words {
            assert!(why.contains(word), "{text}: {why}");
        }
    }
    let from = LineStart {
        program: Some(1001),
        ..LineStart::line(1)
    };
    assert!(refusal("X1\nM30", from).contains("does not call program 1001"));
    // the program itself has set P7 after M70, so P7 is known
    let known = state_at("M70\nP7 = 4\nG01 X[P7] F600\nX2\nM30", LineStart::line(4));
    assert_eq!(known.unwrap().machine["X"], 4.0);
}

#[test]
fn tool_change_to_a_wrong_tool_stops_before_the_approach() {
    let serve_other = |output: AuxOutput, plc: Plc| async move {
        plc.coordinate_system(output.coordinate_system())
            .select_tool(9)
            .await
            .unwrap();
        Ok::<(), Alarm>(())
    };
    let bench = Bench::on_machine(machine()).serve(SequenceProgram::new().on(100, serve_other));
    let ended = bench
        .subprogram(1, "M100 VA2\nG00 X50\nG01 X60 F600\nM30")
        .play(async |scene, _| {
            scene.cs(1).load(1).await.unwrap();
            scene.cs(1).start_from(LineStart::line(3)).await.unwrap();
            scene.cs(1).wait_until(Execution::Stopped).await.unwrap();
            (
                scene.plc().alarms().await.unwrap(),
                scene.cs(1).position().await.unwrap().machine["X"],
            )
        });
    let (alarms, x) = ended.unwrap();
    assert_eq!((alarms[0].number, alarms[0].line, x), (25, Some(3), 0.0));
    assert!(
        alarms[0].text.contains("tool 2") && alarms[0].text.contains("tool 9"),
        "{:?}",
        alarms[0]
    );
}

#[test]
fn the_journal_names_the_line_that_a_run_began_at() {
    let (journal, lines) = kept_journal();
    let bench = Bench::on_machine(machine()).journal(journal);
    let played = bench
        .subprogram(1, "G01 X1 F600\nX2\nM30")
        .play(async |scene, _| {
            scene.cs(1).load(1).await.unwrap();
            run_from(&scene, LineStart::line(2)).await;
        });
    played.unwrap();
    let lines = lines.lock().unwrap();
    let began = lines.iter().find_map(|line| match &line.event {
        Event::Start { from_line, .. } => Some(*from_line),
        _ => None,
    });
    assert_eq!(began, Some(Some(2)));
}

#[test]
fn how_far_a_run_is_is_told_of_one_from_the_head_and_from_a_line() {
    let told = |from: Option<LineStart>| {
        with_program("G01 X100 F600\nX200\nM30", async move |scene, _| {
            let cs = scene.cs(1);
            match from {
                Some(from) => cs.start_from(from).await.unwrap(),
                None => cs.start().await.unwrap(),
            }
            cs.hold().await.unwrap();
            let rehearsal = scene.plc().port().ask(Rehearsal(1, Some(1))).await.unwrap();
            rehearsal.run.is_some()
        })
    };
    assert!(told(None));
    assert!(told(Some(LineStart::line(2))));
}
