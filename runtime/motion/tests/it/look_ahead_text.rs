//! G500 with G41 and G42, from the text through the path stage (M1d, M1g). The limits hold on random contours
//! of lines, arcs and helices with a moving rotary axis.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write as _;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use tandem_interp::dialects::nj;
use tandem_interp::{Inputs, Interpreter, NO_TOOLS};
use tandem_model::flow::{Item, Path, Segment, SegmentMotion};
use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::{AXES_MAX, AxisVector, MachinePosition, Variables};
use tandem_path::PathStage;
use tandem_syntax::{Grammar, parse};

use crate::look_ahead_random::{Random, chains, each_seed};
use crate::look_ahead_rig::{Chain, Shape, check, same_path};
use crate::rig::fast;

/// Creates a compensated contour from a lead-in to a lead-out.
fn contour(random: &mut Random) -> String {
    let code = random.one_of(&["G41", "G42"]);
    let [ta, ts] = [random.one_of(&[5, 20, 100]), random.one_of(&[0, 10, 50])];
    let f = random.magnitude(300.0, 30_000.0);
    let mut text = format!("G17 G90 G64 G500 ta{ta} td{ta} ts{ts} F{f:.1}\nG00 X0 Y0\nG01 {code} X10 Y0\n");
    let sharp = random.one_of(&[0.05, 0.8, 2.2]);
    let (mut heading, mut at, mut z, mut a) = (0.0_f64, [10.0, 0.0], 0.0, 0.0);
    for _ in 0..4 + random.bits() % 16 {
        heading += random.within(-sharp, sharp);
        if random.unit() < 0.3 {
            z += random.within(-3.0, 3.0);
        }
        if random.unit() < 0.3 {
            a += random.within(-20.0, 20.0);
        }
        if random.unit() < 0.5 {
            let length = random.magnitude(1.0, 20.0);
            at = [at[0] + length * heading.cos(), at[1] + length * heading.sin()];
            let _ = writeln!(text, "G01 X{:.5} Y{:.5} Z{z:.5} A{a:.5}", at[0], at[1]);
        } else {
            let radius = random.magnitude(3.0, 30.0);
            let sweep = random.within(0.2, 3.0) * random.one_of(&[1.0, -1.0]);
            let to_centre = heading + FRAC_PI_2.copysign(sweep);
            let arm = [radius * to_centre.cos(), radius * to_centre.sin()];
            let end = to_centre + std::f64::consts::PI + sweep;
            at = [
                at[0] + arm[0] + radius * end.cos(),
                at[1] + arm[1] + radius * end.sin(),
            ];
            heading += sweep;
            let g = if sweep > 0.0 { "G03" } else { "G02" };
            let [x, y] = at;
            let _ = writeln!(text, "{g} X{x:.5} Y{y:.5} Z{z:.5} I{:.5} J{:.5}", arm[0], arm[1]);
        }
    }
    let out = [at[0] + 10.0 * heading.cos(), at[1] + 10.0 * heading.sin()];
    let _ = writeln!(text, "G01 G40 X{:.5} Y{:.5}\nM30", out[0], out[1]);
    text
}

/// Returns the cutting segments of a program. Returns `None` if the program cannot be compensated.
fn segments(text: &str) -> Option<Vec<Segment>> {
    let settings = fast();
    let (program, findings) = parse(text, Grammar::nj());
    assert_eq!(findings, [], "{text}");
    let (programs, work_offsets, variables) = (BTreeMap::new(), WorkOffsets::default(), Variables::default());
    let inputs = Inputs {
        tools: &NO_TOOLS,
        programs: &programs,
        optional_skip: 0,
        work_offsets: &work_offsets,
        variables: &variables,
        tool: Some(Tool {
            length: 0.0,
            radius: 1.5,
        }),
        captured: Some([0.0; AXES_MAX]),
        position: Some(AxisVector::ZERO),
    };
    let mut interpreter = Interpreter::new(&settings, nj());
    let mut path = PathStage::new(&settings, MachinePosition::default());
    let mut out = Vec::new();
    interpreter.start(Arc::new(program), 1);
    loop {
        match interpreter.next(&inputs) {
            Ok(Item::Block(block)) => path.push(&block, &mut out).ok()?,
            Ok(Item::End(_)) => break,
            Ok(_) => {}
            Err(alarm) => panic!("{alarm:?}\n{text}"),
        }
    }
    path.finish(&mut out).ok()?;
    out.retain(|segment| matches!(segment.motion, SegmentMotion::Feed { .. }));
    Some(out)
}

fn shape(segment: &Segment) -> Shape {
    let SegmentMotion::Feed { path, .. } = &segment.motion else {
        panic!("not a cutting block")
    };
    let Path::Arc(arc) = path else {
        return Shape::Line;
    };
    let plane = arc.plane();
    let centre = arc.centre();
    let arm = plane.axes().map(|axis| arc.start()[axis]);
    let [radius, end] = arc.radii();
    Shape::Arc {
        plane,
        centre,
        radius,
        growth: end - radius,
        angle: (arm[1] - centre[1]).atan2(arm[0] - centre[0]),
        sweep: arc.sweep(),
    }
}

#[test]
fn m1d_random_compensated_contours_from_text_keep_motor_limits() {
    let seeds = chains() / 10;
    let run = AtomicU64::new(0);
    each_seed(seeds, |seed| {
        let mut random = Random(2_000_000 + seed);
        let text = contour(&mut random);
        let Some(segments) = segments(&text) else { return };
        let accelerations: Vec<f64> = (0..4).map(|_| random.magnitude(200.0, 20_000.0)).collect();
        let blocks = segments
            .into_iter()
            .map(|segment| {
                let shape = shape(&segment);
                (segment, shape)
            })
            .collect();
        let chain = Chain::new(&accelerations, blocks);
        let profiles = chain.plan();
        if let Err(found) = check(&chain, &profiles, 6).and_then(|()| same_path(&chain, &profiles)) {
            panic!("seed {seed}: {found}\n{text}");
        }
        run.fetch_add(1, Ordering::Relaxed);
    });
    // All other contours have corners or arcs too narrow for the tool.
    let run = run.into_inner();
    assert!(2 * run >= seeds, "{run} of {seeds}");
}
