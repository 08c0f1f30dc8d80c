//! Commands to a coordinate system and their replies.

mod args;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::explained::explained;
use serde_json::{Value, json};

use super::BootId;
use super::Timestamp;
use super::data::VariableValues;
use super::lease::Lease;
use super::line_start::LineStart;
use super::not_after::NotAfter;
use super::run::RunOrder;
use args::{axis, check_names, jog, mdi, run, start};

pub use super::verb::Verb;

/// A command to a coordinate system. The MQTT topic `command/{verb}` and the REST routes use the same verbs
/// and arguments.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename_all = "snake_case", deny_unknown_fields))]
pub enum Command {
    /// Loads a program from the store.
    Load {
        /// Main program number.
        #[cfg_attr(feature = "schema", schemars(range(min = 1, max = 9999)))]
        program: u16,
    },
    /// Starts a new run at the beginning of the loaded program, or with `from_line` at that line.
    Start,
    /// Starts a run at a line of the program, with the state in force at that line: verb `start` with
    /// `from_line`.
    #[cfg_attr(feature = "schema", schemars(skip))]
    StartFrom(LineStart),
    /// Loads a program, if the order contains a program number, and starts the loaded program. After each
    /// `PROGRAM_COMPLETED` the machine starts the program again until all parts are done. The machine starts
    /// no further part after an alarm, a stop, a reset, a lost lease or a restart of the runtime.
    #[cfg_attr(feature = "schema", schemars(skip))]
    Run(RunOrder),
    /// Holds the motion on its path (feed hold).
    Hold,
    /// Continues a paused run.
    Resume,
    /// Moves back along the path already passed, during a feed hold with G500, or moves forward again.
    BackTrace {
        /// True to move back; false to move forward again, as resume does.
        on: bool,
    },
    /// Decelerates on the path and ends the run.
    Stop,
    /// Brakes each motor at once, and ends the run.
    Abort,
    /// Cancels outputs, ends the run, and clears alarms.
    Reset,
    /// Acknowledges an alarm.
    AlarmAcknowledge {
        /// Id of the alarm.
        id: u64,
    },
    /// Manual data input: runs lines of NC text; the state word is READY after that. The command is done when
    /// all lines have been run.
    Mdi {
        /// One or several lines, at most 32 KiB; an end (M30) is not needed.
        text: String,
        /// True for a macro: text that a program or a button generates. The macro starts with the configured
        /// unit and absolute positions (G90) in force. At its end, also after an alarm or a stop, the machine
        /// restores the modal state, the feedrate and the selected offsets that were in force before the
        /// macro.
        #[cfg_attr(feature = "schema", schemars(rename = "macro", with = "Option<bool>"))]
        is_macro: bool,
    },
    /// Moves one axis by hand; the state word is READY after that. A jog with the `refresh_id` of the running
    /// jog refreshes that jog and changes nothing else; 200 ms after the last refresh the jog stops. A step,
    /// which is a jog with a `distance` of at most `jog_step_max` of `[hmi]`, needs no refresh. A jog ends at
    /// the soft limit. With `end` in the JSON arguments, the command ends the jog with this `refresh_id`. A
    /// jog with a distance is `done` if it has moved the whole distance, otherwise `failed`.
    #[cfg_attr(feature = "schema", schemars(transform = jog_or_its_end))]
    Jog {
        /// Axis letter.
        axis: char,
        /// Velocity, mm/min or deg/min, not 0; the sign is the direction. The machine limits the velocity to
        /// the maximum of the motor; the rapid override applies.
        velocity: f64,
        /// Largest distance, mm or degrees, above 0; `None` moves up to the soft limit.
        distance: Option<f64>,
        /// Id of the jog, 1 to 128 characters. A jog that has ended cannot be started again with its id.
        refresh_id: String,
    },
    /// Brakes the jog with this id at once; the state word is READY after that. In JSON it is a `jog` with
    /// `end`. This command needs no lease. If it arrives before or after its jog, or twice, nothing else
    /// changes, and a later jog with this id is refused.
    #[cfg_attr(feature = "schema", schemars(skip))]
    JogEnd {
        /// Id of the jog.
        refresh_id: String,
    },
    /// Moves axes to their first reference points, each motor alone as G28 does; the state word is READY
    /// after that.
    Home {
        /// Axis letters; an empty list means all axes.
        #[cfg_attr(feature = "schema", schemars(with = "Option<Vec<char>>", length(min = 1)))]
        axes: Vec<char>,
    },
}

impl Command {
    /// All verbs that [`Command::parse`] accepts, with or without arguments.
    pub const VERBS: [&'static str; 13] = [
        "load",
        "start",
        "run",
        "hold",
        "resume",
        "back_trace",
        "stop",
        "abort",
        "reset",
        "alarm_acknowledge",
        "mdi",
        "jog",
        "home",
    ];

    /// Returns the verb of the command.
    pub fn verb(&self) -> Verb {
        match self {
            Command::Load { .. } => Verb::Load,
            Command::Start | Command::StartFrom(_) => Verb::Start,
            Command::Run(_) => Verb::Run,
            Command::Hold => Verb::Hold,
            Command::Resume => Verb::Resume,
            Command::BackTrace { .. } => Verb::BackTrace,
            Command::Stop => Verb::Stop,
            Command::Abort => Verb::Abort,
            Command::Reset => Verb::Reset,
            Command::AlarmAcknowledge { .. } => Verb::AlarmAcknowledge,
            Command::Mdi { .. } => Verb::Mdi,
            Command::Jog { .. } | Command::JogEnd { .. } => Verb::Jog,
            Command::Home { .. } => Verb::Home,
        }
    }

    /// Returns true for hold, stop, abort and the end of a jog: these commands bypass every queue, and every
    /// state allows them.
    pub fn is_urgent(&self) -> bool {
        self.verb().is_urgent() || matches!(self, Command::JogEnd { .. })
    }

    /// Returns the JSON arguments of the command, as [`Command::parse`] accepts them.
    pub fn args(&self) -> Value {
        match self {
            Command::Load { program } => json!({ "program": program }),
            Command::AlarmAcknowledge { id } => json!({ "id": id }),
            Command::Mdi {
                text,
                is_macro: false,
            } => json!({ "text": text }),
            Command::Mdi { text, is_macro } => json!({ "text": text, "macro": is_macro }),
            Command::Jog {
                axis,
                velocity,
                distance,
                refresh_id,
            } => {
                json!({"axis": axis, "velocity": velocity, "distance": distance, "refresh_id": refresh_id})
            }
            Command::JogEnd { refresh_id } => json!({"refresh_id": refresh_id, "end": true}),
            Command::StartFrom(from) => json!(from),
            Command::Run(order) => json!(order),
            Command::Home { axes } if !axes.is_empty() => json!({ "axes": axes }),
            Command::BackTrace { on } => json!({ "on": on }),
            Command::Start
            | Command::Hold
            | Command::Resume
            | Command::Stop
            | Command::Abort
            | Command::Reset
            | Command::Home { .. } => {
                json!({})
            }
        }
    }

    /// Returns true for hold, stop, abort and the end of a jog: no age limit applies to them.
    pub fn brings_to_rest(&self) -> bool {
        self.is_urgent() || matches!(self, Command::JogEnd { .. })
    }

    /// Returns the names of the arguments of a verb, or `None` for hold, stop and abort. These three commands
    /// ignore unknown arguments, so that an additional argument never prevents a machine from stopping.
    fn names_of_args(verb: &str) -> Option<&'static [&'static str]> {
        Some(match verb {
            "hold" | "stop" | "abort" => return None,
            "load" => &["program"],
            "alarm_acknowledge" => &["id"],
            "mdi" => &["text", "macro"],
            "back_trace" => &["on"],
            "jog" => &["axis", "velocity", "distance", "refresh_id", "end"],
            "home" => &["axes"],
            "start" => &["from_line", "program", "occurrence", "approach"],
            "run" => &["program", "parts"],
            _ => &[],
        })
    }

    /// Parses a verb and its JSON arguments.
    ///
    /// # Errors
    /// Fails if the verb or an argument is not valid; the text is for the sender of the command.
    pub fn parse(verb: &str, args: &Value) -> Result<Command, String> {
        if let (Some(known), true) = (Self::names_of_args(verb), Self::VERBS.contains(&verb)) {
            check_names(verb, known, args)?;
        }
        let number = |key: &str| {
            args.get(key)
                .and_then(Value::as_u64)
                .ok_or_else(|| format!("{verb} needs \"{key}\": a whole number"))
        };
        match verb {
            "load" => {
                let program = number("program")?;
                let program = u16::try_from(program)
                    .map_err(|_| format!("program {program} is not a program number; write 1 to 9999"))?;
                Ok(Command::Load { program })
            }
            "start" => start(args),
            "run" => run(args),
            "hold" => Ok(Command::Hold),
            "resume" => Ok(Command::Resume),
            "stop" => Ok(Command::Stop),
            "abort" => Ok(Command::Abort),
            "reset" => Ok(Command::Reset),
            "alarm_acknowledge" => Ok(Command::AlarmAcknowledge { id: number("id")? }),
            "mdi" => mdi(args),
            "back_trace" => match args.get("on").and_then(Value::as_bool) {
                Some(on) => Ok(Command::BackTrace { on }),
                None => Err("back_trace needs \"on\": true to go back, false to go forward again".to_owned()),
            },
            "jog" => jog(args),
            "home" => match args.get("axes") {
                None | Some(Value::Null) => Ok(Command::Home { axes: Vec::new() }),
                Some(axes) => axes
                    .as_array()
                    .filter(|axes| !axes.is_empty())
                    .and_then(|axes| axes.iter().map(axis).collect())
                    .map(|axes| Command::Home { axes })
                    .ok_or_else(|| {
                        "home: \"axes\" is a list of axis letters, such as [\"X\", \"Y\"]; without it all axes home"
                            .to_owned()
                    }),
            },
            _ => Err(format!(
                "there is no command {verb}; there are {}",
                Self::VERBS.join(", ")
            )),
        }
    }
}

/// Extends the JSON schema of `jog` by the form that ends a jog, which needs only the id of the jog.
#[cfg(feature = "schema")]
fn jog_or_its_end(schema: &mut schemars::Schema) {
    let Some(jog) = schema.pointer_mut("/properties/jog") else {
        return;
    };
    let end = "If true, ends the jog that `refresh_id` names; no other argument is needed.";
    jog["properties"]["end"] = json!({"type": ["boolean", "null"], "description": end});
    jog["required"] = json!(["refresh_id"]);
    jog["anyOf"] = json!([
        {"required": ["axis", "velocity"]},
        {"required": ["end"], "properties": {"end": {"const": true}}},
    ]);
}

/// Sender and conditions of a command.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CommandMeta {
    /// Id of the command, 1 to 128 characters. A command with an id that was received in the last 10 minutes
    /// gets the stored reply and is not executed again. If the verb, the coordinate system or the arguments
    /// differ from those of the earlier command, the command is refused
    /// ([`RefusalCode::CommandIdReused`](crate::types::request::RefusalCode)); hold, stop and abort are
    /// executed nevertheless.
    pub command_id: String,
    /// Id of the sending client; replies go to `reply/{client_id}`. 1 to 64 characters without `/ + #`.
    pub client_id: String,
    /// Time when the command was issued; required with `ttl_ms`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub issued_at: Option<Timestamp>,
    /// Age limit, ms after `issued_at`: an older command is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ttl_ms: Option<u64>,
    /// Conditions under which the machine executes the command.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expect: Option<Expect>,
    /// Latest time at which the command may take effect; after this time the command is refused. Without this
    /// field, the command takes effect at any age.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_after: Option<NotAfter>,
    /// Number of the control lease under which the command is sent. While a client holds the lease, load,
    /// start, run, resume, back trace, mdi, jog and home need this number. These commands are refused if the
    /// lease with this number has ended. Hold, stop, abort, reset and the end of a jog need no lease.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fence: Option<u64>,
    /// Key under which the runtime remembers the command. The runtime sets the key; messages do not contain
    /// it.
    #[serde(skip)]
    pub memory: MemoryKey,
}

impl CommandMeta {
    /// Sets the age limit `not_after` if the command has no such limit.
    #[must_use]
    pub fn limited(self, not_after: Option<NotAfter>) -> Self {
        let not_after = self.not_after.or(not_after);
        Self { not_after, ..self }
    }
}

/// Key under which the runtime remembers a command.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct MemoryKey {
    /// User of the command; on a machine without users, its host or its transport.
    pub user: String,
    /// Id of the command among those of the user.
    pub command: String,
}

/// Conditions of a command: if one of them does not hold, the command is refused.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// The boot of the runtime that the sender expects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boot_id: Option<BootId>,
    /// The revision of `state` that the sender expects.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state_rev: Option<u64>,
    /// Hash of the program: for a load the hash of the program to be loaded, otherwise the hash of the loaded
    /// program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hash: Option<String>,
}

explained! {
    "status of a command"
    /// Status of a command.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
    #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
    #[non_exhaustive]
    pub enum CommandStatus {
        /// The command will be executed.
        Accepted = "accepted",
            "Wait for done or failed.";
        /// The command will not be executed; nothing has changed.
        Rejected = "rejected",
            "The code and the text give the reason and the remedy.";
        /// The effect of the command has been reached.
        Done = "done",
            "Nothing to do.";
        /// The command was accepted, but its effect was prevented.
        Failed = "failed",
            "The text names the cause, in most cases an alarm or another command.";
    }
}

/// Payload of `reply/{client_id}`, and of `GET /commands/{id}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CommandReply {
    /// Id of the command.
    pub command_id: String,
    /// Status of the command.
    pub status: CommandStatus,
    /// `ok`, or the code of the refusal or failure.
    pub code: String,
    /// Description of the result for people.
    pub text: String,
    /// Revision of `state` at the time of this reply.
    pub state_rev: u64,
    /// Values that were read; only for `variable/get`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variables: Option<VariableValues>,
    /// The lease that was taken; only for `lease/take`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lease: Option<Lease>,
    /// Hash of the program that is loaded or started; only for `load` and `start`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hash: Option<String>,
    /// Id of the run that was started; only for `start` and `run`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run_id: Option<String>,
    /// Signed distance from the start of the motion to its end, by axis letter, mm or degrees; only for a
    /// failed `jog`, `mdi` or `home`. Axes that did not move are left out.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub moved: BTreeMap<char, f64>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::line_start::Approach;
    use crate::types::run::PARTS_MAX;

    #[test]
    fn arguments_come_back_as_sent() {
        for command in [
            Command::Load { program: 7 },
            Command::Mdi {
                text: "G00 X1\nY2".into(),
                is_macro: false,
            },
            Command::Mdi {
                text: "G91 G31 Z-5".into(),
                is_macro: true,
            },
            Command::Home { axes: vec!['X', 'Z'] },
            Command::Home { axes: Vec::new() },
            Command::BackTrace { on: true },
            Command::BackTrace { on: false },
            Command::Jog {
                axis: 'Y',
                velocity: -600.0,
                distance: Some(0.1),
                refresh_id: "pendant-1".into(),
            },
            Command::Jog {
                axis: 'X',
                velocity: 1.0,
                distance: None,
                refresh_id: "a".into(),
            },
            Command::JogEnd {
                refresh_id: "a".into(),
            },
            Command::StartFrom(LineStart::line(12)),
            Command::Run(RunOrder::program(7)),
            Command::Run(RunOrder {
                program: None,
                parts: PARTS_MAX,
            }),
            Command::StartFrom(LineStart {
                from_line: 3,
                program: Some(1000),
                occurrence: Some(2),
                approach: Approach::Direct,
            }),
        ] {
            let verb = serde_json::to_value(command.verb()).unwrap();
            let verb = verb.as_str().unwrap();
            assert!(Command::VERBS.contains(&verb));
            assert_eq!(Command::parse(verb, &command.args()), Ok(command));
        }
    }

    #[test]
    fn unknown_arguments_are_refused_except_for_urgent_commands() {
        for verb in Command::VERBS {
            let known = Command::names_of_args(verb);
            let args = match verb {
                "load" => json!({"program": 1}),
                "alarm_acknowledge" => json!({"id": 1}),
                "mdi" => json!({"text": "G04 P1"}),
                "back_trace" => json!({"on": true}),
                "jog" => json!({"axis": "X", "velocity": 1, "refresh_id": "a"}),
                _ => json!({}),
            };
            assert!(Command::parse(verb, &args).is_ok(), "{verb}");
            let mut more = args.clone();
            more["unknown"] = json!(1);
            let parsed = Command::parse(verb, &more);
            match known {
                None => assert!(parsed.is_ok_and(|command| command.verb().is_urgent()), "{verb}"),
                Some(_) => assert!(parsed.unwrap_err().contains("\"unknown\""), "{verb}"),
            }
            for wrong in [json!([]), json!(1), json!("x")] {
                assert_eq!(
                    Command::parse(verb, &wrong).is_ok(),
                    known.is_none(),
                    "{verb} {wrong}"
                );
            }
        }
    }

    #[test]
    fn a_start_from_a_line_that_is_not_one_is_refused_in_words() {
        for (args, what) in [
            (json!({"from_line": 0}), "from_line"),
            (json!({"from_line": 1.5}), "from_line"),
            (json!({"from_line": 1, "occurrence": 0}), "occurrence"),
            (json!({"from_line": 1, "program": 70_000}), "70000"),
            (json!({"from_line": 1, "approach": "sideways"}), "plane_first"),
            (json!({"occurrence": 2}), "from_line"),
        ] {
            let refusal = Command::parse("start", &args).unwrap_err();
            assert!(refusal.contains(what), "{args}: {refusal}");
        }
        assert_eq!(
            Command::parse("start", &json!({"from_line": null})),
            Ok(Command::Start)
        );
    }

    #[test]
    fn a_run_of_no_parts_or_of_no_program_is_refused_in_words() {
        for (args, what) in [
            (json!({"parts": 0}), "1 to 1000000"),
            (json!({"parts": 1_000_001}), "1 to 1000000"),
            (json!({"parts": 1.5}), "parts"),
            (json!({"program": 70_000}), "1 to 9999"),
            (json!({"program": "one"}), "1 to 9999"),
        ] {
            let refusal = Command::parse("run", &args).unwrap_err();
            assert!(refusal.contains(what), "{args}: {refusal}");
        }
        let one = RunOrder {
            program: None,
            parts: 1,
        };
        assert_eq!(Command::parse("run", &json!({})), Ok(Command::Run(one)));
    }

    #[test]
    fn a_jog_without_direction_distance_or_name_is_refused_in_words() {
        let good = json!({"axis": "X", "velocity": 100, "refresh_id": "a"});
        assert!(Command::parse("jog", &good).is_ok());
        for (key, value, what) in [
            ("axis", json!("XY"), "axis"),
            ("axis", json!(null), "axis"),
            ("velocity", json!(0), "velocity"),
            ("velocity", json!("fast"), "velocity"),
            ("distance", json!(-1), "distance"),
            ("distance", json!("far"), "distance"),
            ("distance", json!(1e7), "distance"),
            ("refresh_id", json!(""), "refresh_id"),
            ("refresh_id", json!("x".repeat(129)), "refresh_id"),
        ] {
            let mut args = good.clone();
            args[key] = value;
            let refusal = Command::parse("jog", &args).unwrap_err();
            assert!(refusal.contains(what), "{args}: {refusal}");
        }
        assert!(Command::parse("mdi", &json!({"text": " \n"})).is_err());
        let refusal = Command::parse("mdi", &json!({"text": "G00 X1", "macro": 1})).unwrap_err();
        assert!(refusal.contains("macro"), "{refusal}");
        assert!(Command::parse("home", &json!({"axes": "X"})).is_err());
        assert!(Command::parse("home", &json!({"axes": ["XY"]})).is_err());
        let none = Command::parse("home", &json!({"axes": []}));
        assert!(none.is_err(), "an empty list does not mean all axes");
    }
}
