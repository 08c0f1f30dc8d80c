//! Data that NC programs and sequence programs share: variables, tools and work offsets.
//!
//! One lock orders all accesses. A block is interpreted under the read lock; a change of a range of variables, a tool
//! or an offset takes the write lock. So each block sees a change completely or not at all, and blocks never wait for
//! one another.

use std::collections::{BTreeMap, BTreeSet};

use parking_lot::{Mutex, RwLock, RwLockReadGuard, RwLockWriteGuard};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::data::{
    ToolChange, ToolData, ToolTable, VARIABLES_AT_ONCE_MAX, VariableArea, VariableKind, WorkOffsetTable,
};
use plc_protocol::types::request::{Refusal, RefusalCode};
use serde::{Deserialize, Serialize};
use tandem_interp::codes::work_offset::NAMES as WORK_OFFSETS;
use tandem_model::lost::is_lost;
use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::variables::{GLOBAL_VARIABLES, VariableArray};
use tandem_model::{Axis, AxisSet, AxisVector, Variables};

/// Maximum number of tools in the tool table. Further tools are rejected.
pub const TOOLS_MAX: usize = 1000;

/// Work offsets of a coordinate system that has no table of them: all are zero.
const NO_OFFSETS: &WorkOffsets = &WorkOffsets([AxisVector::ZERO; 6]);

/// Values as stored on disk: the JSON text of each value by its name.
pub type KeptValues = BTreeMap<String, Vec<u8>>;

/// Returns the name of a stored value of a coordinate system.
pub fn value_key(what: &str, cs: CoordinateSystemNumber) -> String {
    format!("{what}/{cs}")
}

/// Returns the name of the stored data of a tool.
pub fn tool_key(id: u16) -> String {
    format!("tool_data/{id}")
}

/// Returns the name of the stored work offset of a coordinate system.
pub fn work_offset_key(cs: CoordinateSystemNumber, name: &str) -> String {
    format!("work_offset/{cs}/{name}")
}

/// Text that is stored for a lost value. The JSON text of a value is never equal to it.
pub const LOST_VALUE: &[u8] = b"lost";

/// A work offset in its stored form: values by axis letter, `None` for a lost value.
pub type KeptOffset = BTreeMap<String, Option<f64>>;

/// Adds a value to the stored values under its name.
pub fn keep(values: &mut KeptValues, key: String, value: &impl Serialize) {
    // Numbers, words and lists of them always have a JSON form.
    if let Ok(bytes) = serde_json::to_vec(value) {
        values.insert(key, bytes);
    }
}

/// A tool or an offset in its stored form.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StoredSetting<T> {
    /// Value of the configuration when this entry was written.
    pub configured: T,
    /// Value that is in effect.
    pub now: T,
}

/// The tables of a machine.
#[derive(Debug)]
pub struct Tables {
    variables: BTreeMap<CoordinateSystemNumber, Variables>,
    global: VariableArray,
    axes: BTreeMap<CoordinateSystemNumber, AxisSet>,
    values: RwLock<Values>,
    /// Values of the configuration.
    configured: Values,
    /// Coordinate systems whose spindle tool is unknown.
    unknown_spindles: Mutex<BTreeSet<CoordinateSystemNumber>>,
    /// Serializes changes: held from reading the current values until the new values are in effect.
    changing: Mutex<()>,
}

/// Tools and work offsets. Variables have arrays of their own, to which the same lock applies.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Values {
    /// Tools by their numbers.
    pub tools: BTreeMap<u16, Tool>,
    /// Work offsets of each coordinate system.
    pub work_offsets: BTreeMap<CoordinateSystemNumber, WorkOffsets>,
}

impl Values {
    /// Returns the tool with this number; `None` if the table does not contain it. Number 0 means no tool.
    pub fn tool(&self, id: u16) -> Option<Tool> {
        self.tools.get(&id).copied()
    }

    /// Returns all tools by their numbers.
    pub fn tools(&self) -> &BTreeMap<u16, Tool> {
        &self.tools
    }

    /// Returns the work offsets of a coordinate system.
    pub fn work_offsets(&self, cs: CoordinateSystemNumber) -> &WorkOffsets {
        self.work_offsets.get(&cs).unwrap_or(NO_OFFSETS)
    }

    fn tool_table(&self) -> ToolTable {
        let data = |(id, tool): (&u16, &Tool)| {
            let (id, Tool { length, radius }) = (*id, *tool);
            ToolData { id, radius, length }
        };
        let known = self.tools.iter().filter(|(_, tool)| !tool.is_lost());
        ToolTable {
            tools: known.map(data).collect(),
        }
    }

    fn work_offset_table(&self, cs: CoordinateSystemNumber, axes: AxisSet) -> WorkOffsetTable {
        let named = WORK_OFFSETS.iter().zip(&self.work_offsets(cs).0);
        let by_letter = |offset: &AxisVector| {
            axes.iter()
                .map(|axis| (axis.letter().to_string(), offset[axis]))
                .filter(|(_, value)| !is_lost(*value))
                .collect()
        };
        WorkOffsetTable {
            work_offsets: named
                .map(|(name, offset)| ((*name).to_owned(), by_letter(offset)))
                .collect(),
        }
    }
}

/// Settings of a machine on which its tables depend.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TableSettings {
    /// Tools by their numbers.
    pub tools: BTreeMap<u16, Tool>,
    /// Axes of each coordinate system.
    pub axes: BTreeMap<CoordinateSystemNumber, AxisSet>,
    /// Work offsets of each coordinate system.
    pub work_offsets: BTreeMap<CoordinateSystemNumber, WorkOffsets>,
}

impl Tables {
    /// Creates the tables with the configured values. All variables are zero.
    pub fn new(settings: TableSettings) -> Self {
        let TableSettings {
            tools,
            axes,
            work_offsets,
        } = settings;
        let global = VariableArray::new(GLOBAL_VARIABLES);
        let variables = axes.keys().map(|cs| (*cs, Variables::new(global.clone())));
        let configured = Values { tools, work_offsets };
        Self {
            variables: variables.collect(),
            axes,
            values: RwLock::new(configured.clone()),
            configured,
            unknown_spindles: Mutex::default(),
            global,
            changing: Mutex::default(),
        }
    }

    /// Locks the tables for reading, such as while a block is interpreted. No change occurs until the guard is dropped.
    pub fn read(&self) -> RwLockReadGuard<'_, Values> {
        self.values.read()
    }

    fn write(&self) -> RwLockWriteGuard<'_, Values> {
        self.values.write()
    }

    /// Returns the variables that a program of a coordinate system can access.
    pub fn variables(&self, cs: CoordinateSystemNumber) -> Variables {
        self.variables
            .get(&cs)
            .cloned()
            .unwrap_or_else(|| Variables::new(self.global.clone()))
    }

    /// Returns the P variables.
    pub fn global(&self) -> VariableArray {
        self.global.clone()
    }

    /// Returns the numbers of the coordinate systems in ascending order.
    pub fn coordinate_systems(&self) -> impl Iterator<Item = CoordinateSystemNumber> {
        self.axes.keys().copied()
    }

    /// Returns the values of a range of variables. All of them are from before or from after a write.
    ///
    /// # Errors
    /// Returns a refusal if the range does not exist or is too long, or if a value is lost.
    pub fn read_variables(&self, area: VariableArea, from: u32, count: u32) -> Result<Vec<f64>, Refusal> {
        let array = self.range(area, from, count as usize)?;
        let _no_range_is_written = self.read();
        let numbers = (from as usize..).take(count as usize);
        let values: Vec<f64> = numbers.filter_map(|number| array.get(number)).collect();
        if let Some(lost) = (from..).zip(&values).find(|(_, value)| is_lost(**value)) {
            let letter = letter(area);
            let text = format!(
                "{letter}{} is damaged and has no value; write it again, or stop the runtime and run tandem \
                 store repair",
                lost.0
            );
            return Err(Refusal::new(RefusalCode::Unavailable, text));
        }
        Ok(values)
    }

    /// Returns the values of ranges that exist. All of them are from before or from after a write; a lost value has its
    /// mark.
    pub fn ranges(&self, area: VariableArea, ranges: &[(u32, u32)]) -> Vec<Vec<f64>> {
        let array = match area {
            VariableArea::Global => Some(&self.global),
            VariableArea::CoordinateSystem(cs) => {
                self.variables.get(&cs).map(|of_cs| &of_cs.coordinate_system)
            }
        };
        let _no_range_is_written = self.read();
        let values = |(from, count): &(u32, u32)| {
            let numbers = (*from as usize..).take(*count as usize);
            numbers.filter_map(|number| array?.get(number)).collect()
        };
        ranges.iter().map(values).collect()
    }

    /// Writes a range of variables between two blocks, completely or not at all.
    ///
    /// # Errors
    /// Returns a refusal if the range does not exist or is too long.
    pub fn write_variables(&self, area: VariableArea, from: u32, values: &[f64]) -> Result<(), Refusal> {
        let array = self.range(area, from, values.len())?;
        let _no_block_is_interpreted = self.write();
        for (number, value) in (from as usize..).zip(values) {
            array.set(number, *value);
        }
        Ok(())
    }

    fn range(&self, area: VariableArea, from: u32, count: usize) -> Result<&VariableArray, Refusal> {
        let array = match area {
            VariableArea::Global => &self.global,
            VariableArea::CoordinateSystem(cs) => {
                let of_cs = self.variables.get(&cs).ok_or_else(|| no_coordinate_system(cs))?;
                &of_cs.coordinate_system
            }
        };
        if count == 0 {
            return Err(invalid(
                "the request names no variable; write 1 to 1024 values".into(),
            ));
        }
        if count > VARIABLES_AT_ONCE_MAX {
            let text = format!("{count} variables at once: write at most {VARIABLES_AT_ONCE_MAX}");
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        if (from as usize).saturating_add(count) > array.len() {
            let letter = letter(area);
            return Err(invalid(format!(
                "{count} variables from {letter}{from} on: the variables are {letter}0 to {letter}{}",
                array.len() - 1
            )));
        }
        Ok(array)
    }

    /// Returns the tool table in ascending order of numbers, without lost tools.
    pub fn tools(&self) -> ToolTable {
        self.read().tool_table()
    }

    /// Returns the tool table of the configuration.
    pub fn configured_tools(&self) -> ToolTable {
        self.configured.tool_table()
    }

    /// Replaces the tool table. Called before any program runs.
    pub fn restore_tools(&self, tools: impl Iterator<Item = ToolData>) {
        let tool = |data: ToolData| {
            let ToolData { id, radius, length } = data;
            (id, Tool { length, radius })
        };
        self.write().tools = tools.map(tool).collect();
    }

    /// Returns all values with a change of the tool table applied. The tables themselves do not change.
    ///
    /// # Errors
    /// Returns a refusal if a tool is invalid, named twice or missing, or if the table would be too long.
    pub fn with_tools(&self, change: &ToolChange) -> Result<Values, Refusal> {
        let mut values = self.read().clone();
        for id in &change.remove {
            if values.tools.remove(id).is_none() {
                let text = format!("tool {id} is not in the table; nothing was changed");
                return Err(Refusal::new(RefusalCode::NotFound, text));
            }
        }
        let mut named: BTreeSet<u16> = change.remove.iter().copied().collect();
        for ToolData { id, radius, length } in &change.tools {
            if *id == 0 || !(0.0..f64::INFINITY).contains(radius) || !length.is_finite() {
                return Err(invalid(format!(
                    "tool {id}, radius {radius}, length {length}: write a number from 1, a radius of at \
                     least 0 and a finite length; nothing was changed"
                )));
            }
            if !named.insert(*id) {
                return Err(invalid(format!("tool {id} is named twice; nothing was changed")));
            }
            let (length, radius) = (*length, *radius);
            values.tools.insert(*id, Tool { length, radius });
        }
        if values.tools.len() > TOOLS_MAX {
            let text = format!("the table holds {TOOLS_MAX} tools; remove some first");
            return Err(Refusal::new(RefusalCode::TooLarge, text));
        }
        Ok(values)
    }

    /// Returns the work offsets of a coordinate system by their names, each with its axes.
    ///
    /// # Errors
    /// Returns a refusal if the coordinate system does not exist.
    pub fn work_offsets(&self, cs: CoordinateSystemNumber) -> Result<WorkOffsetTable, Refusal> {
        let axes = *self.axes.get(&cs).ok_or_else(|| no_coordinate_system(cs))?;
        Ok(self.read().work_offset_table(cs, axes))
    }

    /// Returns the work offsets of the configuration.
    pub fn configured_work_offsets(&self, cs: CoordinateSystemNumber) -> WorkOffsetTable {
        let axes = self.axes.get(&cs).copied().unwrap_or(AxisSet::EMPTY);
        self.configured.work_offset_table(cs, axes)
    }

    /// Sets values of work offsets. Called before any program runs. Skips names and axes that the coordinate system
    /// does not have.
    pub fn restore_work_offsets<'a>(
        &self,
        cs: CoordinateSystemNumber,
        values: impl Iterator<Item = (&'a str, &'a str, f64)>,
    ) {
        let axes = self.axes.get(&cs).copied().unwrap_or(AxisSet::EMPTY);
        let mut tables = self.write();
        let offsets = tables.work_offsets.entry(cs).or_default();
        for (name, letter, value) in values {
            if let (Some(place), Some(axis)) = (work_offset_index(name), axis_of(letter, axes)) {
                offsets.0[place][axis] = value;
            }
        }
    }

    /// Returns tools and work offsets in their stored form, each with its configured value (see
    /// `persistence/restore.rs`).
    pub fn kept(&self, values: &Values) -> KeptValues {
        self.kept_with(values, values)
    }

    /// Works as [`Tables::kept`], and also has an entry for each tool of `other`.
    fn kept_with(&self, values: &Values, other: &Values) -> KeptValues {
        let mut kept = KeptValues::new();
        let data = |id: u16, tool: &Tool| {
            let (length, radius) = (tool.length, tool.radius);
            ToolData { id, radius, length }
        };
        let before = self.read();
        let ids = [&before.tools, &values.tools, &other.tools, &self.configured.tools];
        let ids: BTreeSet<u16> = ids.into_iter().flat_map(BTreeMap::keys).copied().collect();
        drop(before);
        for id in ids {
            let of = |values: &Values| values.tools.get(&id).map(|tool| data(id, tool));
            if values.tools.get(&id).is_some_and(Tool::is_lost) {
                kept.insert(tool_key(id), LOST_VALUE.to_vec());
                continue;
            }
            let tool = StoredSetting {
                configured: of(&self.configured),
                now: of(values),
            };
            keep(&mut kept, tool_key(id), &tool);
        }
        for (cs, axes) in &self.axes {
            for (name, place) in WORK_OFFSETS.iter().zip(0..) {
                let of = |values: &Values| -> KeptOffset {
                    let offset: &AxisVector = &values.work_offsets(*cs).0[place];
                    let value = |axis| Some(offset[axis]).filter(|value| !is_lost(*value));
                    axes.iter()
                        .map(|axis| (axis.letter().to_string(), value(axis)))
                        .collect()
                };
                let offset = StoredSetting {
                    configured: of(&self.configured),
                    now: of(values),
                };
                keep(&mut kept, work_offset_key(*cs, name), &offset);
            }
        }
        kept
    }

    /// Records whether the tool in the spindle of a coordinate system is known.
    pub fn note_spindle(&self, cs: CoordinateSystemNumber, is_known: bool) {
        let mut unknown = self.unknown_spindles.lock();
        if is_known {
            unknown.remove(&cs);
        } else {
            unknown.insert(cs);
        }
    }

    /// Returns the coordinate systems whose spindle tool is unknown.
    pub fn unknown_spindles(&self) -> BTreeSet<CoordinateSystemNumber> {
        self.unknown_spindles.lock().clone()
    }

    /// Returns all values, with each lost value replaced by that of `other`. The tables themselves do not change.
    pub fn with_lost_from(&self, other: &Values) -> Values {
        let mut values = self.read().clone();
        for (id, tool) in &other.tools {
            let now = values.tools.entry(*id).or_insert(*tool);
            if now.is_lost() {
                *now = *tool;
            }
        }
        for (cs, axes) in &self.axes {
            let (offsets, other) = (
                values.work_offsets.entry(*cs).or_default(),
                other.work_offsets(*cs),
            );
            for (offset, other) in offsets.0.iter_mut().zip(&other.0) {
                for axis in axes
                    .iter()
                    .filter(|axis| is_lost(offset[*axis]))
                    .collect::<Vec<_>>()
                {
                    offset[axis] = other[axis];
                }
            }
        }
        values
    }

    /// Replaces each lost variable by that of `other`.
    pub fn take_lost_variables(&self, other: &Self) {
        let _no_block_is_interpreted = self.write();
        take_lost(&self.global, &other.global);
        for (cs, variables) in &self.variables {
            take_lost(
                &variables.coordinate_system,
                &other.variables(*cs).coordinate_system,
            );
        }
    }

    /// Returns a description of each lost value.
    pub fn lost(&self) -> Vec<String> {
        let mut lost = lost_ranges("P", &self.global, "");
        for (cs, variables) in &self.variables {
            let of = format!(" of coordinate system {cs}");
            lost.extend(lost_ranges("Q", &variables.coordinate_system, &of));
        }
        let values = self.read();
        let tools = values.tools.iter().filter(|(_, tool)| tool.is_lost());
        lost.extend(tools.map(|(id, _)| format!("tool {id}")));
        for (cs, axes) in &self.axes {
            for (name, offset) in WORK_OFFSETS.iter().zip(&values.work_offsets(*cs).0) {
                let letters = axes.iter().filter(|axis| is_lost(offset[*axis]));
                let letters: Vec<String> = letters.map(|axis| axis.letter().to_string()).collect();
                if !letters.is_empty() {
                    lost.push(format!("{name} {} of coordinate system {cs}", letters.join(", ")));
                }
            }
        }
        let unknown = self.unknown_spindles.lock();
        lost.extend(
            unknown
                .iter()
                .map(|cs| format!("the tool in the spindle of coordinate system {cs}")),
        );
        lost
    }

    /// Returns all values with a change of work offsets applied. The tables themselves do not change.
    ///
    /// # Errors
    /// Returns a refusal if the coordinate system, the offset or the axis does not exist, or if a value is not finite.
    pub fn with_work_offsets(
        &self,
        cs: CoordinateSystemNumber,
        change: &WorkOffsetTable,
    ) -> Result<Values, Refusal> {
        let axes = *self.axes.get(&cs).ok_or_else(|| no_coordinate_system(cs))?;
        let mut values = self.read().clone();
        let offsets = values.work_offsets.entry(cs).or_default();
        for (name, named) in &change.work_offsets {
            let place = work_offset_index(name).ok_or_else(|| {
                let [first, .., last] = WORK_OFFSETS;
                invalid(format!(
                    "there is no work offset {name:.16}; write {first} to {last}"
                ))
            })?;
            for (letter, value) in named {
                let Some(axis) = axis_of(letter, axes).filter(|_| value.is_finite()) else {
                    return Err(invalid(format!(
                        "{name} {letter:.16} = {value}: write a number for an axis of coordinate system {cs}"
                    )));
                };
                offsets.0[place][axis] = *value;
            }
        }
        Ok(values)
    }

    /// Changes tools or work offsets between two blocks, one change at a time. Before a change takes effect, `keep`
    /// writes it to disk; its second argument are the values that undo the change on disk.
    ///
    /// # Errors
    /// Returns the refusal of `changed` or `keep`. Then nothing has changed.
    pub fn change(
        &self,
        changed: impl FnOnce(&Self) -> Result<Values, Refusal>,
        keep: impl FnOnce(KeptValues, KeptValues) -> Result<(), Refusal>,
    ) -> Result<(), Refusal> {
        let _one_at_a_time = self.changing.lock();
        let values = changed(self)?;
        let current = self.read().clone();
        keep(self.kept(&values), self.kept_with(&current, &values))?;
        *self.write() = values;
        Ok(())
    }
}

fn take_lost(array: &VariableArray, other: &VariableArray) {
    for number in 0..array.len() {
        let is_lost = array.get(number).is_some_and(is_lost);
        if let Some(value) = other.get(number).filter(|_| is_lost) {
            array.set(number, value);
        }
    }
}

fn letter(area: VariableArea) -> &'static str {
    match area.kind() {
        VariableKind::P => "P",
        VariableKind::Q => "Q",
    }
}

/// Returns descriptions of the lost variables of an array, such as `P384 to P511`.
fn lost_ranges(letter: &str, array: &VariableArray, of: &str) -> Vec<String> {
    let is_lost_at = |number: &usize| array.get(*number).is_some_and(is_lost);
    let (mut ranges, mut next) = (Vec::new(), 0);
    while let Some(first) = (next..array.len()).find(is_lost_at) {
        let end = (first..array.len()).find(|number| !is_lost_at(number));
        next = end.unwrap_or(array.len());
        ranges.push(match next - first {
            1 => format!("{letter}{first}{of}"),
            _ => format!("{letter}{first} to {letter}{}{of}", next - 1),
        });
    }
    ranges
}

/// Returns the index of the work offset with this name.
fn work_offset_index(name: &str) -> Option<usize> {
    WORK_OFFSETS.iter().position(|known| *known == name)
}

/// Returns the axis with this letter, if it is one of `axes`.
fn axis_of(letter: &str, axes: AxisSet) -> Option<Axis> {
    axes.iter().find(|axis| letter.chars().eq([axis.letter()]))
}

fn invalid(text: String) -> Refusal {
    Refusal::new(RefusalCode::Invalid, text)
}

fn no_coordinate_system(cs: CoordinateSystemNumber) -> Refusal {
    let text = format!("there is no coordinate system {cs}");
    Refusal::new(RefusalCode::NotFound, text)
}

#[cfg(test)]
pub(crate) mod tests;
