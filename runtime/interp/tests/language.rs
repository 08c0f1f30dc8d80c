//! Chapter 4 of the manual, and codes without path geometry, as the path stage receives them: one test for
//! each rule.

#![allow(
    clippy::panic,
    clippy::float_cmp,
    reason = "helpers of tests; values come through unchanged"
)]

mod support;

use std::f64::consts::PI;

use support::{Run, check, settings};
use tandem_interp::Interpreter;
use tandem_interp::dialects::nj;
use tandem_model::axis::{Axis, AxisVector};
use tandem_model::flow::{
    Action, ArcShape, Block, Compensation, Distance, Frame, Item, MultiBlock, Transform,
};
use tandem_model::plane::{Plane, Turn};
use tandem_model::settings::{CoordinateSystemSettings, Unit};

/// Returns the blocks of a program up to its end.
fn blocks(source: &str) -> Vec<Block> {
    blocks_of(Run::new(source))
}

fn blocks_of(mut run: Run) -> Vec<Block> {
    let mut blocks = Vec::new();
    loop {
        match run.next() {
            Ok(Item::Block(block)) => blocks.push(block),
            Ok(Item::End(_)) => return blocks,
            Ok(_) => {}
            Err(alarm) => panic!("{alarm:?}"),
        }
    }
}

fn last(source: &str) -> Block {
    blocks(source).pop().unwrap_or_else(|| panic!("no block"))
}

fn last_transform(source: &str) -> Transform {
    blocks(source)
        .into_iter()
        .rev()
        .find_map(|block| match block.action {
            Action::Transform(transform) => Some(*transform),
            _ => None,
        })
        .unwrap_or_else(|| panic!("no transform"))
}

/// Returns the value of L0 after a program, which outputs it as parameter VA.
fn calculated(code: &str) -> f64 {
    let mut run = Run::new(&format!("{code}\nM100 VA[L0]\nM30"));
    loop {
        match run.next() {
            Ok(Item::Output(output)) => return output.params[0].unwrap_or_default(),
            Ok(_) => {}
            Err(alarm) => panic!("{alarm:?}"),
        }
    }
}

fn equal(code: &str, expected: f64) {
    let value = calculated(code);
    assert!((value - expected).abs() < 1e-12, "{code} gives {value}");
}

#[test]
fn operators_follow_the_priority_of_the_manual() {
    equal("L0=1+2*3", 7.0);
    equal("L0=(1+2)*3", 9.0);
    equal("L0=-2*-3", 6.0);
    equal("L0=10-4-3", 3.0);
    equal("L0=2*sind(30)+sqrt(16)/4", 2.0);
    equal("L0=acos(-1)", PI);
}

#[test]
fn d07_modulo_keeps_the_sign_of_the_dividend() {
    equal("L0=7%3", 1.0);
    equal("L0=-7%3", -1.0);
    equal("L0=7%-3", 1.0);
    equal("L0=-7%-3", -1.0);
    equal("L0=7%4.5", 2.5);
    equal("L1=0/0 L2=7%0 L0=isnan(L1)+2*isnan(L2)+4*isnan(1/0)", 3.0);
}

#[test]
fn d07_what_is_not_a_number_alarms_only_where_it_reaches_a_word() {
    check("L1=0/0\nX[L1]\nM30", &["1:2 alarm 10"]);
    check("L1=1/0\nX[L1]\nM30", &["1:2 alarm 10"]);
    check("L1=1000001\nX[L1]\nM30", &["1:2 alarm 11"]);
    check("L1=1000.5\nM98 P[L1]\nM30", &["1:2 alarm 23"]);
}

#[test]
fn d04_an_indirection_is_the_value_of_its_variable() {
    check(
        "L12=10 Q34=-2.5 P5=7\nX[L12] Y[Q34] Z[P5] F[L12]\nM100 VA[Q34]\nM30",
        &["1:2 linear X10 Y-2.5 Z7", "1:3 none", "1:3 M100 A-2.5", "1:4 end"],
    );
}

#[test]
fn l_is_fresh_in_each_call_and_q_is_not() {
    let run = Run::new("L1=5 Q1=5\nM98 P1000 L2\nX[L1] Y[Q1]\nM30").with(1000, "X[L1]\nL1=9 Q1=Q1+1\nM99");
    assert_eq!(
        run.items(),
        [
            "1:2 none",
            "1000:1 linear X0",
            "1000:3 none",
            "1000:1 linear X0",
            "1000:3 none",
            "1:3 linear X5 Y7",
            "1:4 end"
        ]
    );
}

#[test]
fn p_and_q_are_seen_from_outside() {
    let mut run = Run::new("P7=Q3*2\nX1\nM30");
    run.variables.coordinate_system.set(3, 21.0);
    assert!(run.next().is_ok());
    assert_eq!(run.variables.global.get(7), Some(42.0));
}

#[test]
fn p_is_shared_with_other_threads_and_is_never_torn() {
    let global = Run::new("M30").variables.global;
    let writers = [1e300, -1e-300].map(|value| {
        let global = global.clone();
        std::thread::spawn(move || {
            // the fraction's bits differ, so that a torn value would be seen
            let mut run = Run::new("L0=Q0\nwhile(Q1<3000) { P5=L0 Q1=Q1+1 }\nM30");
            run.variables.global = global;
            run.variables.coordinate_system.set(0, value);
            while !matches!(run.next(), Ok(Item::End(_))) {}
        })
    });
    while !writers.iter().all(std::thread::JoinHandle::is_finished) {
        let value = global.get(5).unwrap_or(f64::NAN);
        assert!([0.0, 1e300, -1e-300].contains(&value), "{value}");
    }
    for writer in writers {
        assert!(writer.join().is_ok());
    }
    assert_ne!(global.get(5), Some(0.0));
}

#[test]
fn if_and_else_take_one_command_or_braces() {
    let program =
        |value: i32| format!("L1={value}\nif(L1==1) X1\nelse if(L1==2) {{\nX2\nX3\n}}\nelse X4\nX5\nM30");
    check(&program(1), &["1:2 linear X1", "1:8 linear X5", "1:9 end"]);
    check(
        &program(2),
        &["1:4 linear X2", "1:5 linear X3", "1:8 linear X5", "1:9 end"],
    );
    check(&program(3), &["1:7 linear X4", "1:8 linear X5", "1:9 end"]);
}

#[test]
fn d09_joins_and_negation_decide() {
    let taken = |condition: &str| calculated(&format!("L1=3 L2=0/0\nif({condition}) L0=1")) > 0.0;
    assert!(taken("L1>=3&&L1<=3"));
    assert!(taken("L1<3||L1!=4"));
    assert!(taken("!(L1==4)"));
    assert!(taken("isnan(L2)&&!(L2==L2)"));
    assert!(!taken("L1>3||L1<3&&1==1"));
    assert!(taken("1==1||1==2&&1==2"));
}

#[test]
fn while_and_do_repeat_and_break_leaves() {
    check(
        "while(L1<3) { L1=L1+1 X[L1] if(L1==2) break }\ndo { L2=L2+1 } while(L2<5)\nY[L2]\ndo Z1 while(1==2)\nM30",
        &[
            "1:1 linear X1",
            "1:1 linear X2",
            "1:3 linear Y5",
            "1:4 linear Z1",
            "1:5 end",
        ],
    );
}

#[test]
fn d10_a_switch_falls_through_to_break_and_takes_default() {
    let program = |value: &str| {
        format!(
            "L1={value}\nswitch(L1){{\ncase 1: X1\ncase -2: X2 break\ndefault: X3\ncase 4: X4\n}}\nX5\nM30"
        )
    };
    let items = |value: &str| Run::new(&program(value)).items();
    assert_eq!(
        items("1.9"),
        ["1:3 linear X1", "1:4 linear X2", "1:8 linear X5", "1:9 end"]
    );
    assert_eq!(items("-2.9"), ["1:4 linear X2", "1:8 linear X5", "1:9 end"]);
    assert_eq!(
        items("7"),
        ["1:5 linear X3", "1:6 linear X4", "1:8 linear X5", "1:9 end"]
    );
    assert_eq!(items("4"), ["1:6 linear X4", "1:8 linear X5", "1:9 end"]);
    assert_eq!(
        items("0/0"),
        ["1:5 linear X3", "1:6 linear X4", "1:8 linear X5", "1:9 end"]
    );
    check("switch(L1){case 1: X1}\nM30", &["1:2 end"]);
}

#[test]
fn an_endless_loop_is_an_alarm() {
    let items = Run::new("while(1==1) L1=L1+1\nM30").items();
    assert_eq!(items.last().map(String::as_str), Some("1:1 alarm 21"));
}

#[test]
fn d15_a_captured_position_waits_for_the_end_of_its_g31() {
    let mut run = Run::new("G31 X10\nX1\nL1=_CNC_CapturedPosition0\nX[_CNC_CapturedPosition1] Y[L1]\nM30");
    run.captured[1] = 4.0;
    let skip = run.next();
    assert!(matches!(
        skip,
        Ok(Item::Block(Block {
            action: Action::Skip(_),
            ..
        }))
    ));
    run.skips = true;
    assert!(matches!(run.next(), Ok(Item::Block(_))));
    assert!(matches!(run.next(), Ok(Item::NeedsStandstill(origin)) if origin.line == 3));
    run.skips = false;
    run.captured[0] = 2.5;
    assert_eq!(run.items(), ["1:4 linear X4 Y2.5", "1:5 end"]);
}

#[test]
fn d15_block_that_uses_the_position_waits_for_the_end_of_g31() {
    for (block, waits) in [
        ("G68 X1 R90", true),
        ("G51 X1 Y2 P2", true),
        ("G84 Z-5 R2 F100", true),
        ("G68 X1 Y2 R90", false),
        ("G18 G68 X1 Y2 R90", true),
        ("G51 X1 Y2 Z3 P2", false),
        ("G91 G01 X1", false),
        ("G02 X1 Y1 I1", false),
        ("G28 X1", false),
    ] {
        let mut run = Run::new(&format!("G31 X10 S300\n{block} M50\nM30"));
        assert!(matches!(run.next(), Ok(Item::Block(_))));
        let modal = run.interpreter.modal().clone();
        run.skips = true;
        let item = run.next().unwrap();
        assert_eq!(
            matches!(item, Item::NeedsStandstill(_)),
            waits,
            "{block}: {item:?}"
        );
        if waits {
            assert_eq!(*run.interpreter.modal(), modal, "{block}");
            run.skips = false;
            run.position[Axis::Z] = 7.0;
            let item = run.next().unwrap();
            assert!(!matches!(item, Item::NeedsStandstill(_)), "{block}: {item:?}");
        }
    }
}

#[test]
fn d26_arcs_carry_plane_turn_and_shape() {
    let arc = |source: &str| match last(source).action {
        Action::Arc(arc) => *arc,
        other => panic!("{other:?}"),
    };
    let full = arc("G02 J50 Z10\nM30");
    assert_eq!((full.plane, full.turn), (Plane::Xy, Turn::Clockwise));
    assert_eq!(full.shape, ArcShape::Centre([0.0, 50.0, 0.0]));
    assert!(!full.target.named.contains(Axis::X) && full.target.named.contains(Axis::Z));
    let later = arc("G18 G91 G03 X1 R-7\nX3 R2\nM30");
    assert_eq!((later.plane, later.turn), (Plane::Zx, Turn::CounterClockwise));
    assert_eq!(later.shape, ArcShape::Radius(2.0));
    assert_eq!(later.target.distance, Distance::Incremental);
    assert_eq!(arc("G02 I1\nM30").shape, ArcShape::Centre([1.0, 0.0, 0.0]));
    assert!(Run::new("G02 X1 I3 R2\nM30").items()[0].contains("warning"));
}

#[test]
fn d25_inches_are_lengths_and_feedrates() {
    let block = last("G20 X1 Y-2 A3 F10\nM30");
    let Action::Linear(words) = block.action else {
        panic!("no line")
    };
    assert!((words.values[Axis::X] - 25.4).abs() < 1e-12);
    assert!((words.values[Axis::Y] + 50.8).abs() < 1e-12);
    assert!((words.values[Axis::A] - 3.0).abs() < 1e-12);
    assert!((block.feed.feedrate_mm_min - 254.0).abs() < 1e-12);
    let Action::Linear(words) = last("G20\nG21 X1\nM30").action else {
        panic!("no line")
    };
    assert!((words.values[Axis::X] - 1.0).abs() < 1e-12);
}

#[test]
fn d25_a_block_has_f_in_degrees_for_rotary_axes_in_inches_too() {
    let feedrates = |source: &str| {
        let block = last(&format!("{source}\nM30"));
        (block.feed.feedrate_mm_min, block.feedrate_deg_min)
    };
    for source in ["G20 F10 A90", "G20 F10 X1\nA90", "G20 F10 A90\nX1 A0"] {
        let (length, degrees) = feedrates(source);
        assert!(
            (length - 254.0).abs() < 1e-9 && (degrees - 10.0).abs() < 1e-12,
            "{source}"
        );
    }
    let (length, degrees) = feedrates("G21 F10 A90");
    assert!((length - 10.0).abs() < 1e-12 && (degrees - 10.0).abs() < 1e-12);
    // before an F, the number of the settings counts in the unit in force
    for (source, unit_mm) in [("G20 A90", 25.4), ("A90", 1.0), ("G20\nG21 A90", 1.0)] {
        let (length, degrees) = feedrates(source);
        assert!((length - 500.0 * unit_mm).abs() < 1e-9, "{source}");
        assert!((degrees - 500.0).abs() < 1e-12, "{source}");
    }
}

#[test]
fn d25_the_settings_tell_the_unit_at_start_up() {
    let inch = CoordinateSystemSettings {
        unit: Unit::Inch,
        ..settings()
    };
    let mut run = Run::with_settings("X1 F10\nG21 X1\nM30", &inch);
    let mut step = || match run.next() {
        Ok(Item::Block(block)) => match block.action {
            Action::Linear(words) => (words.values[Axis::X], block.feed.feedrate_mm_min),
            other => panic!("{other:?}"),
        },
        other => panic!("{other:?}"),
    };
    assert_eq!(step(), (25.4, 254.0));
    assert_eq!(step(), (1.0, 254.0));
    let groups: Vec<_> = Interpreter::new(&inch, nj()).modal().groups().collect();
    assert!(groups.contains(&("06", "G20")), "{groups:?}");
}

#[test]
fn d24_references_name_their_middle_point_and_end_the_shape() {
    let blocks = blocks("G51.1 X0\nG68 R30\nG28 X5\nM30");
    let actions: Vec<_> = blocks.iter().rev().take(2).map(|block| &block.action).collect();
    let [
        Action::Transform(after),
        Action::Reference { middle, point: 1, .. },
    ] = actions[..]
    else {
        panic!("{actions:?}")
    };
    assert!(after.mirror.is_none() && after.rotation.is_none());
    assert_eq!(middle.named.iter().collect::<Vec<_>>(), [Axis::X]);
    let Action::Reference { middle, point, .. } = last("G28\nG30 P3\nM30").action else {
        panic!()
    };
    assert_eq!(point, 3);
    assert!(middle.named.is_empty());
    assert!(matches!(
        last("G30 X1\nM30").action,
        Action::Reference { point: 2, .. }
    ));
}

#[test]
fn g53_is_rapid_in_machine_coordinates_and_ends_the_local_ones() {
    let blocks = blocks("G91 G52 X5\nG53 X10\nM30");
    let Some(Action::Rapid(words)) = blocks.last().map(|block| &block.action) else {
        panic!()
    };
    assert_eq!(
        (words.frame, words.distance),
        (Frame::Machine, Distance::Absolute)
    );
    assert!(last_transform("G52 X5\nG53 X10\nM30").local[Axis::X].abs() <= 0.0);
}

#[test]
fn d20_transforms_come_one_by_one() {
    let all = last_transform("G17 G52 X1 Y2\nG52 X3\nG51.1 Y5\nG51 X1 J2 K-3\nG68 X7 R90\nG43\nM30");
    assert!((all.local[Axis::X] - 3.0).abs() <= 0.0 && (all.local[Axis::Y] - 2.0).abs() <= 0.0);
    let (Some(mirror), Some(scaling), Some(rotation)) = (all.mirror, all.scaling, all.rotation) else {
        panic!("{all:?}")
    };
    assert_eq!(mirror.axes.iter().collect::<Vec<_>>(), [Axis::Y]);
    assert_eq!(scaling.factors, [1.0, 2.0, -3.0]);
    assert_eq!((rotation.plane, rotation.angle_deg), (Plane::Xy, 90.0));
    assert!((all.tool_length - 8.0).abs() <= 0.0);
    assert!((last_transform("G44\nM30").tool_length + 8.0).abs() <= 0.0);
    assert!(last_transform("G43\nG49\nM30").tool_length.abs() <= 0.0);
    assert_eq!(
        last_transform("G51 P3 I2\nM30").scaling.map(|s| s.factors),
        Some([3.0; 3])
    );
}

#[test]
fn d20_a_centre_that_names_no_axis_is_where_the_tool_is() {
    // The tool is at machine (30, 40, 5), with G52 X2 at (28, 40, 5) of the coordinates that scaling and rotation take.
    let centre = |source: &str, of: &dyn Fn(&Transform) -> AxisVector| {
        let mut run = Run::new(source);
        run.position = AxisVector([30.0, 40.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        loop {
            match run.next() {
                Ok(Item::Block(block)) => {
                    if let Action::Transform(transform) = block.action
                        && (transform.scaling.is_some() || transform.rotation.is_some())
                    {
                        let centre = of(&transform);
                        return [Axis::X, Axis::Y, Axis::Z].map(|axis| centre[axis]);
                    }
                }
                Ok(Item::End(_)) | Err(_) => panic!("{source:?} switches nothing on"),
                Ok(_) => {}
            }
        }
    };
    let of_scaling = |transform: &Transform| {
        transform
            .scaling
            .map(|scaling| scaling.centre)
            .unwrap_or_default()
    };
    let of_rotation = |transform: &Transform| {
        transform
            .rotation
            .map(|rotation| rotation.centre)
            .unwrap_or_default()
    };
    assert_eq!(centre("G52 X2\nG51 Y7 P2\nM30", &of_scaling), [28.0, 7.0, 5.0]);
    assert_eq!(centre("G52 X2\nG68 X1 R90\nM30", &of_rotation), [1.0, 40.0, 5.0]);
}

#[test]
fn work_coordinates_and_g52_end_scaling_mirroring_and_rotation() {
    for code in ["G54", "G52 X1", "G53 X1"] {
        let source = format!("G51.1 X1\nG51 P2\nG68 R9\n{code}\nM30");
        let transform = last_transform(&source);
        assert!(transform.mirror.is_none() && transform.scaling.is_none() && transform.rotation.is_none());
    }
    let mut run = Run::new("G51 P2\nG54\nM30");
    while !matches!(run.next(), Ok(Item::End(_))) {}
    assert!(
        run.interpreter
            .modal()
            .groups()
            .any(|group| group == ("11", "G50"))
    );
}

#[test]
fn g50_1_ends_the_mirroring_of_named_axes() {
    let axes = |source: &str| {
        last_transform(source)
            .mirror
            .map(|mirror| mirror.axes.iter().collect::<Vec<_>>())
    };
    assert_eq!(axes("G51.1 X1 Y2\nG50.1 X0\nM30"), Some(vec![Axis::Y]));
    assert_eq!(axes("G51.1 X1 Y2\nG50.1\nM30"), None);
    assert_eq!(axes("G51.1 X1 Y2\nG51.1 Z1\nM30"), Some(vec![Axis::Z]));
}

#[test]
fn d17_compensation_takes_the_tool_and_the_plane_in_force() {
    let right = &blocks("G42 G18 X10\nG40 X20\nM30")[0];
    assert_eq!(
        right.compensation,
        Compensation::Right {
            radius: 5.0,
            plane: Plane::Zx
        }
    );
    let blocks = blocks("G41\nX10\nG40\nX20\nM30");
    assert_eq!(
        blocks[1].compensation,
        Compensation::Left {
            radius: 5.0,
            plane: Plane::Xy
        }
    );
    assert_eq!(blocks[3].compensation, Compensation::Off);
}

#[test]
fn d17_g41_to_g44_without_a_tool_warn_and_count_it_as_0() {
    for (code, what) in [
        ("G41", "radius"),
        ("G42", "radius"),
        ("G43", "length"),
        ("G44", "length"),
    ] {
        let mut run = Run::new(&format!("{code}\nM30"));
        run.tool = None;
        let warning =
            format!("1:1 warning {code}: no tool of the tool table is selected; a {what} of 0 mm is used");
        assert_eq!(run.items()[0], warning);
    }
}

#[test]
fn g500_stands_in_the_block() {
    assert_eq!(last("G500 X1\nM30").multi_block, MultiBlock::On);
    assert_eq!(last("G500\nG501 X1\nM30").multi_block, MultiBlock::Off);
}

#[test]
fn what_the_text_does_not_show_is_an_alarm() {
    let alarm = |main: &str, sub: &str| Run::new(main).with(1000, sub).items().pop();
    assert_eq!(
        alarm("G43\nM98 P1000\nM30", "G28\nM99"),
        Some("1000:1 alarm 41".into())
    );
    assert_eq!(
        alarm("G41\nX9\nM98 P1000\nM30", "G00 X1\nM99"),
        Some("1000:1 alarm 40".into())
    );
    assert_eq!(
        alarm("G02 I1\nM98 P1000\nM30", "X1\nM99"),
        Some("1000:1 alarm 43".into())
    );
    assert_eq!(
        alarm("S300 G84 Z-1 R1\nif(1==1) M98 P1000\nM30", "M99"),
        Some("1:2 alarm 42".into())
    );
}

#[test]
fn where_a_program_cannot_be_stopped_between_blocks_is_known() {
    for (source, compensates, in_cycle) in [
        ("G41\nX9\nM30", true, false),
        ("G42\nX9\nG40 X0\nM30", false, false),
        ("G84 X1 Z-5 R2 F100 S100\nM30", false, true),
        ("G84 X1 Z-5 R2 F100 S100\nG80\nM30", false, false),
    ] {
        let mut run = Run::new(source);
        // G41 up to the end: the last answer is an alarm, and does not show the modal state.
        (0..20).for_each(|_| drop(run.next()));
        let modal = run.interpreter.modal();
        assert_eq!(
            (modal.compensates(), modal.fixed_cycle().is_some()),
            (compensates, in_cycle),
            "{source:?}"
        );
    }
}

#[test]
fn program_starts_in_the_start_up_state_and_mdi_in_the_current_state() {
    let mut run = Run::new("G91 F500 G54\nM30");
    assert!((0..9).any(|_| matches!(run.next(), Ok(Item::End(_)))));
    assert!(run.interpreter.is_between_blocks());
    run.interpreter.start_in_modal(support::program("X1\nM30"), 0);
    assert_eq!(
        run.next().map(|item| support::text(&item)),
        Ok("0:1 linear X1".to_owned())
    );
    let modal = run.interpreter.modal();
    assert_eq!(
        (modal.distance(), modal.work_offset()),
        (Distance::Incremental, Some("G54"))
    );
    run.interpreter.reset();
    let modal = run.interpreter.modal();
    assert_eq!(
        (modal.distance(), modal.work_offset()),
        (Distance::Absolute, None)
    );
}
