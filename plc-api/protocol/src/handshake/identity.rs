//! The instance that acts for a handler, and the handlers that may claim an output after the loss of its
//! owner.

use std::collections::BTreeMap;
use std::time::SystemTime;

use crate::types::handler::is_own_instance;
use crate::types::output::{HandlerPresence, HandshakeStatus, Redelivery};
use crate::types::{CoordinateSystemNumber, Timestamp};

use super::open_output::{ClaimedOutput, IssuedOutput, OpenOutput, OutputOwner, UnclaimedOutput};

/// Status of a rejection, with a text if the status alone does not explain the rejection.
pub(super) type Denial = (HandshakeStatus, Option<String>);

/// A handler that is online.
#[derive(Debug, Clone)]
struct Live {
    instance: Option<String>,
    /// M codes of the coordinate system that the handler serves. The value is the treatment of a lost output
    /// of this M code.
    serves: BTreeMap<u16, Option<Redelivery>>,
    /// Treatment of lost outputs of M codes that `serves` does not contain.
    redelivery: Option<Redelivery>,
    is_exclusive: bool,
    since: SystemTime,
}

/// Handlers that are online, by id.
#[derive(Debug, Default)]
pub(super) struct LiveHandlers(BTreeMap<String, Live>);

impl LiveHandlers {
    pub(super) fn insert_handler(
        &mut self,
        cs: CoordinateSystemNumber,
        id: &str,
        presence: &HandlerPresence,
        since: SystemTime,
    ) {
        let instance = presence.instance.clone();
        let known = self.0.get(id).filter(|known| known.instance == instance);
        let since = known.map_or(since, |known| known.since);
        let handled = presence.handles.iter().filter(|code| code.cs == cs);
        let live = Live {
            instance,
            serves: handled
                .map(|code| (code.m, presence.redelivery_of(cs, code.m)))
                .collect(),
            redelivery: presence.redelivery,
            is_exclusive: presence.exclusive,
            since,
        };
        self.0.insert(id.to_owned(), live);
    }

    /// Removes a handler, unless another instance than `instance` is online meanwhile.
    pub(super) fn remove_handler(&mut self, id: &str, instance: Option<&str>) {
        let goes = |live: &Live| instance.is_none() || live.instance.as_deref() == instance;
        if self.0.get(id).is_some_and(goes) {
            self.0.remove(id);
        }
    }

    /// Returns the handler and the instance for which outputs of an M code are claimed when issued (H20).
    pub(super) fn owner_at_once(&self, m: u16) -> Option<OutputOwner> {
        let mut serving = self.0.iter().filter(|(_, live)| live.serves.contains_key(&m));
        let (id, live) = serving.next().filter(|(_, live)| live.is_exclusive)?;
        let instance = live.instance.as_deref().filter(|named| is_own_instance(named))?;
        serving.next().is_none().then(|| OutputOwner {
            handler_id: id.clone(),
            instance: Some(instance.to_owned()),
        })
    }

    /// Returns the treatment that a handler has announced for lost outputs of an M code.
    pub(super) fn redelivery(&self, id: &str, m: u16) -> Option<Redelivery> {
        let live = self.0.get(id)?;
        live.serves.get(&m).copied().unwrap_or(live.redelivery)
    }

    /// Returns the instance that sends a message. If the message names no instance, this is the online
    /// instance.
    ///
    /// # Errors
    /// Fails if the message names an instance and another instance is online.
    pub(super) fn speaker(&self, id: &str, instance: Option<&String>) -> Result<Option<String>, Denial> {
        match (self.0.get(id), instance) {
            (Some(live), Some(named)) if live.instance.as_ref() != Some(named) => {
                let text = handler_in_use_text(id, live.instance.as_deref(), Some(named), &live.since);
                Err((HandshakeStatus::NotOwner, Some(text)))
            }
            (Some(live), None) => Ok(live.instance.clone()),
            (_, named) => Ok(named.cloned()),
        }
    }

    /// Returns the instance that sends a claim. This instance must be registered. The claim must name the
    /// instance if the registration names one.
    ///
    /// # Errors
    /// Fails if the handler is not registered, if another instance is registered, or if the claim does not
    /// name its instance.
    pub(super) fn claimant(&self, id: &str, instance: Option<&String>) -> Result<Option<String>, Denial> {
        let Some(live) = self.0.get(id) else {
            let text = format!(
                "handler {id} is not registered: announce its presence (handler/{id}/presence, or PUT /handlers/{id}) before it claims"
            );
            return Err((HandshakeStatus::NotOwner, Some(text)));
        };
        if instance.is_none() {
            check_named(id, live.instance.as_deref())?;
        }
        self.speaker(id, instance)
    }

    /// Returns how a handler must continue an unclaimed output after its claim. Returns `None` if no handler has
    /// worked on the output, or if this instance still works on the output.
    ///
    /// # Errors
    /// Fails if the output is withheld from this handler.
    pub(super) fn check_claim(
        &self,
        output: &OpenOutput,
        unclaimed: &UnclaimedOutput,
        id: &str,
        instance: Option<&String>,
    ) -> Result<Option<Redelivery>, Denial> {
        let Some(lost_owner) = unclaimed
            .lost_owner
            .as_ref()
            .filter(|_| unclaimed.decision.is_none())
        else {
            return Ok(unclaimed.decision);
        };
        if lost_owner.is_instance(id, instance) {
            return Ok(None);
        }
        match strictest(output.redelivery, self.redelivery(id, output.notice.m)) {
            None | Some(Redelivery::Ask) => {
                let text = format!(
                    "{} was lost while it worked on this output: an operator decides, by redeliver with redo or verify, or by a reset",
                    lost_owner.handler_id
                );
                Err((HandshakeStatus::Withheld, Some(text)))
            }
            how => Ok(how),
        }
    }

    /// Checks a reset of an unclaimed output as [`check_claim`](Self::check_claim) checks a claim. A sender
    /// that is neither an online handler nor the lost handler is accepted like an operator.
    pub(super) fn check_unclaimed_reset(
        &self,
        output: &OpenOutput,
        unclaimed: &UnclaimedOutput,
        id: &str,
        instance: Option<&String>,
    ) -> Result<(), Denial> {
        let lost_owner = unclaimed.lost_owner.as_ref();
        let is_lost_one = lost_owner.is_some_and(|owner| owner.handler_id == id);
        if !(self.0.contains_key(id) || is_lost_one) {
            return Ok(());
        }
        self.check_claim(output, unclaimed, id, instance).map(|_| ())
    }
}

impl IssuedOutput {
    /// Checks that a handler and its instance own the output, and returns the data of the claimed output.
    /// `since` is the time of the claim.
    ///
    /// # Errors
    /// Fails if another handler or instance owns the output, or if the output has no owner.
    pub(super) fn check_owner(
        &mut self,
        since: SystemTime,
        handler_id: &str,
        instance: Option<&String>,
    ) -> Result<&mut ClaimedOutput, Denial> {
        let claimed = self.claimed_mut().ok_or((HandshakeStatus::NotOwner, None))?;
        claimed.owner.check_sender(since, handler_id, instance)?;
        Ok(claimed)
    }
}

impl OpenOutput {
    /// Returns true if the handler owns the output. If `instance` is `None`, any instance of the handler
    /// matches.
    pub fn is_owned_by(&self, handler_id: &str, instance: Option<&str>) -> bool {
        self.claimed().is_some_and(|claimed| {
            let owner = claimed.owner.instance.as_deref();
            claimed.owner.handler_id == handler_id
                && (instance.is_none() || owner.is_none() || owner == instance)
        })
    }
}

impl OutputOwner {
    /// Checks that a message comes from the owner. `since` is the time of the claim.
    ///
    /// # Errors
    /// Fails if another handler or instance has sent the message, or if the message does not name the instance.
    pub(super) fn check_sender(
        &self,
        since: SystemTime,
        handler_id: &str,
        instance: Option<&String>,
    ) -> Result<(), Denial> {
        if self.handler_id != handler_id {
            return Err((HandshakeStatus::NotOwner, None));
        }
        match (&self.instance, instance) {
            (Some(owner), Some(named)) if owner != named => {
                let text = handler_in_use_text(handler_id, Some(owner), Some(named), &since);
                Err((HandshakeStatus::NotOwner, Some(text)))
            }
            (owner, None) => check_named(handler_id, owner.as_deref()),
            _ => Ok(()),
        }
    }

    /// Returns true for the instance that owned the output at the loss of the connection. In this case the
    /// same process still works on the output.
    fn is_instance(&self, handler_id: &str, instance: Option<&String>) -> bool {
        let named = instance.map(String::as_str);
        self.own_instance().is_some_and(|by| Some(by) == named) && self.handler_id == handler_id
    }

    /// Returns the instance of the owner, if it has named itself.
    pub(super) fn own_instance(&self) -> Option<&str> {
        self.instance.as_deref().filter(|named| is_own_instance(named))
    }
}

/// Rejects a message that names no instance, if the registered process has named its instance.
fn check_named(id: &str, there: Option<&str>) -> Result<(), Denial> {
    if there.is_none_or(|there| !is_own_instance(there)) {
        return Ok(());
    }
    Err((HandshakeStatus::NotOwner, Some(unnamed_text(id))))
}

/// Returns the text that rejects a message without an instance, with the remedy.
pub(crate) fn unnamed_text(id: &str) -> String {
    format!(
        "this message does not name the process of handler {id} that sends it: name the instance of its presence (instance)"
    )
}

/// Returns the stricter of two settings; `None` if neither is set.
pub fn strictest(one: Option<Redelivery>, other: Option<Redelivery>) -> Option<Redelivery> {
    one.max(other)
}

/// Returns the text that rejects a message because another instance of the handler is online, with the
/// remedy.
pub(crate) fn handler_in_use_text(
    handler_id: &str,
    there: Option<&str>,
    named: Option<&String>,
    since: &SystemTime,
) -> String {
    let name = |instance: Option<&str>| match instance.filter(|named| is_own_instance(named)) {
        Some(instance) => format!("instance {instance}"),
        None => "a program without instance".to_owned(),
    };
    let named = named.map(String::as_str);
    let is_unnamed = named.is_none_or(|named| !is_own_instance(named)) && there.is_some_and(is_own_instance);
    let name_itself = if is_unnamed {
        "name the instance of its presence (instance) if it is the same program, "
    } else {
        ""
    };
    format!(
        "handler_id {handler_id} is in use by {} since {}, and this is {}: {name_itself}end that program, use a different \
         handler_id for this program, or let it take over (take_over)",
        name(there),
        Timestamp::from_system_time(*since).to_the_second(),
        name(named),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    impl LiveHandlers {
        /// Returns the registered instance of a handler.
        pub(crate) fn instance(&self, id: &str) -> Option<String> {
            self.0.get(id)?.instance.clone()
        }
    }
}
