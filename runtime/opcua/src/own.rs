//! The namespace of this server for data that no specification covers: state words of the machine, its M codes, and
//! commands.

use opcua::types::{Argument, DataTypeId, LocalizedText, NodeId, ObjectId, UAString};
use plc_protocol::execution::wire_name;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::machine::{AlarmRecord, CoordinateSystemInfo};

use crate::instance::Builder;
use crate::values::Values;
use crate::view::{Channel, View};

/// Root path of this namespace.
pub const ROOT: &str = "Tandem";

/// Variables of the machine: name, data type, and whether it is an array.
const OF_MACHINE: [(&str, DataTypeId, bool); 9] = [
    ("Machine", DataTypeId::String, false),
    ("BootId", DataTypeId::String, false),
    ("AlarmIds", DataTypeId::UInt64, true),
    ("AlarmNumbers", DataTypeId::UInt32, true),
    ("AlarmTexts", DataTypeId::String, true),
    ("AlarmRemedies", DataTypeId::String, true),
    ("AlarmCoordinateSystems", DataTypeId::UInt32, true),
    ("AlarmsAreWarnings", DataTypeId::Boolean, true),
    ("AlarmsAcknowledgedBy", DataTypeId::String, true),
];

/// Variables of a coordinate system.
const OF_CHANNEL: [(&str, DataTypeId, bool); 18] = [
    ("State", DataTypeId::String, false),
    ("Reason", DataTypeId::String, false),
    ("Program", DataTypeId::UInt32, false),
    ("ProgramHash", DataTypeId::String, false),
    ("RunId", DataTypeId::String, false),
    ("DryRun", DataTypeId::Boolean, false),
    ("OptionalStop", DataTypeId::Boolean, false),
    ("OptionalSkips", DataTypeId::UInt32, true),
    ("RapidOverride", DataTypeId::Double, false),
    ("Question", DataTypeId::String, false),
    ("QuestionId", DataTypeId::String, false),
    ("QuestionChoices", DataTypeId::String, true),
    ("MCodes", DataTypeId::UInt32, true),
    ("MCodeSeqs", DataTypeId::UInt64, true),
    ("MCodeStates", DataTypeId::String, true),
    ("MCodeHandlers", DataTypeId::String, true),
    ("MCodeParameters", DataTypeId::String, true),
    ("MCodeProgress", DataTypeId::String, true),
];

/// Effect of a method of a coordinate system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Does {
    /// Executes a command with this verb; the arguments have the names of its inputs.
    Command(&'static str),
    /// Sets overrides.
    SetOverrides,
    /// Sets an input.
    SetInput,
    /// Resets an M code by hand.
    ResetMCode,
    /// Fails an M code by hand.
    FailMCode,
    /// Decides about an M code after its handler was lost.
    RedeliverMCode,
    /// Answers a question.
    Answer,
}

/// An input of a method: name, data type, whether it is an array, and description.
type Input = (&'static str, DataTypeId, bool, &'static str);

/// A method of each coordinate system.
pub struct Method {
    pub name: &'static str,
    pub does: Does,
    says: &'static str,
    pub inputs: &'static [Input],
}

const fn new_method(name: &'static str, does: Does, says: &'static str, inputs: &'static [Input]) -> Method {
    Method {
        name,
        does,
        says,
        inputs,
    }
}

const BOOT_ID: Input = (
    "boot_id",
    DataTypeId::String,
    false,
    "BootId of the machine when the M code was seen",
);
const SEQ: Input = (
    "seq",
    DataTypeId::UInt64,
    false,
    "Sequence number of the M code, of MCodeSeqs",
);
const PROGRAM: Input = (
    "program",
    DataTypeId::UInt16,
    false,
    "Number of a program in the store, 1 to 9999",
);

/// Methods of each coordinate system.
pub const METHODS: [Method; 17] = [
    new_method(
        "Load",
        Does::Command("load"),
        "Loads a program of the store.",
        &[PROGRAM],
    ),
    new_method(
        "Start",
        Does::Command("start"),
        "Starts the loaded program from line 1.",
        &[],
    ),
    new_method(
        "Run",
        Does::Command("run"),
        "Loads a program and runs it once for each part.",
        &[
            PROGRAM,
            (
                "parts",
                DataTypeId::UInt32,
                false,
                "Number of parts, 1 to 1000000",
            ),
        ],
    ),
    new_method("Hold", Does::Command("hold"), "Feed hold.", &[]),
    new_method("Resume", Does::Command("resume"), "Continues after a pause.", &[]),
    new_method(
        "Stop",
        Does::Command("stop"),
        "Decelerates on the path and ends the run.",
        &[],
    ),
    new_method(
        "Reset",
        Does::Command("reset"),
        "Ends the run, cancels M codes, clears alarms.",
        &[],
    ),
    new_method(
        "Abort",
        Does::Command("abort"),
        "Brakes each motor at once and ends the run.",
        &[],
    ),
    new_method(
        "Mdi",
        Does::Command("mdi"),
        "Runs lines of NC text.",
        &[(
            "text",
            DataTypeId::String,
            false,
            "One or several lines, at most 32 KiB",
        )],
    ),
    new_method(
        "Home",
        Does::Command("home"),
        "Returns axes to their reference points.",
        &[(
            "axes",
            DataTypeId::String,
            true,
            "Axis letters; an empty list selects all axes",
        )],
    ),
    new_method(
        "AcknowledgeAlarm",
        Does::Command("alarm_acknowledge"),
        "Acknowledges an alarm.",
        &[("id", DataTypeId::UInt64, false, "Id of the alarm, of AlarmIds")],
    ),
    new_method(
        "SetOverrides",
        Does::SetOverrides,
        "Sets overrides, percent.",
        &[
            ("feed", DataTypeId::Double, false, "0 to 200"),
            ("rapid", DataTypeId::Double, false, "0 to 100"),
            ("spindle", DataTypeId::Double, false, "0 to 200"),
        ],
    ),
    new_method(
        "SetInput",
        Does::SetInput,
        "Sets an input.",
        &[
            (
                "input",
                DataTypeId::String,
                false,
                "single_block, dry_run or optional_stop",
            ),
            ("value", DataTypeId::Boolean, false, "On or off"),
        ],
    ),
    new_method(
        "ResetMCode",
        Does::ResetMCode,
        "Resets an M code by hand: the program continues.",
        &[BOOT_ID, SEQ],
    ),
    new_method(
        "FailMCode",
        Does::FailMCode,
        "Fails an M code by hand: alarm 10000 + code stops the program.",
        &[
            BOOT_ID,
            SEQ,
            ("code", DataTypeId::UInt16, false, "0 to 9999"),
            ("text", DataTypeId::String, false, "Text of the alarm"),
        ],
    ),
    new_method(
        "RedeliverMCode",
        Does::RedeliverMCode,
        "Delivers an M code of a lost handler to a handler again.",
        &[BOOT_ID, SEQ, ("how", DataTypeId::String, false, "verify or redo")],
    ),
    new_method(
        "Answer",
        Does::Answer,
        "Answers the question of a handler.",
        &[
            BOOT_ID,
            SEQ,
            ("question_id", DataTypeId::String, false, "QuestionId"),
            ("choice", DataTypeId::String, false, "One of QuestionChoices"),
        ],
    ),
];

/// Returns the path of a coordinate system.
pub fn channel_path(number: CoordinateSystemNumber) -> String {
    format!("{ROOT}/cs{number}")
}

fn argument((name, data_type, is_array, says): Input) -> Argument {
    Argument {
        name: UAString::from(name),
        data_type: data_type.into(),
        value_rank: if is_array { 1 } else { -1 },
        array_dimensions: is_array.then(|| vec![0]),
        description: LocalizedText::from(says),
    }
}

/// Builds the nodes.
pub fn build(builder: &mut Builder<'_>, view: &View) {
    let root = builder.folder(ROOT, ROOT, &ObjectId::ObjectsFolder.into());
    variables(builder, ROOT, &OF_MACHINE, &root);
    let outputs = [
        ("code", DataTypeId::String, false, "ok, or the refusal's code"),
        ("text", DataTypeId::String, false, "Result, reason, and remedy"),
    ];
    let outputs = outputs.map(argument);
    for info in &view.birth.coordinate_systems {
        let path = channel_path(info.number);
        let channel = builder.folder(&path, &format!("cs{}", info.number), &root);
        variables(builder, &path, &OF_CHANNEL, &channel);
        for method in &METHODS {
            let inputs: Vec<Argument> = method.inputs.iter().copied().map(argument).collect();
            let path = format!("{path}/{}", method.name);
            builder.method(&path, (method.name, method.says), &inputs, &outputs, &channel);
        }
    }
}

fn variables(builder: &mut Builder<'_>, path: &str, all: &[(&str, DataTypeId, bool)], parent: &NodeId) {
    for (name, data_type, is_array) in all {
        builder.variable(&format!("{path}/{name}"), name, *data_type, *is_array, parent);
    }
}

/// Adds the values of the machine as a whole.
pub fn machine_values(view: &View, values: &mut Values) {
    values.put(ROOT, "Machine", Some(view.birth.machine.as_str()));
    values.put(ROOT, "BootId", Some(view.boot.0.as_str()));
}

/// Writes the active alarms.
pub fn alarm_values(view: &View, values: &mut Values) {
    let all = view.alarms.as_ref().map(|active| active.alarms.as_slice());
    values.put(ROOT, "AlarmIds", of_each(all, |alarm| alarm.id));
    values.put(
        ROOT,
        "AlarmNumbers",
        of_each(all, |alarm| u32::from(alarm.number)),
    );
    values.put(ROOT, "AlarmTexts", of_each(all, |alarm| alarm.text.clone()));
    values.put(
        ROOT,
        "AlarmRemedies",
        of_each(all, |alarm| alarm.remedy.clone().unwrap_or_default()),
    );
    values.put(
        ROOT,
        "AlarmCoordinateSystems",
        of_each(all, |alarm| u32::from(alarm.cs.unwrap_or(0))),
    );
    let is_warning = |alarm: &AlarmRecord| wire_name(&alarm.severity) == "warning";
    values.put(ROOT, "AlarmsAreWarnings", of_each(all, is_warning));
    let by = |alarm: &AlarmRecord| alarm.acknowledged_by.clone().unwrap_or_default();
    values.put(ROOT, "AlarmsAcknowledgedBy", of_each(all, by));
}

fn of_each<T, V>(all: Option<&[T]>, value: impl Fn(&T) -> V) -> Option<Vec<V>> {
    all.map(|all| all.iter().map(value).collect())
}

/// Adds the values of a coordinate system.
pub fn channel_values(info: &CoordinateSystemInfo, channel: &Channel, values: &mut Values) {
    let path = channel_path(info.number);
    let state = channel.state.as_ref();
    values.put(&path, "State", state.map(|state| wire_name(&state.execution)));
    values.put(
        &path,
        "Reason",
        state.map(|state| state.reason.map_or_else(String::new, |reason| wire_name(&reason))),
    );
    values.put(
        &path,
        "Program",
        state.map(|state| u32::from(state.program.unwrap_or(0))),
    );
    values.put(
        &path,
        "ProgramHash",
        state.map(|state| state.hash.clone().unwrap_or_default()),
    );
    values.put(
        &path,
        "RunId",
        state.map(|state| state.run_id.clone().unwrap_or_default()),
    );
    values.put(&path, "DryRun", state.map(|state| state.dry_run));
    values.put(&path, "OptionalStop", state.map(|state| state.optional_stop));
    let skips = state.map(|state| {
        state
            .optional_skip
            .iter()
            .copied()
            .map(u32::from)
            .collect::<Vec<u32>>()
    });
    values.put(&path, "OptionalSkips", skips);
    values.put(
        &path,
        "RapidOverride",
        channel.overrides.map(|overrides| overrides.rapid),
    );
    let asked = state.map(|state| {
        let waiting = state.waiting_on.as_ref();
        waiting.and_then(|waiting| waiting.question.as_deref())
    });
    let text = asked.map(|question| question.map_or_else(String::new, |question| question.text.clone()));
    values.put(&path, "Question", text);
    let id = asked.map(|question| question.map_or_else(String::new, |question| question.id.clone()));
    values.put(&path, "QuestionId", id);
    let choices = asked.map(|question| question.map_or_else(Vec::new, |question| question.choices.clone()));
    values.put(&path, "QuestionChoices", choices);
    m_code_values(&path, channel, values);
}

fn m_code_values(path: &str, channel: &Channel, values: &mut Values) {
    let open = channel.pending.as_ref().map(|pending| pending.outputs.as_slice());
    values.put(path, "MCodes", of_each(open, |open| u32::from(open.output.m)));
    values.put(path, "MCodeSeqs", of_each(open, |open| open.output.seq));
    values.put(path, "MCodeStates", of_each(open, |open| wire_name(&open.state)));
    values.put(
        path,
        "MCodeHandlers",
        of_each(open, |open| open.handler_id.clone().unwrap_or_default()),
    );
    let parameters = of_each(open, |open| {
        serde_json::to_string(&open.output.params).unwrap_or_default()
    });
    values.put(path, "MCodeParameters", parameters);
    let progress = of_each(open, |open| {
        let said = open.progress.as_ref();
        said.map_or_else(String::new, |progress| progress.text.clone())
    });
    values.put(path, "MCodeProgress", progress);
}
