//! Memory of the commands of the last minutes: a repeated command gets its stored reply, and nothing is done twice.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Debug;
use std::hash::{Hash, Hasher};
use std::time::{Duration, SystemTime};

use plc_api::execution::wire_name;
use plc_api::types::CoordinateSystemNumber;
use plc_api::types::command::{Command, CommandReply};

/// How long a command's reply is kept: a command with the same id gets it again instead of being carried out twice.
pub const COMMAND_MEMORY: Duration = Duration::from_mins(10);

/// Commands kept at the most, whatever their age. Reason: at 16 commands a second 10 minutes fit.
pub const COMMANDS_MAX: usize = 10_000;

/// Commands by their ids.
#[derive(Debug, Default)]
pub(crate) struct CommandMemory {
    known: BTreeMap<String, Known>,
    order: VecDeque<String>,
}

#[derive(Debug)]
struct Known {
    at: SystemTime,
    asked: Asked,
    /// `None` until it has been answered.
    reply: Option<CommandReply>,
}

/// What a command asks for, to tell the same command sent again from another one with its id.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Asked {
    /// For people.
    words: String,
    content: u64,
    /// Of hold, stop and abort: they are carried out whatever their id was used for before.
    urgent_of: Option<String>,
}

impl Asked {
    pub fn new(words: String, content: &impl Debug) -> Self {
        let mut hasher = DefaultHasher::new();
        format!("{content:?}").hash(&mut hasher);
        Self {
            words,
            content: hasher.finish(),
            urgent_of: None,
        }
    }

    pub fn command(cs: CoordinateSystemNumber, command: &Command, client_id: &str) -> Self {
        let verb = command.verb();
        let words = format!("{} of coordinate system {cs}", wire_name(&verb));
        Self {
            urgent_of: verb.is_urgent().then(|| client_id.to_owned()),
            ..Self::new(words, &(cs, command))
        }
    }
}

/// What is known of a command.
#[derive(Debug, PartialEq)]
pub(crate) enum Recalled {
    /// Nothing.
    New,
    /// It came before, and was answered, or is not yet.
    Again(Option<CommandReply>),
    /// Its id is that of another command: of which.
    OtherCommand(String),
}

impl CommandMemory {
    /// Looks a command up by its id, and notes it when it is new.
    pub fn recall(&mut self, command_id: &str, asked: Asked, now: SystemTime) -> Recalled {
        self.forget(now);
        match self.known.get(command_id) {
            Some(known) if known.asked == asked => return Recalled::Again(known.reply.clone()),
            Some(known) if asked.urgent_of.is_none() => {
                return Recalled::OtherCommand(known.asked.words.clone());
            }
            Some(_) => {}
            None => self.order.push_back(command_id.to_owned()),
        }
        let known = Known {
            at: now,
            asked,
            reply: None,
        };
        self.known.insert(command_id.to_owned(), known);
        Recalled::New
    }

    /// Keeps the last reply to a command.
    pub fn on_reply(&mut self, reply: &CommandReply, now: SystemTime) {
        if let Some(known) = self.known.get_mut(&reply.command_id) {
            (known.at, known.reply) = (now, Some(reply.clone()));
        }
    }

    /// The last reply to a command.
    pub fn reply(&self, command_id: &str) -> Option<&CommandReply> {
        self.known.get(command_id)?.reply.as_ref()
    }

    fn forget(&mut self, now: SystemTime) {
        while let Some(oldest) = self.order.front() {
            let expired = self
                .known
                .get(oldest)
                .is_none_or(|known| now.duration_since(known.at).is_ok_and(|age| age > COMMAND_MEMORY));
            if !expired && self.order.len() < COMMANDS_MAX {
                return;
            }
            if let Some(oldest) = self.order.pop_front() {
                self.known.remove(&oldest);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use plc_api::types::command::CommandStatus;

    use super::*;

    fn start(memory: &mut CommandMemory, id: &str, at_s: u64) -> Recalled {
        let asked = Asked::command(1, &Command::Start, "hmi");
        memory.recall(id, asked, SystemTime::UNIX_EPOCH + Duration::from_secs(at_s))
    }

    #[test]
    fn a_command_is_known_for_ten_minutes_and_not_longer() {
        let mut memory = CommandMemory::default();
        assert_eq!(start(&mut memory, "a", 0), Recalled::New);
        assert_eq!(start(&mut memory, "a", 600), Recalled::Again(None));
        assert_eq!(start(&mut memory, "a", 601), Recalled::New);
    }

    #[test]
    fn at_most_ten_thousand_commands_are_known_and_the_oldest_are_forgotten() {
        let mut memory = CommandMemory::default();
        for id in 0..=COMMANDS_MAX {
            assert_eq!(start(&mut memory, &id.to_string(), 0), Recalled::New);
        }
        assert_eq!(memory.known.len(), COMMANDS_MAX);
        assert_eq!(
            start(&mut memory, &COMMANDS_MAX.to_string(), 0),
            Recalled::Again(None)
        );
        assert_eq!(start(&mut memory, "0", 0), Recalled::New);
    }

    #[test]
    fn a_reply_to_a_command_that_nobody_sent_is_not_kept() {
        let mut memory = CommandMemory::default();
        let reply = CommandReply {
            command_id: "a".into(),
            status: CommandStatus::Done,
            code: "ok".into(),
            text: String::new(),
            state_rev: 1,
            variables: None,
            lease: None,
            hash: None,
            run_id: None,
        };
        memory.on_reply(&reply, SystemTime::UNIX_EPOCH);
        assert_eq!(memory.reply("a"), None);
        start(&mut memory, "a", 0);
        memory.on_reply(&reply, SystemTime::UNIX_EPOCH);
        assert_eq!(memory.reply("a"), Some(&reply));
    }
}
