//! Back trace: backward motion along blocks with G500, and forward motion from its end (M1d, M1e, M1i).

use std::collections::VecDeque;

use proptest::prelude::*;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{PathPlace, Profile};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{ArcPath, AxisVector};
use tandem_motion::Planner;
use tandem_servo::{Control, Splice, profile_queue};

use crate::look_ahead::{BlockDistance, Feeds, feeds, is_fault, jerks, machine, soft_machine, ways};
use crate::planned::Machine;
use crate::rig::{close, origin, vector};
use crate::splice::slow_feed;

/// A block of a program.
#[derive(Debug, Clone)]
enum Step {
    Line(f64, f64),
    /// A half circle.
    Arc(f64, f64),
    Rapid([f64; 3]),
    Dwell(f64),
}

/// Creates blocks, each with a flag: true if the block always ends at rest.
fn steps() -> impl Strategy<Value = Vec<(Step, bool)>> {
    let way = |most: f64| {
        let way = (-most..most, -most..most);
        way.prop_filter("moves", |(x, y): &(f64, f64)| x.hypot(*y) > 1e-4)
    };
    let rapid = prop_oneof![
        prop::array::uniform3(-60.0..60.0),
        prop::array::uniform3(-0.5..0.5)
    ];
    let step = prop_oneof![
        3 => way(20.0).prop_map(|(x, y)| Step::Line(x, y)),
        2 => way(0.1).prop_map(|(x, y)| Step::Line(x, y)),
        1 => way(20.0).prop_map(|(x, y)| Step::Arc(x, y)),
        3 => rapid.prop_map(Step::Rapid),
        1 => (0.0005..0.1).prop_map(Step::Dwell),
    ];
    prop::collection::vec((step, prop::bool::weighted(0.2)), 1..25)
}

fn segments(steps: &[(Step, bool)], feeds: impl Into<Feeds>) -> Vec<Segment> {
    let feeds = feeds.into();
    let mut at = AxisVector::ZERO;
    let mut all = Vec::new();
    for (n, (step, stops)) in steps.iter().enumerate() {
        let from = at;
        let motion = match *step {
            Step::Line(x, y) | Step::Arc(x, y) => {
                at = from.plus(vector(&[x, y]));
                let length = x.hypot(y);
                let path = if let Step::Arc(..) = step {
                    let centre = [from.0[0] + x / 2.0, from.0[1] + y / 2.0];
                    Path::Arc(ArcPath::new(from, at, Plane::Xy, centre, Turn::Clockwise))
                } else {
                    Path::Line { from, to: at, length }
                };
                SegmentMotion::Feed {
                    path,
                    feed: feeds.of(n),
                }
            }
            Step::Rapid(way) => {
                at = from.plus(vector(&way));
                SegmentMotion::Rapid { from, to: at }
            }
            Step::Dwell(dwell_s) => SegmentMotion::Dwell { at, dwell_s },
        };
        let continues = matches!(motion, SegmentMotion::Feed { .. }) && !stops;
        all.push(Segment {
            origin: origin(n as u64 + 1),
            motion,
            end: if continues {
                SegmentEnd::Continuous
            } else {
                SegmentEnd::ExactStop
            },
            multi_block: MultiBlock::On,
            serial: 0,
        });
    }
    all
}

fn running(settings: &CoordinateSystemSettings, segments: &[Segment]) -> Machine {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    for segment in segments {
        planner.push(segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    Machine::of(settings, planner, out)
}

/// Returns true if the motion passes the first position before the second, or rests between them.
fn is_before(one: PathPlace, other: PathPlace) -> bool {
    (one.segment, one.plan_s) <= (other.segment, other.plan_s + 1e-9)
}

impl Machine {
    /// Switches to a plan while at rest, and begins the plan.
    fn turn_round(&mut self, profiles: VecDeque<Profile>) -> Result<(), TestCaseError> {
        self.splice(None, profiles);
        self.rig.control(Control::Resume);
        self.cycles(1);
        prop_assert_eq!(self.settled(), Some(true));
        Ok(())
    }

    /// Runs this number of cycles on the path. In each cycle the position does not move against the
    /// direction.
    fn go(&mut self, cycles: u32, is_backward: bool) -> Result<(), TestCaseError> {
        for _ in 0..cycles {
            let before = self.place();
            self.cycles(1);
            let (off, now) = (self.off_the_path(), self.place());
            prop_assert!(off < 1e-9, "{off} off the path at {now:?}");
            let (first, second) = if is_backward { (now, before) } else { (before, now) };
            prop_assert!(is_before(first, second), "{before:?}, then {now:?}");
        }
        Ok(())
    }

    /// Moves backward from a feed hold for this number of cycles, stops, and then moves forward
    /// again.
    fn back_and_forward(&mut self, cycles: u32) -> Result<(), TestCaseError> {
        let back = self.planner.retrace(self.held_at());
        if !back.is_empty() {
            self.turn_round(back)?;
            self.go(cycles, true)?;
            self.hold();
        }
        let new = self.planner.replan(self.held_at(), true);
        self.turn_round(new.profiles.clone())?;
        self.planner.adopt(new);
        Ok(())
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn back_trace_of_g500_blocks_keeps_path_and_motor_limits_both_directions(
        steps in steps(),
        feed in feeds(),
        acceleration in prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)],
        jerk in jerks(),
        fractions in prop::array::uniform3(0.05..1.0),
        slew_ms in prop_oneof![Just(0.0), Just(50.0), Just(200.0)],
        turns in prop::collection::vec((0_u32..300, 1_u32..300, 0.05..=1.0), 1..8),
    ) {
        let mut settings = soft_machine(acceleration, jerk);
        (settings.hold_slew_ms, settings.override_slew_ms) = (slew_ms, slew_ms);
        for (motor, fraction) in settings.motors.iter_mut().flatten().zip(fractions) {
            (motor.rapid_velocity, motor.rapid_acceleration) = (400.0 * fraction, acceleration);
        }
        let mut machine = running(&settings, &segments(&steps, feed));
        for (forward, backward, rapid) in turns {
            machine.go(forward, false)?;
            machine.hold();
            machine.rig.control(Control::Override { feed: 1.0, rapid });
            machine.back_and_forward(backward)?;
        }
        machine.rig.control(Control::Override { feed: 1.0, rapid: 1.0 });
        for _ in 0..100_000 {
            if machine.rig.servo.channel(0).is_idle() {
                break;
            }
            machine.go(100, false)?;
        }
        let (worst, fastest) = (machine.watch.worst, machine.watch.fastest);
        prop_assert!(worst <= acceleration * (1.0 + 1e-6), "{worst} of {acceleration}");
        prop_assert!(fastest <= 500.0 * (1.0 + 1e-6), "{fastest} of 500");
        prop_assert!(!machine.events.iter().any(is_fault), "{:?}", machine.events);
        prop_assert_eq!(machine.rig.position(), machine.profiles[machine.profiles.len() - 1].end_position());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn back_trace_keeps_the_path_and_limits_and_forward_reaches_the_end(
        ways in ways(),
        feed in feeds(),
        acceleration in prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)],
        turns in prop::collection::vec((0_u32..400, 1_u32..400), 1..5),
    ) {
        let settings = machine(acceleration);
        let last = ways.len() as u64;
        let mut machine = Machine::new(&settings, &ways, feed);
        for (forward, backward) in turns {
            machine.cycles(forward);
            if machine.rig.servo.channel(0).is_idle() {
                break;
            }
            let at = machine.hold();
            let back = machine.planner.retrace(at);
            let begins = machine.rig.position();
            machine.splice(None, back);
            machine.rig.control(Control::Resume);
            for _ in 0..backward {
                machine.cycles(1);
                let off = machine.off_the_path();
                prop_assert!(off < 1e-9, "{off} off the path");
            }
            prop_assert_eq!(machine.settled(), Some(true));
            let at = machine.hold();
            prop_assert!(at.segment <= last, "{begins:?}");
            let new = machine.planner.replan(at, true);
            machine.splice(None, new.profiles.clone());
            machine.planner.adopt(new);
            machine.rig.control(Control::Resume);
            machine.cycles(1);
            prop_assert_eq!(machine.settled(), Some(true));
            machine.events.clear();
        }
        machine.until_finished(last);
        let worst = machine.watch.worst;
        prop_assert!(worst <= acceleration * (1.0 + 1e-6), "{worst} of {acceleration}");
        prop_assert!(!machine.events.iter().any(is_fault), "{:?}", machine.events);
        prop_assert_eq!(machine.rig.position(), machine.profiles[machine.profiles.len() - 1].end_position());
    }
}

#[test]
fn back_trace_ends_at_rest_at_the_begin_of_the_chain_or_at_a_bar() {
    let mut machine = Machine::new(
        &machine(2000.0),
        &[(40.0, 0.0, false), (0.0, 40.0, false)],
        slow_feed(),
    );
    machine.cycles(650);
    let at = machine.hold();
    let back = machine.planner.retrace(at);
    assert!(
        back.iter()
            .all(|profile| profile.exact_stop == (profile.segment == 1))
    );
    machine.splice(None, back);
    machine.rig.control(Control::Resume);
    machine.events.clear();
    machine.until_finished(1);
    assert_eq!(machine.rig.position(), vector(&[0.0, 0.0]));
    machine.planner.forbid_retrace();
    assert_eq!(machine.planner.retrace(at), VecDeque::new());
}

#[test]
fn a_dwell_is_waited_once_in_all_and_not_on_the_way_back() {
    let steps = [
        Step::Line(10.0, 0.0),
        Step::Dwell(0.5),
        Step::Rapid([20.0, 0.0, 0.0]),
    ];
    let mut machine = running(
        &machine(2000.0),
        &segments(&steps.map(|step| (step, false)), slow_feed()),
    );
    let until = |machine: &mut Machine, segment: u64, more: u32| {
        while machine.place().segment < segment {
            machine.cycles(1);
        }
        machine.cycles(more);
        machine.hold()
    };
    let passed = |profiles: &VecDeque<Profile>| -> Vec<(u64, f64)> {
        let of = |profile: &Profile| (profile.segment, profile.duration_s);
        profiles.iter().map(of).collect()
    };
    // After a partial wait: backward motion skips the dwell, forward motion waits the rest.
    let at = until(&mut machine, 2, 200);
    let back = machine.planner.retrace(at);
    assert_eq!(passed(&back)[0], (2, 0.0));
    machine.turn_round(back).unwrap();
    let (begin, new) = (machine.hold(), |machine: &Machine, at| {
        machine.planner.replan(at, true)
    });
    assert_eq!((begin.segment, begin.plan_s), (2, 0.0));
    let forward = new(&machine, begin);
    assert_eq!(forward.profiles[0].segment, 2);
    close(forward.profiles[0].duration_s, 0.5 - at.plan_s);
    machine.turn_round(forward.profiles.clone()).unwrap();
    machine.planner.adopt(forward);
    // After the whole wait: motion in both directions skips the dwell.
    let at = until(&mut machine, 3, 50);
    let back = machine.planner.retrace(at);
    assert_eq!(passed(&back)[1], (2, 0.0));
    machine.turn_round(back).unwrap();
    let at = until(&mut machine, 1, 3000);
    assert_eq!(machine.rig.position(), AxisVector::ZERO);
    let forward = new(&machine, at);
    assert!(passed(&forward.profiles).contains(&(2, 0.0)));
    machine.events.clear();
    machine.turn_round(forward.profiles.clone()).unwrap();
    machine.until_finished(3);
    assert_eq!(machine.rig.position(), vector(&[30.0]));
}

#[test]
fn what_is_passed_within_a_rapid_has_the_position_of_its_time() {
    // 200 mm/s at 2000 mm/s^2: X 40 mm takes 0.3 s, Y 10 mm 2 sqrt(10/2000) s.
    let mut settings = machine(2000.0);
    for motor in settings.motors.iter_mut().flatten() {
        (motor.rapid_velocity, motor.rapid_acceleration) = (200.0, 2000.0);
    }
    let mut machine = running(
        &settings,
        &segments(&[(Step::Rapid([40.0, 10.0, 0.0]), false)], slow_feed()),
    );
    machine.cycles(1000);
    let end = PathPlace {
        segment: 1,
        plan_s: f64::INFINITY,
    };
    let back = machine.planner.retrace(end);
    let half_s = (10.0_f64 / 2000.0).sqrt();
    close(back[0].duration_s, 0.3);
    for (t_s, x, y) in [
        (0.0, 40.0, 10.0),
        (0.05, 40.0 - 1000.0 * 0.05 * 0.05, 10.0),
        (
            0.3 - 1.5 * half_s,
            40.0 - 10.0 - 200.0 * (0.2 - 1.5 * half_s),
            10.0 - 250.0 * half_s * half_s,
        ),
        (0.3 - half_s, 1000.0 * half_s * half_s, 5.0),
        (0.3, 0.0, 0.0),
    ] {
        let position = back[0].position(t_s);
        close(position.0[0], x);
        close(position.0[1], y);
    }
    assert_eq!(back[0].target(), AxisVector::ZERO);
}

/// Passes these paths, and returns through a ring with this room that is refilled once in this number of
/// cycles.
fn go_back_through_a_ring(
    settings: &CoordinateSystemSettings,
    ways: &[BlockDistance],
    feeds: impl Into<Feeds>,
    room: usize,
    every: u32,
) -> Result<Machine, TestCaseError> {
    let mut machine = Machine::new(settings, ways, feeds);
    machine.until_finished(ways.len() as u64);
    machine.rig.control(Control::Hold);
    machine.cycles(2);
    let mut back = machine.planner.retrace(machine.place());
    let (mut ring, profiles) = profile_queue(room);
    let splice = Splice { at: None, profiles };
    machine.rig.handle.splices.push(splice).unwrap();
    machine.rig.control(Control::Splice);
    machine.rig.control(Control::Resume);
    for cycle in 0..400_000 {
        if cycle % every == 0 {
            while ring.slots() > 0
                && let Some(profile) = back.pop_front()
            {
                ring.push(profile).unwrap();
            }
        }
        machine.go(1, true)?;
        prop_assert!(!machine.events.iter().any(is_fault), "{:?}", machine.events);
        if back.is_empty() && machine.rig.servo.channel(0).is_idle() {
            break;
        }
    }
    prop_assert_eq!(machine.rig.position(), AxisVector::ZERO);
    Ok(machine)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn m1d_a_way_back_that_comes_late_or_through_a_short_ring_never_runs_out(
        ways in ways(),
        feed in feeds(),
        acceleration in prop_oneof![Just(300.0), Just(2000.0), Just(10_000.0)],
        jerk in jerks(),
        room in prop_oneof![Just(4_usize), Just(16), Just(64)],
        every in prop_oneof![Just(1_u32), Just(5), Just(50)],
    ) {
        let settings = soft_machine(acceleration, jerk);
        let machine = go_back_through_a_ring(&settings, &ways, feed, room, every)?;
        let worst = machine.watch.worst;
        prop_assert!(worst <= acceleration * (1.0 + 1e-6), "{worst} of {acceleration}");
    }
}

#[test]
fn m1d_back_trace_with_nanoseconds_of_motion_in_the_ring_reaches_its_end() {
    // 376 profiles per block; the shortest of them takes 0.2 ns.
    let (acceleration, jerk) = (2000.0, 4000.0);
    let feed = SegmentFeed {
        feedrate_mm_min: 600.0,
        ta_ms: 0.0,
        td_ms: 0.0,
        ts_ms: 0.0,
        ..SegmentFeed::default()
    };
    let settings = soft_machine(acceleration, Some(jerk));
    let machine = go_back_through_a_ring(&settings, &[(1e-5, 0.0, false); 2], feed, 4, 1).unwrap();
    assert!(machine.watch.worst <= acceleration);
}
