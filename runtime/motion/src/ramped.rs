//! G01 along a path: from rest to rest (M1a), and the parts of it that a chain uses.

use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Feed, MultiBlock, Path};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis};

use crate::reserve::ACCELERATION_RESERVE;

/// A peak speed is found in so many halvings of what it may be: to the last bits that count.
const HALVINGS: u32 = 60;

/// Less than look-ahead leaves, so that rounding does not make it slow a ramp down.
const ROUNDING: f64 = 2e-9;

/// A block on its own: what a chain takes of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Alone {
    /// F within its limits, path units per second: what it reaches when it is long enough.
    pub(crate) limit: f64,
    /// With ta, as programmed.
    pub(crate) start: UnitRamp,
    /// With td, as programmed.
    pub(crate) stop: UnitRamp,
    /// What ramps from rest and to rest keep to; `None`: they are as programmed.
    soft: Option<Soft>,
}

/// What the motors allow along a line.
#[derive(Debug, Clone, Copy)]
struct Soft {
    /// Path units per second squared.
    acceleration: f64,
    /// Path units per second cubed.
    jerk: f64,
}

/// A block from rest to rest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RestToRest {
    /// Between the ramps, path units per second.
    pub(crate) speed: f64,
    pub(crate) start: UnitRamp,
    pub(crate) stop: UnitRamp,
    pub(crate) duration_s: f64,
}

impl Alone {
    /// The ramp from rest to this speed.
    fn start_to(&self, speed: f64) -> UnitRamp {
        self.soft.map_or(self.start, |soft| soft.ramp(self.start, speed))
    }

    /// The ramp from this speed to rest.
    fn stop_from(&self, speed: f64) -> UnitRamp {
        self.soft.map_or(self.stop, |soft| soft.ramp(self.stop, speed))
    }

    /// The ramp with which a chain begins, where its first block takes this time; where that is too short for what the
    /// motors need, it is the one of the smallest jerk, which look-ahead slows down, or else the programmed one gives way
    /// (rule `shrink`).
    pub(crate) fn start_from_rest(&self, block_s: f64) -> UnitRamp {
        self.within(self.start_to(self.limit), self.start, block_s)
    }

    /// The ramp with which a chain ends, likewise.
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

    /// The most that [`Alone::rest_to_rest`] takes, s.
    pub(crate) fn duration_s_max(&self, length: f64) -> f64 {
        let [start, stop] = [self.start_to(self.limit), self.stop_from(self.limit)];
        stop_to_stop(length, self.limit, start, stop).1
    }

    /// The motion over this length, from rest to rest: `t_end = L/v + (Ta + Td)/2`, or, when it is too short to reach
    /// v, the peak at which the ramps fill it. Ramps as programmed keep their time (rule `extend`); those within limits of
    /// the motors are shorter for a lower peak.
    pub(crate) fn rest_to_rest(&self, length: f64) -> RestToRest {
        let ramps = |speed: f64| [self.start_to(speed), self.stop_from(speed)];
        let fits = |speed: f64| {
            let [start, stop] = ramps(speed);
            speed * f64::midpoint(start.duration_s(), stop.duration_s()) <= length
        };
        let mut ramps_at = self.limit;
        if self.soft.is_some() && !fits(self.limit) {
            let mut low = 0.0;
            for _ in 0..HALVINGS {
                let middle = f64::midpoint(low, ramps_at);
                if fits(middle) {
                    low = middle;
                } else {
                    ramps_at = middle;
                }
            }
        }
        let [start, stop] = ramps(ramps_at);
        let (speed, duration_s) = stop_to_stop(length, ramps_at, start, stop);
        RestToRest {
            speed,
            start,
            stop,
            duration_s,
        }
    }
}

impl Soft {
    /// Along a line on which a motor with a maximum jerk moves.
    fn along(settings: &CoordinateSystemSettings, path: &Path) -> Result<Option<Self>, Alarm> {
        let mut motors = settings.motors.iter().flatten();
        let has_jerk = motors.any(|motor| motor.max_jerk.is_some());
        if !has_jerk {
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
                if !(jerk > 0.0 && jerk.is_finite()) {
                    let text = format!("max_jerk of axis {} is {jerk}", axis.letter());
                    return Err(Alarm::new(&LIMIT_ZERO, text));
                }
                soft.jerk = soft.jerk.min(jerk / steepest);
            }
        }
        soft.jerk *= 1.0 - ROUNDING;
        soft.acceleration *= 1.0 - ACCELERATION_RESERVE - ROUNDING;
        let is_line = matches!(path, Path::Line { .. });
        Ok(Some(soft).filter(|soft| is_line && soft.jerk.is_finite()))
    }

    /// The programmed ramp, lengthened until no motor exceeds its limits.
    fn ramp(self, programmed: UnitRamp, speed: f64) -> UnitRamp {
        programmed.within(self.acceleration / speed, self.jerk / speed)
    }
}

/// The speed of a block along a path and its ramps. With G500, where a motor that moves on a line has a maximum jerk, those
/// from rest and to rest keep that and the maximum accelerations: over a line between two stops that is the profile of
/// 7 segments of M1d.
pub(crate) fn plan(
    settings: &CoordinateSystemSettings,
    path: &Path,
    feed: Feed,
    multi_block: MultiBlock,
) -> Result<Alone, Alarm> {
    let length = path.length();
    if !length.is_finite() || !path.start().is_finite() || !path.end().is_finite() {
        return Err(Alarm::new(
            &VALUE_NOT_FINITE,
            format!("The length of the block is {length}"),
        ));
    }
    let start = ramp(settings, "ta", feed.ta_ms, feed.ts_ms)?;
    let stop = ramp(settings, "td", feed.td_ms, feed.ts_ms)?;
    let limit = speed_limit(settings, path, feed)?;
    let soft = match multi_block {
        MultiBlock::On => {
            check_acceleration(settings, path)?;
            Soft::along(settings, path)?
        }
        MultiBlock::Off => None,
    };
    Ok(Alone {
        limit,
        start,
        stop,
        soft,
    })
}

/// Speed and duration from rest to rest: the limit where the length is enough for both ramps, else the peak that they
/// leave.
pub(crate) fn stop_to_stop(length: f64, limit: f64, start: UnitRamp, stop: UnitRamp) -> (f64, f64) {
    let ramps_s = start.duration_s() + stop.duration_s();
    if length / limit >= ramps_s / 2.0 {
        (limit, length / limit + ramps_s / 2.0)
    } else {
        (2.0 * length / ramps_s, ramps_s)
    }
}

/// F in units per second, clipped by the coordinate system's maximum feedrate and slowed until no motor exceeds its
/// maximum velocity.
pub(crate) fn speed_limit(
    settings: &CoordinateSystemSettings,
    path: &Path,
    feed: Feed,
) -> Result<f64, Alarm> {
    let feedrate = feed.feedrate_mm_min;
    if !feedrate.is_finite() {
        return Err(Alarm::new(
            &VALUE_NOT_FINITE,
            format!("The feedrate is {feedrate}"),
        ));
    }
    let maximum = settings.max_feedrate_mm_min;
    if feedrate <= 0.0 || maximum.is_nan() || maximum <= 0.0 {
        let text = format!("The feedrate {feedrate} and its maximum {maximum} must be above 0");
        return Err(Alarm::new(&VALUE_OUT_OF_RANGE, text));
    }
    let mut speed = feedrate.min(maximum) / 60.0;
    for axis in Axis::ALL {
        let motor = settings.motors[axis.index()].as_ref();
        let max_velocity = motor.map_or(0.0, |motor| motor.max_velocity);
        // X, Y and Z never go farther than the path.
        if axis.is_orthogonal() && max_velocity >= speed && max_velocity.is_finite() {
            continue;
        }
        let steepest = path.steepest(axis);
        if steepest == 0.0 {
            continue;
        }
        if !(max_velocity > 0.0 && max_velocity.is_finite()) {
            let text = format!("max_velocity of axis {} is {max_velocity}", axis.letter());
            return Err(Alarm::new(&LIMIT_ZERO, text));
        }
        speed = speed.min(max_velocity / steepest);
    }
    if speed > 0.0 {
        Ok(speed)
    } else {
        let text = format!("The block of length {} has no speed above 0", path.length());
        Err(Alarm::new(&VALUE_OUT_OF_RANGE, text))
    }
}

/// G500: each motor that moves must have a maximum acceleration.
fn check_acceleration(settings: &CoordinateSystemSettings, path: &Path) -> Result<(), Alarm> {
    for axis in Axis::ALL {
        let motor = settings.motors[axis.index()].as_ref();
        let most = motor.map_or(0.0, |motor| motor.max_acceleration);
        if !(most > 0.0 && most.is_finite()) && path.steepest(axis) > 0.0 {
            let text = format!("max_acceleration of axis {} is {most}", axis.letter());
            return Err(Alarm::new(&LIMIT_ZERO, text));
        }
    }
    Ok(())
}

/// A programmed ramp. An acceleration time of 0 counts as one servo period; then it is at least the jerk time.
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
