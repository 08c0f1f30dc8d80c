//! The device model: components and data items of a machine, as a probe request returns them.

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::machine::{Birth, Identification};

/// Kind of value of a data item.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Category {
    /// A number that changes continuously.
    Sample,
    /// An event or a state.
    Event,
    /// An alarm condition.
    Condition,
}

impl Category {
    /// Returns its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Category::Sample => "SAMPLE",
            Category::Event => "EVENT",
            Category::Condition => "CONDITION",
        }
    }
}

/// A component of the machine.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Component {
    /// Name of its element: `Device`, `Axes`, `Linear`, `Rotary`, `Controller` or `Path`.
    pub element: &'static str,
    /// Unique in the device.
    pub id: String,
    /// Name for people.
    pub name: String,
    /// Index of the parent component; `None` for the device.
    pub parent: Option<usize>,
}

/// An observed data item.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DataItem {
    /// Unique in the device.
    pub id: String,
    /// Kind of value.
    pub category: Category,
    /// Its type, such as `PATH_FEEDRATE`.
    pub kind: &'static str,
    /// Its subtype.
    pub sub_type: Option<&'static str>,
    /// Its unit.
    pub units: Option<&'static str>,
    /// `MACHINE` or `WORK`, for positions.
    pub coordinates: Option<&'static str>,
    /// Index of its component.
    pub component: usize,
}

impl DataItem {
    /// Returns the element name of its observations: for `PATH_FEEDRATE`, this is `PathFeedrate`.
    pub fn element(&self) -> String {
        let mut begins = true;
        let letters = self.kind.chars().filter_map(|letter| {
            let is_first = std::mem::replace(&mut begins, letter == '_');
            (letter != '_').then(|| {
                if is_first {
                    letter
                } else {
                    letter.to_ascii_lowercase()
                }
            })
        });
        letters.collect()
    }
}

/// A machine in the model of MTConnect.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Device {
    /// Its name.
    pub name: String,
    /// Identifier that is unique among all machines.
    pub uuid: String,
    /// Data of its nameplate.
    pub identification: Identification,
    /// Components of the device; each comes after its parent, the device first.
    pub components: Vec<Component>,
    /// Data items of the device.
    pub items: Vec<DataItem>,
}

/// Letters of linear axes.
const LINEAR: [&str; 6] = ["X", "Y", "Z", "U", "V", "W"];

impl Device {
    /// Creates the device of a machine: a path for each coordinate system, and an axis for each motor that belongs to
    /// one.
    pub fn from_birth(birth: &Birth) -> Self {
        let mut device = Self {
            name: birth.machine.clone(),
            uuid: format!("tandem-{}", birth.machine),
            identification: birth.identification.clone(),
            components: Vec::new(),
            items: Vec::new(),
        };
        let root = device.part("Device", "dev", &birth.machine, None);
        for kind in ["AVAILABILITY", "ASSET_CHANGED", "ASSET_REMOVED"] {
            device.event(root, kind, None);
        }
        let axes = device.part("Axes", "axes", "axes", Some(root));
        for system in &birth.coordinate_systems {
            // the axes of the first coordinate system have plain names
            let named = |letter: &str| match system.number {
                1 => letter.to_owned(),
                number => format!("{letter}{number}"),
            };
            for (letter, motor) in &system.axes {
                let is_rotary = birth
                    .motors
                    .iter()
                    .find(|info| info.number == *motor)
                    .map_or(!LINEAR.contains(&letter.as_str()), |info| info.kind == "rotary");
                device.axis(axes, &axis_id(system.number, letter), &named(letter), is_rotary);
            }
            if system.spindle.is_some() {
                device.spindle(axes, &axis_id(system.number, "S"), &named("S"));
            }
        }
        let controller = device.part("Controller", "ctl", "controller", Some(root));
        device.event(controller, "EMERGENCY_STOP", None);
        device.condition(controller, "SYSTEM");
        for system in &birth.coordinate_systems {
            device.path(controller, system.number);
        }
        device
    }

    fn part(&mut self, element: &'static str, id: &str, name: &str, parent: Option<usize>) -> usize {
        self.components.push(Component {
            element,
            id: id.to_owned(),
            name: name.to_owned(),
            parent,
        });
        self.components.len() - 1
    }

    fn add(
        &mut self,
        component: usize,
        category: Category,
        kind: &'static str,
        sub_type: Option<&'static str>,
        units: Option<&'static str>,
    ) -> usize {
        let id = item_id(&self.components[component].id, kind, sub_type);
        self.items.push(DataItem {
            id,
            category,
            kind,
            sub_type,
            units,
            coordinates: None,
            component,
        });
        self.items.len() - 1
    }

    fn event(&mut self, component: usize, kind: &'static str, sub_type: Option<&'static str>) {
        self.add(component, Category::Event, kind, sub_type, None);
    }

    fn percent(&mut self, component: usize, kind: &'static str, sub_type: Option<&'static str>) {
        self.add(component, Category::Event, kind, sub_type, Some("PERCENT"));
    }

    fn sample(
        &mut self,
        component: usize,
        kind: &'static str,
        sub_type: &'static str,
        units: &'static str,
    ) -> usize {
        self.add(component, Category::Sample, kind, Some(sub_type), Some(units))
    }

    fn condition(&mut self, component: usize, kind: &'static str) {
        self.add(component, Category::Condition, kind, None, None);
    }

    fn axis(&mut self, axes: usize, id: &str, name: &str, is_rotary: bool) {
        let (element, kind, units) = if is_rotary {
            ("Rotary", "ANGLE", "DEGREE")
        } else {
            ("Linear", "POSITION", "MILLIMETER")
        };
        let axis = self.part(element, id, name, Some(axes));
        for sub_type in ["ACTUAL", "COMMANDED"] {
            let item = self.sample(axis, kind, sub_type, units);
            self.items[item].coordinates = Some("MACHINE");
        }
        if is_rotary {
            self.event(axis, "ROTARY_MODE", None);
        }
    }

    fn spindle(&mut self, axes: usize, id: &str, name: &str) {
        let spindle = self.part("Rotary", id, name, Some(axes));
        for sub_type in ["ACTUAL", "COMMANDED"] {
            self.sample(spindle, "ROTARY_VELOCITY", sub_type, "REVOLUTION/MINUTE");
        }
        self.percent(spindle, "ROTARY_VELOCITY_OVERRIDE", None);
        self.event(spindle, "ROTARY_MODE", None);
    }

    fn path(&mut self, controller: usize, number: CoordinateSystemNumber) {
        let path = self.part("Path", &path_id(number), &format!("cs{number}"), Some(controller));
        for kind in [
            "EXECUTION",
            "CONTROLLER_MODE",
            "WAIT_STATE",
            "BLOCK",
            "PROGRAM_NEST_LEVEL",
            "TOOL_NUMBER",
            "TOOL_ASSET_ID",
            "WORK_OFFSET",
            "PART_COUNT",
            "MESSAGE",
        ] {
            self.event(path, kind, None);
        }
        for (kind, sub_type) in [
            ("PART_COUNT", "TARGET"),
            ("PART_COUNT", "REMAINING"),
            ("PROGRAM", "MAIN"),
            ("PROGRAM", "ACTIVE"),
            ("LINE_NUMBER", "ABSOLUTE"),
            ("CONTROLLER_MODE_OVERRIDE", "DRY_RUN"),
            ("CONTROLLER_MODE_OVERRIDE", "SINGLE_BLOCK"),
            ("CONTROLLER_MODE_OVERRIDE", "OPTIONAL_STOP"),
        ] {
            self.event(path, kind, Some(sub_type));
        }
        self.percent(path, "PATH_FEEDRATE_OVERRIDE", Some("PROGRAMMED"));
        self.percent(path, "PATH_FEEDRATE_OVERRIDE", Some("RAPID"));
        self.sample(path, "PATH_FEEDRATE", "ACTUAL", "MILLIMETER/SECOND");
        let position = self.sample(path, "PATH_POSITION", "ACTUAL", "MILLIMETER_3D");
        self.items[position].coordinates = Some("MACHINE");
        for kind in ["LOGIC_PROGRAM", "MOTION_PROGRAM", "SYSTEM"] {
            self.condition(path, kind);
        }
    }
}

/// Returns the id of the component of an axis; `S` is the spindle.
pub fn axis_id(cs: CoordinateSystemNumber, letter: &str) -> String {
    format!("ax{cs}{letter}")
}

/// Returns the id of the component of a coordinate system.
pub fn path_id(cs: CoordinateSystemNumber) -> String {
    format!("path{cs}")
}

/// Returns the id of a data item.
pub fn item_id(component: &str, kind: &str, sub_type: Option<&str>) -> String {
    let mut id = format!("{component}_{}", kind.to_ascii_lowercase());
    if let Some(sub_type) = sub_type {
        id.push('_');
        id.push_str(&sub_type.to_ascii_lowercase());
    }
    id
}
