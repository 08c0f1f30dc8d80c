//! Variables, tools and work offsets of the scripted machine.

use std::collections::BTreeMap;

use crate::types::CoordinateSystemNumber;
use crate::types::data::{
    PublishedVariables, ToolChange, ToolData, ToolTable, VARIABLES_AT_ONCE_MAX, VariableArea, VariableValues,
    WorkOffsetTable, WorkOffsetValues,
};
use crate::types::message::Payload;
use crate::types::request::{Answer, Refusal, RefusalCode};
use crate::types::topic::{CsTopic, Topic};

/// Variables, tools and work offsets that requests have set. A variable that was never set is zero.
#[derive(Debug, Default)]
pub(super) struct Data {
    variables: BTreeMap<(VariableArea, u32), f64>,
    tools: BTreeMap<u16, ToolData>,
    work_offsets: BTreeMap<CoordinateSystemNumber, WorkOffsetTable>,
    published: Vec<(VariableArea, u32, u32)>,
}

impl Data {
    pub(super) fn read(&self, area: VariableArea, from: u32, count: u32) -> Result<Answer, Refusal> {
        check_count(count as usize)?;
        let value = |number| self.variables.get(&(area, number)).copied();
        let numbers = from..from.saturating_add(count);
        let values = numbers.map(|number| value(number).unwrap_or(0.0));
        Ok(Answer::Variables(values.collect()))
    }

    pub(super) fn write(&mut self, area: VariableArea, from: u32, values: &[f64]) -> Result<Answer, Refusal> {
        check_count(values.len())?;
        let numbered = (from..).zip(values);
        self.variables
            .extend(numbered.map(|(number, value)| ((area, number), *value)));
        Ok(Answer::Done)
    }

    pub(super) fn tools(&self) -> Answer {
        Answer::Tools(self.tool_table())
    }

    fn tool_table(&self) -> ToolTable {
        ToolTable {
            tools: self.tools.values().copied().collect(),
        }
    }

    /// Adds `count` variables from number `from` on to the variables that this machine publishes.
    pub(super) fn publish(&mut self, area: VariableArea, from: u32, count: u32) {
        self.published.push((area, from, count));
    }

    /// Returns the messages of variables, tools and work offsets with their current values.
    pub(super) fn messages(&self, systems: &[CoordinateSystemNumber]) -> Vec<(Topic, Payload)> {
        let mut messages = vec![
            (Topic::Variables, self.published_variables(VariableArea::Global)),
            (Topic::Tools, Payload::Tools(self.tool_table())),
        ];
        for cs in systems {
            let variables = self.published_variables(VariableArea::CoordinateSystem(*cs));
            messages.push((Topic::cs(*cs, CsTopic::Variables), variables));
            let work_offsets = self.work_offsets.get(cs).cloned().unwrap_or_default();
            let values = WorkOffsetValues {
                work_offsets: work_offsets.work_offsets,
            };
            messages.push((Topic::cs(*cs, CsTopic::WorkOffsets), Payload::WorkOffsets(values)));
        }
        messages
    }

    fn published_variables(&self, area: VariableArea) -> Payload {
        let of_area = self.published.iter().filter(|(of, ..)| *of == area);
        let variables = of_area.map(|(_, from, count)| {
            let numbers = *from..from.saturating_add(*count);
            let values = numbers.map(|number| self.variables.get(&(area, number)).copied().unwrap_or(0.0));
            VariableValues::new(area.kind(), *from, values)
        });
        Payload::Variables(PublishedVariables {
            variables: variables.collect(),
        })
    }

    pub(super) fn change_tools(&mut self, change: &ToolChange) -> Answer {
        self.tools
            .extend(change.tools.iter().map(|tool| (tool.id, *tool)));
        self.tools.retain(|id, _| !change.remove.contains(id));
        Answer::Done
    }

    pub(super) fn work_offsets(&self, cs: CoordinateSystemNumber) -> Answer {
        Answer::WorkOffsets(self.work_offsets.get(&cs).cloned().unwrap_or_default())
    }

    pub(super) fn change_work_offsets(
        &mut self,
        cs: CoordinateSystemNumber,
        change: WorkOffsetTable,
    ) -> Answer {
        let table = self.work_offsets.entry(cs).or_default();
        for (name, axes) in change.work_offsets {
            table.work_offsets.entry(name).or_default().extend(axes);
        }
        Answer::Done
    }
}

fn check_count(count: usize) -> Result<(), Refusal> {
    if (1..=VARIABLES_AT_ONCE_MAX).contains(&count) {
        return Ok(());
    }
    let text = format!("{count} variables at once: write 1 to {VARIABLES_AT_ONCE_MAX}");
    Err(Refusal::new(RefusalCode::TooLarge, text))
}
