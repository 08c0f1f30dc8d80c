//! One run of a program in a trial, without a machine.

use std::sync::Arc;

use plc_protocol::types::output::Timing;
use tandem_config::Stock;
use tandem_interp::{Inputs, Interpreter, NO_TOOLS};
use tandem_model::alarm::{
    AlarmEntry, COMPENSATION_ARC_SMALL, COMPENSATION_CORNER, COMPENSATION_LEAD_SHORT,
    COMPENSATION_LOOK_AHEAD, COMPENSATION_REFUSED, COMPENSATION_SPIRAL, OVERCUT,
};
use tandem_model::flow::{Action, Block, Compensation, Item, Output, Segment};
use tandem_model::lost::LOST;
use tandem_model::settings::{CoordinateSystemSettings, MotorSettings, Tool, WorkOffsets};
use tandem_model::variables::{GLOBAL_VARIABLES, VariableArray, Variables};
use tandem_model::{AXES_MAX, Alarm, Axis, AxisVector, MachinePosition, Origin};
use tandem_motion::{ChainCheck, ExceededLimit};
use tandem_path::PathStage;
use tandem_syntax::diagnostics::{self, DiagnosticEntry};

use super::{LISTED_MAX, Trial, Warning, is_same};
use crate::coordinate_system::rest_refused;
use crate::sequence::stock::selected_tool;

/// Alarms of the path stage after which the trial continues without cutter compensation.
const OF_COMPENSATION: [&AlarmEntry; 7] = [
    &COMPENSATION_REFUSED,
    &COMPENSATION_LEAD_SHORT,
    &COMPENSATION_ARC_SMALL,
    &COMPENSATION_CORNER,
    &COMPENSATION_SPIRAL,
    &COMPENSATION_LOOK_AHEAD,
    &OVERCUT,
];

/// Assumed values for data that the program text does not contain.
#[derive(Debug, Clone, Copy)]
pub(super) struct TrialAssumptions {
    /// Distance of each axis from its `start_at` at the start, mm or degrees.
    pub start_offset: f64,
    pub tool: Tool,
    pub optional_skip: u32,
    /// Share of the programmed distance after which a G31 ends, 0 to 1.
    pub skip_share: f64,
    /// Value of P and Q variables that the program has not written.
    pub outside: f64,
}

/// The first assumptions: neutral values.
pub(super) const FIRST: TrialAssumptions = TrialAssumptions {
    start_offset: 0.0,
    tool: Tool {
        length: 0.0,
        radius: 0.0,
    },
    optional_skip: 0,
    skip_share: 1.0,
    outside: LOST,
};

/// The second assumptions, which differ from the first as much as possible.
pub(super) const SECOND: TrialAssumptions = TrialAssumptions {
    start_offset: 1.375,
    tool: Tool {
        length: 2.0,
        radius: 0.0,
    },
    optional_skip: u32::MAX,
    skip_share: 0.5,
    outside: LOST,
};

/// One run of the program with certain assumptions.
pub(super) struct TrialRun<'a> {
    trial: &'a Trial<'a>,
    assumed: TrialAssumptions,
    interpreter: Interpreter,
    path: PathStage,
    segments: Vec<Segment>,
    /// Check of the blended chains, on a machine.
    chains: Option<ChainCheck>,
    variables: Variables,
    work_offsets: WorkOffsets,
    tool: Tool,
    captured: [f64; AXES_MAX],
    /// True if motion was interpreted since the program last came to rest.
    is_moving: bool,
    /// True if cutter compensation has caused an alarm. Until compensation is switched off, the program then
    /// moves along its programmed path.
    is_uncompensated: bool,
    /// Alarms after which the run continued.
    alarms: Vec<Alarm>,
    steps_max: u64,
}

impl<'a> TrialRun<'a> {
    pub fn new(
        trial: &'a Trial<'_>,
        settings: &CoordinateSystemSettings,
        assumed: TrialAssumptions,
        steps_max: u64,
    ) -> Self {
        let variables = Variables::new(VariableArray::new(GLOBAL_VARIABLES));
        for array in [&variables.global, &variables.coordinate_system] {
            (0..array.len()).for_each(|index| _ = array.set(index, assumed.outside));
        }
        let mut interpreter = Interpreter::new(settings, trial.dialect);
        interpreter.start(Arc::clone(trial.program), 0);
        let mut at = AxisVector::ZERO;
        for (axis, motor) in Axis::ALL.into_iter().zip(&settings.motors) {
            let motor = motor.as_ref();
            at[axis] = motor.map_or(0.0, |motor| position_at_start(motor, assumed.start_offset));
        }
        let mut path = PathStage::new(settings, MachinePosition(at));
        path.let_limits_pass();
        Self {
            trial,
            assumed,
            interpreter,
            path,
            segments: Vec::new(),
            // With other skips the same chains would be reported again.
            chains: trial
                .machine
                .filter(|_| assumed.optional_skip == FIRST.optional_skip)
                .map(|_| ChainCheck::new(settings, settings.motion.corner_warning_mm)),
            variables,
            work_offsets: trial
                .machine
                .map_or_else(WorkOffsets::default, |(_, system)| system.work_offsets),
            tool: assumed.tool,
            captured: [0.0; AXES_MAX],
            is_moving: false,
            is_uncompensated: false,
            alarms: Vec::new(),
            steps_max,
        }
    }

    /// Returns the number of executed blocks.
    pub fn steps(&self) -> u64 {
        self.interpreter.steps()
    }

    /// Returns the alarms after which the run continued, in order. Each alarm is listed once per location.
    pub fn into_alarms(self) -> Vec<Alarm> {
        self.alarms
    }

    /// Runs the program to its end, or for the maximum number of blocks.
    ///
    /// # Errors
    /// Returns the alarm that ends the run. Alarms about soft limits and about missing paths in cutter
    /// compensation do not end it; they are in [`TrialRun::into_alarms`].
    pub fn run_out(&mut self, warnings: &mut Vec<Warning>) -> Result<(), Alarm> {
        while self.interpreter.steps() < self.steps_max {
            let item = match self.next() {
                Ok(item) => item,
                // An alarm of an earlier block that the path stage has held back comes first.
                Err(alarm) => return self.finish().and(Err(alarm)),
            };
            match item {
                Item::Block(block) => {
                    let from = self.path.position();
                    self.process_block(block)?;
                    self.is_moving |= !self.segments.is_empty() || self.path.position() != from;
                    self.check_chains(warnings);
                    self.end_skip(from);
                }
                Item::Output(output) => {
                    if self.timing(&output) == Timing::AfterMotion {
                        self.rest(&item, warnings);
                    }
                    self.look_at_motion(&output, warnings);
                    self.select_tool(&output, warnings);
                }
                Item::Stop(_) => self.rest(&item, warnings),
                Item::NeedsStandstill(_) => self.flush(warnings),
                Item::Warning(origin, text) => {
                    add_warning(warnings, &diagnostics::WARNS_IN_RUN, origin, text);
                }
                Item::End(_) => {
                    self.rest(&item, warnings);
                    let finished = self.finish();
                    self.check_chains(warnings);
                    self.warn_of_limits(warnings);
                    return finished;
                }
            }
        }
        Ok(())
    }

    fn next(&mut self) -> Result<Item, Alarm> {
        let tools = self
            .trial
            .machine
            .map_or(&NO_TOOLS, |(machine, _)| &machine.tools);
        self.interpreter.next(&Inputs {
            programs: self.trial.programs,
            optional_skip: self.assumed.optional_skip,
            work_offsets: &self.work_offsets,
            variables: &self.variables,
            tool: Some(self.tool),
            tools,
            captured: Some(self.captured),
            position: Some(self.path.counts_from().0),
        })
    }

    /// Passes a block to the path stage. If cutter compensation finds no path for the block, the program
    /// moves without compensation until compensation is switched off.
    fn process_block(&mut self, mut block: Block) -> Result<(), Alarm> {
        self.is_uncompensated &= block.compensation != Compensation::Off;
        if !self.is_uncompensated {
            match self.push(&block) {
                Err(alarm) if OF_COMPENSATION.contains(&alarm.entry) => self.record_alarm(alarm),
                pushed => return pushed,
            }
            self.is_uncompensated = block.compensation != Compensation::Off;
        }
        block.compensation = Compensation::Off;
        if matches!(block.action, Action::Corner(_)) {
            return Ok(());
        }
        self.push(&block)
    }

    fn push(&mut self, block: &Block) -> Result<(), Alarm> {
        let pushed = self.path.push(block, &mut self.segments);
        self.note_passed_limits();
        pushed
    }

    fn finish(&mut self) -> Result<(), Alarm> {
        let finished = self.path.finish(&mut self.segments);
        self.note_passed_limits();
        finished
    }

    fn note_passed_limits(&mut self) {
        for alarm in self.path.take_passed_limits() {
            self.record_alarm(alarm);
        }
    }

    fn record_alarm(&mut self, alarm: Alarm) {
        if self.alarms.len() < LISTED_MAX && !self.alarms.iter().any(|known| is_same(known, &alarm)) {
            self.alarms.push(alarm);
        }
    }

    /// Brings the program to rest; within cutter compensation, records an alarm instead.
    fn rest(&mut self, item: &Item, warnings: &mut Vec<Warning>) {
        let is_compensating =
            self.path.is_compensating() || self.interpreter.modal().compensation != Compensation::Off;
        match rest_refused(item) {
            Some(alarm) if is_compensating && !self.is_uncompensated => self.record_alarm(alarm),
            _ => self.flush(warnings),
        }
    }

    fn flush(&mut self, warnings: &mut Vec<Warning>) {
        self.path.flush(&mut self.segments);
        self.check_chains(warnings);
        self.is_moving = false;
    }

    /// Passes the segments to the check of the chains, and warns of corners that the path misses.
    fn check_chains(&mut self, warnings: &mut Vec<Warning>) {
        let segments = self.segments.drain(..);
        let Some(chains) = &mut self.chains else { return };
        for segment in segments {
            // The motion stage rejects such a segment with an alarm of its own when the program runs.
            if chains.push(&segment).is_err() {
                chains.finish();
            }
        }
        for corner in chains.take_corners() {
            let text = format!("the path misses this corner by {:.4} mm", corner.distance_mm);
            add_warning(warnings, &diagnostics::CORNER_MISSED, corner.origin, text);
        }
    }

    /// Warns of the limits that the chains exceed.
    fn warn_of_limits(&self, warnings: &mut Vec<Warning>) {
        let exceeded = self.chains.iter().flat_map(ChainCheck::exceeded);
        for ExceededLimit {
            axis,
            limit,
            factor,
            origin,
        } in exceeded
        {
            let motors = self.trial.machine.map(|(_, system)| &system.settings.motors);
            let number = motors
                .and_then(|motors| motors[axis.index()].as_ref())
                .map_or(0, |motor| motor.number);
            let text = if factor.is_finite() {
                format!(
                    "motor {number} ({}) reaches {factor:.2} times its {limit}",
                    axis.letter()
                )
            } else {
                format!("motor {number} ({}) exceeds its {limit}: ts is 0", axis.letter())
            };
            add_warning(warnings, &diagnostics::LIMIT_EXCEEDED, origin, text);
        }
    }

    /// Ends a G31 immediately, after the assumed share of its distance.
    fn end_skip(&mut self, from: MachinePosition) {
        if !self.path.is_skipping() {
            return;
        }
        let way = self.path.position().0.minus(from.0);
        let mut at = from.0;
        for axis in Axis::ALL {
            at[axis] += way[axis] * self.assumed.skip_share;
            self.captured[axis.index()] = at[axis];
        }
        self.path.skipped_to(MachinePosition(at));
    }

    /// Returns the timing of an output. Without a machine, the output waits for the motion only if the manual
    /// requires it (D30).
    fn timing(&self, output: &Output) -> Timing {
        match self.trial.machine {
            Some((machine, system)) => system.timing(output, machine.m_codes.get(&output.m)),
            None if output.has_params() => Timing::AfterMotion,
            None => Timing::WithMotion,
        }
    }

    /// Warns of an output that is issued when its block is interpreted, although earlier motion has not
    /// ended.
    fn look_at_motion(&self, output: &Output, warnings: &mut Vec<Warning>) {
        let Some((machine, system)) = self.trial.machine else {
            return;
        };
        let is_at_once = system.is_issued_at_once(
            output,
            machine.m_codes.get(&output.m),
            self.path.is_compensating(),
        );
        let entry = &diagnostics::OUTPUT_BEFORE_MOTION_ENDS;
        let text = format!(
            "M{:02} is issued when its block is interpreted: earlier motion may still be active, or may not \
             have begun",
            output.m
        );
        let is_known = |warning: &Warning| warning.entry == entry && warning.text == text;
        if self.is_moving && is_at_once && !warnings.iter().any(is_known) {
            add_warning(warnings, entry, output.origin, text);
        }
    }

    fn select_tool(&mut self, output: &Output, warnings: &mut Vec<Warning>) {
        let Some((machine, _)) = self.trial.machine else {
            return;
        };
        let settings = machine.m_codes.get(&output.m);
        if settings.is_none_or(|settings| settings.stock != Some(Stock::SelectTool)) {
            return;
        }
        let Ok(id) = selected_tool(output.m, output.params[0]) else {
            return;
        };
        self.tool = machine.tools.get(&id).copied().unwrap_or_else(|| {
            let text = format!(
                "M{:02} selects tool {id}, which is not in the tool table",
                output.m
            );
            add_warning(warnings, &diagnostics::WARNS_IN_RUN, output.origin, text);
            Tool::default()
        });
    }
}

/// Returns the position of a motor at the start: this distance from its `start_at`, within its soft limits.
fn position_at_start(motor: &MotorSettings, offset: f64) -> f64 {
    let limits = motor.soft_limits.filter(|[low, high]| low < high);
    let Some([low, high]) = limits else {
        return motor.start_at + offset;
    };
    let at = motor.start_at + offset;
    let other = if at <= high { at } else { motor.start_at - offset };
    other.max(low).min(high)
}

fn add_warning(warnings: &mut Vec<Warning>, entry: &'static DiagnosticEntry, origin: Origin, text: String) {
    let warning = Warning { entry, origin, text };
    if warnings.len() < LISTED_MAX && !warnings.contains(&warning) {
        warnings.push(warning);
    }
}
