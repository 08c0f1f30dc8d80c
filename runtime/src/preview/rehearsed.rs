//! Converts a plan to a rehearsal, the form in which clients receive it.

use plc_protocol::types::planned::{
    PathIdentity, Rehearsal, RehearsedAxis, RehearsedCorner, RehearsedLine, RehearsedPeak, RehearsedRun,
};
use plc_protocol::types::state::Overrides;
use tandem_model::settings::{LowOverride, MotorSettings};

use super::plan::{Plan, PlanContent, RunMoment};
use super::tracer::{AxisTrace, PlanMark, PlannedPeak, Times};

/// Maximum number of blocks whose times a rehearsal lists.
const LINES_MAX: usize = 2048;

pub(super) fn rehearsal(plan: &Plan, content: &PlanContent, identity: PathIdentity) -> Rehearsal {
    let conditions = &plan.conditions;
    let settings = &conditions.configured.settings;
    let axis = |trace: &AxisTrace| {
        let motor = settings.motors[trace.axis.index()].as_ref()?;
        Some((trace.axis.letter().to_string(), axis_of(trace, motor)))
    };
    let Times {
        total,
        feed,
        rapid,
        fixed,
        wait,
        ..
    } = content.times;
    let step = content.marks.len().div_ceil(LINES_MAX).max(1);
    Rehearsal {
        program: conditions.main.number,
        cs: settings.number,
        hash: conditions.main.checksum().to_owned(),
        revision: Plan::tag(content, &identity),
        run_id: identity.run_id,
        plan: identity.plan,
        outcome: content.outcome,
        text: content.text.clone(),
        at: content.at,
        cycle_time_s: total,
        feed_s: feed,
        rapid_s: rapid,
        fixed_s: fixed,
        wait_s: wait,
        depends: content.depends.clone(),
        m_codes: content.m_codes.clone(),
        m_code_count: content.m_code_count,
        axes: content.axes.iter().filter_map(axis).collect(),
        corners: content.corners.iter().map(corner_of).collect(),
        lines: content.marks.iter().step_by(step).map(line_of).collect(),
        run: None,
    }
}

fn corner_of(corner: &PlannedPeak) -> RehearsedCorner {
    RehearsedCorner {
        distance_mm: corner.value,
        program: corner.origin.program,
        line: corner.origin.line,
    }
}

fn line_of(mark: &PlanMark) -> RehearsedLine {
    RehearsedLine {
        program: mark.origin.program,
        line: mark.origin.line,
        at_s: mark.times.total,
    }
}

fn axis_of(trace: &AxisTrace, motor: &MotorSettings) -> RehearsedAxis {
    let peak = |peak: PlannedPeak, limit| RehearsedPeak {
        value: peak.value,
        limit,
        program: peak.origin.program,
        line: peak.origin.line,
    };
    RehearsedAxis {
        motor: motor.number,
        lowest: trace.lowest,
        highest: trace.highest,
        soft_limits: motor.soft_limits,
        velocity: peak(trace.velocity, motor.max_velocity),
        acceleration: peak(trace.acceleration, motor.max_acceleration),
    }
}

/// Planned time in s below which no time is left.
const NOTHING_S: f64 = 1e-6;

/// Returns the progress of a run at its current position.
pub(super) fn run(
    content: &PlanContent,
    now: &RunMoment,
    overrides: &Overrides,
    low_override: LowOverride,
) -> RehearsedRun {
    let (at, end) = (content.time_of(now), content.times);
    let left = |from: f64, to: f64| (to - from).max(0.0);
    // At an override of 0 the machine rests, so the end time is unknown.
    let at_rate = |planned_s: f64, percent: f64| match planned_s {
        0.0..NOTHING_S => Some(0.0),
        _ if percent > 0.0 => Some(planned_s * 100.0 / percent),
        _ => None,
    };
    let is_replanned = low_override == LowOverride::Replan || overrides.feed > 100.0;
    let feed_s = match left(at.feed, end.feed) {
        0.0..NOTHING_S => Some(0.0),
        _ if overrides.feed > 0.0 => Some(at.feed_to(&end, overrides.feed / 100.0, is_replanned)),
        _ => None,
    };
    let left_s = feed_s
        .zip(at_rate(left(at.rapid, end.rapid), overrides.rapid))
        .map(|(feed_s, rapid_s)| feed_s + rapid_s + left(at.fixed, end.fixed) + left(at.wait, end.wait));
    RehearsedRun {
        at_s: at.total,
        left_s: left_s.filter(|_| !now.waits_without_end),
        progress: if end.total > 0.0 {
            (at.total / end.total).clamp(0.0, 1.0)
        } else {
            0.0
        },
    }
}
