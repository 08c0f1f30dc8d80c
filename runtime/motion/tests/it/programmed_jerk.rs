//! The maximum jerk on programmed paths (M1d.5, M1d.9).

use std::collections::VecDeque;

use tandem_model::alarm::LIMIT_ZERO;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{Law, PathPlace, Profile};
use tandem_model::settings::{CoordinateSystemSettings, ShortBlock};
use tandem_model::{ArcPath, AxisVector};
use tandem_motion::Planner;

use crate::look_ahead_random::{Random, chains, each_seed, random_blocks};
use crate::look_ahead_rig::{Chain, check, same_path, time_s};
use crate::rig::{PERIOD_S, close, feed, line, motor, refused, segment, settings, turning, vector};
use crate::smooth::{blended, plan};
use crate::smooth_jerk::{JERK_MAX, double_s, jerk_of_setpoints, shapes, soft_machine};

const LIMITS: [f64; 3] = [500.0, 5000.0, 50_000.0];

/// Ramp times ta, td and ts of blocks, ms: without ramps, without jerk time, and with all.
const RAMPS: [[f64; 3]; 3] = [[0.0; 3], [20.0, 20.0, 0.0], [20.0, 20.0, 10.0]];

fn lines(points: &[AxisVector], feed: SegmentFeed) -> Vec<Segment> {
    let ends = points.windows(2);
    ends.map(|ends| blended(line(ends[0], ends[1], feed))).collect()
}

/// Plans segments, and checks that the setpoints keep the maximum jerk. Returns the time, s.
fn time_within_jerk(settings: &CoordinateSystemSettings, segments: &[Segment], context: &str) -> f64 {
    let profiles = plan(settings, segments);
    let used = jerk_of_setpoints(settings, &profiles);
    assert!(used <= JERK_MAX, "{context}: {used} of the jerk");
    time_s(&profiles)
}

#[test]
fn m1d5_random_chains_keep_all_limits_of_the_motors() {
    each_seed(chains() / 50, |seed| {
        let mut numbers = Random(5_000_000 + seed);
        let blocks = 2 + usize::try_from(numbers.bits() % 12).unwrap();
        let (accelerations, all) = random_blocks(&mut numbers, blocks);
        let jerks: Vec<Option<f64>> = accelerations
            .iter()
            .map(|a| (numbers.unit() < 0.7).then(|| a * numbers.magnitude(2.0, 2000.0)))
            .collect();
        let soft = Chain::soft(&accelerations, &jerks, all.clone());
        let factor = numbers.within(0.5, 2.0);
        let profiles = soft.plan_for(factor);
        if let Err(found) = check(&soft, &profiles, 6).and_then(|()| same_path(&soft, &profiles)) {
            panic!("seed {seed}, {blocks} blocks: {found}");
        }
        let used = jerk_of_setpoints(&soft.settings, &profiles);
        assert!(
            used <= JERK_MAX,
            "seed {seed}, {blocks} blocks: {used} of the jerk"
        );
        let stiff = time_s(&Chain::new(&accelerations, all).plan_for(factor));
        let least = (stiff - 3.0 * PERIOD_S) / 1.02;
        assert!(
            time_s(&profiles) >= least,
            "seed {seed}: {} s, without jerk {stiff} s",
            time_s(&profiles)
        );
    });
}

#[test]
fn m1d5_a_line_takes_the_time_of_seven_segments() {
    for distance in [0.01, 1.0, 100.0] {
        let settings = soft_machine(0.0, LIMITS);
        let segments = lines(&[AxisVector::ZERO, vector(&[distance])], feed(6000.0, [0.0; 3]));
        let time_s = time_within_jerk(&settings, &segments, "line");
        let [_, acceleration, jerk] = LIMITS;
        // A reserve of 5 percent of the jerk remains for feed hold.
        let best_s = double_s(distance, [100.0, acceleration, 0.95 * jerk]);
        assert!(
            (0.999..1.01).contains(&(time_s / best_s)),
            "{distance} mm: {time_s} s, not {best_s} s"
        );
    }
}

#[test]
fn m1d5_ramps_within_the_maximum_jerk_are_as_programmed() {
    // 100 mm/s in 0.25 s, 0.05 s of it jerk: 500 mm/s^2, 10,000 mm/s^3.
    let settings = soft_machine(0.0, [500.0, 505.0, 10_600.0]);
    let segments = lines(
        &[AxisVector::ZERO, vector(&[50.0])],
        feed(6000.0, [200.0, 200.0, 50.0]),
    );
    close(time_s(&plan(&settings, &segments)), 50.0 / 100.0 + 0.25);
}

#[test]
fn m1d5_one_line_in_blocks_of_different_f_keeps_the_maximum_jerk() {
    for ramps in RAMPS {
        for length in [0.01, 0.3, 4.0] {
            let mut random = Random(7);
            let segments: Vec<Segment> = (0..60)
                .map(|k| {
                    let ends =
                        [k, k + 1].map(|k| vector(&[f64::from(k) * length, f64::from(k) * length / 3.0]));
                    let feed = feed(random.magnitude(300.0, 9000.0), ramps);
                    blended(line(ends[0], ends[1], feed))
                })
                .collect();
            let context = format!("blocks of {length} mm, ramps {ramps:?}");
            time_within_jerk(&soft_machine(0.0, LIMITS), &segments, &context);
        }
    }
}

#[test]
fn m1d5_shapes_of_cam_programs_keep_the_maximum_jerk() {
    for (name, points) in shapes(300) {
        for ramps in RAMPS {
            let context = format!("{name}, ramps {ramps:?}");
            time_within_jerk(
                &soft_machine(0.0, LIMITS),
                &lines(&points, feed(6000.0, ramps)),
                &context,
            );
        }
    }
}

#[test]
fn m1d5_even_chords_of_a_circle_need_no_stop() {
    // Chords of 0.5 mm, on a radius of 20 mm: the acceleration steps by v^2/r times the angle of a chord.
    let points: Vec<AxisVector> = (0..=250)
        .map(|k| {
            let angle = f64::from(k) * 0.025;
            vector(&[20.0 * angle.sin(), 20.0 - 20.0 * angle.cos()])
        })
        .collect();
    let segments = lines(&points, feed(3000.0, [20.0, 20.0, 0.0]));
    let time_s = time_within_jerk(&soft_machine(0.0, LIMITS), &segments, "circle");
    let at_feed_s = 250.0 * 0.5 / 50.0;
    assert!(time_s < 1.1 * at_feed_s, "{time_s} s, at F {at_feed_s} s");
}

#[test]
fn m1d5_arcs_and_spirals_keep_the_maximum_jerk() {
    for radius in [0.05, 1.0, 40.0] {
        let settings = soft_machine(0.0, LIMITS);
        let arc = turning(AxisVector::ZERO, 0.3, radius, 5.0);
        let end = arc.end();
        let spiral = ArcPath::new(
            end,
            end.plus(vector(&[3.0 * radius])),
            Plane::Xy,
            [end.0[0] + 0.5 * radius, end.0[1]],
            Turn::CounterClockwise,
        );
        for ramps in RAMPS {
            let arcs = [&arc, &spiral].map(|arc| {
                blended(segment(SegmentMotion::Feed {
                    path: Path::Arc(arc.clone()),
                    feed: feed(9000.0, ramps),
                }))
            });
            time_within_jerk(&settings, &arcs, &format!("radius {radius}, ramps {ramps:?}"));
        }
    }
}

#[test]
fn m1d5_an_opening_spiral_is_not_slowed_by_its_narrowest_turn() {
    // A spiral from a radius of 1 mm to 50 mm in one turn.
    let path = ArcPath::new(
        vector(&[1.0]),
        vector(&[50.0]),
        Plane::Xy,
        [0.0; 2],
        Turn::CounterClockwise,
    );
    let spiral = [blended(segment(SegmentMotion::Feed {
        path: Path::Arc(path),
        feed: feed(12_000.0, [20.0, 20.0, 10.0]),
    }))];
    let [soft, stiff] = [Some(1e5), None].map(|jerk| {
        let machine = settings(std::array::from_fn(|i| {
            (i < 2).then(|| motor(1000.0, 2000.0, jerk))
        }));
        time_s(&plan(&machine, &spiral))
    });
    assert!(soft < 1.25 * stiff, "{soft} s, without a maximum jerk {stiff} s");
}

#[test]
fn m1d5_arcs_of_any_radius_are_planned_with_any_maximum_jerk() {
    for r in [1e-9, 1e-6, 1e-3, 1e6] {
        for jerk in [1e-3, 1.0, 1e12] {
            let to = vector(&[2.0 * r]);
            let arc = ArcPath::new(AxisVector::ZERO, to, Plane::Xy, [r, 0.0], Turn::Clockwise);
            let half = blended(segment(SegmentMotion::Feed {
                path: Path::Arc(arc),
                feed: feed(60_000.0, [20.0, 20.0, 10.0]),
            }));
            let machine = settings(std::array::from_fn(|i| {
                (i < 2).then(|| motor(1000.0, 1000.0, Some(jerk)))
            }));
            let profiles = plan(&machine, &[half]);
            let time = time_s(&profiles);
            assert!(time > 0.0 && time.is_finite(), "{r} {jerk}: {time}");
            assert_eq!(profiles[profiles.len() - 1].end_position(), to);
        }
    }
}

#[test]
fn m1d5_back_trace_and_replanning_keep_the_maximum_jerk() {
    let settings = soft_machine(0.0, [300.0, 2000.0, 20_000.0]);
    let [(_, points), ..] = shapes(400);
    let mut planner = Planner::new(&settings);
    let mut out = VecDeque::new();
    for segment in lines(&points, feed(6000.0, [20.0, 20.0, 10.0])) {
        planner.push(&segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    let at = PathPlace {
        segment: 200,
        plan_s: 1e-3,
    };
    let ahead = planner.replan(at, true);
    assert!(ahead.can_begin());
    let back = planner.retrace(at);
    for profiles in [Vec::from(ahead.profiles), Vec::from(back)] {
        let used = jerk_of_setpoints(&settings, &profiles);
        assert!(used <= JERK_MAX, "{used}");
    }
}

/// Returns the ramps of the profiles, without repetitions.
fn ramps(profiles: &[Profile]) -> Vec<[tandem_model::ramp::UnitRamp; 2]> {
    let mut ramps: Vec<_> = profiles
        .iter()
        .map(|profile| match &profile.law {
            Law::Paced { block, .. } => block.as_ramped().map(|block| [block.start, block.stop]).unwrap(),
            other => panic!("not paced: {other:?}"),
        })
        .collect();
    ramps.dedup();
    ramps
}

#[test]
fn m1d5_ramps_between_blocks_are_as_programmed_with_extend_and_g501() {
    let points = [AxisVector::ZERO, vector(&[2.0]), vector(&[4.0])];
    let times = [20.0, 20.0, 10.0];
    let machine = |rule, jerk| {
        let mut machine = soft_machine(0.0, [1000.0, 1e6, 1e9]);
        machine.motion.short_block = rule;
        for motor in machine.motors.iter_mut().flatten() {
            motor.max_jerk = jerk;
        }
        machine
    };
    let extend = lines(&points, feed(6000.0, times));
    let [soft, stiff] =
        [Some(1e4), None].map(|jerk| ramps(&plan(&machine(ShortBlock::Extend, jerk), &extend)));
    assert_eq!(soft, stiff);
    let g501: Vec<Segment> = lines(&points[..2], feed(6000.0, times))
        .into_iter()
        .map(|segment| Segment {
            multi_block: MultiBlock::Off,
            ..segment
        })
        .collect();
    // 2 mm of the 3 mm that both ramps need at 100 mm/s.
    close(
        time_s(&plan(&machine(ShortBlock::Shrink, Some(1e4)), &g501)),
        0.060,
    );
}

#[test]
fn m1d5_max_jerk_not_above_zero_is_an_alarm_for_a_moving_motor() {
    let xy = |jerk| {
        settings(std::array::from_fn(|i| {
            (i < 2).then(|| motor(1000.0, 1000.0, Some(jerk)))
        }))
    };
    for jerk in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let segments = lines(&[AxisVector::ZERO, vector(&[2.0])], feed(600.0, [20.0; 3]));
        let text = refused(&xy(jerk), &segments[0], &LIMIT_ZERO);
        assert!(text.contains("max_jerk of axis X"), "{text}");
        let end = vector(&[4.0]);
        let circle = ArcPath::new(AxisVector::ZERO, end, Plane::Xy, [2.0, 0.0], Turn::Clockwise);
        let arc = blended(segment(SegmentMotion::Feed {
            path: Path::Arc(circle),
            feed: feed(600.0, [20.0; 3]),
        }));
        let text = refused(&xy(jerk), &arc, &LIMIT_ZERO);
        assert!(text.contains("max_jerk of axis X"), "{text}");
    }
    let segments = lines(&[AxisVector::ZERO, vector(&[2.0])], feed(600.0, [20.0; 3]));
    let mut machine = xy(1000.0);
    for motor in machine.motors.iter_mut().skip(1).flatten() {
        motor.max_jerk = Some(0.0);
    }
    let profiles = plan(&machine, &segments);
    assert_eq!(profiles[profiles.len() - 1].end_position(), vector(&[2.0]));
}
