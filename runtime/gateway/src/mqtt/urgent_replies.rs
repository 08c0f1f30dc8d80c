//! Replies to urgent commands, which the urgent lane publishes ahead of all other messages.

use std::collections::{HashMap, VecDeque};

use parking_lot::Mutex;
use plc_protocol::types::command::CommandStatus;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::topic::Topic;

/// Largest number of newest urgent commands whose replies the lane publishes. Reason: 256 clients with 4 kinds of
/// commands to 8 coordinate systems. Replies to older commands are published in order with all other messages.
const AWAITED_MAX: usize = 8192;

/// A client id and a command id.
type ReplyId = (String, String);

/// Two readers see each reply: the urgent lane, which publishes it, and the link, which must not publish it again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Reader {
    Lane,
    Link,
}

/// Which replies belong to urgent commands.
#[derive(Debug, Default)]
pub(crate) struct UrgentReplies(Mutex<AwaitedReplies>);

#[derive(Debug, Default)]
struct AwaitedReplies {
    /// The reader that has already seen the last reply to the command.
    by_id: HashMap<ReplyId, Option<Reader>>,
    order: VecDeque<ReplyId>,
}

impl UrgentReplies {
    /// Awaits the replies to an urgent command.
    pub(super) fn await_replies(&self, client_id: &str, command_id: &str) {
        let mut awaited = self.0.lock();
        while awaited.order.len() >= AWAITED_MAX {
            if let Some(oldest) = awaited.order.pop_front() {
                awaited.by_id.remove(&oldest);
            }
        }
        let id = (client_id.to_owned(), command_id.to_owned());
        if awaited.by_id.insert(id.clone(), None).is_none() {
            awaited.order.push_back(id);
        }
    }

    /// Returns true for a reply to an urgent command. The last reply is forgotten when both readers have seen it.
    pub(super) fn is_urgent(&self, message: &Message, reader: Reader) -> bool {
        let (Topic::Reply(client_id), Payload::Reply(reply)) = (&message.topic, &message.payload) else {
            return false;
        };
        let mut awaited = self.0.lock();
        let id = (client_id.clone(), reply.command_id.clone());
        let Some(seen_by) = awaited.by_id.get_mut(&id) else {
            return false;
        };
        if reply.status != CommandStatus::Accepted {
            match seen_by {
                Some(other) if *other != reader => {
                    awaited.by_id.remove(&id);
                }
                _ => *seen_by = Some(reader),
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{message, reply};

    fn reply_message(client_id: &str, command_id: &str, status: CommandStatus) -> Message {
        let reply = reply(command_id, status, "ok");
        message(Topic::Reply(client_id.into()), None, Payload::Reply(reply))
    }

    #[test]
    fn both_readers_see_each_reply_of_an_urgent_command_and_no_other() {
        let replies = UrgentReplies::default();
        replies.await_replies("hmi", "c-1");
        let accepted = reply_message("hmi", "c-1", CommandStatus::Accepted);
        let done = reply_message("hmi", "c-1", CommandStatus::Done);
        for message in [&accepted, &done] {
            assert!(replies.is_urgent(message, Reader::Link));
            assert!(replies.is_urgent(message, Reader::Lane));
        }
        assert!(
            replies.0.lock().by_id.is_empty(),
            "it is forgotten after the last reply"
        );
        for other in [
            reply_message("hmi", "c-2", CommandStatus::Done),
            reply_message("cell", "c-1", CommandStatus::Done),
        ] {
            assert!(!replies.is_urgent(&other, Reader::Lane));
        }
    }

    #[test]
    fn awaited_replies_are_bounded_and_the_oldest_go_the_ordinary_way() {
        let replies = UrgentReplies::default();
        for n in 0..=AWAITED_MAX {
            replies.await_replies("hmi", &n.to_string());
        }
        assert!(replies.0.lock().by_id.len() <= AWAITED_MAX);
        assert!(!replies.is_urgent(&reply_message("hmi", "0", CommandStatus::Done), Reader::Lane));
        assert!(replies.is_urgent(&reply_message("hmi", "1", CommandStatus::Done), Reader::Lane));
    }
}
