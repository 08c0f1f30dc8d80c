//! A block along a path at feedrate: from rest to rest (M1a), and the parts of it that a chain uses.

use tandem_model::alarm::{VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE, check_finite};
use tandem_model::flow::{MultiBlock, Path, SegmentFeed};
use tandem_model::profile::JERK_RESERVE;
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis, bisect};

use crate::limit::{self, ACCELERATION_RESERVE, USED_WITHIN_JERK};

/// Number of halvings of the range of a peak speed, enough for the last significant bits.
const HALVINGS: u32 = 60;

/// Margin for rounding below the reserve of look-ahead. It prevents look-ahead from slowing a ramp down
/// because of rounding.
const ROUNDING: f64 = 2e-9;

/// A block from rest to rest, outside of any chain.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SingleBlock {
    /// Limited F, path units per second: the speed of a block that is long enough to reach it.
    pub(crate) limit: f64,
    /// Ramp with ta, as programmed.
    pub(crate) start: UnitRamp,
    /// Ramp with td, as programmed.
    pub(crate) stop: UnitRamp,
    /// Limits of the ramps from rest and to rest. With `None`, the ramps are as programmed.
    soft: Option<JerkLimits>,
}

/// The limits of all motors, converted to limits along a line.
#[derive(Debug, Clone, Copy)]
struct JerkLimits {
    /// Maximum acceleration, path units per second squared.
    acceleration: f64,
    /// Maximum jerk, path units per second cubed.
    jerk: f64,
}

impl SingleBlock {
    /// Returns the programmed acceleration and deceleration times, s.
    pub(crate) fn ramps_s(&self) -> [f64; 2] {
        [self.start, self.stop].map(|ramp| 1.0 / ramp.steepest()[0])
    }

    /// Returns the ramps from rest to this speed and from this speed to rest.
    fn ramps(&self, speed: f64) -> [UnitRamp; 2] {
        [self.start_to(speed), self.stop_from(speed)]
    }

    /// Returns the ramp from rest to this speed.
    fn start_to(&self, speed: f64) -> UnitRamp {
        self.soft.map_or(self.start, |soft| soft.ramp(self.start, speed))
    }

    /// Returns the ramp from this speed to rest.
    fn stop_from(&self, speed: f64) -> UnitRamp {
        self.soft.map_or(self.stop, |soft| soft.ramp(self.stop, speed))
    }

    /// Returns the ramp at the start of a chain whose first block takes this time. If the time is too short
    /// for the limits of the motors, returns the ramp of the smallest jerk, at which look-ahead then slows
    /// the motion down. Without a jerk limit, returns the programmed ramp, shortened (rule `shrink`).
    pub(crate) fn start_from_rest(&self, block_s: f64) -> UnitRamp {
        self.within(self.start_to(self.limit), self.start, block_s)
    }

    /// Returns the ramp at the end of a chain, by the rule of [`SingleBlock::start_from_rest`].
    pub(crate) fn stop_to_rest(&self, block_s: f64) -> UnitRamp {
        self.within(self.stop_from(self.limit), self.stop, block_s)
    }

    fn within(&self, longer: UnitRamp, programmed: UnitRamp, block_s: f64) -> UnitRamp {
        if longer.duration_s() <= block_s {
            longer
        } else if self.soft.is_some() {
            UnitRamp::new(block_s / 2.0, block_s / 2.0)
        } else {
            programmed.at_most(block_s)
        }
    }

    /// Returns an upper bound of the duration of [`SingleBlock::rest_to_rest`], s.
    pub(crate) fn duration_s_max(&self, length: f64) -> f64 {
        stop_to_stop(length, self.limit, self.ramps(self.limit)).1
    }

    /// Returns the speed between the ramps, the ramps, and the duration from rest to rest over this length:
    /// `t_end = L/v + (Ta + Td)/2`. If the length is too short to reach v, the speed is the peak at which the
    /// ramps fill the length. Programmed ramps keep their time (rule `extend`); ramps within limits of the
    /// motors are shorter for a lower peak.
    pub(crate) fn rest_to_rest(&self, length: f64) -> (f64, [UnitRamp; 2], f64) {
        let fits = |speed: f64| {
            let [start, stop] = self.ramps(speed);
            speed * f64::midpoint(start.duration_s(), stop.duration_s()) <= length
        };
        let ramps_at = if self.soft.is_some() && !fits(self.limit) {
            bisect([0.0, self.limit], HALVINGS, fits)[1]
        } else {
            self.limit
        };
        let ramps = self.ramps(ramps_at);
        let (speed, duration_s) = stop_to_stop(length, ramps_at, ramps);
        (speed, ramps, duration_s)
    }
}

impl JerkLimits {
    /// Returns the limits along a line. Returns `None` if no moving motor has a maximum jerk, or if the path
    /// is an arc.
    fn along(settings: &CoordinateSystemSettings, path: &Path) -> Result<Option<Self>, Alarm> {
        let mut motors = settings.motors.iter().flatten();
        if motors.all(|motor| motor.max_jerk.is_none()) {
            return Ok(None);
        }
        let mut soft = Self {
            acceleration: f64::INFINITY,
            jerk: f64::INFINITY,
        };
        for (axis, motor) in Axis::ALL.into_iter().zip(&settings.motors) {
            let steepest = path.steepest(axis);
            let Some(motor) = motor.as_ref().filter(|_| steepest > 0.0) else {
                continue;
            };
            soft.acceleration = soft.acceleration.min(motor.max_acceleration / steepest);
            if let Some(jerk) = motor.max_jerk {
                soft.jerk = soft
                    .jerk
                    .min(limit::check_axis_limit(axis, "max_jerk", jerk)? / steepest);
            }
        }
        soft.jerk *= (1.0 - JERK_RESERVE - ROUNDING) * USED_WITHIN_JERK;
        soft.acceleration *= (1.0 - ACCELERATION_RESERVE - ROUNDING) * USED_WITHIN_JERK;
        let is_line = matches!(path, Path::Line { .. });
        Ok(Some(soft).filter(|soft| is_line && soft.jerk.is_finite()))
    }

    /// Returns the programmed ramp to this speed, lengthened until no motor exceeds its limits.
    fn ramp(self, programmed: UnitRamp, speed: f64) -> UnitRamp {
        programmed.within(self.acceleration / speed, self.jerk / speed)
    }
}

/// Returns the speed of a block along a path, and its ramps. With G500, on a line that moves a motor with a
/// maximum jerk, the ramps from rest and to rest respect the maximum jerk and the maximum accelerations. Such
/// a line between two stops has the 7 segments of M1d.
pub(crate) fn plan(
    settings: &CoordinateSystemSettings,
    path: &Path,
    feed: SegmentFeed,
    multi_block: MultiBlock,
) -> Result<SingleBlock, Alarm> {
    let length = path.length();
    if !length.is_finite() || !path.start().is_finite() || !path.end().is_finite() {
        let text = format!("The length of the block is {length}");
        return Err(Alarm::new(&VALUE_NOT_FINITE, text));
    }
    let start = ramp(settings, "ta", feed.ta_ms, feed.ts_ms)?;
    let stop = ramp(settings, "td", feed.td_ms, feed.ts_ms)?;
    let limit = speed_limit(settings, path, feed)?;
    let soft = match multi_block {
        MultiBlock::On => {
            check_acceleration(settings, path)?;
            JerkLimits::along(settings, path)?
        }
        MultiBlock::Off => None,
    };
    Ok(SingleBlock {
        limit,
        start,
        stop,
        soft,
    })
}

/// Returns the speed and duration from rest to rest. The speed is the limit if both ramps fit into the
/// length, otherwise the peak at which they fill the length.
pub(crate) fn stop_to_stop(length: f64, limit: f64, [start, stop]: [UnitRamp; 2]) -> (f64, f64) {
    let ramps_s = start.duration_s() + stop.duration_s();
    if length / limit >= ramps_s / 2.0 {
        (limit, length / limit + ramps_s / 2.0)
    } else {
        (2.0 * length / ramps_s, ramps_s)
    }
}

/// Returns F in units per second, limited by the maximum feedrate of the coordinate system and by the maximum
/// velocity of each motor.
///
/// # Errors
/// Returns an alarm if the feedrate, its maximum, or the maximum velocity of a moving motor is not a number
/// above 0.
pub fn speed_limit(
    settings: &CoordinateSystemSettings,
    path: &Path,
    feed: SegmentFeed,
) -> Result<f64, Alarm> {
    let feedrate = feed.feedrate_mm_min;
    check_finite("The feedrate", feedrate)?;
    let maximum = settings.max_feedrate_mm_min * feed.unit_mm;
    if feedrate <= 0.0 || maximum.is_nan() || maximum <= 0.0 {
        let text = format!("The feedrate {feedrate} and its maximum {maximum} must be above 0");
        return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
    }
    let mut speed = feedrate.min(maximum) / 60.0;
    for axis in Axis::ALL {
        let motor = settings.motors[axis.index()].as_ref();
        let max_velocity = motor.map_or(0.0, |motor| motor.max_velocity);
        // X, Y and Z move at most the distance of the path, so that `max_velocity >= speed` is sufficient.
        if axis.is_orthogonal() && max_velocity >= speed && max_velocity.is_finite() {
            continue;
        }
        let steepest = path.steepest(axis);
        if steepest == 0.0 {
            continue;
        }
        speed = speed.min(limit::check_axis_limit(axis, "max_velocity", max_velocity)? / steepest);
    }
    if speed > 0.0 {
        Ok(speed)
    } else {
        let text = format!("The block of length {} has no speed above 0", path.length());
        Err(Alarm::new(&VALUE_OUT_OF_RANGE, text))
    }
}

/// Returns an alarm if a moving motor has no valid maximum acceleration, as G500 requires.
fn check_acceleration(settings: &CoordinateSystemSettings, path: &Path) -> Result<(), Alarm> {
    for axis in Axis::ALL {
        let motor = settings.motors[axis.index()].as_ref();
        let limit = motor.map_or(0.0, |motor| motor.max_acceleration);
        if !limit::is_valid(limit) && path.steepest(axis) > 0.0 {
            limit::check_axis_limit(axis, "max_acceleration", limit)?;
        }
    }
    Ok(())
}

/// Returns a programmed ramp. An acceleration time of 0 is replaced by one servo period; the jerk time is the
/// lower limit of the acceleration time.
pub(crate) fn ramp(
    settings: &CoordinateSystemSettings,
    name: &str,
    time_ms: f64,
    ts_ms: f64,
) -> Result<UnitRamp, Alarm> {
    for (name, value) in [(name, time_ms), ("ts", ts_ms)] {
        if !value.is_finite() {
            return Err(Alarm::new(&VALUE_NOT_FINITE, format!("{name} is {value} ms")));
        }
        if value < 0.0 {
            return Err(Alarm::new(
                &VALUE_OUT_OF_RANGE,
                format!("{name} is {value} ms, below 0"),
            ));
        }
    }
    let time_s = if time_ms > 0.0 {
        time_ms / 1000.0
    } else {
        settings.servo_period_s
    };
    Ok(UnitRamp::new(time_s, ts_ms / 1000.0))
}
