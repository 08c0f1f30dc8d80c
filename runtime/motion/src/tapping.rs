//! A move in a thread: Z from rest to rest, with the spindle locked to it (M1h).
//!
//! The spindle turns in proportion to Z, so its limits are limits of Z. At the largest speed of Z, the
//! spindle turns at its maximum. Each ramp takes at least the time in which the spindle reaches its speed.

use tandem_model::alarm::VALUE_NOT_FINITE;
use tandem_model::flow::{Path, SegmentFeed, TapLeg};
use tandem_model::profile::Law;
use tandem_model::settings::CoordinateSystemSettings;
use tandem_model::{Alarm, AxisVector};

use crate::{limit, ramped};

/// Returns the motion and its duration: as a G01 block from rest to rest, within the limits of Z and of the
/// spindle.
pub(crate) fn plan(
    settings: &CoordinateSystemSettings,
    [from, to]: [AxisVector; 2],
    feed: SegmentFeed,
    revolutions: f64,
    leg: TapLeg,
) -> Result<(Law, f64), Alarm> {
    let length = to.minus(from).orthogonal_length();
    if !length.is_finite() || !revolutions.is_finite() {
        let text = format!("The thread is {length} mm long and takes {revolutions} revolutions");
        return Err(Alarm::new(&VALUE_NOT_FINITE, text));
    }
    let mut speed = ramped::speed_limit(settings, &Path::Line { from, to, length }, feed)?;
    let mut spindle_ramp_ms = 0.0;
    if revolutions != 0.0 {
        let r_min_of_mm_s = revolutions.abs() / length * 60.0;
        let limits = (settings.spindle.as_ref()).map(|motor| [motor.max_velocity, motor.max_acceleration]);
        let [velocity, acceleration] = limits.unwrap_or_default();
        let velocity = limit::check_limit("the spindle", "max_velocity", velocity)?;
        let acceleration = limit::check_limit("the spindle", "max_acceleration", acceleration)?;
        speed = speed.min(velocity / r_min_of_mm_s);
        spindle_ramp_ms = speed * r_min_of_mm_s / acceleration * 1000.0;
    }
    let start = ramped::ramp(settings, "ta", feed.ta_ms.max(spindle_ramp_ms), feed.ts_ms)?;
    let stop = ramped::ramp(settings, "td", feed.td_ms.max(spindle_ramp_ms), feed.ts_ms)?;
    let (speed, duration_s) = ramped::stop_to_stop(length, speed, [start, stop]);
    let law = Law::Tap {
        from,
        to,
        rate: speed / length,
        start,
        stop,
        revolutions,
        leg,
    };
    Ok((law, duration_s))
}
