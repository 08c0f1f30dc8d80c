//! The machine as the servers see it: every server may read it, but it executes only authorized requests.
//!
//! A row of the wire parses a request once. [`Machine::authorize_request`] decides on the parsed value whether its user may make
//! it, and [`Machine::execute_request`] executes that same value. There is no other path to the port: code that passes an
//! unauthorized request does not compile.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::SystemTime;

use plc_protocol::hub::{Filter, Subscription};
use plc_protocol::port::BoxFuture;
use plc_protocol::server::{
    AccessKind, AccessNote, Origin, ServedPort, ServerNotice, ServerTransport, ServoTiming,
};
use plc_protocol::supervisor::Supervisor;
use plc_protocol::types::message::{Message, Payload};
use plc_protocol::types::output::HandlerPresence;
use plc_protocol::types::request::{Answer, Refusal, RefusalCode, Request};
use plc_protocol::types::topic::Topic;
use plc_protocol::types::{BootId, CoordinateSystemNumber};
use plc_protocol::wire::rest;
use plc_protocol::wire::right::Right;
use plc_protocol::wire::row::ParsedRequest;

use crate::access::{User, rules};
use crate::shares::{Shares, TakenShare};

/// The machine that is served.
#[derive(Clone)]
pub(crate) struct Machine {
    port: Arc<dyn ServedPort>,
    /// Request budget of each user.
    shares: Arc<Shares>,
}

/// Origin of a request.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Caller<'a> {
    pub(crate) user: &'a User,
    pub(crate) from: Option<IpAddr>,
    pub(crate) over: ServerTransport,
}

/// A request that its user may make. Only [`Machine`] creates it.
#[derive(Debug, PartialEq)]
pub(crate) struct AuthorizedRequest {
    request: Request,
    origin: Origin,
}

impl AuthorizedRequest {
    /// Returns the authorized request.
    pub(crate) fn request(&self) -> &Request {
        &self.request
    }

    /// Answers a command when it is accepted, not when it is finished.
    pub(crate) fn do_not_wait(&mut self) {
        if let Request::Command { wait, .. } = &mut self.request {
            *wait = false;
        }
    }
}

impl Machine {
    pub(crate) fn new(port: Arc<dyn ServedPort>) -> Self {
        Self {
            port,
            shares: Arc::default(),
        }
    }

    /// Returns the supervisor of the servers' tasks.
    pub(crate) fn supervisor(&self) -> Supervisor {
        self.port.supervisor()
    }

    /// Decides whether a user may make a request.
    ///
    /// # Errors
    /// `forbidden`.
    pub(crate) async fn authorize_request(
        &self,
        Caller { user, from, over }: Caller<'_>,
        parsed: ParsedRequest,
    ) -> Result<AuthorizedRequest, Refusal> {
        let presence = match user.name().filter(|_| parsed.right() == Right::Set) {
            Some(name) => self.presence_of(name).await,
            None => None,
        };
        let serves = |cs: Option<CoordinateSystemNumber>| {
            let handles = presence.iter().flat_map(|presence| &presence.handles);
            handles.into_iter().any(|code| cs.is_none_or(|cs| code.cs == cs))
        };
        if let Err(text) = rules::check(user, &parsed, serves) {
            self.record_access(
                AccessKind::Forbidden,
                user.name(),
                from,
                over,
                name_of(parsed.request()),
            );
            return Err(forbidden(text));
        }
        self.shares.count(user, parsed.request())?;
        Ok(AuthorizedRequest {
            origin: Origin {
                user: user.name().map(ToOwned::to_owned),
                from,
                over,
                right: parsed.right(),
                not_after: parsed.not_after().cloned(),
            },
            request: parsed.into_request(),
        })
    }

    /// Records an access in the journal.
    pub(crate) fn record_access(
        &self,
        what: AccessKind,
        user: Option<&str>,
        from: Option<IpAddr>,
        over: ServerTransport,
        request: String,
    ) {
        self.port.notice(ServerNotice::Access(AccessNote {
            what,
            user: user.map(str::to_owned),
            from,
            over,
            request,
        }));
    }

    /// Authorizes a request of a user whose token is no longer valid. Only the report that the user's handler is
    /// offline is accepted: the last will of its connection contains it.
    ///
    /// # Errors
    /// `forbidden` for everything else.
    pub(crate) fn authorize_last_will(
        name: &str,
        parsed: ParsedRequest,
    ) -> Result<AuthorizedRequest, Refusal> {
        match parsed.into_request() {
            Request::Handler(id, presence) if id == name && !presence.online => {
                Ok(Self::offline_report(id, presence.instance, ServerTransport::Mqtt))
            }
            _ => Err(forbidden(format!("the token of {name:?} is no longer valid"))),
        }
    }

    /// Creates the report that a handler is offline, after the server has seen its connection end.
    pub(crate) fn offline_report(
        handler_id: String,
        instance: Option<String>,
        over: ServerTransport,
    ) -> AuthorizedRequest {
        AuthorizedRequest {
            origin: Origin {
                user: Some(handler_id.clone()),
                from: None,
                over,
                right: Right::Handle,
                not_after: None,
            },
            request: Request::Handler(handler_id, HandlerPresence::offline(instance)),
        }
    }

    /// Executes an authorized request.
    pub(crate) fn execute_request(
        &self,
        authorized: AuthorizedRequest,
    ) -> BoxFuture<'_, Result<Answer, Refusal>> {
        self.shares.record_offline(&authorized.request);
        let taken = TakenShare::of_request(&authorized.request);
        let asking = self.port.request_from(authorized.origin, authorized.request);
        let Some(taken) = taken else { return asking };
        Box::pin(async move {
            let answer = asking.await;
            self.shares.settle(&taken, answer.is_ok());
            answer
        })
    }

    async fn presence_of(&self, handler_id: &str) -> Option<HandlerPresence> {
        let topic = Topic::HandlerPresence(handler_id.to_owned());
        match &self.port.read(&topic).await?.payload {
            Payload::HandlerPresence(presence) if presence.online => Some(presence.clone()),
            _ => None,
        }
    }

    pub(crate) fn boot_id(&self) -> BootId {
        self.port.boot_id()
    }

    pub(crate) fn read<'a>(&'a self, topic: &'a Topic) -> BoxFuture<'a, Option<Arc<Message>>> {
        self.port.read(topic)
    }

    pub(crate) fn subscribe(&self, filter: Filter) -> Subscription {
        self.port.subscribe(filter)
    }

    /// Publishes pending outputs again, as redelivered. Completes when all are published.
    pub(crate) fn republish(&self) -> BoxFuture<'static, ()> {
        let port = Arc::clone(&self.port);
        let republishing = async move { port.republish().await };
        Box::pin(
            self.supervisor()
                .contained("republisher of outputs", republishing),
        )
    }

    pub(crate) fn notice(&self, notice: ServerNotice) {
        self.port.notice(notice);
    }

    pub(crate) fn time(&self) -> SystemTime {
        self.port.time()
    }

    pub(crate) fn servo_timing(&self) -> Option<ServoTiming> {
        self.port.servo_timing()
    }
}

/// Formats a request as its REST route.
fn name_of(request: &Request) -> String {
    match request {
        // a program may have 64 MiB
        Request::WriteProgram(number, _) | Request::StoreProgram(number, _) => {
            format!("PUT /programs/{number}")
        }
        request => match rest::encode(request.clone()) {
            Ok(exchange) => format!("{} {}", exchange.method, exchange.path),
            Err(_) => "a request without a route".to_owned(),
        },
    }
}

fn forbidden(text: String) -> Refusal {
    Refusal::new(RefusalCode::Forbidden, text)
}
