//! Machines and segments for tests, and ramps that are implemented a second time.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use tandem_model::alarm::AlarmEntry;
use tandem_model::flow::{MultiBlock, Path, Segment, SegmentEnd, SegmentFeed, SegmentMotion};
use tandem_model::plane::{Plane, Turn};
use tandem_model::profile::Profile;
use tandem_model::settings::{CoordinateSystemSettings, MotorKind, MotorSettings};
use tandem_model::{AXES_MAX, ArcPath, AxisVector, Origin};
use tandem_motion::Planner;

pub const PERIOD_S: f64 = 0.001;

pub fn motor(velocity: f64, acceleration: f64, jerk: Option<f64>) -> MotorSettings {
    MotorSettings {
        max_jerk: jerk,
        ..MotorSettings::new(1, MotorKind::Linear, velocity, acceleration)
    }
}

pub fn settings(motors: [Option<MotorSettings>; AXES_MAX]) -> CoordinateSystemSettings {
    CoordinateSystemSettings {
        motors,
        max_feedrate_mm_min: 1e6,
        servo_period_s: PERIOD_S,
        ..CoordinateSystemSettings::default()
    }
}

/// Returns settings with all eight axes and wide limits.
pub fn fast() -> CoordinateSystemSettings {
    settings(std::array::from_fn(|_| Some(motor(1e5, 1e6, None))))
}

pub fn vector(values: &[f64]) -> AxisVector {
    AxisVector(std::array::from_fn(|i| values.get(i).copied().unwrap_or(0.0)))
}

pub fn segment(motion: SegmentMotion) -> Segment {
    Segment {
        origin: Origin {
            program: 7,
            line: 3,
            column: 1,
        },
        motion,
        end: SegmentEnd::ExactStop,
        multi_block: MultiBlock::Off,
        serial: 0,
    }
}

pub fn line(from: AxisVector, to: AxisVector, feed: SegmentFeed) -> Segment {
    let way = to.minus(from);
    let length = if way.orthogonal_length() > 0.0 {
        way.orthogonal_length()
    } else {
        way.rotary_length()
    };
    segment(SegmentMotion::Feed {
        path: Path::Line { from, to, length },
        feed,
    })
}

/// Creates an arc in X and Y that begins in a direction, through a signed angle.
pub fn turning(at: AxisVector, direction: f64, radius: f64, sweep: f64) -> ArcPath {
    let angle = direction - sweep.signum() * TAU / 4.0;
    let centre = [at.0[0] - radius * angle.cos(), at.0[1] - radius * angle.sin()];
    let end = angle + sweep;
    let to = vector(&[centre[0] + radius * end.cos(), centre[1] + radius * end.sin()]);
    let turn = if sweep > 0.0 {
        Turn::CounterClockwise
    } else {
        Turn::Clockwise
    };
    ArcPath::new(at, to, Plane::Xy, centre, turn)
}

pub fn feed(feedrate_mm_min: f64, [ta_ms, td_ms, ts_ms]: [f64; 3]) -> SegmentFeed {
    SegmentFeed {
        feedrate_mm_min,
        ta_ms,
        td_ms,
        ts_ms,
        ..SegmentFeed::default()
    }
}

pub fn plan(settings: &CoordinateSystemSettings, segment: &Segment) -> Profile {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    planner.push(segment, &mut out).unwrap();
    planner.flush(&mut out);
    assert_eq!(out.len(), 1);
    out.pop_front().unwrap()
}

#[track_caller]
pub fn refused(settings: &CoordinateSystemSettings, segment: &Segment, entry: &'static AlarmEntry) -> String {
    let mut planner = Planner::new(settings);
    let mut out = VecDeque::new();
    let alarm = planner.push(segment, &mut out).unwrap_err();
    assert_eq!(alarm.entry, entry, "{}", alarm.text);
    assert_eq!(alarm.origin, Some(segment.origin));
    assert!(out.is_empty());
    assert_eq!(planner.last_segment(), 0);
    alarm.text
}

#[track_caller]
pub fn close(value: f64, expected: f64) {
    assert!((value - expected).abs() < 1e-9, "{value} is not {expected}");
}

/// Returns P(t) by its definition, the integral of step * box(ta) * box(ts), as truncated powers without
/// phases. After the ramp the powers equal t - (ta + ts)/2; this form avoids the cancellation of their sum.
pub fn integral_of_ramp(t: f64, ta: f64, ts: f64) -> f64 {
    if t > ta + ts {
        return t - f64::midpoint(ta, ts);
    }
    let cut = |x: f64, power: i32| if x > 0.0 { x.powi(power) } else { 0.0 };
    if ts > 0.0 {
        (cut(t, 3) - cut(t - ta, 3) - cut(t - ts, 3) + cut(t - ta - ts, 3)) / (6.0 * ta * ts)
    } else {
        (cut(t, 2) - cut(t - ta, 2)) / (2.0 * ta)
    }
}

/// Returns peak speed and time of the shortest motion from rest to rest. The ramp time is by M1e; the peak is
/// found by bisection instead of a closed form.
pub fn shortest_by_halving(way: f64, v: f64, a: f64, j: Option<f64>) -> (f64, f64) {
    let ramp = |w: f64| match j {
        None => w / a,
        Some(j) if w >= a * a / j => w / a + a / j,
        Some(j) => 2.0 * (w / j).sqrt(),
    };
    let (mut low, mut high) = (0.0, v);
    if v * ramp(v) > way {
        for _ in 0..200 {
            let middle = f64::midpoint(low, high);
            if middle * ramp(middle) > way {
                high = middle;
            } else {
                low = middle;
            }
        }
    }
    (high, way / high + ramp(high))
}
