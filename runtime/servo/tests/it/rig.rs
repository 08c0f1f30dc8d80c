//! One channel with its handle, and profiles for tests.

use tandem_model::flow::Path;
use tandem_model::profile::{ChainPlace, Law, MotorMove, Profile, RampedMotion, Stretch};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings};
use tandem_model::{AXES_MAX, AxisVector, Origin};
use tandem_servo::{ChannelHandle, Control, DriveBus, Event, Feedback, Hardware, Reading, Servo};

/// Servo period of the tests, s.
pub const T: f64 = 0.001;

pub fn motor(number: u16) -> MotorSettings {
    MotorSettings::new(number, MotorKind::Linear, 500.0, 5000.0)
}

/// Returns a spindle: 4000 r/min at most, 1000 r/min per second, orientation at 60 r/min to 90 degrees.
pub fn spindle() -> MotorSettings {
    MotorSettings {
        orientation_velocity: 60.0,
        orientation_position: 90.0,
        ..MotorSettings::new(5, MotorKind::Spindle, 4000.0, 1000.0)
    }
}

/// Returns settings with motors 11, 12, 13 as X, Y, Z, override slew 1 s, hold slew 0.2 s, and no spindle.
pub fn settings() -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        motors: std::array::from_fn(|i| (i < 3).then(|| motor([11, 12, 13, 0, 0, 0, 0, 0][i]))),
        servo_period_s: T,
        ..CoordinateSystemSettings::default()
    }
}

pub fn vector(values: &[f64]) -> AxisVector {
    AxisVector(std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0)))
}

pub fn origin(segment: u64) -> Origin {
    Origin {
        program: 5,
        line: u32::try_from(segment).unwrap() + 100,
        column: 1,
    }
}

fn profile(segment: u64, law: Law, duration_s: f64) -> Profile {
    Profile {
        segment,
        epoch: 0,
        origin: origin(segment),
        law,
        duration_s,
        exact_stop: true,
    }
}

/// Creates a line from rest to rest at this speed with trapezoidal ramps of `ta_s`, long enough to reach the
/// speed.
pub fn line(segment: u64, from: AxisVector, to: AxisVector, speed: f64, ta_s: f64) -> Profile {
    let length = to.minus(from).orthogonal_length();
    let ramp = UnitRamp::new(ta_s, 0.0);
    let duration_s = length / speed + ta_s;
    let law = Law::Ramped {
        block: RampedMotion {
            path: Path::Line { from, to, length },
            speed,
            start: ramp,
            stop: ramp,
            begun_s: 0.0,
            next: None,
            plan_s: duration_s,
        },
        place: ChainPlace {
            first_segment: segment,
            ends_s: duration_s,
        },
    };
    profile(segment, law, duration_s)
}

/// Creates a rapid of X alone with velocity 100 and ramps of 0.1 s.
pub fn rapid(segment: u64, from_x: f64, to_x: f64) -> Profile {
    let mut moves = [MotorMove::default(); AXES_MAX];
    moves[0] = MotorMove {
        velocity: 100.0_f64.copysign(to_x - from_x),
        ramp_s: 0.1,
        jerk_s: 0.0,
        cruise_s: (to_x - from_x).abs() / 100.0 - 0.1,
    };
    let law = Law::Motors {
        from: vector(&[from_x]),
        to: vector(&[to_x]),
        moves,
        stretch: Stretch::whole(moves[0].duration_s()),
    };
    profile(segment, law, moves[0].duration_s())
}

pub fn dwell(segment: u64, at: AxisVector, dwell_s: f64) -> Profile {
    let stretch = Stretch::whole(dwell_s);
    profile(segment, Law::Rest { at, stretch }, dwell_s)
}

/// A servo of one channel.
pub struct Rig {
    pub servo: Servo,
    pub handle: ChannelHandle,
}

impl Rig {
    pub fn new(settings: &CoordinateSystemSettings) -> Self {
        Self::with_room(settings, 64)
    }

    /// Creates a rig with room for this number of profiles.
    pub fn with_room(settings: &CoordinateSystemSettings, profiles: usize) -> Self {
        let (servo, mut handles) = Servo::simulated(&[(settings, profiles)], settings.servo_period_s);
        let handle = handles.remove(0);
        Self { servo, handle }
    }

    /// Creates a rig with these drives.
    pub fn on_bus(settings: &CoordinateSystemSettings, bus: impl DriveBus + 'static) -> Self {
        let hardware = Hardware {
            bus: Box::new(bus),
            at_start: vec![Feedback::following(0.0); settings.motors.iter().flatten().count()],
            spindles: vec![],
        };
        let (servo, mut handles) = Servo::new(&[(settings, 64)], settings.servo_period_s, hardware);
        let handle = handles.remove(0);
        Self { servo, handle }
    }

    pub fn push(&mut self, profile: Profile) {
        self.handle.profiles.push(profile).unwrap();
    }

    pub fn control(&mut self, control: Control) {
        self.handle.controls.push(control).unwrap();
    }

    /// Runs one cycle and returns its events.
    pub fn cycle(&mut self) -> Vec<Event> {
        let told = self.servo.cycle();
        let events: Vec<Event> = std::iter::from_fn(|| self.handle.events.pop().ok()).collect();
        assert!(told || events.is_empty());
        events
    }

    pub fn cycles(&mut self, n: u32) -> Vec<Event> {
        (0..n).flat_map(|_| self.cycle()).collect()
    }

    /// Runs cycles until one of them emits such an event; returns the number of cycles.
    pub fn until(&mut self, wanted: impl Fn(&Event) -> bool) -> u32 {
        for n in 1..1_000_000 {
            if self.cycle().iter().any(&wanted) {
                return n;
            }
        }
        panic!("the event never comes");
    }

    pub fn position(&self) -> AxisVector {
        self.servo.channel(0).setpoint()
    }

    pub fn x(&self) -> f64 {
        self.position().0[0]
    }

    pub fn reading(&self) -> Reading {
        self.handle.readings.read()
    }
}

pub fn is_finished(number: u64) -> impl Fn(&Event) -> bool {
    move |event| matches!(event, Event::Finished { segment, .. } if *segment == number)
}

pub fn is_stopped(event: &Event) -> bool {
    matches!(event, Event::Stopped { .. })
}

#[track_caller]
pub fn close(value: f64, expected: f64) {
    assert!((value - expected).abs() < 1e-9, "{value} is not {expected}");
}
