//! A run that starts at a given line: it issues the M codes that the state at the line needs, moves the axes to the
//! start of the line, then continues the program.

use std::sync::Arc;

use plc_protocol::types::data::VariableKind;
use plc_protocol::types::line_start::LineStart;
use plc_protocol::types::request::Refusal;
use tandem_model::Alarm;
use tandem_model::alarm::TOOL_DIFFERS;
use tandem_store::program_store::StoredProgram;

use super::active_run::{ActiveRun, ActiveRunKind};
use super::conditions::Conditions;
use super::line_search::{LineArrival, LineEntry, search};
use super::run_state::Then;
use crate::coordinate_system::CoordinateSystem;

impl CoordinateSystem {
    /// Creates the run of a program or of its next part. If the run does not begin at line 1, also returns the entry at
    /// its line. The texts of its programs stay in the store until the run ends.
    pub(crate) fn new_program_run(
        &self,
        run_id: String,
        main: &Arc<StoredProgram>,
        from: Option<&LineStart>,
    ) -> Result<(ActiveRun, Option<LineEntry>), Refusal> {
        let context = &self.context;
        let all = context.shared.store.all();
        let conditions = Conditions::of_run(
            &context.shared,
            &context.view,
            &context.configured,
            Arc::clone(main),
            &all,
            from.copied(),
        );
        let entry = from.map(|from| search(&context.shared, &conditions, from));
        let entry = entry.transpose()?;
        (context.shared.store).begin_run(context.number, &run_id, &conditions.texts)?;
        let run = ActiveRun {
            id: run_id,
            conditions: Some(Arc::new(conditions)),
            ..self.new_run(ActiveRunKind::Program, Arc::clone(main), &all)
        };
        Ok((run, entry))
    }

    /// Restores the state at the line of `entry`, except for the outputs and the position of the axes.
    pub(crate) fn begin_at_line(&mut self, entry: LineEntry) -> LineArrival {
        self.past.manual_goes_on = false;
        let arrival = self.pipeline.start_from(entry, self.servo.epoch());
        let variables = &self.context.variables;
        for (kind, index, value) in &arrival.variables {
            let array = match kind {
                VariableKind::P => &variables.global,
                VariableKind::Q => &variables.coordinate_system,
            };
            array.set(*index, *value);
        }
        self.publish_modal(&self.pipeline.in_force.modal);
        let (transform, stack) = (
            self.pipeline.in_force.transform,
            Arc::clone(&self.pipeline.in_force.stack),
        );
        self.context.view.update(|place| {
            place.transform = transform;
            place.stack = stack;
        });
        arrival
    }

    /// Executes the next step towards the first line of the run: issues an output, or plans the approach. Returns false
    /// if no step is left.
    pub(crate) fn approach_line(&mut self) -> bool {
        let Some(run) = self.state.run_mut() else {
            return false;
        };
        let Some(mut arrival) = run.arrival.take() else {
            return false;
        };
        if let Some(output) = arrival.restore.pop_front() {
            run.arrival = Some(arrival);
            let context = &self.context;
            let refused = context.shared.refused_output(context.number, &output);
            self.stand_still_then(refused.map_or(Then::Output(output), Then::Alarm));
            return true;
        }
        run.steps.in_block = true;
        let target = arrival.target;
        let entered = if arrival.tool == self.inputs.tool {
            self.pipeline.enter(*arrival)
        } else {
            let name =
                |tool: Option<u16>| tool.map_or("an unknown tool".to_owned(), |id| format!("tool {id}"));
            let (needed, here) = (name(arrival.tool), name(self.inputs.tool));
            let text = format!(
                "the program needs {needed} in line {}, but the spindle has {here}",
                target.line
            );
            Err(Alarm::new(&TOOL_DIFFERS, text))
        };
        if let Err(alarm) = entered {
            self.stand_still_then(Then::Alarm(alarm.at(target)));
        }
        true
    }
}

#[cfg(test)]
mod tests;
