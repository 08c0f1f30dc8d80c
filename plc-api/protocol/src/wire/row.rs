//! One row for each request: its routes and topics, and the functions that write and read the request.

use std::borrow::Cow;
use std::str::FromStr;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::answer::AnswerForm;
use super::json::edited_json_object;
use super::parameter::{Fault, QueryValues};
use super::pattern::{self, Param};
use super::right::Right;
use super::route::Route;
use super::tag;
use crate::types::CoordinateSystemNumber;
use crate::types::command::CommandMeta;
use crate::types::form::{Form, HasForm};
use crate::types::handler::{CONNECTION_MARK, INSTANCE_MAX, is_own_instance};
use crate::types::ids::COMMAND_ID_MAX;
use crate::types::io::{IoPoint, IoSide};
use crate::types::not_after::NotAfter;
use crate::types::request::{Input, Request};
use crate::types::upload::ProgramCondition;

/// Header with the id of a command.
pub(super) const IDEMPOTENCY_KEY: &str = "idempotency-key";

/// Header with the state revision or the program hash that a command expects, or with the hash of the program
/// to change.
pub(super) const IF_MATCH: &str = "if-match";

/// Header with hashes of programs: those that must not be stored, or those that the client already has.
pub const IF_NONE_MATCH: &str = "if-none-match";

/// Header with the signature of a program.
pub(super) const PROGRAM_SIGNATURE: &str = "program-signature";

/// Header with the number of the control lease under which a command is sent.
pub(super) const LEASE_FENCE: &str = "lease-fence";

/// Name of the age limit in bodies and payloads.
pub(super) const NOT_AFTER: &str = "not_after";

/// Fields of a payload that identify the command and its sender.
pub(super) const IDS: &[&str] = &["command_id", "client_id"];

/// Row of one request.
#[derive(Debug)]
pub struct Row {
    /// The right that the sender needs.
    pub right: Right,
    /// Routes of the request: several if the path contains a part of the request, such as the verb of a
    /// command.
    pub routes: &'static [Route],
    /// Topic on which the request is received over MQTT.
    pub topic: Option<InboundTopic>,
    /// True if the request may carry [`NotAfter`], because it can cause a motion. Requests about a lease
    /// carry none: a lease has its own validity.
    pub takes_not_after: bool,
    /// True if the body or the answer is a whole program: a server executes only a few such requests at the
    /// same time.
    pub is_large: bool,
    /// Reads the request from a route or from a topic.
    pub(super) read: fn(IncomingRequest<'_>) -> Result<Request, Fault>,
    /// Form of the answer over REST.
    pub answer: fn(&Request) -> AnswerForm,
    /// Splits a request of this row into the parts for routes and topics; returns any other request
    /// unchanged.
    pub write: fn(Request) -> Result<RequestParts, Request>,
}

impl Row {
    /// Creates a row without routes and topic, which is answered without content.
    pub(super) const fn new(
        right: Right,
        read: fn(IncomingRequest<'_>) -> Result<Request, Fault>,
        write: fn(Request) -> Result<RequestParts, Request>,
    ) -> Self {
        Self {
            right,
            routes: &[],
            topic: None,
            takes_not_after: right.takes_not_after(),
            is_large: false,
            read,
            answer: |_| AnswerForm::Nothing,
            write,
        }
    }

    /// Reads a request from received data.
    ///
    /// # Errors
    /// Fails if the data are not a request of this row.
    pub fn parse(&self, mut incoming: IncomingRequest<'_>) -> Result<ParsedRequest, Fault> {
        incoming.not_after_is_apart = self.takes_not_after;
        let not_after = incoming.not_after()?;
        let mut parsed = self.parsed((self.read)(incoming)?);
        if let Request::Command { meta, .. } | Request::WriteVariables { meta: Some(meta), .. } =
            &mut parsed.request
        {
            meta.not_after.clone_from(&not_after);
        }
        Ok(ParsedRequest { not_after, ..parsed })
    }

    /// Adds the right of this row to a request.
    pub(super) fn parsed(&self, request: Request) -> ParsedRequest {
        ParsedRequest {
            request,
            right: self.right,
            not_after: None,
        }
    }
}

/// A request that its row has read, with the right that the sender needs. Only a row creates this type, so
/// that the right is checked for the same values that are executed.
#[derive(Debug, Clone, PartialEq)]
pub struct ParsedRequest {
    request: Request,
    right: Right,
    not_after: Option<NotAfter>,
}

impl ParsedRequest {
    /// Returns the request.
    pub fn request(&self) -> &Request {
        &self.request
    }

    /// Returns the right that the sender needs.
    pub fn right(&self) -> Right {
        self.right
    }

    /// Returns the age limit of the request.
    pub fn not_after(&self) -> Option<&NotAfter> {
        self.not_after.as_ref()
    }

    /// If the request contains no instance of its sender, sets the name of the connection as the instance.
    /// Only server ends name connections.
    pub fn identify(&mut self, connection: &str) {
        let instance = match &mut self.request {
            Request::Claim(_, _, claim) => &mut claim.instance,
            Request::Reset(_, _, reset) => &mut reset.instance,
            Request::Progress(_, _, report) => &mut report.instance,
            Request::Checkpoint(_, _, report) => &mut report.instance,
            Request::Ask(_, _, ask) => &mut ask.instance,
            Request::Handler(_, presence) => &mut presence.instance,
            Request::Input(_, Input::Interlock(set) | Input::StartLock(set)) if set.handler_id.is_some() => {
                &mut set.instance
            }
            Request::WriteIo(_, set) if set.handler_id.is_some() => &mut set.instance,
            _ => return,
        };
        if instance.as_deref().is_none_or(|named| !is_own_instance(named)) {
            *instance = Some(connection_name(connection));
        }
    }

    /// Returns the owner of a lock source or of an input or output of the plant; `None` for other requests.
    pub(super) fn owner_mut(&mut self) -> Option<&mut Option<String>> {
        match &mut self.request {
            Request::Input(_, Input::Interlock(set) | Input::StartLock(set)) => Some(&mut set.handler_id),
            Request::WriteIo(_, set) => Some(&mut set.handler_id),
            _ => None,
        }
    }

    /// Returns the request.
    pub fn into_request(self) -> Request {
        self.request
    }
}

/// Returns the instance name that identifies a connection.
pub fn connection_name(connection: &str) -> String {
    let named = connection.replace(['/', '+', '#', '\0'], "_");
    let named = named.chars().take(INSTANCE_MAX - 1);
    CONNECTION_MARK.to_string() + &named.collect::<String>()
}

/// A topic on which requests are received.
#[derive(Debug)]
pub struct InboundTopic {
    /// Path below the machine's root: a pattern with names in braces.
    pub pattern: &'static str,
    /// Effect of a message, in one sentence.
    pub summary: &'static str,
    /// True if the retain flag is allowed: only for a state of the sender. A broker would send a
    /// retained command again, and the command would be executed again.
    pub retained: bool,
    /// Form of the payload, without the fields of the envelope.
    pub form: Form,
    /// Fields of [`CommandMeta`] in the payload.
    pub envelope: &'static [&'static str],
    /// Pattern of the topic on which the request is answered; `None` if it is not answered.
    pub answer: Option<&'static str>,
}

impl InboundTopic {
    /// Creates a topic with a payload of this form.
    pub(super) const fn new<T: HasForm>(pattern: &'static str, summary: &'static str) -> Self {
        Self {
            pattern,
            summary,
            retained: false,
            form: Form::for_type::<T>(),
            envelope: &[],
            answer: None,
        }
    }

    /// Sets the fields of [`CommandMeta`] in the payload. Such a request is answered on `reply/{client_id}`.
    pub(super) const fn envelope(mut self, envelope: &'static [&'static str]) -> Self {
        self.envelope = envelope;
        self.answer = Some("reply/{client_id}");
        self
    }

    /// Sets the pattern of the topic on which the request is answered.
    pub(super) const fn answered_on(mut self, pattern: &'static str) -> Self {
        self.answer = Some(pattern);
        self
    }

    /// Allows the retain flag.
    pub(super) const fn retained(mut self) -> Self {
        self.retained = true;
        self
    }

    /// Returns the path with names in braces.
    pub fn path(&self) -> String {
        pattern::shown(self.pattern)
    }

    /// Returns the filter, with `+` for each level that varies.
    pub fn filter(&self) -> String {
        pattern::filter(self.pattern)
    }

    /// Returns true if a path matches the topic.
    pub fn fits(&self, path: &str) -> bool {
        pattern::take_apart(self.pattern, path).is_some()
    }
}

/// Sender of a request over REST: headers of the request, and defaults for missing headers.
pub trait Sender {
    /// Returns a header by its name in lower case; `None` if the header is absent, empty if it is not ASCII.
    fn header(&self, name: &str) -> Option<&str>;

    /// Returns the id of the sender.
    fn client_id(&self) -> String;

    /// Returns a command id that is unused in this boot.
    fn new_command_id(&self) -> String;
}

/// Transport on which a request was received.
#[expect(clippy::large_enum_variant, reason = "it lives while one request is parsed")]
pub enum Source<'a> {
    /// On a route of REST.
    Http(&'a dyn Sender),
    /// On a topic of MQTT without an envelope.
    Message,
    /// On a topic of MQTT whose payload contains these fields of the envelope.
    Command(CommandMeta, &'static [&'static str]),
}

/// A request, as received on a route or topic.
pub struct IncomingRequest<'a> {
    /// Values in the path, by name.
    pub params: &'a [(&'a str, &'a str)],
    /// The body or payload; an object if it is JSON.
    pub body: Cow<'a, [u8]>,
    /// The query.
    pub query: QueryValues,
    /// Transport on which the request was received, with the sender.
    pub source: Source<'a>,
    /// True if `not_after` of the body is read separately; [`Row::parse`] sets this field.
    pub not_after_is_apart: bool,
}

/// Parses a number in a path. A number has only one valid spelling: `1` is valid, `01` and `+1` are not.
pub fn number<T: FromStr + ToString>(text: &str) -> Option<T> {
    text.parse().ok().filter(|number: &T| number.to_string() == text)
}

/// Returns true if each value in a path is valid for its name.
pub fn check_path(params: &[(&str, &str)]) -> bool {
    params.iter().all(|(name, value)| match *name {
        "cs" => number::<CoordinateSystemNumber>(value).is_some(),
        "m" | "number" => number::<u16>(value).is_some(),
        "seq" => number::<u64>(value).is_some(),
        _ => true,
    })
}

impl IncomingRequest<'_> {
    /// Returns the value of a name in the path; empty if the path does not contain the name.
    pub(super) fn text(&self, name: &str) -> &str {
        self.find(name).unwrap_or_default()
    }

    fn find(&self, name: &str) -> Option<&str> {
        let mut params = self.params.iter();
        params.find(|(known, _)| *known == name).map(|(_, value)| *value)
    }

    /// Returns the value of a name in the path as a number.
    pub(super) fn number<T: FromStr + ToString>(&self, name: &str) -> Result<T, Fault> {
        let text = self.text(name);
        number(text).ok_or_else(|| Fault::Level(text.to_owned()))
    }

    /// Returns the value of a name as a number, or `None` if the path does not contain the name.
    pub(super) fn optional_number<T: FromStr + ToString>(&self, name: &str) -> Result<Option<T>, Fault> {
        self.find(name).map(|_| self.number(name)).transpose()
    }

    pub(super) fn cs(&self) -> Result<CoordinateSystemNumber, Fault> {
        self.number("cs")
    }

    /// Returns the input or output of the plant that the path names.
    pub(super) fn io_point(&self) -> Result<IoPoint, Fault> {
        let (side, name) = (self.text("side"), self.text("name").to_owned());
        let side = IoSide::of_wire_name(side)
            .ok_or_else(|| Fault::NotFound(format!("io/{side:.64} does not exist; write in or out")))?;
        Ok(IoPoint { side, name })
    }

    /// Parses the JSON body. If the path contains the sequence number of an output, this number is added to
    /// the body as `seq`.
    pub(super) fn json<T: DeserializeOwned>(&self) -> Result<T, Fault> {
        let seq = self.optional_number("seq")?;
        let left_out = match &self.source {
            Source::Command(_, envelope) => envelope,
            Source::Http(_) | Source::Message if self.not_after_is_apart => &[NOT_AFTER][..],
            Source::Http(_) | Source::Message => &[][..],
        };
        edited_json_object(&self.body, seq.map(|seq| ("seq", seq)), left_out).map_err(Fault::Json)
    }

    /// Returns true if the request was received over REST.
    pub(super) fn is_rest(&self) -> bool {
        matches!(self.source, Source::Http(_))
    }

    fn header(&self, name: &str) -> Option<&str> {
        match self.source {
            Source::Http(sender) => sender.header(name),
            Source::Message | Source::Command(..) => None,
        }
    }

    /// Returns the sender and the conditions of a command from its payload; `None` over REST.
    pub(super) fn payload_meta(&self) -> Option<CommandMeta> {
        match &self.source {
            Source::Command(meta, _) => Some(meta.clone()),
            Source::Http(_) | Source::Message => None,
        }
    }

    /// Returns the sender and the conditions of a command: from the payload, or from `Idempotency-Key`,
    /// `If-Match` and `Lease-Fence`.
    pub(super) fn meta(&self) -> Result<CommandMeta, Fault> {
        let sender = match &self.source {
            Source::Http(sender) => sender,
            Source::Command(meta, _) => return Ok(meta.clone()),
            Source::Message => return Err(Fault::Invalid("a command names its sender".to_owned())),
        };
        let command_id = match sender.header(IDEMPOTENCY_KEY) {
            None => sender.new_command_id(),
            Some(key) if (1..=COMMAND_ID_MAX).contains(&key.len()) => key.to_owned(),
            Some(_) => {
                return Err(Fault::Invalid(format!(
                    "Idempotency-Key is the command's id: write 1 to {COMMAND_ID_MAX} ASCII characters"
                )));
            }
        };
        let expect = self.header(IF_MATCH).map(tag::expected).transpose();
        Ok(CommandMeta {
            command_id,
            client_id: sender.client_id(),
            expect: expect.map_err(Fault::Invalid)?,
            fence: self.fence()?,
            ..CommandMeta::default()
        })
    }

    /// Returns the number of the control lease under which the request is sent.
    pub(super) fn fence(&self) -> Result<Option<u64>, Fault> {
        let fence = self.header(LEASE_FENCE).map(|text| text.trim().parse());
        fence.transpose().map_err(|_| {
            Fault::Invalid(
                "Lease-Fence is the number of the control lease, which the answer to its taking contains"
                    .to_owned(),
            )
        })
    }

    /// Returns the condition for changing a program.
    pub(super) fn condition(&self) -> Result<ProgramCondition, Fault> {
        let hashes = |name| {
            let read = |text| tag::hashes(name, text, name == IF_MATCH).map_err(Fault::Invalid);
            self.header(name).map(read).transpose()
        };
        Ok(ProgramCondition {
            if_match: hashes(IF_MATCH)?,
            if_none_match: hashes(IF_NONE_MATCH)?,
        })
    }

    /// Returns the signature of a program.
    pub(super) fn signature(&self) -> Option<String> {
        self.header(PROGRAM_SIGNATURE).map(|text| text.trim().to_owned())
    }

    /// Returns true if the answer must wait until the request is done.
    pub(super) fn wait(&self) -> Result<bool, Fault> {
        match self.query.wait.as_deref() {
            None | Some("0" | "false") => Ok(false),
            Some("" | "1" | "true") => Ok(true),
            Some(other) => Err(Fault::Invalid(format!(
                "wait={other} is not known; write wait=1 or wait=0"
            ))),
        }
    }
}

/// A request in parts; each route and each topic uses the parts that its pattern or its fields name.
#[derive(Debug, Default)]
pub struct RequestParts {
    /// Values of the names in a path.
    pub(super) params: Vec<Param>,
    /// Names and values of the query of a route.
    pub(super) query: Vec<(&'static str, String)>,
    pub(super) headers: Vec<(&'static str, String)>,
    pub(super) body: Body,
    /// Payload for the topic if it differs from the body.
    pub(super) payload: Option<Value>,
}

/// Body of a request over REST.
#[derive(Debug, Default)]
pub(super) enum Body {
    #[default]
    Nothing,
    Json(Value),
    Text(String),
}

impl RequestParts {
    /// Creates the parts of a request to a coordinate system.
    pub(super) fn for_coordinate_system(cs: CoordinateSystemNumber) -> Self {
        Self::default().with("cs", cs)
    }

    /// Creates the parts of a request about an input or output of the plant.
    pub(super) fn for_io(point: &IoPoint) -> Self {
        Self::default()
            .with("side", point.side.wire_name())
            .with("name", &point.name)
    }

    /// Adds a value of a name in the path.
    #[allow(
        clippy::needless_pass_by_value,
        reason = "numbers and literals read better so"
    )]
    pub(super) fn with(mut self, name: &'static str, value: impl ToString) -> Self {
        self.params.push((name, value.to_string()));
        self
    }

    /// Creates the parts of a request about an output.
    pub(super) fn for_output(
        cs: CoordinateSystemNumber,
        m: Option<u16>,
        seq: u64,
        said: &impl Serialize,
    ) -> Self {
        let parts = Self::for_coordinate_system(cs).with("seq", seq).json(said);
        match m {
            Some(m) => parts.with("m", m),
            None => parts,
        }
    }

    pub(super) fn json(mut self, body: &impl Serialize) -> Self {
        self.body = Body::Json(json!(body));
        self
    }

    pub(super) fn text(mut self, body: String) -> Self {
        self.body = Body::Text(body);
        self
    }

    /// Sets the payload for the topic.
    pub(super) fn payload(mut self, payload: &impl Serialize) -> Self {
        self.payload = Some(json!(payload));
        self
    }

    #[allow(
        clippy::needless_pass_by_value,
        reason = "numbers and literals read better so"
    )]
    pub(super) fn query(mut self, name: &'static str, value: impl ToString) -> Self {
        self.query.push((name, value.to_string()));
        self
    }

    /// Adds a value to the query, unless the value is `None`.
    pub(super) fn queried(self, name: &'static str, value: Option<impl ToString>) -> Self {
        match value {
            Some(value) => self.query(name, value),
            None => self,
        }
    }

    #[allow(
        clippy::needless_pass_by_value,
        reason = "numbers and literals read better so"
    )]
    pub(super) fn header(mut self, name: &'static str, value: impl ToString) -> Self {
        self.headers.push((name, value.to_string()));
        self
    }

    /// Sets whether the answer waits until the request is done.
    pub(super) fn waiting(self, wait: bool) -> Self {
        if wait { self.query("wait", 1) } else { self }
    }

    /// Sets the condition for changing a program.
    pub(super) fn condition(mut self, condition: &ProgramCondition) -> Self {
        for (name, hashes) in [
            (IF_MATCH, &condition.if_match),
            (IF_NONE_MATCH, &condition.if_none_match),
        ] {
            if let Some(hashes) = hashes {
                self = self.header(name, tag::of_hashes(hashes));
            }
        }
        self
    }

    /// Sets the id and the conditions of a command.
    pub(super) fn meta(mut self, meta: CommandMeta) -> Self {
        self.limit_age(meta.not_after.as_ref());
        let mut parts = self.header(IDEMPOTENCY_KEY, meta.command_id);
        if let Some(tags) = meta.expect.and_then(|expect| tag::of_expected(&expect)) {
            parts = parts.header(IF_MATCH, tags);
        }
        match meta.fence {
            Some(fence) => parts.header(LEASE_FENCE, fence),
            None => parts,
        }
    }
}
