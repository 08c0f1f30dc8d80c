//! Commands to a coordinate system and their replies.

use serde::{Deserialize, Serialize};

use super::BootId;
use super::Timestamp;

/// What can be commanded. Verbs and arguments are those of `command/{verb}` and of the REST routes.
#[derive(Debug, Clone, PartialEq)]
pub enum Command {
    /// Takes a program of the store.
    Load {
        /// Main program number.
        program: u16,
    },
    /// From the head, as a new run.
    Start,
    /// Feed hold.
    Hold,
    /// Goes on after a pause.
    Resume,
    /// Decelerates on the path and ends the run.
    Stop,
    /// Each motor brakes at once; ends the run.
    Abort,
    /// Cancels outputs, ends the run, clears alarms.
    Reset,
    /// Acknowledges an alarm.
    AlarmAcknowledge {
        /// Of the alarm.
        id: u64,
    },
}

/// A verb, for lists of what is allowed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verb {
    /// See [`Command::Load`].
    Load,
    /// See [`Command::Start`].
    Start,
    /// See [`Command::Hold`].
    Hold,
    /// See [`Command::Resume`].
    Resume,
    /// See [`Command::Stop`].
    Stop,
    /// See [`Command::Abort`].
    Abort,
    /// See [`Command::Reset`].
    Reset,
    /// See [`Command::AlarmAcknowledge`].
    AlarmAcknowledge,
}

impl Command {
    /// Verbs of the interface that this version refuses with `not_supported`.
    pub const NOT_SUPPORTED: [&'static str; 4] = ["mdi", "jog", "home", "back_trace"];

    /// The verb of the command.
    pub fn verb(&self) -> Verb {
        match self {
            Command::Load { .. } => Verb::Load,
            Command::Start => Verb::Start,
            Command::Hold => Verb::Hold,
            Command::Resume => Verb::Resume,
            Command::Stop => Verb::Stop,
            Command::Abort => Verb::Abort,
            Command::Reset => Verb::Reset,
            Command::AlarmAcknowledge { .. } => Verb::AlarmAcknowledge,
        }
    }

    /// The command of a verb word and its JSON arguments.
    ///
    /// # Errors
    /// What is wrong with them, in words for the sender.
    pub fn parse(verb: &str, args: &serde_json::Value) -> Result<Command, String> {
        let number = |key: &str| {
            args.get(key)
                .and_then(serde_json::Value::as_u64)
                .ok_or_else(|| format!("{verb} needs \"{key}\": a whole number"))
        };
        match verb {
            "load" => {
                let program = number("program")?;
                let program = u16::try_from(program)
                    .map_err(|_| format!("program {program} is not a program number; write 1 to 9999"))?;
                Ok(Command::Load { program })
            }
            "start" => Ok(Command::Start),
            "hold" => Ok(Command::Hold),
            "resume" => Ok(Command::Resume),
            "stop" => Ok(Command::Stop),
            "abort" => Ok(Command::Abort),
            "reset" => Ok(Command::Reset),
            "alarm_acknowledge" => Ok(Command::AlarmAcknowledge { id: number("id")? }),
            _ if Self::NOT_SUPPORTED.contains(&verb) => Err(format!("{verb} is not supported yet")),
            _ => Err(format!(
                "there is no command {verb}; write load, start, hold, resume, stop, abort, reset or alarm_acknowledge"
            )),
        }
    }
}

/// Who commands, and under which condition.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct CommandMeta {
    /// Names the command; one seen in the last 10 minutes gets the stored reply. 1 to 128 characters.
    pub command_id: String,
    /// Who commands; replies go to `reply/{client_id}`. 1 to 64 characters without `/ + #`.
    pub client_id: String,
    /// When it was issued; needed with `ttl_ms`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub issued_at: Option<Timestamp>,
    /// Refused when older than this, ms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ttl_ms: Option<u64>,
    /// What must hold for it to be carried out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expect: Option<Expect>,
}

/// Condition of a command.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expect {
    /// The boot that the sender has seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub boot_id: Option<BootId>,
    /// The revision of `state` that the sender has seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state_rev: Option<u64>,
}

/// How far a command is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CommandStatus {
    /// It will be carried out.
    Accepted,
    /// It will not; nothing changed.
    Rejected,
    /// Its effect has been reached.
    Done,
    /// It was accepted, and then something prevented its effect.
    Failed,
}

/// Payload of `reply/{client_id}`, and of `GET /commands/{id}`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CommandReply {
    /// Of the command.
    pub command_id: String,
    /// How far it is.
    pub status: CommandStatus,
    /// `ok`, or the refusal's code.
    pub code: String,
    /// For people.
    pub text: String,
    /// Revision of `state` when this was said.
    pub state_rev: u64,
}
