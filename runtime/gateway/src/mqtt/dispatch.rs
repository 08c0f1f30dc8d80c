//! Passes received MQTT messages to the port in the order of arrival, without waiting for its answers.

use std::collections::BTreeMap;
use std::future::{pending, poll_fn};
use std::sync::Arc;
use std::task::Poll;

use plc_protocol::server::{ServerNotice, ServerTransport};
use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::command::{CommandReply, CommandStatus};
use plc_protocol::types::handler::{HandlerResult, is_own_instance};
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::{
    Claim, HandlerPresence, HandshakeResult, HandshakeStatus, OutputAct, Reset,
};
use plc_protocol::types::request::{Refusal, RefusalCode, Request};
use plc_protocol::types::topic::{CsTopic, Topic};
use plc_protocol::wire::mqtt::{Inbound, sender};
use plc_protocol::wire::problem::code_word;
use plc_protocol::wire::row::{ParsedRequest, connection_name};
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc};
use tokio::time::Instant;
use tracing::warn;

use super::message;
use crate::access::{Account, User, rules};
use crate::account_slots::{AccountLimits, AccountSlot, AccountSlots};
use crate::arrivals::Arrivals;
use crate::broker::Sessions;
use crate::machine::{AuthorizedRequest, Caller, Machine};
use crate::metrics::Metrics;
use crate::presence_ages::PresenceAges;
use crate::publisher::Publisher;

/// Limits of unanswered requests; further ones are rejected, except hold, stop and abort. Reason: one process may serve
/// 8 coordinate systems.
const UNANSWERED_LIMITS: AccountLimits = AccountLimits {
    all: 256,
    of_user: 128,
    unreserved: 128,
};

/// Largest number of unanswered urgent requests through an external broker. A further one waits: it is never rejected
/// because of other requests.
const URGENT_MAX: usize = 64;

/// Receiver of a rejection: coordinate system, client id, command id.
type ReplyTarget = (CoordinateSystemNumber, String, String);

/// Makes requests of the machine.
pub(super) struct Dispatch {
    machine: Machine,
    metrics: Arc<Metrics>,
    unanswered: AccountSlots,
    urgent: Arc<Semaphore>,
    results: mpsc::Sender<Message>,
    /// Clients of the embedded broker.
    clients: Option<Arc<Sessions>>,
    /// The order in which messages arrived.
    arrivals: Arc<Arrivals>,
    /// True for an external broker: topics name the senders of requests, so that its access rules can tie them to
    /// users.
    requires_named: bool,
    ages: PresenceAges,
}

/// Slot of an unanswered request.
enum RequestPermit {
    Urgent { _permit: OwnedSemaphorePermit },
    Other { _slot: AccountSlot },
}

/// How a message arrived.
pub(super) struct Arrival {
    /// With the retain flag.
    pub(super) retain: bool,
    /// Its number in the order of arrival.
    pub(super) number: Option<u64>,
    /// On a topic that names its sender.
    pub(super) is_named: bool,
}

impl Dispatch {
    /// Creates the dispatcher, and the channel with the results of rejected requests, which must be published.
    pub(super) fn new(
        machine: Machine,
        metrics: Arc<Metrics>,
        clients: Option<Arc<Sessions>>,
        arrivals: Arc<Arrivals>,
        requires_named: bool,
    ) -> (Self, mpsc::Receiver<Message>) {
        let (results, received) = mpsc::channel(UNANSWERED_LIMITS.all);
        let dispatch = Self {
            machine,
            metrics,
            unanswered: AccountSlots::new(UNANSWERED_LIMITS),
            urgent: Arc::new(Semaphore::new(URGENT_MAX)),
            results,
            clients,
            arrivals,
            requires_named,
            ages: PresenceAges::default(),
        };
        (dispatch, received)
    }

    /// Executes a received message, and returns the reply to a command that is rejected before it becomes a request.
    /// Each request reaches the port before the next one is made, so that the port receives them in order; a slow
    /// answer delays nothing.
    pub(super) async fn dispatch_message(
        &mut self,
        publisher: Publisher,
        inbound: Inbound,
        arrival: Arrival,
    ) -> Option<Message> {
        match inbound {
            Inbound::Ask { request, urgent } => {
                let is_foreign = publisher.client_id().is_none();
                match refuse_unnamed(request.request()).filter(|_| is_foreign) {
                    Some((id, refusal)) => Some(self.refuse_handler(id, None, &refusal)),
                    None => self.ask(publisher, request, urgent, arrival).await,
                }
            }
            Inbound::Reject {
                cs,
                client_id,
                command_id,
                refusal,
            } => Some(self.reject(cs, client_id, command_id, refusal).await),
            Inbound::RefuseOutput { cs, m, result, right } => {
                let text = result.text.as_deref().unwrap_or_default();
                let dropped = self.drop_message(&format!(
                    "MQTT message about output {} refused: {text}",
                    result.seq
                ));
                match &publisher {
                    Publisher::User { user, .. } if rules::may_speak_as(user, right, &result.handler_id) => {
                        Some(self.result(cs, m, result))
                    }
                    _ => dropped,
                }
            }
            Inbound::Drop(text) => self.drop_message(&text),
        }
    }

    fn result(&self, cs: CoordinateSystemNumber, m: u16, result: HandshakeResult) -> Message {
        message(
            &self.machine,
            Topic::cs(cs, CsTopic::Result(m)),
            Payload::Result(result),
        )
    }

    async fn ask(
        &mut self,
        publisher: Publisher,
        mut parsed: ParsedRequest,
        urgent: bool,
        arrival: Arrival,
    ) -> Option<Message> {
        if let Some(client_id) = publisher.client_id() {
            parsed.identify(&connection(client_id));
        }
        self.report_earlier_offline(parsed.request()).await;
        let to_tell =
            sender(parsed.request()).map(|(cs, meta)| (cs, meta.client_id.clone(), meta.command_id.clone()));
        let moved = moving_system(parsed.request()).zip(arrival.number);
        if let Some(refusal) = self.reject_on_arrival(parsed.request(), urgent, &arrival) {
            return match output_of(parsed.request()) {
                Some(output) => Some(self.refuse_output(output, refusal)),
                None => self.refuse(to_tell, refusal).await,
            };
        }
        let Some(place) = self.acquire_permit(urgent, &publisher).await else {
            let text = "too many requests are unanswered; send the request again";
            let refusal = Refusal::new(RefusalCode::Unavailable, text);
            return self.refuse(to_tell, refusal).await;
        };
        let announced = match parsed.request() {
            Request::Handler(id, presence) if presence.online => {
                Some((id.clone(), presence.instance.clone()))
            }
            _ => None,
        };
        let authorized = match (authorize(&self.machine, publisher, parsed).await, announced) {
            (Ok(authorized), _) => authorized,
            (Err(refusal), Some((id, instance))) => return Some(self.refuse_handler(id, instance, &refusal)),
            (Err(refusal), None) => return self.refuse(to_tell, refusal).await,
        };
        self.record_presence(authorized.request(), arrival.retain);
        let (machine, results) = (self.machine.clone(), self.results.clone());
        let output = output_of(authorized.request());
        // the port itself replies to a named sender, also to reject a request
        let is_replied_to = to_tell.is_some();
        let asking = async move {
            if let Err(refusal) = machine.execute_request(authorized).await
                && !is_replied_to
            {
                warn!("MQTT request refused: {refusal}");
                if let Some((topic, result)) = output.filter(|_| refusal.code != RefusalCode::Unavailable) {
                    let text = Some(refusal.text);
                    let payload = Payload::Result(HandshakeResult { text, ..result });
                    // the log contains a result that finds no room
                    let _ = results.try_send(message(&machine, topic, payload));
                }
            }
            drop(place);
        };
        let supervisor = self.machine.supervisor();
        let mut asking = Box::pin(supervisor.contained("request over MQTT", asking));
        let begun = poll_fn(|context| Poll::Ready(asking.as_mut().poll(context))).await;
        if begun.is_pending() {
            tokio::spawn(asking); // with its supervisor
        }
        if let Some((cs, number)) = moved {
            self.arrivals.receive(cs, number);
        }
        None
    }

    /// Records the age of a presence. The machine refuses an invalid presence; the earlier one keeps its age.
    fn record_presence(&mut self, request: &Request, retain: bool) {
        if let Request::Handler(id, presence) = request
            && presence.check().is_ok()
        {
            self.ages.record_presence(id, presence, retain, Instant::now());
        }
    }

    /// Takes the slot of an unanswered request. An urgent one waits for its slot, and always gets one.
    async fn acquire_permit(&self, urgent: bool, publisher: &Publisher) -> Option<RequestPermit> {
        if urgent {
            let permit = Arc::clone(&self.urgent).acquire_owned().await.ok()?;
            return Some(RequestPermit::Urgent { _permit: permit });
        }
        let slot = match publisher {
            Publisher::User { user, from, .. } => self.unanswered.acquire(user, Account::new(user, *from)),
            Publisher::Unknown { name, .. } => {
                let account = Account::named(Some(name), None);
                self.unanswered.acquire(&User::Unidentified, account)
            }
        };
        Some(RequestPermit::Other { _slot: slot? })
    }

    /// Rejects a request that its topic or its order of arrival forbids.
    fn reject_on_arrival(&self, request: &Request, urgent: bool, arrival: &Arrival) -> Option<Refusal> {
        if self.requires_named && !arrival.is_named && !urgent && !names_itself(request) {
            let text = "over an external broker the topic must name the sender: publish on \
                        client/{client_id}/... or \
                        handler/{handler_id}/..., or set [mqtt] accept_unverified_senders";
            return Some(Refusal::new(RefusalCode::Forbidden, text));
        }
        let (cs, number) = moving_system(request).zip(arrival.number)?;
        if !self.arrivals.is_overtaken(cs, number) {
            return None;
        }
        self.arrivals.receive(cs, number);
        let text = "a later hold, stop or abort was executed before this command; send the command again";
        Some(Refusal::new(RefusalCode::NotAllowed, text))
    }

    /// Rejects a claim or reset before it reaches the port.
    fn refuse_output(&self, (topic, result): (Topic, HandshakeResult), refusal: Refusal) -> Message {
        self.drop_message(&format!("MQTT request refused: {refusal}"));
        let text = Some(refusal.text);
        message(
            &self.machine,
            topic,
            Payload::Result(HandshakeResult { text, ..result }),
        )
    }

    fn refuse_handler(&self, id: String, instance: Option<String>, refusal: &Refusal) -> Message {
        self.drop_message(&format!("MQTT request refused: {refusal}"));
        let result = HandlerResult::refused(instance, refusal);
        let topic = Topic::HandlerResult(id);
        message(&self.machine, topic, Payload::HandlerResult(result))
    }

    /// Records a new connection.
    pub(super) fn on_connected(&mut self) {
        self.ages.restart_ages(Instant::now());
    }

    /// Records the loss of the connection.
    pub(super) fn on_lost(&mut self) {
        self.ages.pause();
    }

    /// Waits until the presence of a handler expires, while there is a connection. Cancel-safe.
    pub(super) async fn wait_for_expiry(&self) {
        match self.ages.next_expiry() {
            Some(end) => tokio::time::sleep_until(end).await,
            None => pending().await,
        }
    }

    /// Reports the handlers with expired presences as offline. Returns the content of their last wills, by path.
    pub(super) async fn expire_presences(&mut self) -> Vec<(String, String)> {
        let mut said = Vec::new();
        for (id, instance) in self.ages.take_expired(Instant::now()) {
            warn!(
                "handler {id:?} has not repeated its presence within its interval and is treated as \
                   offline"
            );
            let gone = Machine::offline_report(id.clone(), instance.clone(), ServerTransport::Mqtt);
            // fails if the runtime is stopping
            let _ = self.machine.execute_request(gone).await;
            let known = self.machine.read(&Topic::HandlerPresence(id.clone())).await;
            let is_known = known.as_deref().is_some_and(|known| {
                matches!(&known.payload, Payload::HandlerPresence(shown) if !shown.online && shown.instance == instance)
            });
            if is_known {
                let gone = serde_json::to_string(&HandlerPresence::offline(instance));
                said.push((Topic::HandlerPresence(id).path(), gone.unwrap_or_default()));
            }
        }
        said
    }

    /// Reports an earlier handler of the same name as offline, if it is identified by a connection that has ended, also
    /// without a last will.
    async fn report_earlier_offline(&self, request: &Request) {
        let (Some(clients), Request::Handler(id, presence)) = (&self.clients, request) else {
            return;
        };
        let known = self.machine.read(&Topic::HandlerPresence(id.clone())).await;
        let Some(Payload::HandlerPresence(known)) = known.as_deref().map(|message| &message.payload) else {
            return;
        };
        if !presence.online || !known.online || known.instance == presence.instance {
            return;
        }
        let is_connected = |instance: &String| {
            let mut connected = clients.connected().into_iter();
            connected.any(|client_id| connection_name(&connection(&client_id)) == *instance)
        };
        let of_connection = known.instance.as_ref().filter(|named| !is_own_instance(named));
        if of_connection.is_some_and(|instance| !is_connected(instance)) {
            let gone = Machine::offline_report(id.clone(), known.instance.clone(), ServerTransport::Mqtt);
            // fails if the runtime is stopping
            let _ = self.machine.execute_request(gone).await;
        }
    }

    /// Rejects a request before it reaches the port.
    async fn refuse(&self, to_tell: Option<ReplyTarget>, refusal: Refusal) -> Option<Message> {
        let Some((cs, client_id, command_id)) = to_tell else {
            return self.drop_message(&format!("MQTT request refused: {refusal}"));
        };
        Some(self.reject(cs, client_id, command_id, refusal).await)
    }

    /// Drops a message without a sender, to which no reply is possible.
    fn drop_message(&self, text: &str) -> Option<Message> {
        self.metrics.mqtt_refused.inc();
        warn!("{text}");
        None
    }

    async fn reject(
        &self,
        cs: CoordinateSystemNumber,
        client_id: String,
        command_id: String,
        refusal: Refusal,
    ) -> Message {
        self.metrics.mqtt_refused.inc();
        if refusal.code == RefusalCode::Retained {
            let text = format!("retained command {command_id:.128} of {client_id:.64} over MQTT: {refusal}");
            self.machine.notice(ServerNotice::Warning(text));
        }
        rejection(&self.machine, cs, (client_id, command_id), refusal).await
    }
}

/// Rejects a presence that names no instance, if no connection identifies the handler: its broker is not the embedded
/// one.
fn refuse_unnamed(request: &Request) -> Option<(String, Refusal)> {
    let Request::Handler(id, presence) = request else {
        return None;
    };
    let text = "instance: write a name of 1 to 64 characters without / + # ~ that the process creates at \
                its start; this broker \
                cannot distinguish two processes";
    let is_unnamed = presence.online && presence.instance.is_none();
    is_unnamed.then(|| (id.clone(), Refusal::new(RefusalCode::Invalid, text)))
}

/// Returns true for a presence or a heartbeat: the topic of such a request always contains the handler's id.
fn names_itself(request: &Request) -> bool {
    matches!(request, Request::Handler(..) | Request::Heartbeat(..))
}

/// Returns the coordinate system that a command would move; `None` for other requests.
fn moving_system(request: &Request) -> Option<CoordinateSystemNumber> {
    match request {
        Request::Command { cs, command, .. } if command.verb().moves() => Some(*cs),
        _ => None,
    }
}

/// Authorizes the request of a publisher.
pub(super) async fn authorize(
    machine: &Machine,
    publisher: Publisher,
    parsed: ParsedRequest,
) -> Result<AuthorizedRequest, Refusal> {
    match publisher {
        Publisher::User { user, from, .. } => {
            let caller = Caller {
                user: &user,
                from,
                over: ServerTransport::Mqtt,
            };
            machine.authorize_request(caller, parsed).await
        }
        Publisher::Unknown { name, .. } => Machine::authorize_last_will(&name, parsed),
    }
}

/// Returns the reply to a command that is rejected before it reaches the port.
pub(super) async fn rejection(
    machine: &Machine,
    cs: CoordinateSystemNumber,
    (client_id, command_id): (String, String),
    refusal: Refusal,
) -> Message {
    // as a literal: the text comes from the sender, and a log entry must stay on one line
    warn!("MQTT command {command_id:?} of {client_id:?} rejected: {refusal}");
    let state = machine.read(&Topic::cs(cs, CsTopic::State)).await;
    let reply = CommandReply {
        command_id,
        status: CommandStatus::Rejected,
        code: code_word(refusal.code),
        text: refusal.text,
        state_rev: state.and_then(|state| state.rev).unwrap_or(0),
        variables: None,
        lease: None,
        hash: None,
        run_id: None,
        moved: BTreeMap::new(),
    };
    message(machine, Topic::Reply(client_id), Payload::Reply(reply))
}

/// Returns the name of a connection to the embedded broker.
fn connection(client_id: &str) -> String {
    format!("mqtt-{client_id}")
}

/// Returns the topic of a claim or reset, and the result that rejects it.
fn output_of(request: &Request) -> Option<(Topic, HandshakeResult)> {
    let (of, cs, m, seq, handler_id, instance) = match request {
        Request::Claim(cs, m, claim) => {
            let Claim {
                seq,
                handler_id,
                instance,
                ..
            } = claim;
            (OutputAct::Claim, *cs, *m, *seq, handler_id, instance)
        }
        Request::Reset(cs, m, reset) => {
            let Reset {
                seq,
                handler_id,
                instance,
                ..
            } = reset;
            (OutputAct::Reset, *cs, *m, *seq, handler_id, instance)
        }
        _ => return None,
    };
    let result = HandshakeResult {
        of: Some(of),
        instance: instance.clone().filter(|named| is_own_instance(named)),
        ..HandshakeResult::new(seq, handler_id.clone(), HandshakeStatus::Refused)
    };
    Some((Topic::cs(cs, CsTopic::Result(m?)), result))
}
