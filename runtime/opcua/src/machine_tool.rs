//! OPC 40501, machine tools: the object of a machine below `Machines`, and its values.

use opcua::types::{LocalizedText, NodeId, QualifiedName, ReferenceTypeId, Variant};
use plc_protocol::types::machine::{AlarmSeverity, CoordinateSystemInfo};
use plc_protocol::types::state::{Execution, RunKind, State};

use crate::cnc;
use crate::instance::Builder;
use crate::nodesets::{MACHINE_TOOL, MACHINERY};
use crate::program::{ActiveProgram, ProgramState};
use crate::values::{PERCENT, Values, range};
use crate::view::{Channel, View};

/// Path of the machine.
pub const MACHINE: &str = "MachineTool";

/// Path of the object whose events are alarms and messages.
pub const MESSAGES: &str = "MachineTool/Notification/Messages";

/// Path of the program that is loaded or runs.
pub const PROGRAM: &str = "MachineTool/Production/ActiveProgram";

/// Parts of the machine tool that its type declares as optional.
const OPTIONAL: [&str; 8] = [
    "Identification/ComponentName",
    "Identification/SoftwareIdentification",
    "Identification/SoftwareRevision",
    "Monitoring/MachineTool/MachineryItemState",
    "Monitoring/MachineTool/MachineryOperationMode",
    "Notification/Messages",
    "Production/ActiveProgram/JobIdentifier",
    "Production/ActiveProgram/State/LastTransition",
];

/// Indices of the namespaces whose states are named by their nodes.
#[derive(Debug, Clone, Copy)]
pub struct Spaces {
    pub machine_tool: u16,
    pub machinery: u16,
}

fn monitoring(name: &str) -> String {
    format!("{MACHINE}/Monitoring/{name}")
}

fn channel_path(info: &CoordinateSystemInfo) -> String {
    monitoring(&format!("cs{}", info.number))
}

fn spindle_path(info: &CoordinateSystemInfo) -> String {
    monitoring(&cnc::axis_name(info, "S"))
}

/// Builds the nodes of a machine.
pub fn build(builder: &mut Builder<'_>, view: &View) {
    let machine_tool = builder.namespace(MACHINE_TOOL);
    let machines = NodeId::new(builder.namespace(MACHINERY), 1001);
    let known = identification(view);
    let known_paths: Vec<String> = known
        .iter()
        .map(|(name, _)| format!("Identification/{name}"))
        .collect();
    let optional: Vec<&str> = OPTIONAL
        .into_iter()
        .chain(known_paths.iter().map(String::as_str))
        .collect();
    let name = QualifiedName::new(builder.id(MACHINE).namespace, view.birth.machine.as_str());
    builder.object(
        MACHINE,
        name,
        &NodeId::new(machine_tool, 13),
        &machines,
        ReferenceTypeId::Organizes,
        &optional,
    );
    builder.emits_events(&builder.id(MESSAGES));
    builder.emits_events(&builder.id(&format!("{PROGRAM}/State")));
    for (name, value) in known {
        builder.set(&format!("{MACHINE}/Identification/{name}"), value);
    }
    let software = format!("{MACHINE}/Identification/SoftwareIdentification");
    let parent = builder.id(&software);
    builder.object(
        &format!("{software}/Tandem"),
        QualifiedName::new(parent.namespace, "Tandem"),
        &NodeId::new(machine_tool, 43),
        &parent,
        ReferenceTypeId::HasComponent,
        &["Manufacturer"],
    );
    builder.set(&format!("{software}/Tandem/Identifier"), "Tandem");
    builder.set(
        &format!("{software}/Tandem/Manufacturer"),
        LocalizedText::from("Tandem"),
    );
    builder.set(&format!("{PROGRAM}/NumberInList"), 0_u16);
    for info in &view.birth.coordinate_systems {
        build_channel(builder, info);
        if info.spindle.is_some() {
            build_spindle(builder, info);
        }
    }
}

/// Returns the data of the machine's nameplate.
fn identification(view: &View) -> Vec<(&'static str, Variant)> {
    let plate = &view.birth.identification;
    let text = |text: &Option<String>| {
        text.as_deref()
            .map(|text| Variant::from(LocalizedText::from(text)))
    };
    let string = |text: &Option<String>| text.as_deref().map(Variant::from);
    let name = Some(view.birth.machine.clone());
    let all = [
        ("ComponentName", text(&name)),
        ("Location", string(&plate.location)),
        ("Manufacturer", text(&plate.manufacturer)),
        ("Model", text(&plate.model)),
        ("ProductInstanceUri", string(&plate.product_instance_uri)),
        ("SerialNumber", string(&plate.serial_number)),
        (
            "YearOfConstruction",
            plate.year_of_construction.map(Variant::from),
        ),
    ];
    all.into_iter()
        .filter_map(|(name, value)| Some((name, value?)))
        .collect()
}

fn build_channel(builder: &mut Builder<'_>, info: &CoordinateSystemInfo) {
    let path = channel_path(info);
    let name = format!("cs{}", info.number);
    build_monitored(
        builder,
        &path,
        &name,
        16,
        &["ChannelModifiers", "ChannelModifiers/BlockSkip", "RapidOverride"],
    );
    for (name, most) in [("FeedOverride", 200.0), ("RapidOverride", 100.0)] {
        builder.set(&format!("{path}/{name}/EngineeringUnits"), PERCENT);
        builder.set(&format!("{path}/{name}/EURange"), range(0.0, most));
    }
}

fn build_spindle(builder: &mut Builder<'_>, info: &CoordinateSystemInfo) {
    let path = spindle_path(info);
    build_monitored(builder, &path, &cnc::axis_name(info, "S"), 22, &["Override"]);
    builder.set(&format!("{path}/Override/EngineeringUnits"), PERCENT);
    builder.set(&format!("{path}/Override/EURange"), range(0.0, 200.0));
}

fn build_monitored(builder: &mut Builder<'_>, path: &str, name: &str, type_id: u32, optional: &[&str]) {
    let parent = builder.id(&format!("{MACHINE}/Monitoring"));
    let type_id = NodeId::new(builder.namespace(MACHINE_TOOL), type_id);
    let browse_name = QualifiedName::new(parent.namespace, name);
    builder.object(
        path,
        browse_name,
        &type_id,
        &parent,
        ReferenceTypeId::HasComponent,
        optional,
    );
    builder.set(&format!("{path}/Name"), name);
}

/// Adds the values of the machine as a whole.
pub fn machine_values(view: &View, spaces: Spaces, values: &mut Values) {
    let version = Some(view.presence.version.as_str());
    let identification = format!("{MACHINE}/Identification");
    values.put(&identification, "SoftwareRevision", version);
    let software = format!("{identification}/SoftwareIdentification/Tandem");
    values.put(&software, "SoftwareRevision", version);
    let path = monitoring("MachineTool");
    let states = states(view);
    let is_by_hand = states.as_ref().map(|states| {
        let mut kinds = states.iter().filter_map(|state| state.run_kind);
        kinds.any(|kind| kind != RunKind::Program)
    });
    // MachineOperationMode: Manual, Automatic
    values.put(
        &path,
        "OperationMode",
        is_by_hand.map(|is_by_hand| i32::from(!is_by_hand)),
    );
    let mode = is_by_hand.map(|is_by_hand| {
        if is_by_hand {
            ("Setup", 5061)
        } else {
            ("Processing", 5060)
        }
    });
    put_state(
        &format!("{path}/MachineryOperationMode"),
        spaces.machine_tool,
        mode,
        values,
    );
    let alarms = view.alarms.as_ref();
    let item = states.zip(alarms).map(|(states, active)| {
        let is_alarm = |severity: AlarmSeverity| severity == AlarmSeverity::Alarm;
        if active.alarms.iter().any(|alarm| is_alarm(alarm.severity)) {
            ("OutOfService", 5004)
        } else if states
            .iter()
            .any(|state| matches!(state.execution, Execution::Active | Execution::Wait))
        {
            ("Executing", 5006)
        } else {
            ("NotExecuting", 5007)
        }
    });
    put_state(
        &format!("{path}/MachineryItemState"),
        spaces.machinery,
        item,
        values,
    );
}

/// Returns the states of all coordinate systems; `None` until all are known.
fn states(view: &View) -> Option<Vec<&State>> {
    let systems = view.birth.coordinate_systems.iter();
    systems
        .map(|info| view.channel(info.number)?.1.state.as_ref())
        .collect()
}

/// Writes the state of a state machine: its name, and the number of its node.
fn put_state(path: &str, namespace: u16, state: Option<(&'static str, u32)>, values: &mut Values) {
    values.put(
        path,
        "CurrentState",
        state.map(|(name, _)| LocalizedText::from(name)),
    );
    values.put(
        path,
        "CurrentState/Id",
        state.map(|(_, id)| NodeId::new(namespace, id)),
    );
}

/// Adds the values of a coordinate system.
pub fn channel_values(info: &CoordinateSystemInfo, channel: &Channel, values: &mut Values) {
    let path = channel_path(info);
    let state = channel.state.as_ref();
    values.put(
        &path,
        "ChannelState",
        state.map(|state| cnc::channel_status(state.execution)),
    );
    values.put(
        &path,
        "ChannelMode",
        state.map(|state| channel_mode(state.run_kind)),
    );
    let overrides = channel.overrides;
    values.put(&path, "FeedOverride", overrides.map(|overrides| overrides.feed));
    values.put(&path, "RapidOverride", overrides.map(|overrides| overrides.rapid));
    let modifiers = format!("{path}/ChannelModifiers");
    values.put(&modifiers, "DryRun", state.map(|state| state.dry_run));
    values.put(&modifiers, "OptionalStop", state.map(|state| state.optional_stop));
    values.put(&modifiers, "SingleStep", state.map(|state| state.single_block));
    values.put(
        &modifiers,
        "BlockSkip",
        state.map(|state| !state.optional_skip.is_empty()),
    );
    if info.spindle.is_some() {
        let path = spindle_path(info);
        let rpm = channel.position.as_ref().map(|position| position.spindle_rpm);
        values.put(&path, "IsRotating", rpm.map(|rpm| cnc::turn_direction(rpm) != 0));
        values.put(&path, "Override", overrides.map(|overrides| overrides.spindle));
    }
}

/// Returns `ChannelMode`: Automatic, `MdaMdi`, `JogManual`; Reference is 6.
fn channel_mode(run_kind: Option<RunKind>) -> i32 {
    match run_kind {
        Some(RunKind::Mdi) => 1,
        Some(RunKind::Jog) => 2,
        Some(RunKind::Home) => 6,
        _ => 0,
    }
}

/// Adds the values of the active program: that of the first coordinate system.
pub fn program_values(program: &ActiveProgram, spaces: Spaces, values: &mut Values) {
    let known = program.status();
    values.put(PROGRAM, "Name", known.map(|known| known.name.as_str()));
    values.put(PROGRAM, "JobIdentifier", known.map(|known| known.job.as_str()));
    let state = known.map(|known| known.state);
    let path = format!("{PROGRAM}/State");
    put_state(
        &path,
        spaces.machine_tool,
        state.map(|state| (state.name(), state.node())),
        values,
    );
    values.put(&path, "CurrentState/Number", state.map(ProgramState::number));
    let last = program.last();
    values.put(
        &path,
        "LastTransition",
        last.map(|last| LocalizedText::from(last.name)),
    );
    values.put(
        &path,
        "LastTransition/Id",
        last.map(|last| NodeId::new(spaces.machine_tool, last.node)),
    );
    values.put(&path, "LastTransition/Number", last.map(|last| last.number));
}
