//! Variables, tools and work offsets of a machine of paper.

use std::collections::BTreeMap;

use crate::types::CoordinateSystemNumber;
use crate::types::data::{ToolData, ToolTable, VARIABLES_AT_ONCE_MAX, VariableArea, WorkOffsetTable};
use crate::types::request::{Answer, Refusal, RefusalCode, Request};

/// What was set; variables not set are zero.
#[derive(Debug, Default)]
pub(super) struct Data {
    variables: BTreeMap<(VariableArea, u32), f64>,
    tools: BTreeMap<u16, ToolData>,
    work_offsets: BTreeMap<CoordinateSystemNumber, WorkOffsetTable>,
}

impl Data {
    /// The answer to a request of this kind; `None`: it is of another.
    pub(super) fn answer(&mut self, request: &Request) -> Option<Result<Answer, Refusal>> {
        Some(Ok(match request {
            Request::ReadVariables {
                area, from, count, ..
            } => {
                if let Err(refusal) = check_count(*count as usize) {
                    return Some(Err(refusal));
                }
                let value = |number| self.variables.get(&(*area, number)).copied();
                let numbers = *from..from.saturating_add(*count);
                Answer::Variables(numbers.map(|number| value(number).unwrap_or(0.0)).collect())
            }
            Request::WriteVariables {
                area, from, values, ..
            } => {
                if let Err(refusal) = check_count(values.len()) {
                    return Some(Err(refusal));
                }
                let numbered = (*from..).zip(values);
                self.variables
                    .extend(numbered.map(|(number, value)| ((*area, number), *value)));
                Answer::Done
            }
            Request::Tools => Answer::Tools(ToolTable {
                tools: self.tools.values().copied().collect(),
            }),
            Request::WriteTools(change) => {
                self.tools
                    .extend(change.tools.iter().map(|tool| (tool.id, *tool)));
                self.tools.retain(|id, _| !change.remove.contains(id));
                Answer::Done
            }
            Request::WorkOffsets(cs) => {
                Answer::WorkOffsets(self.work_offsets.get(cs).cloned().unwrap_or_default())
            }
            Request::WriteWorkOffsets(cs, change) => {
                let table = self.work_offsets.entry(*cs).or_default();
                for (name, axes) in &change.work_offsets {
                    let offset = table.work_offsets.entry(name.clone()).or_default();
                    offset.extend(axes.iter().map(|(axis, value)| (axis.clone(), *value)));
                }
                Answer::Done
            }
            Request::LastRun(_) => Answer::LastRun(None),
            Request::Journal { .. } => Answer::Journal(Vec::new()),
            _ => return None,
        }))
    }
}

fn check_count(count: usize) -> Result<(), Refusal> {
    if (1..=VARIABLES_AT_ONCE_MAX).contains(&count) {
        return Ok(());
    }
    let text = format!("{count} variables at once: write 1 to {VARIABLES_AT_ONCE_MAX}");
    Err(Refusal::new(RefusalCode::TooLarge, text))
}
