//! G01 along a path: from rest to rest (motion-semantics 1a), and what a chain needs of it.

use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE, VALUE_OUT_OF_RANGE};
use tandem_model::flow::{Feed, Path};
use tandem_model::ramp::UnitRamp;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, Axis};

/// A block from rest to rest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Alone {
    /// Between the ramps, path units per second.
    pub(crate) speed: f64,
    /// F within its limits, path units per second: what it reaches when it is long enough.
    pub(crate) limit: f64,
    pub(crate) start: UnitRamp,
    pub(crate) stop: UnitRamp,
    pub(crate) duration_s: f64,
}

/// The ramped motion along a path: `t_end = L/v + (Ta + Td)/2`, or, when the path is too short to reach v,
/// `v_peak = 2 L/(Ta + Td)` with the ramps as long as programmed (rule `extend`).
pub(crate) fn plan(settings: &CoordinateSystemSettings, path: &Path, feed: Feed) -> Result<Alone, Alarm> {
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
    let (speed, duration_s) = stop_to_stop(length, limit, start, stop);
    Ok(Alone {
        speed,
        limit,
        start,
        stop,
        duration_s,
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
pub(crate) fn check_acceleration(settings: &CoordinateSystemSettings, path: &Path) -> Result<(), Alarm> {
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
