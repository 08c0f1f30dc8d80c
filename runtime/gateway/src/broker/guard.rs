//! Admits users, restricts them to their topics, and decides on each message.

use std::future::{Future, ready};
use std::net::{IpAddr, SocketAddr};
use std::pin::Pin;
use std::sync::{Arc, OnceLock, Weak};

use mqtt5::QoS;
use mqtt5::broker::auth::AuthResult;
use mqtt5::broker::events::{
    BrokerEventHandler, ClientConnectEvent, ClientDisconnectEvent, ClientPublishEvent, RetainedSetEvent,
};
use mqtt5::broker::storage::ClientSession;
use mqtt5::packet::connect::ConnectPacket;
use mqtt5::packet::publish::PublishPacket;
use mqtt5::types::ReasonCode;
use plc_protocol::server::{AccessKind, ServerNotice, ServerTransport};
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::request::Request;
use plc_protocol::wire::mqtt::{Inbound, decode};
use plc_protocol::wire::right::Right;
use plc_protocol::wire::row::ParsedRequest;
use tokio::sync::mpsc;
use tracing::warn;

use super::packet_monitor::MessagesInTransit;
use super::retained::{Kind, RetainedMessages};
use super::sessions::{AdmittedClient, Sessions};
use super::{BrokerAccess, FILTER_BYTES_MAX, MQTT_5};
use crate::access::activity::is_activity_over_mqtt;
use crate::access::topics::{may_publish, may_subscribe};
use crate::access::{Account, AuthenticatedUser, Rates, User, Users};
use crate::arrivals::{Arrivals, command_of, may_be_urgent};
use crate::broker_address::RefusedMessage;
use crate::certificate::ClientCertificate;
use crate::connection_slots::{ConnectionSlot, host_of};
use crate::contract::topics::is_inbound;
use crate::publisher::Publisher;
use crate::urgent_slots::ExecuteUrgent;

/// Connection slots of known clients that are reserved for users who may stop a machine.
const RESERVED: usize = 32;

/// Messages of one user, or without users of one host: burst, and rate per second. Further ones are delayed, not
/// rejected: over MQTT 3.1.1 a rejected message is lost silently. Reason: one process may serve 8 coordinate systems
/// with 200 M codes a second, each with a claim and a reset.
const USER_BURST: u32 = 10_000;
const USER_PER_SECOND: u32 = 5000;

/// Limits of urgent requests, separate from all other messages. Reason: if one message of each of 256 connections is
/// delayed, the last one waits 0.26 s.
const URGENT_BURST: u32 = 1000;
const URGENT_PER_SECOND: u32 = 1000;

/// Wrong tokens from one address: burst, and rate per second. Further ones are rejected as too many.
const WRONG_BURST: u32 = 50;
const WRONG_PER_SECOND: u32 = 10;

/// Identifies the user of a connection. With a password, it is the owner of that token or login, and the name must
/// match. Without a password, it is the owner of the client certificate, and a name must match if it is given.
fn identify_user(
    users: &Users,
    connect: &ConnectPacket,
    certificate: Option<&ClientCertificate>,
) -> Option<AuthenticatedUser> {
    let (name, password) = (connect.username.as_deref(), connect.password.as_deref());
    let shown = users.identify(password, certificate)?;
    let is_named = shown.user.name() == name || name.is_none() && password.is_none();
    is_named.then_some(shown)
}

/// Returns true for a client whose session outlives its connection.
fn outlives(connect: &ConnectPacket) -> bool {
    ClientSession::expiry_from_connect(connect) != Some(0)
}

/// Creates the message that clears a retained topic.
pub(super) fn clearing(topic: &str) -> PublishPacket {
    let mut clear = PublishPacket::new(topic, Vec::new(), QoS::AtLeastOnce);
    clear.retain = true;
    clear
}

/// Decision on a message.
pub(super) enum PublishDecision {
    /// It is delivered, after this retained topic is cleared for it.
    Deliver { clear: Option<String> },
    /// It is not delivered, because the guard has handled it.
    Handled,
    /// It is not delivered, because it cannot be kept.
    NotRetained,
}

/// Admits users, restricts them to their topics, and rejects commands with the retain flag.
pub(super) struct Guard {
    pub(super) access: BrokerAccess,
    pub(super) refused: mpsc::Sender<RefusedMessage>,
    pub(super) rates: Rates<Account>,
    // for urgent requests
    pub(super) urgent_rates: Rates<Account>,
    // receiver of urgent requests
    pub(super) urgent: OnceLock<Weak<dyn ExecuteUrgent>>,
    pub(super) arrivals: Arc<Arrivals>,
    // by address
    pub(super) wrong: Rates<IpAddr>,
    pub(super) sessions: Arc<Sessions>,
    pub(super) retained: RetainedMessages,
    pub(super) in_transit: MessagesInTransit,
}

impl Guard {
    pub(super) fn new(
        access: BrokerAccess,
        refused: mpsc::Sender<RefusedMessage>,
        sessions: Arc<Sessions>,
    ) -> Self {
        Self {
            access,
            refused,
            rates: Rates::new(USER_BURST, USER_PER_SECOND),
            urgent_rates: Rates::new(URGENT_BURST, URGENT_PER_SECOND),
            urgent: OnceLock::new(),
            arrivals: Arc::default(),
            wrong: Rates::new(WRONG_BURST, WRONG_PER_SECOND),
            sessions,
            retained: RetainedMessages::default(),
            in_transit: MessagesInTransit::default(),
        }
    }

    /// Returns the user with a user id of [`Guard::authenticate`]; `None` for an unknown one.
    fn user(&self, user_id: Option<&str>) -> Option<User> {
        match &self.access.users {
            None => Some(User::Anyone),
            Some(users) => users.tokens.now().user_named(user_id?),
        }
    }

    /// Returns the user id of an admitted connection and its credentials, or why it is rejected.
    fn admit(
        &self,
        connect: &ConnectPacket,
        certificate: Option<&ClientCertificate>,
        from: SocketAddr,
        place: &ConnectionSlot,
    ) -> Result<(Option<String>, Option<AuthenticatedUser>), (ReasonCode, String)> {
        let client_id = connect.client_id.as_str();
        if client_id == self.access.runtime_client_id {
            let text = "that client id is the runtime's own".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        let shown = match &self.access.users {
            None => User::Anyone.into(),
            Some(users) => identify_user(users, connect, certificate).ok_or_else(|| {
                self.wrong(
                    from,
                    "user and password match no [[token]] or login, and no \
                                                 certificate of a [[certificate]] is presented",
                )
            })?,
        };
        let user = shown.user.clone();
        let other = self.sessions.connected_client(client_id);
        if other.is_some_and(|other| other.user.as_ref().and_then(User::name) != user.name()) {
            // a second connection of one client id ends the first
            let text = "its client id is in use by another user".to_owned();
            return Err((ReasonCode::ClientIdentifierNotValid, text));
        }
        self.check_will(&user, connect)?;
        let reserved = if user.has(Right::Operate) { 0 } else { RESERVED };
        if !place.mark_known(reserved) {
            let text = format!("the limit of {} connected clients is reached", place.known_max());
            return Err((ReasonCode::ServerBusy, text));
        }
        place.protect_permanently();
        let account = Account::new(&user, Some(from.ip()));
        let is_reserved = user.has(Right::Operate) || user.has(Right::Handle);
        self.sessions
            .remember(client_id, outlives(connect), account, is_reserved)
            .map_err(|text| (ReasonCode::QuotaExceeded, text))?;
        let user_id = user.name().map(ToOwned::to_owned);
        let session = AdmittedClient {
            from: Some(from.ip()),
            user: Some(user),
            speaks_5: connect.protocol_version == MQTT_5,
            is_revoked: false,
        };
        self.sessions.admit(client_id, session);
        Ok((user_id, Some(shown)))
    }

    /// Returns why the client is rejected because of its will.
    fn check_will(&self, user: &User, connect: &ConnectPacket) -> Result<(), (ReasonCode, String)> {
        let refused_will = match connect.will.as_ref().map(|will| &will.topic) {
            // a lost connection of an HMI must not start a machine
            Some(topic) if self.is_inbound(topic) => Some(format!(
                "its will on {topic} is a command; only a presence is allowed as a will"
            )),
            Some(topic) if !may_publish(user, &self.access.root, topic) => {
                Some(format!("it may not publish its will on {topic}"))
            }
            // a lost handler must not appear as online, and its loss is not announced
            Some(topic) if self.is_no_loss(topic, connect) => Some(format!(
                "its will on {topic} must report the handler as offline, without returns_within_ms; write \
                 {{\"online\": false}}"
            )),
            _ => None,
        };
        if let Some(text) = refused_will {
            return Err((ReasonCode::NotAuthorized, text));
        }
        if let Some(will) = connect.will.as_ref().filter(|will| will.retain)
            && let Err(text) = self
                .retained
                .put(self.kind(&will.topic), &will.topic, will.payload.len())
        {
            self.report_not_retained(&will.topic, &connect.client_id, &text);
            let text = format!("its will on {} could not be kept: {text}", will.topic);
            return Err((ReasonCode::QuotaExceeded, text));
        }
        Ok(())
    }

    /// Returns true for a will on a presence below the root that does not report the loss of a handler.
    fn is_no_loss(&self, topic: &str, connect: &ConnectPacket) -> bool {
        let Some(path) = topic.strip_prefix(&self.access.root) else {
            return false;
        };
        let payload = connect
            .will
            .as_ref()
            .map(|will| &will.payload[..])
            .unwrap_or_default();
        match decode(path, payload, false) {
            Inbound::Ask { request, .. } => {
                let is_loss =
                    |presence: &HandlerPresence| !presence.online && presence.returns_within_ms.is_none();
                !matches!(request.request(), Request::Handler(_, presence) if is_loss(presence))
            }
            _ => true,
        }
    }

    /// Rejects a wrong password, with a different code beyond the rate of its address.
    fn wrong(&self, from: SocketAddr, text: &str) -> (ReasonCode, String) {
        match self.wrong.rate_for(&host_of(from.ip())).try_charge() {
            Ok(()) => {
                let (from, over) = (Some(from.ip()), ServerTransport::Mqtt);
                let connect = "CONNECT".to_owned();
                (self.access.machine).record_access(AccessKind::LoginRefused, None, from, over, connect);
                (ReasonCode::BadUsernameOrPassword, text.to_owned())
            }
            Err(_) => (ReasonCode::ConnectionRateExceeded, String::new()),
        }
    }

    /// Returns true for a topic on which a person commands the machine or sets a value.
    pub(super) fn is_activity(&self, topic: &str) -> bool {
        topic
            .strip_prefix(&self.access.root)
            .is_some_and(is_activity_over_mqtt)
    }

    fn is_inbound(&self, topic: &str) -> bool {
        topic.strip_prefix(&self.access.root).is_some_and(is_inbound)
    }

    /// Returns the account to which a message is charged.
    pub(super) fn account(&self, event: &ClientPublishEvent) -> Account {
        let from = self.sessions.address_of(&event.client_id);
        Account::named(event.user_id.as_deref(), from)
    }

    /// Returns the lane and the request of an urgent message, if its user may send it.
    pub(super) fn urgent(
        &self,
        event: &ClientPublishEvent,
    ) -> Option<(Arc<dyn ExecuteUrgent>, ParsedRequest)> {
        let path = event.topic.strip_prefix(&self.access.root)?;
        // a retained request is rejected
        if event.retain || !may_be_urgent(path) {
            return None;
        }
        let lane = self.urgent.get()?.upgrade()?;
        match decode(path, &event.payload, false) {
            Inbound::Ask {
                request,
                urgent: true,
            } if self.may_publish(event.user_id.as_deref(), &event.topic) => Some((lane, request)),
            _ => None,
        }
    }

    /// Numbers a message in the order of arrival.
    pub(super) fn arrive(&self, topic: &str) -> u64 {
        let command = topic.strip_prefix(&self.access.root).and_then(command_of);
        match command.filter(|(_, verb)| verb.moves()) {
            Some((cs, _)) => self.arrivals.next_moving(cs),
            None => self.arrivals.next(),
        }
    }

    /// Passes an urgent request to the machine, ahead of the queue of other messages.
    pub(super) async fn execute_urgent(
        &self,
        event: &ClientPublishEvent,
        lane: Arc<dyn ExecuteUrgent>,
        request: ParsedRequest,
    ) {
        let account = self.account(event);
        let wait = self.urgent_rates.rate_for(&account).charge();
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        let from = self.sessions.address_of(&event.client_id);
        let client_id = Some(event.client_id.to_string());
        let name = event.user_id.as_deref();
        let publisher = Publisher::new(self.user(name), name, from, client_id);
        lane.execute(publisher, account, request).await;
    }

    fn may_publish(&self, user_id: Option<&str>, topic: &str) -> bool {
        self.user(user_id)
            .is_some_and(|user| may_publish(&user, &self.access.root, topic))
    }

    /// Returns true for a message that the broker must not deliver, because it has been handled.
    fn withholds(&self, event: &ClientPublishEvent) -> bool {
        let user_id = event.user_id.as_deref();
        if !self.may_publish(user_id, &event.topic) {
            warn!("MQTT message on {} of {user_id:?} refused: its role", event.topic);
            let from = self.sessions.address_of(&event.client_id);
            let (over, topic) = (ServerTransport::Mqtt, event.topic.to_string());
            (self.access.machine).record_access(AccessKind::Forbidden, user_id, from, over, topic);
            return true;
        }
        if event.retain && !event.payload.is_empty() && self.is_inbound(&event.topic) {
            // without room it is dropped silently
            let _ = self
                .refused
                .try_send((event.topic.to_string(), event.payload.to_vec()));
            return true;
        }
        false
    }
}

pub(super) type Answer<'a, T> = Pin<Box<dyn Future<Output = T> + Send + 'a>>;

impl Guard {
    pub(super) async fn decide_delivery(&self, event: &ClientPublishEvent) -> PublishDecision {
        let wait = self.rates.rate_for(&self.account(event)).charge();
        if !wait.is_zero() {
            tokio::time::sleep(wait).await;
        }
        if self.withholds(event) {
            return PublishDecision::Handled;
        }
        if !event.retain {
            return PublishDecision::Deliver { clear: None };
        }
        match self
            .retained
            .put(self.kind(&event.topic), &event.topic, event.payload.len())
        {
            Ok(clear) => PublishDecision::Deliver { clear },
            Err(text) => {
                self.report_not_retained(&event.topic, &event.client_id, &text);
                PublishDecision::NotRetained
            }
        }
    }

    /// Returns the kind of a retained message that a client publishes. Below the root of the machine a client may
    /// retain presences only.
    fn kind(&self, topic: &str) -> Kind {
        if topic.starts_with(&self.access.root) {
            Kind::Presence
        } else {
            Kind::Other
        }
    }

    /// Reports to the operator that the memory for retained messages is full. The notice stays until memory is free.
    fn report_not_retained(&self, topic: &str, client: &str, text: &str) {
        if !self.retained.is_newly_full() {
            return;
        }
        let text = format!("retained message on {topic:.128} of {client:.64} refused: {text}");
        warn!("{text}");
        self.access.machine.notice(ServerNotice::NotRetained(Some(text)));
    }

    pub(super) fn speaks_5(&self, client_id: &str) -> bool {
        self.sessions
            .connected_client(client_id)
            .is_some_and(|session| session.speaks_5)
    }

    pub(super) fn authenticate(
        &self,
        connect: &ConnectPacket,
        certificate: Option<&ClientCertificate>,
        address: SocketAddr,
        place: &ConnectionSlot,
    ) -> (AuthResult, Option<AuthenticatedUser>) {
        let (user_id, shown) = match self.admit(connect, certificate, address, place) {
            Ok(admitted) => admitted,
            // beyond the rate nothing is logged, so that no client can fill the log
            Err((code @ ReasonCode::ConnectionRateExceeded, _)) => return (AuthResult::fail(code), None),
            Err((code, text)) => {
                warn!(
                    "MQTT client {:.64} at {address} refused: {text}",
                    connect.client_id
                );
                return (AuthResult::fail(code), None);
            }
        };
        let admitted = user_id.map_or_else(AuthResult::success, AuthResult::success_with_user);
        (admitted, shown)
    }

    // Only clients of MQTT 5 understand an acknowledgement "not authorized". Over 3.1.1 the same bytes are a protocol
    // error, after which the client reconnects and publishes again: there `withholds` drops the message. The will of a
    // revoked user is still published, because it reports the handler as offline.
    pub(super) fn authorize_publish(
        &self,
        client_id: &str,
        user: Option<&str>,
        topic: &str,
    ) -> Answer<'static, bool> {
        let session = self.sessions.connected_client(client_id).unwrap_or_default();
        Box::pin(ready(
            !session.speaks_5 || session.is_revoked || self.may_publish(user, topic),
        ))
    }

    pub(super) fn authorize_subscribe(&self, user: Option<&str>, filter: &str) -> Answer<'static, bool> {
        let may = filter.len() <= FILTER_BYTES_MAX && self.user(user).as_ref().is_some_and(may_subscribe);
        Box::pin(ready(may))
    }
}

impl BrokerEventHandler for Guard {
    fn on_client_connect(&self, event: ClientConnectEvent) -> Answer<'_, ()> {
        let user = || self.user(event.user_id.as_deref());
        self.sessions.connect(event.client_id, user);
        Box::pin(ready(()))
    }

    fn on_client_disconnect(&self, event: ClientDisconnectEvent) -> Answer<'_, ()> {
        self.sessions.disconnect(&event.client_id);
        Box::pin(ready(()))
    }

    fn on_retained_set(&self, event: RetainedSetEvent) -> Answer<'_, ()> {
        // the number of the runtime's own states is limited already
        let is_of_runtime = event.topic.starts_with(&self.access.root) && !self.is_inbound(&event.topic);
        if !is_of_runtime {
            let kind = self.kind(&event.topic);
            if self.retained.record_retained(kind, &event.topic, &event.payload) {
                self.access.machine.notice(ServerNotice::NotRetained(None));
            }
        }
        Box::pin(ready(()))
    }
}
