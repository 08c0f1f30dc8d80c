//! The motors of a channel: their places on the bus, actual positions, in-position check.

use std::ops::Range;

use tandem_model::profile::{MotorLimits, Profile};
use tandem_model::settings::{CoordinateSystemSettings, SimulatedRound, SimulatedSkip};
use tandem_model::{AXES_MAX, Axis, AxisSet, AxisVector};

use crate::brake::or_unlimited;
use crate::bus::{Command, DriveBus, Feedback};
use crate::control::Fault;

/// Largest distance between the machine and the start of a profile from rest, mm or degrees. A smaller
/// distance is rounding of the preceding stages, a larger distance is a jump.
const JUMP_MAX: f64 = 1e-6;

/// One motor.
#[derive(Debug)]
struct Motor {
    number: u16,
    in_position: f64,
    timeout_s: f64,
    /// True if the skip input is on by [`Control::SkipInput`](crate::Control::SkipInput).
    skip_is_set: bool,
    simulated_skip: Option<SimulatedSkip>,
    /// Limits of the return move to a captured position.
    skip_limits: MotorLimits,
}

#[derive(Debug)]
pub(crate) struct Motors {
    axes: [Option<Motor>; AXES_MAX],
    deceleration: [f64; AXES_MAX],
    /// `max_jerk` of each motor; infinite without a limit.
    jerk: [f64; AXES_MAX],
    has_jerk: bool,
    /// The axes with a motor, by the motor's place on the bus, then the axes without a motor.
    by_place: [Axis; AXES_MAX],
    with_motor: AxisSet,
    /// Object that a simulated probe touches.
    round: Option<SimulatedRound>,
    /// Places of the motors on the bus.
    places: Range<usize>,
    is_ideal: bool,
    actual: AxisVector,
    /// Axes whose motor position refers to the machine's zero.
    homed: AxisSet,
    settled: bool,
    /// Fault that prevents the motors from following. `None` if all motors follow.
    trouble: Option<Fault>,
}

impl Motors {
    /// Creates motors at their reported positions, with consecutive places on the bus from `first_place` on.
    /// An axis without a motor is at 0, follows its command ideally and is not checked.
    pub(crate) fn new(
        settings: &CoordinateSystemSettings,
        first_place: usize,
        bus: &dyn DriveBus,
        feedback: &[Feedback],
    ) -> Self {
        let axes = std::array::from_fn(|i| {
            let motor = settings.motors[i].as_ref()?;
            Some(Motor {
                number: motor.number,
                in_position: motor.in_position,
                timeout_s: motor.in_position_timeout_ms / 1000.0,
                skip_is_set: false,
                simulated_skip: settings.motion.simulated_skip[i],
                skip_limits: MotorLimits {
                    velocity: motor.skip_velocity,
                    acceleration: motor.rapid_acceleration,
                    jerk: motor.max_jerk,
                }
                .with_reserve(),
            })
        });
        let deceleration = std::array::from_fn(|i| {
            settings.motors[i]
                .as_ref()
                .map_or(0.0, |motor| motor.max_acceleration)
        });
        let mut by_place = Axis::ALL;
        by_place.sort_by_key(|axis| settings.motors[axis.index()].is_none());
        let places = first_place..first_place + settings.motors.iter().flatten().count();
        let mut with_motor = AxisSet::EMPTY;
        for axis in &by_place[..places.len()] {
            with_motor.insert(*axis);
        }
        let mut motors = Self {
            axes,
            by_place,
            with_motor,
            deceleration,
            has_jerk: settings
                .motors
                .iter()
                .flatten()
                .any(|motor| motor.max_jerk.is_some()),
            jerk: settings.motors.each_ref().map(|motor| {
                let jerk = motor.as_ref().and_then(|motor| motor.max_jerk);
                jerk.map_or(f64::INFINITY, or_unlimited)
            }),
            round: settings.motion.simulated_round,
            is_ideal: places.clone().all(|place| bus.is_ideal(place)),
            places,
            actual: AxisVector::ZERO,
            homed: AxisSet::EMPTY,
            settled: false,
            trouble: None,
        };
        motors.take_feedback(feedback);
        motors.settled = false;
        motors
    }

    /// Writes the command of each motor: its position, and the fields common to all motors. An axis without a
    /// motor is at its command.
    pub(crate) fn command(&mut self, setpoint: AxisVector, of_all: Command, commands: &mut [Command]) {
        let commands = commands.get_mut(self.places.clone()).unwrap_or_default();
        let (with_motor, without_motor) = self.by_place.split_at(commands.len());
        for (command, axis) in commands.iter_mut().zip(with_motor) {
            *command = Command {
                position: setpoint[*axis],
                ..of_all
            };
        }
        for axis in without_motor {
            self.actual[*axis] = setpoint[*axis];
        }
    }

    /// Processes the reports of the motors.
    pub(crate) fn take_feedback(&mut self, feedback: &[Feedback]) {
        let feedback = feedback.get(self.places.clone()).unwrap_or_default();
        let (mut changed, mut are_operational) = (0, true);
        for (axis, feedback) in self.by_place.iter().zip(feedback) {
            let actual = &mut self.actual[*axis];
            changed |= actual.to_bits() ^ feedback.position.to_bits();
            *actual = feedback.position;
            are_operational &= feedback.is_operational();
        }
        let homed = if are_operational {
            self.with_motor
        } else {
            self.find_homed(feedback)
        };
        self.settled = changed == 0 && homed == self.homed;
        self.homed = homed;
        self.trouble = None;
        if !are_operational {
            self.trouble = self.find_trouble(feedback);
        }
    }

    #[cold]
    fn find_homed(&self, feedback: &[Feedback]) -> AxisSet {
        let mut homed = AxisSet::EMPTY;
        for (axis, feedback) in self.by_place.iter().zip(feedback) {
            if feedback.is_homed {
                homed.insert(*axis);
            }
        }
        homed
    }

    /// Returns the most serious fault: a fault of a drive, then a motor that is not homed, then a drive
    /// without power.
    #[cold]
    fn find_trouble(&self, feedback: &[Feedback]) -> Option<Fault> {
        let motors = self.by_place.iter().zip(feedback);
        let faults = motors.filter_map(|(&axis, feedback)| {
            let motor = self.number(axis);
            if feedback.fault == 0 && !feedback.is_homed {
                Some((1, Fault::NotHomed { motor, axis }))
            } else {
                let rank = if feedback.fault == 0 { 2 } else { 0 };
                let fault = Fault::from_drive(motor, Some(axis), feedback.is_enabled, feedback.fault)?;
                Some((rank, fault))
            }
        });
        faults.min_by_key(|(rank, _)| *rank).map(|(_, fault)| fault)
    }

    /// Returns true if every motor is homed and follows its commanded position.
    pub(crate) fn are_operational(&self) -> bool {
        self.trouble.is_none()
    }

    /// Returns the fault that prevents the motors from following their commanded positions: a lost bus first,
    /// then the fault of a motor.
    pub(crate) fn trouble(&self, bus_lost: Option<u32>) -> Option<Fault> {
        let lost = bus_lost.map(|cycles| Fault::BusLost { cycles });
        lost.or(self.trouble)
    }

    /// Returns the fault of a motor outside its in-position window. Such a motor would jump when its drive is
    /// enabled.
    pub(crate) fn elsewhere(&self, setpoint: AxisVector) -> Option<Fault> {
        let (motor, axis, jump) = self.outside(setpoint).next()?;
        let motor = motor.number;
        Some(Fault::PositionJump { motor, axis, jump })
    }

    /// Returns true if in the last cycle no motor moved, was homed or lost its reference. A drive may settle
    /// one bit away from its command; with the same command it then stays there.
    pub(crate) fn has_settled(&self) -> bool {
        self.settled
    }

    /// Returns true if each motor is always at its command, without lag.
    pub(crate) fn are_ideal(&self) -> bool {
        self.is_ideal
    }

    pub(crate) fn actual(&self) -> AxisVector {
        self.actual
    }

    /// Returns the axes whose motor position refers to the machine's zero.
    pub(crate) fn homed(&self) -> AxisSet {
        self.homed
    }

    /// Returns the `max_acceleration` of each motor.
    pub(crate) fn deceleration(&self) -> [f64; AXES_MAX] {
        self.deceleration
    }

    /// Returns true if a motor has a `max_jerk`.
    pub(crate) fn has_jerk(&self) -> bool {
        self.has_jerk
    }

    /// Returns the `max_jerk` and the `max_acceleration` of the motor of an axis; infinite without a limit.
    pub(crate) fn limits_of(&self, axis: usize) -> [f64; 2] {
        [self.jerk[axis], or_unlimited(self.deceleration[axis])]
    }

    /// Sets the skip input of a motor, as commanded by the coordinator.
    pub(crate) fn set_skip_input(&mut self, motor: u16, on: bool) {
        for axis in self.axes.iter_mut().flatten().filter(|axis| axis.number == motor) {
            axis.skip_is_set = on;
        }
    }

    /// Returns the captured position and the limits of the return move if the axis's skip input is on,
    /// otherwise `None`. An input set by the coordinator captures the actual position. A simulated input
    /// captures its threshold, or the actual position with `at_once`.
    pub(crate) fn skip(&self, axis: Axis, at_once: bool) -> Option<(f64, MotorLimits)> {
        let motor = self.axes[axis.index()].as_ref()?;
        let actual = self.actual[axis];
        if motor.skip_is_set {
            return Some((actual, motor.skip_limits));
        }
        let input = motor.simulated_skip.filter(|input| input.is_on(actual));
        let threshold = input
            .map(SimulatedSkip::threshold)
            .or_else(|| self.touched(axis))?;
        let position = if at_once { actual } else { threshold };
        Some((position, motor.skip_limits))
    }

    /// Returns the position of the axis at contact with the object that a simulated probe touches.
    fn touched(&self, axis: Axis) -> Option<f64> {
        let place = [Axis::X, Axis::Y].iter().position(|one| *one == axis)?;
        let at = [Axis::X, Axis::Y, Axis::Z].map(|axis| self.actual[axis]);
        self.round?.touched(place, at)
    }

    /// Returns the CNC motor number of an axis; 0 if the axis has no motor.
    pub(crate) fn number(&self, axis: Axis) -> u16 {
        self.axes[axis.index()].as_ref().map_or(0, |motor| motor.number)
    }

    /// Returns the motors outside their in-position windows, with their following errors.
    fn outside(&self, command: AxisVector) -> impl Iterator<Item = (&Motor, Axis, f64)> {
        Axis::ALL.into_iter().filter_map(move |axis| {
            let motor = self.axes[axis.index()].as_ref()?;
            let following_error = command[axis] - self.actual[axis];
            let is_inside = following_error.abs() <= motor.in_position;
            (!is_inside).then_some((motor, axis, following_error))
        })
    }

    /// Returns true if every motor is in position, `waited_s` after the end of the commanded motion. Returns
    /// an error if a motor exceeds its time limit.
    pub(crate) fn in_position(&self, command: AxisVector, waited_s: f64) -> Result<bool, Fault> {
        let late = self
            .outside(command)
            .find(|(motor, ..)| waited_s >= motor.timeout_s);
        match late {
            Some((motor, axis, following_error)) => Err(Fault::InPositionTimeout {
                motor: motor.number,
                axis,
                following_error,
            }),
            None => Ok(self.outside(command).next().is_none()),
        }
    }
}

/// Returns the first axis that would jump if the profile started now, and the size of the jump. The size is
/// NaN if the start or end of the profile is not a number.
pub(crate) fn first_jump(profile: &Profile, setpoint: AxisVector) -> Option<(Axis, f64)> {
    let start = profile.position(0.0);
    let end = profile.end_position();
    Axis::ALL.into_iter().find_map(|axis| {
        let jump = start[axis] - setpoint[axis];
        if !end[axis].is_finite() {
            Some((axis, f64::NAN))
        } else if jump.abs() <= JUMP_MAX {
            None
        } else {
            Some((axis, jump))
        }
    })
}
