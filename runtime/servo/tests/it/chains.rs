//! Blended chains (M1b, M1i): joints, feed hold and override within arcs and blends, late profiles.

use std::collections::VecDeque;

use proptest::prelude::*;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{ChainPlace, Law, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{ArcPath, Axis, AxisVector};
use tandem_motion::Planner;
use tandem_servo::{Control, Event};

use crate::rig::{Rig, T, close, is_finished, origin, settings, vector};

/// Line, half circle, line, quarter of a helix, short lines: X always grows, F6000, ramps of 0.15 s.
fn chain() -> Vec<Profile> {
    let arc = |from: [f64; 3], to: [f64; 3], centre, turn| {
        Path::Arc(ArcPath::new(vector(&from), vector(&to), Plane::Xy, centre, turn))
    };
    let line = |from: [f64; 3], to: [f64; 3]| {
        let (from, to) = (vector(&from), vector(&to));
        let length = to.minus(from).orthogonal_length();
        Path::Line { from, to, length }
    };
    let paths = [
        line([0.0; 3], [20.0, 5.0, 0.0]),
        arc([20.0, 5.0, 0.0], [60.0, 5.0, 0.0], [40.0, 5.0], Turn::Clockwise),
        line([60.0, 5.0, 0.0], [75.0, 0.0, 3.0]),
        arc(
            [75.0, 0.0, 3.0],
            [95.0, 20.0, 8.0],
            [75.0, 20.0],
            Turn::CounterClockwise,
        ),
        line([95.0, 20.0, 8.0], [97.0, 20.0, 8.0]),
        line([97.0, 20.0, 8.0], [99.0, 21.0, 8.0]),
        line([99.0, 21.0, 8.0], [130.0, 0.0, 0.0]),
    ];
    let feed = SegmentFeed {
        feedrate_mm_min: 6000.0,
        ta_ms: 100.0,
        td_ms: 120.0,
        ts_ms: 50.0,
        ..SegmentFeed::default()
    };
    let mut planner = Planner::new(&settings());
    let mut out = VecDeque::new();
    for (path, n) in paths.into_iter().zip(1..) {
        let segment = Segment {
            origin: origin(n),
            motion: SegmentMotion::Feed { path, feed },
            end: SegmentEnd::Continuous,
            multi_block: MultiBlock::Off,
            serial: 0,
        };
        planner.push(&segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    out.into()
}

fn end_s(profiles: &[Profile]) -> f64 {
    profiles.iter().map(|profile| profile.duration_s).sum()
}

fn position(profiles: &[Profile], t: f64) -> AxisVector {
    let mut t = t;
    for profile in profiles {
        if t < profile.duration_s {
            return profile.position(t);
        }
        t -= profile.duration_s;
    }
    profiles[profiles.len() - 1].end_position()
}

/// Returns the point of the chain at this X, by bisection of its time.
fn position_at_x(profiles: &[Profile], x: f64) -> AxisVector {
    let (mut low, mut high) = (0.0, end_s(profiles));
    for _ in 0..100 {
        let middle = f64::midpoint(low, high);
        if position(profiles, middle)[Axis::X] > x {
            high = middle;
        } else {
            low = middle;
        }
    }
    position(profiles, low)
}

#[test]
fn s1b_sample_k_of_a_chain_is_its_formula_at_k_periods_over_all_joints() {
    let profiles = chain();
    let mut rig = Rig::new(&settings());
    for profile in &profiles {
        rig.push(profile.clone());
    }
    let mut events = rig.cycle();
    let mut k = 0;
    while !events.iter().any(is_finished(7)) {
        events.extend(rig.cycle());
        k += 1;
        let off = rig.position().minus(position(&profiles, f64::from(k) * T));
        assert!(
            off.orthogonal_length() < 1e-9,
            "sample {k}: {}",
            off.orthogonal_length()
        );
    }
    assert_eq!(rig.position(), vector(&[130.0, 0.0, 0.0]));
    assert!(f64::from(k) * T - end_s(&profiles) <= T);
    let order: Vec<u64> = events
        .iter()
        .filter_map(|event| match event {
            Event::Started { segment, .. } => Some(*segment),
            _ => None,
        })
        .collect();
    assert_eq!(order, [1, 2, 3, 4, 5, 6, 7]);
}

#[test]
fn the_way_to_go_counts_to_the_end_of_the_block_as_programmed() {
    let mut rig = Rig::new(&settings());
    for profile in chain() {
        rig.push(profile);
    }
    rig.cycles(100);
    let to_go = rig.reading().distance_to_go;
    close(to_go[Axis::X], 20.0 - rig.x());
}

#[test]
fn s1i_a_chain_whose_next_block_is_late_waits_for_it_on_its_path() {
    let profiles = chain();
    let mut rig = Rig::new(&settings());
    rig.push(profiles[0].clone());
    rig.push(profiles[1].clone());
    let events = rig.cycles(3000);
    assert!(
        events
            .iter()
            .all(|event| matches!(event, Event::Started { .. } | Event::Finished { .. }))
    );
    let rest = rig.position();
    let off = rest.minus(position_at_x(&profiles, rest[Axis::X]));
    assert!(off.orthogonal_length() < 1e-9);
    // The motion rests where the second profile ends, or up to two samples of 0.1 mm before.
    let left = profiles[1].end_position()[Axis::X] - rest[Axis::X];
    assert!((0.0..0.2).contains(&left), "{left}");
    rig.cycles(10);
    assert!(rig.position().minus(rest).orthogonal_length() < 1e-9);
    for profile in &profiles[2..] {
        rig.push(profile.clone());
    }
    rig.until(is_finished(7));
    assert_eq!(rig.position(), vector(&[130.0, 0.0, 0.0]));
}

#[test]
fn s1i_chain_too_short_to_stop_waits_for_more_blocks_before_the_joint() {
    // Two blocks of 5 ms each.
    let mut rig = Rig::new(&settings());
    for n in 0..2_u64 {
        let ends = [n, n + 1].map(|k| vector(&[k as f64 * 0.5]));
        let mut profile = crate::rig::line(n + 1, ends[0], ends[1], 100.0, 0.0);
        profile.exact_stop = false;
        if let Law::Ramped { place, .. } = &mut profile.law {
            let ends_s = (n + 1) as f64 * 0.005;
            let first_segment = 1;
            *place = ChainPlace {
                first_segment,
                ends_s,
            };
        }
        rig.push(profile);
    }
    assert_eq!(rig.cycles(100), []);
    close(rig.x(), 0.0);
    // With this block the chain ends at rest.
    rig.push(crate::rig::line(3, vector(&[1.0]), vector(&[1.5]), 100.0, 0.0));
    rig.until(is_finished(3));
    close(rig.x(), 1.5);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn s1i_hold_resume_and_override_never_leave_the_path_of_arcs_and_blends(
        controls in prop::collection::vec((0_u32..250, prop_oneof![
            Just(Control::Hold),
            Just(Control::Resume),
            (0.0..2.0).prop_map(|feed| Control::Override { feed, rapid: 1.0 }),
        ]), 0..12),
    ) {
        let profiles = chain();
        let mut rig = Rig::new(&settings());
        for profile in &profiles {
            rig.push(profile.clone());
        }
        let mut cycle = 0;
        let check = |rig: &mut Rig, cycle: &mut u32| {
            rig.cycle();
            *cycle += 1;
            let at = rig.position();
            // Only every third cycle is checked, because the search takes long.
            if cycle.is_multiple_of(3) {
                let off = at.minus(position_at_x(&profiles, at[Axis::X])).orthogonal_length();
                prop_assert!(off < 1e-9, "{off} off at {at:?}");
            }
            Ok(())
        };
        for (wait, control) in controls {
            rig.control(control);
            for _ in 0..=wait {
                check(&mut rig, &mut cycle)?;
            }
        }
        rig.control(Control::Resume);
        rig.control(Control::Override { feed: 1.0, rapid: 1.0 });
        for _ in 0..300 {
            check(&mut rig, &mut cycle)?;
        }
        rig.cycles(6000);
        prop_assert_eq!(rig.position(), vector(&[130.0, 0.0, 0.0]));
    }

    #[test]
    fn s1i_a_stop_within_a_chain_ends_on_its_path(wait in 1_u32..2000, feed in 0.1..2.0) {
        let profiles = chain();
        let mut rig = Rig::new(&settings());
        rig.control(Control::Override { feed, rapid: 1.0 });
        for profile in &profiles {
            rig.push(profile.clone());
        }
        rig.cycles(wait);
        rig.control(Control::Stop { epoch: 1 });
        let events = rig.cycles(500);
        let stopped = events.iter().any(|event| matches!(event, Event::Stopped { epoch: 1, .. }));
        prop_assert!(stopped);
        let at = rig.position();
        prop_assert!(at.minus(position_at_x(&profiles, at[Axis::X])).orthogonal_length() < 1e-9);
    }
}

#[test]
fn s1i_single_block_in_a_chain_rests_on_the_path_behind_the_joint() {
    let profiles = chain();
    let mut rig = Rig::new(&settings());
    for profile in profiles.clone() {
        rig.push(profile);
    }
    let end = profiles[profiles.len() - 1].end_position();
    let ends = profiles.iter().scan(0.0, |end_s, profile| {
        *end_s += profile.duration_s;
        Some(*end_s)
    });
    let mut rests = 0;
    for joint_s in ends {
        let joint = position(&profiles, joint_s)[Axis::X];
        // The deceleration of the previous hold may have passed short blocks.
        if joint <= rig.x() {
            continue;
        }
        rig.control(Control::Resume);
        rig.control(Control::HoldAfterBlock(true));
        rig.until(|event| matches!(event, Event::Held { .. }));
        rests += 1;
        let on_path = position_at_x(&profiles, rig.x());
        for axis in [Axis::X, Axis::Y, Axis::Z] {
            close(rig.position()[axis], on_path[axis]);
        }
        // At most half of the hold's slew after the joint, at 100 percent.
        let behind = position(&profiles, joint_s + 0.1 + T)[Axis::X];
        assert!(
            (joint..=behind).contains(&rig.x()),
            "{} is not {joint} to {behind}",
            rig.x()
        );
    }
    assert!(rests > 3);
    assert_eq!(rig.position(), end);
}

/// Returns the largest acceleration of X, Y and Z in the second differences of setpoints.
fn most_acceleration(points: &[AxisVector]) -> f64 {
    let second = |three: &[AxisVector]| three[2].minus(three[1]).minus(three[1].minus(three[0]));
    points
        .windows(3)
        .flat_map(|three| Axis::ORTHOGONAL.map(|axis| second(three)[axis].abs() / (T * T)))
        .fold(0.0, f64::max)
}

#[test]
fn m1i2_holds_and_overrides_add_no_acceleration_to_that_of_g501() {
    // At 100 mm/s with ramps of 0.1 s the chain accelerates with about 2000 mm/s^2; a hold in 5 ms would need 20,000.
    for limit in [500.0, 1500.0, 5000.0] {
        let mut settings = CoordinateSystemSettings {
            hold_slew_ms: 5.0,
            override_slew_ms: 5.0,
            ..settings()
        };
        for motor in settings.motors.iter_mut().flatten() {
            motor.max_acceleration = limit;
        }
        let run = |at: Option<u32>| {
            let mut rig = Rig::new(&settings);
            for profile in chain() {
                rig.push(profile);
            }
            let mut points = Vec::new();
            for cycle in 0..6000 {
                match at.map(|at| i64::from(cycle) - i64::from(at)) {
                    Some(0) => rig.control(Control::Hold),
                    Some(400) => rig.control(Control::Resume),
                    Some(500) => rig.control(Control::Override {
                        feed: 0.3,
                        rapid: 1.0,
                    }),
                    Some(700) => rig.control(Control::Override {
                        feed: 1.0,
                        rapid: 1.0,
                    }),
                    _ => {}
                }
                rig.cycle();
                points.push(rig.position());
            }
            assert_eq!(rig.position(), vector(&[130.0, 0.0, 0.0]), "{limit} {at:?}");
            points
        };
        let undisturbed = most_acceleration(&run(None)).max(limit);
        for at in (0..1500).step_by(37) {
            let found = most_acceleration(&run(Some(at)));
            // The setpoints of the undisturbed run need not meet its largest acceleration.
            let most = undisturbed * (1.0 + 2e-3);
            assert!(found <= most, "{limit}: {found} above {most} after {at} cycles");
        }
    }
}
