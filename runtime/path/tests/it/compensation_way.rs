//! Feedrate, other axes, stops, and the transforms with G41 and G42 (M1g, D20).

use tandem_model::Axis;
use tandem_model::flow::{
    Action, Block, Mirror, MultiBlock, PathControl, Rotation, Scaling, SegmentEnd, SegmentMotion, Transform,
};
use tandem_model::plane::Plane;
use tandem_model::settings::{CompensationFeed, CoordinateSystemSettings};

use crate::contour::Step::{A, L};
use crate::contour::{G41, Step, blocks, completed, led_in_then, outcome, same, way, with};
use crate::rig::{block, ends, g00, g01, length_and_feed, settings, transform, xyz};

use Axis::{X, Y, Z};

#[test]
fn s1g_feedrate_of_centre_and_edge() {
    let contour = [
        L(10.0, 0.0),
        L(20.0, 0.0),
        A((40.0, 20.0), (20.0, 20.0), true),
        A((60.0, 40.0), (60.0, 20.0), false),
        L(80.0, 40.0),
        L(80.0, 20.0),
        L(80.0, 0.0),
    ];
    let feedrates = |settings: &CoordinateSystemSettings| -> Vec<f64> {
        let (segments, _) = outcome(settings, &blocks((0.0, 0.0), &contour, G41));
        let of = |segment| (length_and_feed(segment).1 * 1e9).round() / 1e9;
        segments.iter().map(of).collect()
    };
    let mut settings = settings();
    assert_eq!(feedrates(&settings), [600.0; 7]);
    settings.motion.compensation_feed = CompensationFeed::Edge;
    // Inside 600 * 15/20, outside 600 * 25/20.
    assert_eq!(
        feedrates(&settings),
        [600.0, 600.0, 450.0, 750.0, 600.0, 600.0, 600.0]
    );
    // F is clipped at the maximum, and so is what becomes of it.
    settings.max_feedrate_mm_min = 700.0;
    assert_eq!(
        feedrates(&settings),
        [600.0, 600.0, 450.0, 700.0, 600.0, 600.0, 600.0]
    );
}

#[test]
fn s1g_the_edge_takes_the_programmed_time_on_a_helix_too() {
    let mut settings = settings();
    settings.motion.compensation_feed = CompensationFeed::Edge;
    let mut all = blocks(
        (20.0, -10.0),
        &[L(20.0, 0.0), A((20.0, 0.0), (0.0, 0.0), true), L(20.0, 10.0)],
        G41,
    );
    let programmed = (std::f64::consts::TAU * 20.0).hypot(30.0);
    if let Action::Arc(arc) = &mut all[2].action {
        arc.target.values[Z] = 30.0;
        arc.target.named.insert(Z);
    }
    let (segments, _) = outcome(&settings, &all);
    let (length, feedrate) = length_and_feed(&segments[2]);
    let centre = (std::f64::consts::TAU * 15.0).hypot(30.0);
    assert!((length - centre).abs() < 1e-9);
    assert!((length / feedrate - programmed / 600.0).abs() < 1e-12);
}

#[test]
fn s1g_other_axes_go_linearly_with_their_block() {
    let mut all = blocks(
        (-10.0, 0.0),
        &[
            L(0.0, 0.0),
            L(20.0, 0.0),
            A((0.0, 20.0), (0.0, 0.0), true),
            L(-20.0, 20.0),
        ],
        G41,
    );
    for (i, z) in [(1, -1.0), (2, -3.0), (3, -7.0)] {
        if let Action::Linear(words) = &mut all[i].action {
            (words.values[Z], words.named) = (z, [X, Y, Z].into_iter().collect());
        }
        if let Action::Arc(arc) = &mut all[i].action {
            (arc.target.values[Z], arc.target.named) = (z, [X, Y, Z].into_iter().collect());
        }
    }
    let segments = completed(&all);
    let heights: Vec<f64> = segments
        .iter()
        .map(|segment| match &segment.motion {
            SegmentMotion::Feed { path, .. } => path.end()[Z],
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(heights, [0.0, -1.0, -3.0, -7.0, -7.0]);
    // Half the way of the cut arc is half the way of Z.
    if let SegmentMotion::Feed { path, .. } = &segments[3].motion {
        assert!((path.point_at(path.length() / 2.0)[Z] + 5.0).abs() < 1e-9);
    }
}

#[test]
fn s1g_block_without_plane_motion_moves_at_the_join_of_its_neighbours() {
    let all = led_in_then([
        with(G41, g01(3, &[(Z, -2.0)])),
        with(G41, g01(4, &[(Y, 20.0)])),
        block(5, Action::None),
        g00(6, &[(Z, 30.0)]),
        g00(7, &[(Y, 50.0)]),
    ]);
    let segments = completed(&all);
    same(
        &way(&segments),
        &[
            L(10.0, 5.0),
            L(15.0, 5.0),
            L(15.0, 5.0),
            L(15.0, 20.0),
            L(15.0, 20.0),
            L(20.0, 50.0),
        ],
    );
    let heights: Vec<f64> = segments
        .iter()
        .map(|segment| match &segment.motion {
            SegmentMotion::Feed { path, .. } => path.end()[Z],
            SegmentMotion::Rapid { to, .. } => to[Z],
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(heights, [0.0, 0.0, -2.0, -2.0, 30.0, 30.0]);
    let lines: Vec<u32> = segments.iter().map(|segment| segment.origin.line).collect();
    assert_eq!(lines, [1, 2, 3, 4, 6, 7]);
    assert!(matches!(segments[5].motion, SegmentMotion::Rapid { .. }));
}

#[test]
fn s1g_a_move_along_another_axis_before_the_lead_in_is_not_compensated() {
    let segments = completed(&[
        with(G41, g01(1, &[(Z, -2.0)])),
        with(G41, g01(2, &[(X, 10.0)])),
        with(G41, g01(3, &[(X, 20.0)])),
        g01(4, &[(X, 30.0)]),
    ]);
    same(
        &way(&segments),
        &[L(0.0, 0.0), L(10.0, 5.0), L(20.0, 5.0), L(30.0, 0.0)],
    );
}

#[test]
fn s1g_a_lead_out_with_g00_starts_beside_the_last_block() {
    let segments = completed(&led_in_then([g00(3, &[(X, 10.0), (Y, -10.0)])]));
    same(
        &way(&segments),
        &[
            L(10.0, 5.0),
            L(20.0, 5.0),
            A((20.0 + 12.5_f64.sqrt(), -12.5_f64.sqrt()), (20.0, 0.0), false),
            L(10.0, -10.0),
        ],
    );
    assert!((length_and_feed(&segments[2]).1 - 600.0).abs() < 1e-9);
    assert!(matches!(segments[3].motion, SegmentMotion::Rapid { .. }));
}

#[test]
fn stops_are_made_where_blocks_meet() {
    use SegmentEnd::{Continuous, ExactStop};
    // The added arc of the corner belongs to the block after it.
    let corner = |change: &dyn Fn(&mut Vec<Block>)| {
        let mut all = blocks(
            (0.0, 0.0),
            &[L(10.0, 0.0), L(20.0, 0.0), L(0.0, -20.0), L(-20.0, -40.0)],
            G41,
        );
        all.remove(0);
        change(&mut all);
        ends(&completed(&all))
    };
    let plain = [
        (2, Continuous),
        (3, Continuous),
        (4, Continuous),
        (4, Continuous),
        (5, ExactStop),
    ];
    assert_eq!(corner(&|_| {}), plain);
    let stop_at_corner = [
        (2, Continuous),
        (3, ExactStop),
        (4, Continuous),
        (4, Continuous),
        (5, ExactStop),
    ];
    assert_eq!(corner(&|all| all[1].exact_stop_after = true), stop_at_corner);
    assert_eq!(corner(&|all| all[2].exact_stop_before = true), stop_at_corner);
    let without_movement = |all: &mut Vec<Block>| all.insert(2, with(G41, block(9, Action::None)));
    assert_eq!(corner(&without_movement), stop_at_corner);
    let exact = |all: &mut Vec<Block>| {
        for block in all {
            block.path_control = PathControl::ExactStop;
        }
    };
    assert_eq!(
        corner(&exact),
        [
            (2, ExactStop),
            (3, ExactStop),
            // blended with its line the arc would cut the corner
            (4, ExactStop),
            (4, ExactStop),
            (5, ExactStop)
        ]
    );
    let dwell = |all: &mut Vec<Block>| all.insert(2, with(G41, block(9, Action::Dwell { dwell_s: 1.0 })));
    assert_eq!(
        corner(&dwell),
        [
            (2, Continuous),
            (3, ExactStop),
            (9, ExactStop),
            (4, Continuous),
            (4, Continuous),
            (5, ExactStop)
        ]
    );
}

#[test]
fn m1c_with_g500_an_offset_changes_within_compensation_without_a_stop() {
    let contour = [L(10.0, 0.0), L(20.0, 0.0), L(20.0, 10.0), L(20.0, 20.0)];
    let with_g500 = |all: &mut Vec<Block>| {
        for block in all.iter_mut() {
            block.multi_block = MultiBlock::On;
        }
        completed(all)
    };
    let mut plain = blocks((0.0, 0.0), &contour, G41);
    // the same points, the last two in coordinates that begin at X5
    let shifted = contour.map(|step| L(step.to().0 - 5.0, step.to().1));
    let mut moved = blocks((0.0, 0.0), &contour[..2], G41);
    for block in moved.iter_mut().skip(1) {
        block.compensation = G41;
    }
    let mut local = Transform::default();
    local.local[X] = 5.0;
    moved.push(with(G41, transform(9, local)));
    moved.extend(blocks((0.0, 0.0), &shifted, G41).drain(3..));
    let (plain, moved) = (with_g500(&mut plain), with_g500(&mut moved));
    same(&way(&plain), &way(&moved));
    assert_eq!(ends(&plain), ends(&moved));
}

#[test]
fn d20_the_offset_is_in_the_machine_and_a_mirror_swaps_the_side() {
    let contour = [L(10.0, 0.0), L(20.0, 0.0), L(20.0, 10.0), L(20.0, 20.0)];
    // Centre with G41 on the left: (10, 5), (15, 5), (15, 10), (20, 20).
    let run = |transform_of: Transform| {
        let mut all = vec![transform(9, transform_of)];
        all.extend(blocks((0.0, 0.0), &contour, G41));
        way(&completed(&all))
    };
    let mirror = |axes: &[Axis]| Transform {
        mirror: Some(Mirror {
            axes: axes.iter().copied().collect(),
            centre: xyz([0.0; 3]),
        }),
        ..Transform::default()
    };
    let plain = [(10.0, 5.0), (15.0, 5.0), (15.0, 10.0), (20.0, 20.0)];
    let image = |f: &dyn Fn((f64, f64)) -> (f64, f64)| -> Vec<Step> {
        plain
            .iter()
            .map(|point| f(*point))
            .map(|(u, v)| L(u, v))
            .collect()
    };
    same(&run(Transform::default()), &image(&|p| p));
    same(&run(mirror(&[X])), &image(&|(u, v)| (-u, v)));
    same(&run(mirror(&[Y])), &image(&|(u, v)| (u, -v)));
    same(&run(mirror(&[X, Y])), &image(&|(u, v)| (-u, -v)));
    same(&run(mirror(&[Z])), &image(&|p| p));
    let turned = Transform {
        rotation: Some(Rotation {
            plane: Plane::Xy,
            centre: xyz([0.0; 3]),
            angle_deg: 90.0,
        }),
        ..Transform::default()
    };
    same(&run(turned), &image(&|(u, v)| (-v, u)));
    // Scale 2, and scale -2 in Y: the contour grows, the tool does not.
    let scaled = |factors| Transform {
        scaling: Some(Scaling {
            centre: xyz([0.0; 3]),
            factors,
        }),
        ..Transform::default()
    };
    let twice = [L(20.0, 5.0), L(35.0, 5.0), L(35.0, 20.0), L(40.0, 40.0)];
    same(&run(scaled([2.0, 2.0, 1.0])), &twice);
    same(&run(scaled([2.0, -2.0, 1.0])), &twice.map(Step::mirrored));
}
