//! Memory of the commands of the last 10 minutes. A repeated command gets its stored reply and is not executed again.
//!
//! Each user has a separate memory, so that commands of a user never evict those of another user. Commands that can
//! move the machine are never dropped before their time. If a new one does not fit into the memory, it is rejected.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Debug;
use std::hash::{Hash, Hasher};
use std::time::{Duration, SystemTime};

use plc_protocol::execution::wire_name;
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{Command, CommandReply, CommandStatus, MemoryKey, Verb};
use plc_protocol::types::request::{Refusal, RefusalCode};

/// Validity of a stored reply. Within this time, a command with the same id gets this reply and is not executed again.
pub const COMMAND_MEMORY: Duration = Duration::from_mins(10);

/// Maximum memory in bytes for one kind of commands of one user. Reason: enough for 9,000 commands, which is 15 per
/// second for 10 minutes.
pub const USER_BYTES_MAX: usize = 4 << 20;

/// Maximum memory in bytes for the commands of all users that can move the machine. Reason: eight users at their limits.
pub const MOTION_BYTES_MAX: usize = 32 << 20;

/// Maximum memory in bytes for all commands of all users of each other kind. It is separate, so that requests that move
/// nothing never prevent a motion.
pub const OTHER_BYTES_MAX: usize = 16 << 20;

/// Maximum size of one command in bytes. This size is reserved until the last reply to the command.
const ENTRY_BYTES_MAX: usize = 2048;

/// Size in bytes of a command without its texts: the nodes of two collections.
const ENTRY_BYTES: usize = 256;

/// Maximum stored length of a reply's text in bytes, chosen so that every command fits in [`ENTRY_BYTES_MAX`].
const TEXT_BYTES_MAX: usize = 512;

/// Stored commands, by user and id.
#[derive(Debug, Default)]
pub(crate) struct CommandMemory {
    users: BTreeMap<String, UserMemory>,
    /// Bytes of all users, by kind.
    bytes: BTreeMap<CommandKind, usize>,
}

/// Stored commands of one user.
#[derive(Debug, Default)]
struct UserMemory {
    known: BTreeMap<String, RememberedCommand>,
    lanes: BTreeMap<CommandKind, Lane>,
}

/// Stored commands of one user and kind, in the order of their arrival.
#[derive(Debug, Default)]
struct Lane {
    order: VecDeque<String>,
    bytes: usize,
}

#[derive(Debug)]
struct RememberedCommand {
    at: SystemTime,
    asked: CommandContent,
    bytes: usize,
    /// `None` until the command is answered.
    reply: Option<CommandReply>,
}

/// Kind of a command, which determines the effect of a new command when the memory is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum CommandKind {
    /// Start, run, resume, back trace, MDI, jog, home, load and reset. A new command of this kind is rejected.
    Motion,
    /// Requests that move nothing. A new request drops the user's oldest request of this kind.
    Other,
    /// Hold, stop and abort. A new command drops the user's oldest command of this kind, and is executed in any case.
    Urgent,
}

impl CommandKind {
    /// Returns the maximum memory in bytes for all commands of all users of this kind.
    fn total_max(self) -> usize {
        match self {
            CommandKind::Motion => MOTION_BYTES_MAX,
            CommandKind::Other | CommandKind::Urgent => OTHER_BYTES_MAX,
        }
    }
}

/// Content of a command. It distinguishes a repeated command from a different command with the same id.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CommandContent {
    /// Description of the command for an error text.
    words: String,
    content: u64,
    kind: CommandKind,
    /// Client of a hold, stop or abort; otherwise `None`. These commands are executed even if their id was used before.
    urgent_of: Option<String>,
}

impl CommandContent {
    /// Creates the content of a request that cannot move the machine.
    pub fn new(words: String, content: &impl Debug) -> Self {
        let mut hasher = DefaultHasher::new();
        format!("{content:?}").hash(&mut hasher);
        Self {
            words,
            content: hasher.finish(),
            kind: CommandKind::Other,
            urgent_of: None,
        }
    }

    pub fn command(cs: CoordinateSystemNumber, command: &Command, client_id: &str) -> Self {
        let verb = command.verb();
        let words = format!("{} of coordinate system {cs}", wire_name(&verb));
        let kind = match verb {
            Verb::Hold | Verb::Stop | Verb::Abort => CommandKind::Urgent,
            Verb::AlarmAcknowledge => CommandKind::Other,
            _ => CommandKind::Motion,
        };
        Self {
            urgent_of: verb.is_urgent().then(|| client_id.to_owned()),
            kind,
            ..Self::new(words, &(cs, command))
        }
    }

    /// Returns the key of the command in the memory. Hold, stop and abort have the client in their key, so they never
    /// replace another command with the same id.
    pub fn key(&self, user: impl Into<String>, command_id: &str) -> MemoryKey {
        let client_id = self.urgent_of.as_deref().unwrap_or_default();
        MemoryKey {
            user: user.into(),
            command: format!("{client_id}/{command_id}"),
        }
    }
}

/// Result of looking up a command.
#[expect(
    clippy::large_enum_variant,
    reason = "the value lives only while one command is looked up"
)]
#[derive(Debug, PartialEq)]
pub(crate) enum CommandLookup {
    /// The command was not stored yet, and is to be executed.
    New,
    /// The command is repeated. Contains its reply if it was answered.
    Again(Option<CommandReply>),
    /// A different command, described in this text, has the same id.
    OtherCommand(String),
    /// The command was not stored yet, and the memory has no space for it.
    Full,
}

/// Returns the refusal of a command for which the memory has no space.
pub(crate) fn memory_is_full() -> Refusal {
    let text = format!(
        "the memory for this user's commands of the last {} minutes is full ({} MiB), so that a repeated \
         command \
         could not be detected: wait a few minutes, or send fewer commands; hold, stop and abort are still accepted",
        COMMAND_MEMORY.as_secs() / 60,
        USER_BYTES_MAX >> 20
    );
    Refusal::new(RefusalCode::Unavailable, text)
}

impl CommandMemory {
    /// Looks up a command.
    pub fn look_up(&mut self, key: &MemoryKey, asked: &CommandContent, now: SystemTime) -> CommandLookup {
        self.forget_expired(now);
        match self.known(key) {
            Some(known) if known.asked == *asked => CommandLookup::Again(known.reply.clone()),
            Some(known) if asked.urgent_of.is_none() => {
                CommandLookup::OtherCommand(known.asked.words.clone())
            }
            _ => CommandLookup::New,
        }
    }

    /// Looks up a command, and stores it if it is new.
    pub fn recall(&mut self, key: &MemoryKey, asked: CommandContent, now: SystemTime) -> CommandLookup {
        match self.look_up(key, &asked, now) {
            CommandLookup::New => self.remember(key, asked, now),
            known => known,
        }
    }

    fn known(&self, key: &MemoryKey) -> Option<&RememberedCommand> {
        self.users.get(&key.user)?.known.get(&key.command)
    }

    fn remember(&mut self, key: &MemoryKey, asked: CommandContent, now: SystemTime) -> CommandLookup {
        let kind = asked.kind;
        self.replace(key);
        while !self.has_room(&key.user, kind) {
            if kind == CommandKind::Motion {
                return CommandLookup::Full;
            }
            if !self.forget_oldest(&key.user, kind) {
                // the commands of other users have filled the memory: this command is executed but not stored
                return CommandLookup::New;
            }
        }
        let memory = self.users.entry(key.user.clone()).or_default();
        let lane = memory.lanes.entry(kind).or_default();
        lane.order.push_back(key.command.clone());
        lane.bytes += ENTRY_BYTES_MAX;
        *self.bytes.entry(kind).or_default() += ENTRY_BYTES_MAX;
        let known = RememberedCommand {
            at: now,
            asked,
            bytes: ENTRY_BYTES_MAX,
            reply: None,
        };
        memory.known.insert(key.command.clone(), known);
        CommandLookup::New
    }

    /// Removes a stored hold, stop or abort before a new one with the same key is stored.
    fn replace(&mut self, key: &MemoryKey) {
        let Some(memory) = self.users.get_mut(&key.user) else {
            return;
        };
        let Some(known) = memory.known.remove(&key.command) else {
            return;
        };
        if let Some(lane) = memory.lanes.get_mut(&known.asked.kind) {
            lane.order.retain(|kept| *kept != key.command);
            lane.bytes -= known.bytes;
        }
        *self.bytes.entry(known.asked.kind).or_default() -= known.bytes;
    }

    fn has_room(&self, user: &str, kind: CommandKind) -> bool {
        let lane = self.users.get(user).and_then(|memory| memory.lanes.get(&kind));
        let bytes = lane.map_or(0, |lane| lane.bytes);
        let total = self.bytes.get(&kind).copied().unwrap_or(0);
        bytes + ENTRY_BYTES_MAX <= USER_BYTES_MAX && total + ENTRY_BYTES_MAX <= kind.total_max()
    }

    /// Stores the last reply to a command.
    pub fn on_reply(&mut self, key: &MemoryKey, reply: &CommandReply, now: SystemTime) {
        let Some(memory) = self.users.get_mut(&key.user) else {
            return;
        };
        let Some(known) = memory.known.get_mut(&key.command) else {
            return;
        };
        let mut kept = reply.clone();
        kept.text.truncate(kept.text.floor_char_boundary(TEXT_BYTES_MAX));
        let before = known.bytes;
        if kept.status != CommandStatus::Accepted {
            known.bytes = bytes_of(&key.command, &known.asked, &kept).min(before);
        }
        let freed = before - known.bytes;
        (known.at, known.reply) = (now, Some(kept));
        if let Some(lane) = memory.lanes.get_mut(&known.asked.kind) {
            lane.bytes -= freed;
        }
        *self.bytes.entry(known.asked.kind).or_default() -= freed;
    }

    /// Returns the last reply to a command.
    pub fn reply(&self, key: &MemoryKey) -> Option<&CommandReply> {
        self.known(key)?.reply.as_ref()
    }

    /// Returns the last reply to the command with this id: of this user, otherwise of any user.
    pub fn find_reply(&self, user: &str, command_id: &str) -> Option<&CommandReply> {
        let own = self.users.get(user).into_iter();
        let mut all = own.chain(self.users.values());
        all.find_map(|memory| memory.reply(command_id))
    }

    /// Drops the user's oldest command of this kind. Returns false if no such command is stored.
    fn forget_oldest(&mut self, user: &str, kind: CommandKind) -> bool {
        let Some(memory) = self.users.get_mut(user) else {
            return false;
        };
        let Some(lane) = memory.lanes.get_mut(&kind) else {
            return false;
        };
        let Some(known) = lane.order.pop_front().and_then(|key| memory.known.remove(&key)) else {
            return false;
        };
        lane.bytes -= known.bytes;
        *self.bytes.entry(kind).or_default() -= known.bytes;
        true
    }

    fn forget_expired(&mut self, now: SystemTime) {
        // if the clock is set back, no entry expires
        let is_fresh = |known: &RememberedCommand| {
            now.duration_since(known.at)
                .is_ok_and(|age| age <= COMMAND_MEMORY)
                || now < known.at
        };
        for memory in self.users.values_mut() {
            for (kind, lane) in &mut memory.lanes {
                while let Some(oldest) = lane.order.pop_front() {
                    if memory.known.get(&oldest).is_some_and(is_fresh) {
                        lane.order.push_front(oldest);
                        break;
                    }
                    let bytes = memory.known.remove(&oldest).map_or(0, |known| known.bytes);
                    lane.bytes -= bytes;
                    *self.bytes.entry(*kind).or_default() -= bytes;
                }
            }
        }
        self.users.retain(|_, memory| !memory.known.is_empty());
    }
}

impl UserMemory {
    fn reply(&self, command_id: &str) -> Option<&CommandReply> {
        let plain = self.known.get(&format!("/{command_id}"));
        let mut urgent = self.known.iter().filter(|(key, known)| {
            known.asked.urgent_of.is_some() && key.split_once('/').is_some_and(|(_, id)| id == command_id)
        });
        let found = plain.or_else(|| urgent.next().map(|(_, known)| known));
        found?.reply.as_ref()
    }
}

/// Returns the size in bytes of a stored command with its last reply.
fn bytes_of(key: &str, asked: &CommandContent, reply: &CommandReply) -> usize {
    let texts = [
        Some(&reply.command_id),
        Some(&reply.code),
        Some(&reply.text),
        reply.hash.as_ref(),
        reply.run_id.as_ref(),
        asked.urgent_of.as_ref(),
        Some(&asked.words),
    ];
    let texts: usize = texts.into_iter().flatten().map(String::len).sum();
    ENTRY_BYTES + size_of::<RememberedCommand>() + 2 * key.len() + texts
}

#[cfg(test)]
mod tests {
    use super::*;

    impl CommandMemory {
        fn total(&self) -> usize {
            self.bytes.values().sum()
        }
    }

    fn at(s: u64) -> SystemTime {
        SystemTime::UNIX_EPOCH + Duration::from_secs(s)
    }

    fn ask(memory: &mut CommandMemory, user: &str, id: &str, command: &Command, at_s: u64) -> CommandLookup {
        let asked = CommandContent::command(1, command, "hmi");
        let key = asked.key(user, id);
        memory.recall(&key, asked, at(at_s))
    }

    fn start(memory: &mut CommandMemory, user: &str, id: &str, at_s: u64) -> CommandLookup {
        ask(memory, user, id, &Command::Start, at_s)
    }

    fn done(command_id: &str, text: &str) -> CommandReply {
        CommandReply {
            command_id: command_id.into(),
            status: CommandStatus::Done,
            code: "ok".into(),
            text: text.into(),
            state_rev: 1,
            variables: None,
            lease: None,
            hash: None,
            run_id: None,
            moved: BTreeMap::new(),
        }
    }

    /// Stores answered commands until one is rejected or `most` of them are stored.
    fn fill(memory: &mut CommandMemory, user: &str, command: &Command, most: usize) -> usize {
        for n in 0..most {
            let id = format!("fill-{n}");
            if ask(memory, user, &id, command, 0) == CommandLookup::Full {
                return n;
            }
            let key = CommandContent::command(1, command, "hmi").key(user, &id);
            memory.on_reply(&key, &done(&id, ""), at(0));
        }
        most
    }

    #[test]
    fn a_command_is_known_for_ten_minutes_and_not_longer() {
        let mut memory = CommandMemory::default();
        assert_eq!(start(&mut memory, "u", "a", 0), CommandLookup::New);
        assert_eq!(start(&mut memory, "u", "a", 600), CommandLookup::Again(None));
        assert_eq!(start(&mut memory, "u", "a", 601), CommandLookup::New);
    }

    #[test]
    fn motion_that_does_not_fit_is_rejected_and_nothing_is_forgotten_early() {
        let mut memory = CommandMemory::default();
        assert_eq!(start(&mut memory, "u", "first", 0), CommandLookup::New);
        let filled = fill(&mut memory, "u", &Command::Start, 100_000);
        assert!((5_000..100_000).contains(&filled), "{filled}");
        assert_eq!(start(&mut memory, "u", "first", 600), CommandLookup::Again(None));
        assert_eq!(start(&mut memory, "u", "new", 600), CommandLookup::Full);
        assert!(memory.total() <= USER_BYTES_MAX, "{}", memory.total());
        assert_eq!(start(&mut memory, "u", "new", 601), CommandLookup::New);
    }

    #[test]
    fn a_start_is_remembered_whatever_other_commands_come_after_it() {
        let mut memory = CommandMemory::default();
        start(&mut memory, "u", "first", 0);
        for command in [Command::AlarmAcknowledge { id: 1 }, Command::Stop] {
            assert_eq!(fill(&mut memory, "u", &command, 24_000), 24_000, "{command:?}");
        }
        assert_eq!(start(&mut memory, "u", "first", 0), CommandLookup::Again(None));
        assert!(memory.total() <= 3 * USER_BYTES_MAX, "{}", memory.total());
    }

    #[test]
    fn a_user_whose_memory_is_full_takes_nothing_from_another() {
        let mut memory = CommandMemory::default();
        start(&mut memory, "anna", "1", 0);
        fill(&mut memory, "bert", &Command::Start, 100_000);
        assert_eq!(start(&mut memory, "bert", "new", 0), CommandLookup::Full);
        assert_eq!(start(&mut memory, "anna", "1", 0), CommandLookup::Again(None));
        assert_eq!(start(&mut memory, "anna", "2", 0), CommandLookup::New);
        assert_eq!(
            start(&mut memory, "bert", "1", 0),
            CommandLookup::Full,
            "an id of another user"
        );
    }

    #[test]
    fn all_users_together_stay_within_the_documented_bytes() {
        let mut memory = CommandMemory::default();
        for user in 0..20 {
            fill(&mut memory, &user.to_string(), &Command::Start, 100_000);
        }
        assert!(memory.total() <= MOTION_BYTES_MAX, "{}", memory.total());
        assert_eq!(start(&mut memory, "late", "1", 0), CommandLookup::Full);
        assert_eq!(
            ask(&mut memory, "late", "2", &Command::Stop, 0),
            CommandLookup::New
        );
        assert_eq!(start(&mut memory, "late", "1", 601), CommandLookup::New);
        assert!(memory.total() <= ENTRY_BYTES_MAX, "all others have expired");
    }

    #[test]
    fn requests_that_move_nothing_never_prevent_a_motion_of_others() {
        let mut memory = CommandMemory::default();
        for user in 0..20 {
            let user = user.to_string();
            fill(&mut memory, &user, &Command::AlarmAcknowledge { id: 1 }, 30_000);
            fill(&mut memory, &user, &Command::Stop, 30_000);
        }
        assert!(memory.total() <= 2 * OTHER_BYTES_MAX, "{}", memory.total());
        assert_eq!(start(&mut memory, "late", "1", 0), CommandLookup::New);
        assert_eq!(start(&mut memory, "late", "1", 0), CommandLookup::Again(None));
    }

    #[test]
    fn the_longest_reply_stays_within_the_bytes_that_were_set_aside_for_it() {
        let mut memory = CommandMemory::default();
        let id = "x".repeat(128);
        start(&mut memory, "u", &id, 0);
        let reply = CommandReply {
            hash: Some("h".repeat(64)),
            run_id: Some("r".repeat(64)),
            ..done(&id, &"\u{e4}".repeat(10_000))
        };
        let asked = CommandContent::command(1, &Command::Start, "hmi");
        let key = asked.key("u", &id);
        assert!(
            bytes_of(
                &key.command,
                &asked,
                &CommandReply {
                    text: "t".repeat(TEXT_BYTES_MAX),
                    ..reply.clone()
                }
            ) <= ENTRY_BYTES_MAX
        );
        memory.on_reply(&key, &reply, at(0));
        assert_eq!(
            memory.reply(&key).map(|kept| kept.text.len()),
            Some(TEXT_BYTES_MAX)
        );
    }

    #[test]
    fn a_reply_to_a_command_that_nobody_sent_is_not_kept() {
        let mut memory = CommandMemory::default();
        let key = CommandContent::command(1, &Command::Start, "hmi").key("u", "a");
        memory.on_reply(&key, &done("a", ""), at(0));
        assert_eq!(memory.reply(&key), None);
        start(&mut memory, "u", "a", 0);
        memory.on_reply(&key, &done("a", ""), at(0));
        assert_eq!(memory.reply(&key), Some(&done("a", "")));
        assert_eq!(memory.find_reply("another", "a"), Some(&done("a", "")));
    }

    #[test]
    fn a_stop_keeps_the_start_of_the_same_id_in_memory() {
        let mut memory = CommandMemory::default();
        start(&mut memory, "u", "1", 0);
        assert_eq!(ask(&mut memory, "u", "1", &Command::Hold, 0), CommandLookup::New);
        assert_eq!(ask(&mut memory, "u", "1", &Command::Stop, 0), CommandLookup::New);
        assert_eq!(
            ask(&mut memory, "u", "1", &Command::Stop, 0),
            CommandLookup::Again(None)
        );
        assert_eq!(start(&mut memory, "u", "1", 0), CommandLookup::Again(None));
        assert_eq!(
            ask(&mut memory, "u", "1", &Command::Reset, 0),
            CommandLookup::OtherCommand("start of coordinate system 1".into())
        );
    }
}
