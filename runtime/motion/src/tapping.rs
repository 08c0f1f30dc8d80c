//! A move in a thread: Z from rest to rest, with the spindle locked to it (M1h).
//!
//! The spindle turns in proportion to Z, so its limits are limits of Z: the speed is at most the one at which the
//! spindle turns at its maximum, and each ramp takes at least as long as the spindle needs to reach that speed.

use tandem_model::alarm::{LIMIT_ZERO, VALUE_NOT_FINITE};
use tandem_model::flow::{Feed, Path, TapLeg};
use tandem_model::profile::{Law, TimeBase};
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, AxisVector};

use crate::planned::Planned;
use crate::ramped;

/// What the planner takes of a way in a thread.
pub(crate) struct Thread {
    pub(crate) from: AxisVector,
    pub(crate) to: AxisVector,
    pub(crate) feed: Feed,
    pub(crate) revolutions: f64,
    pub(crate) leg: TapLeg,
}

/// The motion of a way in a thread, as a G01 block from rest to rest within the limits of Z and of the spindle.
pub(crate) fn plan(settings: &CoordinateSystemSettings, thread: &Thread) -> Result<Planned, Alarm> {
    let Thread {
        from,
        to,
        feed,
        revolutions,
        leg,
    } = *thread;
    let length = to.minus(from).orthogonal_length();
    if !length.is_finite() || !revolutions.is_finite() {
        let text = format!("The thread is {length} mm long and takes {revolutions} revolutions");
        return Err(Alarm::new(&VALUE_NOT_FINITE, text));
    }
    let mut speed = ramped::speed_limit(settings, &Path::Line { from, to, length }, feed)?;
    let mut spindle_ramp_ms = 0.0;
    if revolutions != 0.0 {
        let r_min_of_mm_s = revolutions.abs() / length * 60.0;
        let [velocity, acceleration] = spindle_limits(settings)?;
        speed = speed.min(velocity / r_min_of_mm_s);
        spindle_ramp_ms = speed * r_min_of_mm_s / acceleration * 1000.0;
    }
    let start = ramped::ramp(settings, "ta", feed.ta_ms.max(spindle_ramp_ms), feed.ts_ms)?;
    let stop = ramped::ramp(settings, "td", feed.td_ms.max(spindle_ramp_ms), feed.ts_ms)?;
    let (speed, duration_s) = ramped::stop_to_stop(length, speed, start, stop);
    Ok(Planned {
        law: Law::Tap {
            from,
            to,
            rate: speed / length,
            start,
            stop,
            revolutions,
            leg,
        },
        duration_s,
        time_base: TimeBase::Fixed,
    })
}

/// Maximum velocity, r/min, and acceleration, r/min per second.
fn spindle_limits(settings: &CoordinateSystemSettings) -> Result<[f64; 2], Alarm> {
    let limits = (settings.spindle.as_ref()).map(|motor| [motor.max_velocity, motor.max_acceleration]);
    let [velocity, acceleration] = limits.unwrap_or_default();
    for (name, limit) in [("max_velocity", velocity), ("max_acceleration", acceleration)] {
        if !(limit > 0.0 && limit.is_finite()) {
            return Err(Alarm::new(
                &LIMIT_ZERO,
                format!("{name} of the spindle is {limit}"),
            ));
        }
    }
    Ok([velocity, acceleration])
}
