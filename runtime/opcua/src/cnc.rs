//! OPC 40502, CNC systems: the nodes of a machine, and their values.

use opcua::types::{NodeId, ObjectId, QualifiedName, ReferenceTypeId};
use plc_api::Execution;
use plc_protocol::types::machine::CoordinateSystemInfo;
use plc_protocol::types::state::{Position, Reason, RunKind, SpindleDirection, State};

use crate::instance::Builder;
use crate::nodesets::CNC;
use crate::values::{
    DEGREE, MILLIMETRE, MILLIMETRE_PER_MINUTE, PERCENT, REVOLUTIONS_PER_MINUTE, Unit, Values, range,
};
use crate::view::{Channel, View};

/// Path of the CNC interface.
pub const INTERFACE: &str = "CNC";

/// Letters of the axes for which a channel reports tool positions.
const LETTERS: [&str; 6] = ["X", "Y", "Z", "A", "B", "C"];

/// Change below which a position is unchanged and a distance is zero, mm or degrees. Reason: rounding errors of
/// the servo.
const MOVED_MIN: f64 = 1e-6;

/// Relative deviation from the commanded speed within which a spindle is at its speed.
const SPEED_TOLERANCE: f64 = 0.01;

/// Returns the path of the channel of a coordinate system.
pub fn channel_path(info: &CoordinateSystemInfo) -> String {
    format!("{INTERFACE}/CncChannelList/cs{}", info.number)
}

/// Returns the name of an axis, unique in the machine: the axes of the first coordinate system have plain letters.
pub fn axis_name(info: &CoordinateSystemInfo, letter: &str) -> String {
    match info.number {
        1 => letter.to_owned(),
        number => format!("{letter}{number}"),
    }
}

fn axis_path(info: &CoordinateSystemInfo, letter: &str) -> String {
    format!("{INTERFACE}/CncAxisList/{}", axis_name(info, letter))
}

fn spindle_path(info: &CoordinateSystemInfo) -> String {
    format!("{INTERFACE}/CncSpindleList/{}", axis_name(info, "S"))
}

/// Builds the nodes of a machine.
pub fn build(builder: &mut Builder<'_>, view: &View) {
    let cnc = builder.namespace(CNC);
    let interface = builder.object(
        INTERFACE,
        QualifiedName::new(cnc, "CncInterface"),
        &NodeId::new(cnc, 1007),
        &ObjectId::ObjectsFolder.into(),
        ReferenceTypeId::Organizes,
        &["CncTypeName"],
    );
    builder.emits_events(&interface);
    builder.set(&format!("{INTERFACE}/VendorName"), "Tandem");
    builder.set(&format!("{INTERFACE}/Version"), "1.0.0");
    builder.set(&format!("{INTERFACE}/CncTypeName"), view.birth.machine.as_str());
    for info in &view.birth.coordinate_systems {
        let channel = build_channel(builder, view, info);
        for (letter, motor) in &info.axes {
            build_axis(builder, view, info, &channel, (letter, *motor));
        }
        if let Some(motor) = info.spindle {
            build_spindle(builder, view, info, &channel, motor);
        }
    }
}

fn build_channel(builder: &mut Builder<'_>, view: &View, info: &CoordinateSystemInfo) -> NodeId {
    let cnc = builder.namespace(CNC);
    let path = channel_path(info);
    let list = builder.id(&format!("{INTERFACE}/CncChannelList"));
    let name = QualifiedName::new(list.namespace, format!("cs{}", info.number));
    let type_id = NodeId::new(cnc, 1002);
    let channel = builder.object(
        &path,
        name,
        &type_id,
        &list,
        ReferenceTypeId::HasComponent,
        &["ActMainProgramLine", "ActProgramLine"],
    );
    builder.set(&format!("{path}/Id"), u32::from(info.number));
    for (name, unit, range) in [
        ("ActFeedrate", MILLIMETRE_PER_MINUTE, None),
        ("CmdFeedrate", MILLIMETRE_PER_MINUTE, None),
        ("ActOverride", PERCENT, Some(range(0.0, 200.0))),
        ("CmdOverride", PERCENT, Some(range(0.0, 200.0))),
    ] {
        builder.set(&format!("{path}/{name}/EngineeringUnits"), unit);
        if let Some(range) = range {
            builder.set(&format!("{path}/{name}/EURange"), range);
        }
    }
    for (letter, motor) in info
        .axes
        .iter()
        .filter(|(letter, _)| LETTERS.contains(&letter.as_str()))
    {
        for space in ["Wcs", "Bcs"] {
            let position = format!("{path}/PosTcp{space}{letter}");
            builder.set(
                &format!("{position}/EngineeringUnits"),
                unit_of(view, letter, *motor),
            );
        }
        limits(builder, view, *motor, &format!("{path}/PosTcpBcs{letter}"));
    }
    channel
}

fn build_axis(
    builder: &mut Builder<'_>,
    view: &View,
    info: &CoordinateSystemInfo,
    channel: &NodeId,
    (letter, motor): (&str, u16),
) {
    let cnc = builder.namespace(CNC);
    let path = axis_path(info, letter);
    let list = builder.id(&format!("{INTERFACE}/CncAxisList"));
    let name = QualifiedName::new(list.namespace, axis_name(info, letter));
    let type_id = NodeId::new(cnc, 1004);
    let axis = builder.object(&path, name, &type_id, &list, ReferenceTypeId::HasComponent, &[]);
    builder.reference(channel, &axis, ReferenceTypeId::HasComponent);
    let unit = unit_of(view, letter, motor);
    builder.set(&format!("{path}/ActChannel"), channel.clone());
    builder.set(&format!("{path}/IsRotational"), is_rotary(view, letter, motor));
    builder.set(&format!("{path}/IsVirtual"), true);
    builder.set(&format!("{path}/IsInactive"), false);
    builder.set(&format!("{path}/PosDirect/EngineeringUnits"), unit);
    builder.set(&format!("{path}/ZeroOffset/EngineeringUnits"), unit);
    limits(builder, view, motor, &format!("{path}/PosDirect"));
}

fn build_spindle(
    builder: &mut Builder<'_>,
    view: &View,
    info: &CoordinateSystemInfo,
    channel: &NodeId,
    motor: u16,
) {
    let cnc = builder.namespace(CNC);
    let path = spindle_path(info);
    let list = builder.id(&format!("{INTERFACE}/CncSpindleList"));
    let name = QualifiedName::new(list.namespace, axis_name(info, "S"));
    let type_id = NodeId::new(cnc, 1005);
    let spindle = builder.object(&path, name, &type_id, &list, ReferenceTypeId::HasComponent, &[]);
    builder.reference(channel, &spindle, ReferenceTypeId::HasComponent);
    builder.set(&format!("{path}/ActChannel"), channel.clone());
    builder.set(&format!("{path}/IsVirtual"), true);
    builder.set(&format!("{path}/IsInactive"), false);
    let most = view.motor(motor).map(|motor| motor.max_velocity);
    for name in ["ActSpeed", "CmdSpeed"] {
        builder.set(&format!("{path}/{name}/EngineeringUnits"), REVOLUTIONS_PER_MINUTE);
        if let Some(most) = most {
            builder.set(&format!("{path}/{name}/EURange"), range(0.0, most));
        }
    }
    for name in ["ActOverride", "CmdOverride"] {
        builder.set(&format!("{path}/{name}/EURange"), range(0.0, 200.0));
    }
}

fn limits(builder: &mut Builder<'_>, view: &View, motor: u16, path: &str) {
    if let Some([low, high]) = view.motor(motor).and_then(|motor| motor.soft_limits) {
        builder.set(&format!("{path}/EURange"), range(low, high));
    }
}

fn is_rotary(view: &View, letter: &str, motor: u16) -> bool {
    view.motor(motor)
        .map_or(["A", "B", "C"].contains(&letter), |motor| motor.kind == "rotary")
}

fn unit_of(view: &View, letter: &str, motor: u16) -> Unit {
    if is_rotary(view, letter, motor) {
        DEGREE
    } else {
        MILLIMETRE
    }
}

/// Adds the values of the machine as a whole.
pub fn machine_values(view: &View, values: &mut Values) {
    values.put(INTERFACE, "VendorRevision", Some(view.presence.version.as_str()));
}

/// Adds the values of a coordinate system, its axes and its spindle.
pub fn channel_values(info: &CoordinateSystemInfo, channel: &Channel, values: &mut Values) {
    let path = channel_path(info);
    state_values(&path, channel, values);
    program_values(&path, channel, values);
    let position = channel.position.as_ref();
    values.put(&path, "ActFeedrate", position.map(|position| position.feedrate));
    values.put(&path, "CmdFeedrate", channel.modal.as_ref().map(|modal| modal.f));
    for name in ["ActOverride", "CmdOverride"] {
        values.put(&path, name, channel.overrides.map(|overrides| overrides.feed));
    }
    values.put(&path, "ToolId", channel.tool.map(|tool| u32::from(tool.id)));
    for letter in info.axes.keys() {
        if LETTERS.contains(&letter.as_str()) {
            tool_values(&path, letter, position, values);
        }
        axis_values(&axis_path(info, letter), letter, channel, values);
    }
    if info.spindle.is_some() {
        spindle_values(&spindle_path(info), channel, values);
    }
}

fn state_values(path: &str, channel: &Channel, values: &mut Values) {
    let state = channel.state.as_ref();
    values.put(path, "ActProgramStatus", state.map(program_status));
    values.put(
        path,
        "ActStatus",
        state.map(|state| channel_status(state.execution)),
    );
    for name in ["ActOperationMode", "CmdOperationMode"] {
        values.put(path, name, state.map(|state| operation_mode(state.run_kind)));
    }
    let is_held = |state: &State| state.execution == Execution::FeedHold;
    values.put(path, "FeedHold", state.map(is_held));
    values.put(path, "BlockMode", state.map(|state| state.single_block));
}

fn program_values(path: &str, channel: &Channel, values: &mut Values) {
    let name = |number: Option<u16>| match number {
        None => String::new(),
        Some(0) => "MDI".to_owned(),
        Some(number) => number.to_string(),
    };
    let place = channel.place.as_ref();
    let main = channel.state.as_ref().map(|state| name(state.program));
    values.put(path, "ActMainProgramName", main);
    values.put(path, "ActProgramName", place.map(|place| name(place.number)));
    let lines = place.map(|place| {
        let main = place.stack.first().map_or(place.line, |caller| caller.line);
        let shown = |line: u32| place.number.map_or_else(String::new, |_| line.to_string());
        (shown(place.line), shown(main))
    });
    values.put(
        path,
        "ActProgramLine",
        lines.as_ref().map(|(line, _)| line.clone()),
    );
    values.put(path, "ActMainProgramLine", lines.map(|(_, main)| main));
    values.put(
        path,
        "ActProgramBlock",
        place.map(|place| vec![place.block.clone()]),
    );
    let modal = channel.modal.as_ref();
    let codes = modal.map(|modal| {
        modal
            .g
            .values()
            .filter_map(|code| number_of(code))
            .collect::<Vec<u32>>()
    });
    values.put(path, "ActGFunctions", codes);
    let offset = modal.map(|modal| modal.work_offset.as_deref().and_then(number_of).unwrap_or(0));
    values.put(path, "ActModalOffsetFunction", offset);
    let open = channel.pending.as_ref().map(|pending| {
        let open = pending.outputs.iter().map(|open| u32::from(open.output.m));
        open.collect::<Vec<u32>>()
    });
    values.put(path, "ActMFunctions", open);
}

/// Returns the number of a G code; `None` for a code with a decimal point.
fn number_of(code: &str) -> Option<u32> {
    code.strip_prefix('G')?.parse().ok()
}

fn tool_values(path: &str, letter: &str, position: Option<&Position>, values: &mut Values) {
    let of = |map: &std::collections::BTreeMap<String, f64>| map.get(letter).copied();
    let left = position.and_then(|position| of(&position.distance_to_go));
    let work = position.and_then(|position| of(&position.work));
    let error = position.and_then(|position| of(&position.following_error));
    let actual = work.zip(error).map(|(work, error)| work - error);
    let machine = position.and_then(|position| of(&position.machine));
    let at = position.and_then(|position| of(&position.actual));
    for (space, commanded, actual) in [("Wcs", work, actual), ("Bcs", machine, at)] {
        let path = format!("{path}/PosTcp{space}{letter}");
        values.put(&path, "CmdPos", commanded);
        values.put(&path, "ActPos", actual);
        values.put(&path, "RemDist", left);
    }
}

fn axis_values(path: &str, letter: &str, channel: &Channel, values: &mut Values) {
    let of = |position: &Option<Position>, map: fn(&Position) -> &std::collections::BTreeMap<String, f64>| {
        position
            .as_ref()
            .and_then(|position| map(position).get(letter).copied())
    };
    let now = &channel.position;
    let commanded = of(now, |position| &position.machine);
    let left = of(now, |position| &position.distance_to_go);
    let direct = format!("{path}/PosDirect");
    values.put(&direct, "CmdPos", commanded);
    values.put(&direct, "ActPos", of(now, |position| &position.actual));
    values.put(&direct, "RemDist", left);
    let offset = commanded
        .zip(of(now, |position| &position.work))
        .map(|(machine, work)| machine - work);
    values.put(path, "ZeroOffset", offset);
    let homed = now
        .as_ref()
        .and_then(|position| position.homed.get(letter).copied());
    values.put(path, "IsReferenced", homed);
    let before = of(&channel.position_before, |position| &position.machine);
    // the last position of a motion contains no current feedrate
    let is_path_moving = now.as_ref().is_some_and(|now| now.feedrate > 0.0);
    let moves =
        commanded.map(|now| is_path_moving && before.is_some_and(|before| (now - before).abs() > MOVED_MIN));
    values.put(path, "ActStatus", moves.map(i32::from));
}

fn spindle_values(path: &str, channel: &Channel, values: &mut Values) {
    let spindle = channel.spindle;
    // positions contain the spindle speed ten times a second
    let actual = channel.position.as_ref().map(|position| position.spindle_rpm);
    values.put(path, "ActSpeed", actual.map(f64::abs));
    values.put(path, "CmdSpeed", spindle.map(|spindle| spindle.rpm));
    for name in ["ActOverride", "CmdOverride"] {
        values.put(path, name, channel.overrides.map(|overrides| overrides.spindle));
    }
    values.put(path, "ActTurnDirection", actual.map(turn_direction));
    let turns = matches!(
        spindle.map(|spindle| spindle.direction),
        Some(SpindleDirection::Cw | SpindleDirection::Ccw)
    );
    let wanted = spindle.zip(channel.overrides).map(|(spindle, overrides)| {
        if turns {
            spindle.rpm * overrides.spindle / 100.0
        } else {
            0.0
        }
    });
    let status = actual
        .zip(wanted)
        .map(|(actual, wanted)| spindle_status(actual.abs(), wanted));
    values.put(path, "ActStatus", status);
}

/// Returns `CncSpindleTurnDirection`: None, CW, CCW.
pub fn turn_direction(rpm: f64) -> i32 {
    if rpm > MOVED_MIN {
        1
    } else if rpm < -MOVED_MIN {
        2
    } else {
        0
    }
}

/// Returns `CncSpindleStatus`: Stopped, `InTargetArea`, Accelerating, Decelerating.
fn spindle_status(actual: f64, wanted: f64) -> i32 {
    if (actual - wanted).abs() <= wanted * SPEED_TOLERANCE + MOVED_MIN {
        i32::from(wanted > 0.0)
    } else if actual < wanted {
        2
    } else {
        3
    }
}

/// Returns `CncChannelProgramStatus`: Stopped, Running, Waiting, Interrupted, Canceled.
fn program_status(state: &State) -> i32 {
    if matches!(state.run_kind, Some(RunKind::Jog | RunKind::Home)) {
        return 0;
    }
    match (state.execution, state.reason) {
        (Execution::Active, _) => 1,
        (Execution::Wait, _) => 2,
        (
            Execution::FeedHold
            | Execution::Interrupted
            | Execution::ProgramStopped
            | Execution::OptionalStop,
            _,
        ) => 3,
        (Execution::Stopped, Some(Reason::Stop | Reason::Aborted | Reason::Alarm | Reason::Restarted)) => 4,
        (Execution::Ready | Execution::ProgramCompleted | Execution::Stopped, _) => 0,
    }
}

/// Returns `CncChannelStatus`: Active, Interrupted, Reset.
pub fn channel_status(execution: Execution) -> i32 {
    match execution {
        Execution::Active | Execution::Wait => 0,
        Execution::FeedHold
        | Execution::Interrupted
        | Execution::ProgramStopped
        | Execution::OptionalStop => 1,
        Execution::Ready | Execution::ProgramCompleted | Execution::Stopped => 2,
    }
}

/// Returns `CncOperationMode`: Manual, MDA, Automatic.
fn operation_mode(run_kind: Option<RunKind>) -> i32 {
    match run_kind {
        Some(RunKind::Jog | RunKind::Home) => 0,
        Some(RunKind::Mdi) => 1,
        _ => 2,
    }
}
