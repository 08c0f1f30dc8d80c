//! Commands that wait: to be judged, and for their effect.

use std::collections::VecDeque;

use plc_api::execution::word;
use plc_api::types::command::{Command, CommandMeta, CommandStatus, Verb};
use plc_api::types::request::{Answer, Refusal, RefusalCode};
use tokio::sync::oneshot;

use super::context::Context;
use super::programs::Texts;

/// Commands that wait for a transition to end. A further one is refused.
const DEFERRED_MAX: usize = 256;

pub(super) type Reply = oneshot::Sender<Result<Answer, Refusal>>;

/// A command that is to be judged.
pub(super) struct Deferred {
    /// When it came, among all that is asked of this coordinate system.
    pub order: u64,
    pub command: Command,
    pub meta: CommandMeta,
    pub wait: bool,
    pub reply: Reply,
}

/// A command that was accepted and whose effect is still to come.
pub(super) struct Awaiting {
    pub meta: CommandMeta,
    pub verb: Verb,
    /// What was worth knowing when it was accepted.
    pub note: String,
    pub reply: Option<Reply>,
}

impl Awaiting {
    /// Done when the machine rests under feed hold.
    pub fn is_hold(&self) -> bool {
        self.verb == Verb::Hold
    }

    /// Done when a run has been ended and the machine rests. A hold that an end overtook is done then, too.
    pub fn is_end(&self) -> bool {
        matches!(self.verb, Verb::Hold | Verb::Stop | Verb::Abort | Verb::Reset)
    }

    /// Done when the run that it began has ended by itself.
    pub fn is_of_run(&self) -> bool {
        matches!(self.verb, Verb::Mdi | Verb::Home | Verb::Jog)
    }
}

/// Commands to one coordinate system, and the program that they have loaded.
#[derive(Default)]
pub(super) struct Commands {
    deferred: VecDeque<Deferred>,
    awaiting: Vec<Awaiting>,
    /// Order of the last stop or abort.
    stopped_at: u64,
    /// The command that was accepted last.
    pub last_id: Option<String>,
    /// The program loaded.
    pub program: Option<u16>,
    /// It and those that it calls, as they were when it was loaded.
    pub texts: Texts,
}

impl Commands {
    /// Keeps a command until those before it have had their effect.
    ///
    /// # Errors
    /// Too many wait; the command is given back.
    pub fn defer(&mut self, command: Deferred) -> Result<(), Box<Deferred>> {
        if self.deferred.len() >= DEFERRED_MAX {
            return Err(Box::new(command));
        }
        self.deferred.push_back(command);
        Ok(())
    }

    /// The command that is judged next.
    pub fn next(&mut self) -> Option<Deferred> {
        self.deferred.pop_front()
    }

    /// True when none waits to be judged.
    pub fn is_empty(&self) -> bool {
        self.deferred.is_empty()
    }

    /// A stop or an abort passes those that wait.
    pub fn note_stop(&mut self, order: u64) {
        self.stopped_at = order;
    }

    /// Refuses what was to move before a stop or abort that has passed it.
    pub fn judge_order(&self, verb: Verb, order: u64) -> Result<(), Refusal> {
        if verb.moves() && order < self.stopped_at {
            let text = "a stop or abort that came after it has been carried out before it; command it again";
            return Err(Refusal::new(RefusalCode::NotAllowed, text));
        }
        Ok(())
    }

    /// True when the effect of a command of this id is still to come.
    pub fn awaits(&self, command_id: &str) -> bool {
        let mut awaiting = self.awaiting.iter();
        awaiting.any(|awaiting| awaiting.meta.command_id == command_id)
    }

    /// A command was accepted.
    pub fn await_effect(&mut self, awaiting: Awaiting) {
        self.awaiting.push(awaiting);
    }

    /// Tells those commands what has become of them; with `done` each its own note instead of the text.
    pub fn answer(
        &mut self,
        context: &Context,
        is_it: &dyn Fn(&Awaiting) -> bool,
        status: CommandStatus,
        code: &str,
        text: &str,
    ) {
        let (answered, left): (Vec<_>, Vec<_>) = self.awaiting.drain(..).partition(is_it);
        self.awaiting = left;
        for Awaiting {
            meta, note, reply, ..
        } in answered
        {
            // who waits for the end only must hear of it, too
            let text = if status == CommandStatus::Done {
                &note
            } else {
                text
            };
            let said = context.reply(&meta, status, code, text);
            if let Some(reply) = reply {
                // The asker may have gone; the reply is published, too.
                let _ = reply.send(Ok(Answer::Command(said)));
            }
        }
    }
}

/// Refuses a command.
pub(super) fn reject(context: &Context, meta: &CommandMeta, refusal: Refusal, reply: Reply) {
    let code = word(&refusal.code);
    context.reply(meta, CommandStatus::Rejected, &code, &refusal.text);
    // The asker may have gone; the reply is published, too.
    let _ = reply.send(Err(refusal));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(order: u64) -> Deferred {
        Deferred {
            order,
            command: Command::Start,
            meta: CommandMeta::default(),
            wait: false,
            reply: oneshot::channel().0,
        }
    }

    #[test]
    fn commands_are_judged_in_their_order_and_one_too_many_is_given_back() {
        let mut commands = Commands::default();
        for order in 0..DEFERRED_MAX as u64 {
            assert!(commands.defer(command(order)).is_ok());
        }
        assert_eq!(commands.defer(command(999)).unwrap_err().order, 999);
        let orders = std::iter::from_fn(|| commands.next()).map(|command| command.order);
        assert!(orders.eq(0..DEFERRED_MAX as u64));
        assert!(commands.is_empty());
    }

    #[test]
    fn what_was_to_move_before_a_stop_that_has_passed_it_is_refused() {
        let mut commands = Commands::default();
        assert_eq!(commands.judge_order(Verb::Start, 4), Ok(()));
        commands.note_stop(5);
        let refusal = commands.judge_order(Verb::Start, 4).unwrap_err();
        assert_eq!(refusal.code, RefusalCode::NotAllowed);
        assert_eq!(commands.judge_order(Verb::Reset, 4), Ok(()), "it moves nothing");
        assert_eq!(commands.judge_order(Verb::Start, 6), Ok(()));
    }
}
