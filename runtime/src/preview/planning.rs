//! Plans a program from beginning to end with the stages of a run; a tracer takes the place of the servo.

use std::sync::Arc;

use plc_protocol::types::data::VariableKind;
use plc_protocol::types::line_start::LineStart;
use plc_protocol::types::output::Timing;
use plc_protocol::types::planned::{PlannedLocation, RehearsalOutcome, RehearsedMCode, RunTimeDependence};
use plc_protocol::types::request::Refusal;
use plc_protocol::types::state::SpindleDirection;
use tandem_config::{ConfiguredSystem, MCodeSettings, Stock, UnhandledReaction};
use tandem_interp::Inputs;
use tandem_model::alarm::COMPENSATION_REFUSED;
use tandem_model::flow::{Item, Output};
use tandem_model::profile::Law;
use tandem_model::settings::Tool;
use tandem_model::{Alarm, AxisVector, MachinePosition, Origin};
use tandem_store::program_store::mentions_variables;

use super::plan::{Plan, PlanContent};
use super::spindle::PlannedSpindle;
use super::tracer::Tracer;
use crate::coordinate_system::{Pipeline, SINGLE_BLOCK_REFUSED, line_search, rest_refused};
use crate::sequence::stock;
use crate::shared::SharedState;

/// Maximum number of items planned ahead. Reason: a program may contain an endless loop.
const ITEMS_MAX: u64 = 20_000_000;

/// Maximum time planned ahead, s (one week).
const TIME_MAX_S: f64 = 7.0 * 86_400.0;

/// Maximum number of M codes that a rehearsal lists one by one.
const M_CODES_MAX: usize = 1000;

/// Number of items between two checks whether the plan is still needed.
const ITEMS_PER_LOOK: u64 = 256;

/// Reason why planning stops.
enum PlanningEnd {
    Completed,
    Alarm(Alarm),
    /// The program does not reach the line at which the run begins.
    NoLine(Refusal),
    TooLong,
    Cancelled,
}

/// Plans the program; calls `on_change` each time the plan has grown.
pub(super) fn plan(shared: &SharedState, plan: &Plan, is_wanted: &dyn Fn() -> bool, on_change: &dyn Fn()) {
    let conditions = &plan.conditions;
    let settings = &conditions.configured.settings;
    let mut pipeline = Pipeline::new(settings, conditions.configured.dialect, conditions.at);
    pipeline.path.set_dry_run(conditions.dry_run);
    if conditions.from.is_none() {
        let main = Arc::clone(&conditions.main.tree);
        pipeline.start(main, conditions.main.number, 0, false);
    }
    let mut planning = Planning {
        shared,
        plan,
        pipeline,
        tracer: Tracer::new(settings, conditions.main.number, conditions.at),
        content: PlanContent::default(),
        captured: conditions.captured,
        tool: conditions.tool,
        has_put_out: false,
        in_block: false,
        spindle: settings.spindle.as_ref().map(PlannedSpindle::new),
    };
    let entered = conditions.from.map_or(Ok(()), |from| planning.enter(&from));
    let stop = entered.map_or_else(|stop| stop, |()| planning.run(is_wanted, on_change));
    planning.complete_plan(stop);
    on_change();
}

struct Planning<'a> {
    shared: &'a SharedState,
    plan: &'a Plan,
    pipeline: Pipeline,
    tracer: Tracer,
    content: PlanContent,
    captured: [f64; tandem_model::AXES_MAX],
    /// Number of the tool in the spindle; `None` if it is lost.
    tool: Option<u16>,
    /// True if an M code was issued; its handler may have set values that the plan does not know.
    has_put_out: bool,
    /// True while a block is planned that single block ends at rest.
    in_block: bool,
    spindle: Option<PlannedSpindle>,
}

impl Planning<'_> {
    /// Enters the program at the line at which the run begins. As in the run, the M codes that the state at
    /// this line requires come first, then the approach.
    fn enter(&mut self, from: &LineStart) -> Result<(), PlanningEnd> {
        let entry =
            line_search::search(self.shared, &self.plan.conditions, from).map_err(PlanningEnd::NoLine)?;
        let mut arrival = self.pipeline.start_from(entry, 0);
        for (kind, index, value) in &arrival.variables {
            let array = match kind {
                VariableKind::P => &self.plan.variables.global,
                VariableKind::Q => &self.plan.variables.coordinate_system,
            };
            array.set(*index, *value);
        }
        for output in std::mem::take(&mut arrival.restore) {
            self.plan_output(&output).map_err(PlanningEnd::Alarm)?;
        }
        // In a run, a handler that selects another tool here ends the run.
        self.tool = arrival.tool;
        self.pipeline.enter(arrival).map_err(PlanningEnd::Alarm)?;
        self.follow();
        // The approach has the same origin as the block to which it leads, so the tracer must separate them.
        self.tracer.end_block();
        Ok(())
    }

    fn run(&mut self, is_wanted: &dyn Fn() -> bool, on_change: &dyn Fn()) -> PlanningEnd {
        for items in 0..ITEMS_MAX {
            if items % ITEMS_PER_LOOK == 0 {
                if self.plan.is_cancelled() || !is_wanted() {
                    return PlanningEnd::Cancelled;
                }
                if self.take_chunks() {
                    self.publish();
                    on_change();
                }
            }
            let item = self.end_single_block().and_then(|()| self.next());
            let item = item.and_then(|item| self.validate_item(item));
            let done = match item {
                Ok(Item::Block(_) | Item::Warning(..)) => Ok(()),
                Ok(Item::Output(output)) => self.plan_output(&output),
                Ok(Item::Stop(_) | Item::NeedsStandstill(_)) => self.pipeline.flush(),
                Ok(Item::End(_)) => {
                    let ended = self.pipeline.flush();
                    self.follow();
                    return ended.map_or_else(PlanningEnd::Alarm, |()| PlanningEnd::Completed);
                }
                Err(alarm) => Err(alarm),
            };
            self.follow();
            if let Err(alarm) = done {
                // Motion that was planned before the failed block is followed to its end.
                let _ = self.pipeline.finish();
                self.follow();
                return PlanningEnd::Alarm(alarm);
            }
            if self.tracer.times().total > TIME_MAX_S {
                return PlanningEnd::TooLong;
            }
        }
        PlanningEnd::TooLong
    }

    /// In single block, ends the motion at rest after each block, as the run does.
    fn end_single_block(&mut self) -> Result<(), Alarm> {
        let is_end = self.in_block && self.pipeline.interpreter.is_between_blocks();
        if !is_end || !self.plan.conditions.single_block {
            return Ok(());
        }
        self.in_block = false;
        self.pipeline.flush()?;
        self.follow();
        let begun = self.pipeline.interpreter.call_stack();
        let origin = begun.filter(|at| at.line > 0).last();
        match origin.filter(|_| self.pipeline.interpreter.modal().compensates()) {
            Some(origin) => Err(Alarm::new(&COMPENSATION_REFUSED, SINGLE_BLOCK_REFUSED).at(origin)),
            None => Ok(()),
        }
    }

    fn next(&mut self) -> Result<Item, Alarm> {
        let conditions = &self.plan.conditions;
        let tool = match self.tool {
            Some(id) => conditions.tools.get(&id).copied(),
            None => Some(Tool::LOST),
        };
        let is_behind_skip = self.pipeline.is_behind_skip();
        let inputs = Inputs {
            programs: &conditions.programs,
            optional_skip: conditions.optional_skip,
            work_offsets: &conditions.work_offsets,
            variables: &self.plan.variables,
            tool,
            tools: &conditions.tools,
            captured: (!is_behind_skip).then_some(self.captured),
            position: self.pipeline.counts_from().map(|position| position.0),
        };
        let item = self.pipeline.next(&inputs);
        self.in_block |= matches!(item, Ok(Item::Block(_) | Item::Stop(_)));
        if let Some(spindle) = &mut self.spindle {
            let rpm = self.pipeline.interpreter.modal().spindle_speed_r_min;
            spindle.follow(rpm, self.tracer.times().total);
        }
        if self.has_put_out && self.content.depends.is_none() {
            self.look_at_block();
        }
        item
    }

    /// Rejects a wait or an end of the program within cutter compensation, and M codes without the declared
    /// parameters.
    fn validate_item(&self, item: Item) -> Result<Item, Alarm> {
        let cs = self.plan.conditions.configured.settings.number;
        if let Item::Output(output) = &item
            && let Some(alarm) = self.shared.refused_output(cs, output)
        {
            return Err(alarm);
        }
        let is_at_once = matches!(&item, Item::Output(output) if self.is_issued_at_once(output));
        match rest_refused(&item).filter(|_| self.pipeline.is_compensating() && !is_at_once) {
            Some(alarm) => Err(alarm),
            None => Ok(item),
        }
    }

    fn is_issued_at_once(&self, output: &Output) -> bool {
        let configured = &self.plan.conditions.configured;
        let settings = self.shared.machine.m_codes.get(&output.m);
        configured.is_issued_at_once(output, settings, self.pipeline.is_compensating())
    }

    /// Passes the planned profiles to the tracer.
    fn follow(&mut self) {
        while let Some(profile) = self.pipeline.ready.pop_front() {
            self.tracer.follow(&profile);
            if let Law::Skip { to, .. } = &profile.law {
                self.depend(profile.origin, "the skip input determines the end of the motion");
                self.end_skip(*to);
            }
        }
        if self.pipeline.is_behind_skip() && self.pipeline.ready.is_empty() {
            let at = self.pipeline.path.position();
            self.end_skip(at.0);
        }
    }

    /// Ends a skip block (G31) at its full distance.
    fn end_skip(&mut self, at: AxisVector) {
        self.pipeline.path.skipped_to(MachinePosition(at));
        let motors = &self.plan.conditions.configured.settings.motors;
        let mut motors: Vec<(u16, f64)> = (motors.iter().zip(at.0))
            .filter_map(|(motor, at)| Some((motor.as_ref()?.number, at)))
            .collect();
        motors.sort_by_key(|(number, _)| *number);
        for (value, (_, at)) in self.captured.iter_mut().zip(motors) {
            *value = at;
        }
        while let Some(planned) = self.pipeline.next_set_aside() {
            if planned.is_err() {
                break;
            }
        }
    }

    fn plan_output(&mut self, output: &Output) -> Result<(), Alarm> {
        let configured = &self.plan.conditions.configured;
        let settings = self.shared.machine.m_codes.get(&output.m);
        let is_with_motion = configured.timing(output, settings) == Timing::WithMotion;
        if !self.is_issued_at_once(output) {
            self.pipeline.flush()?;
            self.follow();
        }
        self.select_tool(output, settings);
        self.content.m_code_count += 1;
        let at_s = self.tracer.times().total;
        let waits = !is_with_motion;
        let spindle_s = self.turn_spindle(output.m, at_s);
        let wait_s = if waits {
            spindle_s.or_else(|| wait_of(self.shared, configured, output.m))
        } else {
            None
        };
        if self.content.m_codes.len() < M_CODES_MAX {
            self.content.m_codes.push(RehearsedMCode {
                m: output.m,
                program: output.origin.program,
                line: output.origin.line,
                at_s,
                waits,
                wait_s,
            });
        }
        if waits {
            let segment = self.pipeline.planner.last_segment();
            self.tracer
                .wait(output.origin, segment, wait_s.unwrap_or_default());
        }
        Ok(())
    }

    /// Selects the tool if the configuration declares that this M code selects tools, regardless of its
    /// handler. Other effects of a handler are unknown.
    fn select_tool(&mut self, output: &Output, settings: Option<&MCodeSettings>) {
        let cs = self.plan.conditions.configured.settings.number;
        let selected = match settings {
            Some(settings) if selects_tool(settings) => stock::selected_tool(output.m, output.params[0]).ok(),
            _ => None,
        };
        self.tool = selected.or(self.tool);
        self.has_put_out |= selected.is_none() || self.shared.is_handled(cs, output.m);
    }

    /// Returns true if no M code is configured to select tools, so that any handler may select a tool.
    fn any_may_select(&self) -> bool {
        !self.shared.machine.m_codes.values().any(selects_tool)
    }

    /// Returns the time that the stock sequence program takes for M03, M04 or M05. Returns `None` for any
    /// other M code, and if a handler serves the M code.
    fn turn_spindle(&mut self, m: u16, at_s: f64) -> Option<f64> {
        let direction = stock::spindle_direction(m)?;
        let spindle = self.spindle.as_mut()?;
        let cs = self.plan.conditions.configured.settings.number;
        let rpm = self.pipeline.interpreter.modal().spindle_speed_r_min;
        let takes_s = spindle.command(direction, rpm, at_s);
        if direction == SpindleDirection::Orient || self.shared.is_handled(cs, m) {
            return None;
        }
        let settings = self.shared.machine.m_codes.get(&m);
        Some(takes_s.max(settings.map_or(0.0, |settings| settings.simulated_s)))
    }

    /// Records the block that has begun, if it may read a value that a handler has set.
    fn look_at_block(&mut self) {
        let Some(began) = self.pipeline.interpreter.began() else {
            return;
        };
        let text = self
            .plan
            .conditions
            .texts
            .get(&began.program)
            .map(|program| program.line(began.line));
        let text = text.unwrap_or_default();
        let text = text.split("//").next().unwrap_or_default();
        if mentions_variables(text) {
            self.depend(
                began,
                "it reads a variable that the handler of an earlier M code may set",
            );
        } else if takes_tool(text) && self.any_may_select() {
            self.depend(
                began,
                "it uses the tool that the handler of an earlier M code selects",
            );
        }
    }

    fn depend(&mut self, origin: Origin, why: &str) {
        if self.content.depends.is_none() {
            self.content.depends = Some(RunTimeDependence {
                program: origin.program,
                line: origin.line,
                at_s: self.tracer.times().total,
                why: why.to_owned(),
            });
        }
    }

    fn take_chunks(&mut self) -> bool {
        let is_new = !self.tracer.chunks.is_empty();
        self.content
            .chunks
            .extend(self.tracer.chunks.drain(..).map(Arc::new));
        is_new
    }

    fn publish(&mut self) {
        self.content.palette.clone_from(&self.tracer.palette.0);
        self.content.times = self.tracer.times();
        self.content.axes = self.tracer.axes().copied().collect();
        self.content.corners = self.tracer.corners();
        self.content.marks.clone_from(&self.tracer.marks);
        self.content.is_cut = self.tracer.is_cut();
        self.plan.publish(self.content.clone());
    }

    fn complete_plan(&mut self, stop: PlanningEnd) {
        self.tracer.finish_chunks();
        self.take_chunks();
        let last = self.tracer.marks.last().map(|mark| mark.origin);
        let (outcome, text, at) = match stop {
            PlanningEnd::Cancelled => return,
            PlanningEnd::Completed => (RehearsalOutcome::Completed, String::new(), None),
            PlanningEnd::Alarm(alarm) => {
                let text = format!("{}: {}", alarm.entry.title, alarm.text);
                (RehearsalOutcome::Alarm, text, alarm.origin)
            }
            PlanningEnd::NoLine(refusal) => (RehearsalOutcome::Alarm, refusal.text, None),
            PlanningEnd::TooLong => {
                let text = format!(
                    "planning ends here: a program of more than {ITEMS_MAX} blocks or a week may be endless"
                );
                (RehearsalOutcome::TooLong, text, last)
            }
        };
        self.content.outcome = outcome;
        self.content.text = text;
        self.content.at = at.map(|Origin { program, line, .. }| PlannedLocation { program, line });
        self.publish();
    }
}

/// Returns the time that a program waits for an M code, s; `None` if the time is unknown.
pub(super) fn wait_of(shared: &SharedState, configured: &ConfiguredSystem, m: u16) -> Option<f64> {
    let cs = configured.settings.number;
    if let Some(measured_s) = shared.m_code_wait(cs, m) {
        return Some(measured_s);
    }
    if shared.is_handled(cs, m) {
        return None;
    }
    let settings = shared.machine.m_codes.get(&m);
    if let Some(settings) = settings.filter(|settings| settings.stock.is_some()) {
        return Some(settings.simulated_s);
    }
    let unhandled = settings.and_then(|settings| settings.unhandled);
    let unhandled = unhandled.unwrap_or(shared.machine.unhandled);
    let has_spindle = configured.settings.spindle.is_some();
    let is_at_once = unhandled == UnhandledReaction::AutoReset || has_spindle && stock::is_spindle_code(m);
    is_at_once.then_some(0.0)
}

fn selects_tool(settings: &MCodeSettings) -> bool {
    settings.stock == Some(Stock::SelectTool)
}

/// Returns true if the text of a block contains a word that uses the tool in the spindle.
fn takes_tool(text: &str) -> bool {
    let text = text.to_ascii_uppercase();
    let mut words = text.split('G').skip(1);
    words.any(|word| {
        let digits = word.len() - word.trim_start_matches(|c: char| c.is_ascii_digit()).len();
        matches!(&word[..digits], "41" | "42" | "43" | "44")
    })
}

#[cfg(test)]
mod tests {
    use super::takes_tool;

    #[test]
    fn blocks_with_g41_to_g44_take_the_tool() {
        for text in ["G43 Z5", "g01g41X1", "N5 G42"] {
            assert!(takes_tool(text), "{text}");
        }
        for text in ["G40", "G01 X43", "G410", ""] {
            assert!(!takes_tool(text), "{text}");
        }
    }
}
