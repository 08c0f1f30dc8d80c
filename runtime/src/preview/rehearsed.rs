//! The rehearsal: a plan in the form of the interface.

use plc_api::types::planned::{Rehearsal, RehearsedAxis, RehearsedLine, RehearsedPeak, RehearsedRun};
use plc_api::types::state::Overrides;
use tandem_model::settings::MotorSettings;

use super::plan::{Content, Moment, Plan};
use super::tracer::{AxisTrace, Mark, Peak, Times};

/// Most blocks whose times are listed.
const LINES_MAX: usize = 2048;

pub(super) fn rehearsal(plan: &Plan, content: &Content) -> Rehearsal {
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
    } = content.times;
    let step = content.marks.len().div_ceil(LINES_MAX).max(1);
    Rehearsal {
        program: conditions.main.number,
        cs: settings.number,
        hash: conditions.main.sum().to_owned(),
        revision: plan.tag(content),
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
        lines: content.marks.iter().step_by(step).map(line_of).collect(),
        run: None,
    }
}

fn line_of(mark: &Mark) -> RehearsedLine {
    RehearsedLine {
        program: mark.origin.program,
        line: mark.origin.line,
        at_s: mark.times.total,
    }
}

fn axis_of(trace: &AxisTrace, motor: &MotorSettings) -> RehearsedAxis {
    let peak = |peak: Peak, limit| RehearsedPeak {
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

/// How far a run is at this moment.
pub(super) fn run(content: &Content, now: &Moment, overrides: &Overrides) -> RehearsedRun {
    let (now, end) = (content.time_of(now), content.times);
    // at rest by an override of 0 the time left is that at 1 percent
    let rate = |percent: f64| (percent / 100.0).max(0.01);
    let left = |from: f64, to: f64| (to - from).max(0.0);
    let left_s = left(now.feed, end.feed) / rate(overrides.feed)
        + left(now.rapid, end.rapid) / rate(overrides.rapid)
        + left(now.fixed, end.fixed)
        + left(now.wait, end.wait);
    RehearsedRun {
        at_s: now.total,
        left_s,
        progress: if end.total > 0.0 {
            (now.total / end.total).clamp(0.0, 1.0)
        } else {
            0.0
        },
    }
}
