//! The servo cycle calls no allocator in any of its states.

#![allow(clippy::unwrap_used, reason = "tests fail by panicking")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::collections::VecDeque;

use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion, TapLeg};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::{
    ChainPlace, Law, Lead, MotorLimits, MotorMove, PathPlace, Profile, RampedMotion, Stretch,
};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings, SimulatedSkip};
use tandem_model::{AXES_MAX, ArcPath, Axis, AxisVector, Origin};
use tandem_motion::Planner;
use tandem_servo::{
    ChannelHandle, Command, Control, CycleResult, DriveBus, Event, Fault, Feedback, Hardware, Servo,
    SpindleDirection, Splice, profile_queue,
};

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator, which counts each call from this thread.
struct CountingAllocator;

fn count() {
    CALLS.with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every method hands its arguments unchanged to the system's allocator, whose contract is this one's; the
// count is a thread-local cell without a destructor, so counting neither allocates nor can fail.
#[allow(
    unsafe_code,
    reason = "a global allocator can only be written with unsafe; it exists in this test only"
)]
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: the pointer came from `alloc` above, so from the system's allocator.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

const T: f64 = 0.001;

fn motor(number: u16) -> MotorSettings {
    MotorSettings {
        in_position_timeout_ms: 100.0,
        lag_ms: 5.0,
        ..MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
    }
}

fn settings(spindle: bool) -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        motors: std::array::from_fn(|_| Some(motor(1))),
        spindle: spindle.then(|| motor(9)),
        hold_slew_ms: 20.0,
        servo_period_s: T,
        ..CoordinateSystemSettings::default()
    }
}

fn servo<const N: usize>(systems: [(&CoordinateSystemSettings, usize); N]) -> (Servo, [ChannelHandle; N]) {
    let (servo, handles) = Servo::simulated(&systems, T);
    (servo, handles.try_into().unwrap())
}

/// Creates a line, rapid or dwell in turn, each 50 ms long, from X 0 to X 1 and back.
fn profile(n: u64) -> Profile {
    let (from, to) = (AxisVector::ZERO, AxisVector([1.0; AXES_MAX]));
    let ramp = UnitRamp::new(0.01, 0.01);
    let law = match n % 3 {
        0 => Law::Ramped {
            block: RampedMotion {
                path: Path::Line {
                    from,
                    to,
                    length: 1.0,
                },
                speed: 1.0 / 0.03,
                start: ramp,
                stop: ramp,
                begun_s: 0.0,
                next: None,
                plan_s: 0.05,
            },
            place: ChainPlace {
                first_segment: n + 1,
                ends_s: 0.05,
            },
        },
        1 => {
            let stretch = Stretch::whole(0.05);
            Law::Rest { at: to, stretch }
        }
        _ => {
            let back = MotorMove {
                velocity: -1.0 / 0.03,
                ramp_s: 0.02,
                jerk_s: 0.005,
                cruise_s: 0.01,
            };
            Law::Motors {
                from: to,
                to: from,
                moves: [back; AXES_MAX],
                stretch: Stretch::whole(0.05),
            }
        }
    };
    Profile {
        segment: n + 1,
        epoch: 0,
        origin: Origin::default(),
        law,
        duration_s: 0.05,
        exact_stop: n % 3 != 1,
    }
}

/// Runs cycles, and returns the number of allocator calls during them.
fn cycles(servo: &mut Servo, n: u32) -> u64 {
    let before = CALLS.with(Cell::get);
    for _ in 0..n {
        servo.cycle();
    }
    CALLS.with(Cell::get) - before
}

/// Returns a G500 chain with corners.
fn paced() -> Vec<Profile> {
    let mut planner = tandem_motion::Planner::new(&settings(false));
    let mut out = std::collections::VecDeque::new();
    for n in 0..200_u32 {
        let at = |n: u32| AxisVector([f64::from(n), f64::from(n % 2), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let (from, to) = (at(n), at(n + 1));
        let segment = Segment {
            origin: Origin::default(),
            motion: SegmentMotion::Feed {
                path: Path::Line {
                    from,
                    to,
                    length: 2.0_f64.sqrt(),
                },
                feed: SegmentFeed {
                    feedrate_mm_min: 12_000.0,
                    ta_ms: 20.0,
                    td_ms: 20.0,
                    ts_ms: 0.0,
                    ..SegmentFeed::default()
                },
            },
            end: SegmentEnd::Continuous,
            multi_block: MultiBlock::On,
            serial: 0,
        };
        planner.push(&segment, &mut out).unwrap();
    }
    planner.flush(&mut out);
    out.into()
}

#[test]
fn a_g500_chain_with_holds_and_overrides_neither_allocates_nor_frees() {
    let (mut servo, [mut handle]) = servo([(&settings(false), 4096)]);
    let profiles = paced();
    assert!(
        profiles
            .iter()
            .any(|profile| matches!(profile.law, Law::Paced { .. }))
    );
    for profile in profiles {
        handle.profiles.push(profile).unwrap();
    }
    for n in 0..60 {
        let feed = 0.3 + 0.01 * f64::from(n);
        for control in [
            Control::Hold,
            Control::Resume,
            Control::Override { feed, rapid: 1.0 },
        ] {
            handle.controls.push(control).unwrap();
            assert_eq!(cycles(&mut servo, 40), 0);
            while handle.events.pop().is_ok() {}
        }
    }
    assert!(servo.channel(0).setpoint().0[0] > 10.0);
}

/// A bus that loses every frame from a cycle on. Then it works again with a fault in a drive, which ends when
/// it is cleared.
#[derive(Debug, Default)]
struct FailingBus {
    cycles: u32,
}

impl DriveBus for FailingBus {
    fn exchange(&mut self, commands: &[Command], feedback: &mut [Feedback]) -> CycleResult {
        self.cycles += 1;
        if (20..30).contains(&self.cycles) {
            return CycleResult::Lost;
        }
        for (command, feedback) in commands.iter().zip(&mut *feedback) {
            let fault = u16::from(self.cycles == 30 || feedback.fault != 0 && !command.clear_fault);
            *feedback = Feedback {
                fault,
                ..Feedback::following(command.position)
            };
        }
        CycleResult::Late
    }
}

#[test]
fn a_lost_bus_a_drive_fault_and_a_reset_neither_allocate_nor_free() {
    let hardware = Hardware {
        bus: Box::new(FailingBus::default()),
        at_start: vec![Feedback::following(0.0); AXES_MAX],
        spindles: vec![],
    };
    let (mut servo, mut handles) = Servo::new(&[(&settings(false), 64)], T, hardware);
    let handle = &mut handles[0];
    handle.profiles.push(profile(0)).unwrap();
    let mut calls = cycles(&mut servo, 60);
    for control in [Control::ResetDrives, Control::Stop { epoch: 1 }] {
        handle.controls.push(control).unwrap();
    }
    calls += cycles(&mut servo, 60);
    assert_eq!(calls, 0, "calls of the allocator");
    let events: Vec<Event> = std::iter::from_fn(|| handle.events.pop().ok()).collect();
    assert!(
        matches!(
            events[..],
            [
                Event::Started { .. },
                Event::Fault(Fault::BusLost { cycles: 3 }),
                Event::Stopped { .. },
            ]
        ),
        "{events:?}"
    );
    assert_eq!(servo.bus_counts().lost, 10);
}

#[test]
fn the_servo_cycle_neither_allocates_nor_frees() {
    let (mut servo, [mut handle, mut other]) = servo([(&settings(true), 64), (&settings(false), 64)]);
    for n in 0..60 {
        handle.profiles.push(profile(n)).unwrap();
    }
    let controls = [
        Control::Override {
            feed: 0.7,
            rapid: 0.5,
        },
        Control::Hold,
        Control::Resume,
        Control::Spindle {
            direction: SpindleDirection::Cw,
            rpm: 300.0,
        },
        Control::Spindle {
            direction: SpindleDirection::Orient,
            rpm: 0.0,
        },
        Control::Stop { epoch: 1 },
        Control::Abort { epoch: 2 },
    ];
    let mut calls = 0;
    for control in controls {
        handle.controls.push(control).unwrap();
        // In the second channel, which has no spindle, the spindle commands and the jump of the second
        // profile are faults.
        other.controls.push(control).unwrap();
        other.profiles.push(profile(1)).unwrap();
        calls += cycles(&mut servo, 500);
    }
    assert_eq!(calls, 0, "calls of the allocator");

    // The test has reached all intended states.
    let events: Vec<Event> = std::iter::from_fn(|| handle.events.pop().ok()).collect();
    let some = |wanted: fn(&Event) -> bool| events.iter().any(wanted);
    assert!(some(|event| matches!(event, Event::Finished { .. })));
    assert!(some(|event| matches!(event, Event::Held { .. })));
    assert!(some(|event| matches!(event, Event::Oriented)));
    assert!(some(|event| matches!(event, Event::Stopped { epoch: 2, .. })));
    let faults =
        std::iter::from_fn(|| other.events.pop().ok()).filter(|event| matches!(event, Event::Fault(_)));
    assert!(faults.count() >= 2);
    drop(Box::new(0_u8));
    assert!(CALLS.with(Cell::get) > 0, "the allocator counts");
}

/// Returns moves in which only Y moves, by this distance in mm.
fn y_alone(way: f64) -> [MotorMove; AXES_MAX] {
    let limits = MotorLimits {
        velocity: 50.0,
        acceleration: 5000.0,
        jerk: None,
    };
    let mut moves = [MotorMove::default(); AXES_MAX];
    moves[1] = MotorMove::shortest(way, limits);
    moves
}

/// Returns a line, then a spiral, and a G31 of Y back from the end of the spiral, with their durations.
fn chain_and_skip() -> [(Law, f64); 4] {
    let point = |x, y| AxisVector([x, y, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let (corner, end) = (point(1.0, 0.0), point(1.5, 2.5));
    let arc = Path::Arc(ArcPath::new(
        corner,
        end,
        Plane::Xy,
        [1.5, 1.0],
        Turn::CounterClockwise,
    ));
    let (speed, ramp) = (1.0 / 0.03, UnitRamp::new(0.01, 0.01));
    let line = Path::Line {
        from: AxisVector::ZERO,
        to: corner,
        length: 1.0,
    };
    let (back, moves) = (y_alone(-2.5), y_alone(1.0));
    let ramped = |path: &Path, begun_s, next: Option<&Path>, plan_s, ends_s| Law::Ramped {
        block: RampedMotion {
            path: path.clone(),
            speed,
            start: ramp,
            stop: ramp,
            begun_s,
            next: next.map(|path| Lead {
                path: path.clone(),
                speed,
            }),
            plan_s,
        },
        place: ChainPlace {
            first_segment: 1,
            ends_s,
        },
    };
    let arc_s = arc.length() / speed;
    [
        (ramped(&line, 0.0, Some(&arc), 0.05, 0.05), 0.05),
        (ramped(&arc, 0.02, None, arc_s, 0.05 + arc_s), arc_s),
        (
            Law::Motors {
                from: end,
                to: point(1.5, 0.0),
                moves: back,
                stretch: Stretch::whole(back[1].duration_s()),
            },
            back[1].duration_s(),
        ),
        (
            Law::Skip {
                from: point(1.5, 0.0),
                to: point(1.5, 1.0),
                moves,
            },
            moves[1].duration_s(),
        ),
    ]
}

#[test]
fn blended_blocks_arcs_and_skip_inputs_neither_allocate_nor_free() {
    let mut settings = settings(false);
    settings.motion.simulated_skip[1] = Some(SimulatedSkip::Above(0.5));
    let (mut servo, [mut handle]) = servo([(&settings, 64)]);
    for ((law, duration_s), segment) in chain_and_skip().into_iter().zip(1..) {
        let profile = Profile {
            segment,
            epoch: 0,
            origin: Origin::default(),
            law,
            duration_s,
            exact_stop: segment != 1,
        };
        handle.profiles.push(profile).unwrap();
    }
    assert_eq!(cycles(&mut servo, 1000), 0, "calls of the allocator");
    let events: Vec<Event> = std::iter::from_fn(|| handle.events.pop().ok()).collect();
    assert!(
        !events.iter().any(|event| matches!(event, Event::Fault(_))),
        "{events:?}"
    );
    let captured = events.iter().any(|event| {
        matches!(event, Event::Captured { position, captured, .. }
            if captured.contains(Axis::Y) && (position.0[Axis::Y] - 0.5).abs() < 1e-12)
    });
    assert!(captured, "{events:?}");
}

#[test]
fn a_thread_neither_allocates_nor_frees() {
    let (mut servo, [mut handle]) = servo([(&settings(true), 64)]);
    let (top, bottom) = (AxisVector::ZERO, AxisVector([-1.0; AXES_MAX]));
    let ramp = UnitRamp::new(0.01, 0.01);
    let way = |from, to, revolutions, leg| Law::Tap {
        from,
        to,
        rate: 1.0 / 0.03,
        start: ramp,
        stop: ramp,
        revolutions,
        leg,
    };
    let laws = [
        way(top, bottom, 0.1, TapLeg::In),
        Law::Rest {
            at: bottom,
            stretch: Stretch::whole(0.05),
        },
        way(bottom, top, -0.1, TapLeg::Out),
        way(top, bottom, 0.1, TapLeg::In),
    ];
    for (law, segment) in laws.into_iter().zip(1..) {
        let profile = Profile {
            segment,
            epoch: 0,
            origin: Origin::default(),
            law,
            duration_s: 0.05,
            exact_stop: true,
        };
        handle.profiles.push(profile).unwrap();
    }
    let orient = Control::Spindle {
        direction: SpindleDirection::Orient,
        rpm: 0.0,
    };
    handle.controls.push(Control::Hold).unwrap();
    let mut calls = cycles(&mut servo, 10);
    for control in [
        Control::Resume,
        Control::Hold,
        orient,
        Control::Abort { epoch: 1 },
    ] {
        handle.controls.push(control).unwrap();
        calls += cycles(&mut servo, 130);
    }
    assert_eq!(calls, 0, "calls of the allocator");
    let events: Vec<Event> = std::iter::from_fn(|| handle.events.pop().ok()).collect();
    for segment in 1..=3 {
        let finished = |event: &Event| matches!(event, Event::Finished { segment: n, .. } if *n == segment);
        assert!(events.iter().any(finished), "{events:?}");
    }
    assert_eq!(
        events
            .iter()
            .filter(|event| matches!(event, Event::Held { .. }))
            .count(),
        2,
        "{events:?}"
    );
    assert!(!events.iter().any(|event| matches!(event, Event::Fault(_))));
}

/// Plans a rapid, a dwell and two lines of 20 mm along X with G500.
fn either_way(planner: &mut Planner) -> VecDeque<Profile> {
    let at = |x: f64| {
        let mut at = AxisVector::ZERO;
        at.0[0] = x;
        at
    };
    let line = |from_x: f64| SegmentMotion::Feed {
        path: Path::Line {
            from: at(from_x),
            to: at(from_x + 20.0),
            length: 20.0,
        },
        feed: SegmentFeed {
            feedrate_mm_min: 6000.0,
            ta_ms: 50.0,
            td_ms: 50.0,
            ts_ms: 0.0,
            ..SegmentFeed::default()
        },
    };
    let (from, to) = (at(0.0), at(1.0));
    let motions = [
        SegmentMotion::Rapid { from, to },
        SegmentMotion::Dwell {
            at: to,
            dwell_s: 0.01,
        },
        line(1.0),
        line(21.0),
    ];
    let mut planned = VecDeque::new();
    for motion in motions {
        let segment = Segment {
            origin: Origin::default(),
            motion,
            end: SegmentEnd::Continuous,
            multi_block: MultiBlock::On,
            serial: 0,
        };
        planner.push(&segment, &mut planned).unwrap();
    }
    planner.flush(&mut planned);
    planned
}

#[test]
fn another_plan_neither_allocates_nor_frees() {
    let settings = settings(false);
    let (mut servo, [mut handle]) = servo([(&settings, 64)]);
    let mut planner = Planner::new(&settings);
    for profile in either_way(&mut planner) {
        handle.profiles.push(profile).unwrap();
    }
    let splice = |handle: &mut ChannelHandle, at, profiles: VecDeque<Profile>| {
        let (mut ring, consumer) = profile_queue(64);
        for profile in profiles {
            ring.push(profile).unwrap();
        }
        let splice = Splice {
            at,
            profiles: consumer,
        };
        handle.splices.push(splice).unwrap();
        handle.controls.push(Control::Splice).unwrap();
    };
    let mut calls = cycles(&mut servo, 200);
    planner.set_feed_override(2.0);
    handle
        .controls
        .push(Control::Override {
            feed: 2.0,
            rapid: 1.0,
        })
        .unwrap();
    let reading = handle.readings.read();
    let now = PathPlace {
        segment: reading.segment,
        plan_s: reading.plan_s,
    };
    let place = planner.place_ahead(now, 0.03).unwrap();
    let new = planner.replan(place, false);
    splice(&mut handle, Some(place), new.profiles.clone());
    planner.adopt(new);
    calls += cycles(&mut servo, 100);
    handle.controls.push(Control::Hold).unwrap();
    calls += cycles(&mut servo, 400);
    let events: Vec<Event> = std::iter::from_fn(|| handle.events.pop().ok()).collect();
    let held = events.iter().find_map(|event| match event {
        Event::Held { at } => Some(*at),
        _ => None,
    });
    splice(&mut handle, None, planner.retrace(held.unwrap()));
    handle.controls.push(Control::Resume).unwrap();
    calls += cycles(&mut servo, 2000);
    assert_eq!(calls, 0, "calls of the allocator");
    let mut told = events;
    told.extend(std::iter::from_fn(|| handle.events.pop().ok()));
    let taken = told
        .iter()
        .filter(|event| matches!(event, Event::Spliced { taken: true }));
    assert_eq!(taken.count(), 2, "{told:?}");
    assert_eq!(servo.channel(0).setpoint(), AxisVector::ZERO);
}
