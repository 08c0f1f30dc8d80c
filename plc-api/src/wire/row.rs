//! A request as a row: where it goes, and how it is written there and read from there.

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

/// Header with the revision of the state or the hash of the program that a command expects, and with the hash of the program
/// that is to be changed.
pub(super) const IF_MATCH: &str = "if-match";

/// Header with the hashes of programs that must not be there, or that the client has already.
pub const IF_NONE_MATCH: &str = "if-none-match";

/// Header with the signature of a program.
pub(super) const PROGRAM_SIGNATURE: &str = "program-signature";

/// Header with the number of the control lease under which a command is sent.
pub(super) const LEASE_FENCE: &str = "lease-fence";

/// Name of the age limit in bodies and payloads.
pub(super) const NOT_AFTER: &str = "not_after";

/// One request.
#[derive(Debug)]
pub struct Row {
    /// The right that its sender needs.
    pub right: Right,
    /// Its routes: several where the path names what the request holds, such as the verb of a command.
    pub routes: &'static [Route],
    /// Where it comes in over MQTT.
    pub topic: Option<Topic>,
    /// True where it may carry [`NotAfter`]: something can move after it. A lease has an end of its own.
    pub takes_not_after: bool,
    /// True where it carries a whole program, in its body or in its answer: a server carries out a few such at a time.
    pub is_large: bool,
    /// Reads it from a route or from a topic.
    pub(super) read: fn(IncomingRequest<'_>) -> Result<Request, Fault>,
    /// How it is answered over REST.
    pub answer: fn(&Request) -> AnswerForm,
    /// What a route or topic says of it; another request is given back.
    pub write: fn(Request) -> Result<RequestParts, Request>,
}

impl Row {
    /// A row without routes and topic, which is answered without content.
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

    /// Reads a request from what came in.
    ///
    /// # Errors
    /// What came in is no request of the row.
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

    /// A request of the row.
    pub(super) fn parsed(&self, request: Request) -> ParsedRequest {
        ParsedRequest {
            request,
            right: self.right,
            not_after: None,
        }
    }
}

/// A request as its row has read it, with the right that its sender needs. Only reading makes one, so the right is judged
/// by the values that are carried out.
#[derive(Debug, Clone, PartialEq)]
pub struct ParsedRequest {
    request: Request,
    right: Right,
    not_after: Option<NotAfter>,
}

impl ParsedRequest {
    /// What is asked.
    pub fn request(&self) -> &Request {
        &self.request
    }

    /// The right that its sender needs.
    pub fn right(&self) -> Right {
        self.right
    }

    /// Its age limit.
    pub fn not_after(&self) -> Option<&NotAfter> {
        self.not_after.as_ref()
    }

    /// Names the connection by which a client without an instance is told from others. None but a server end names connections.
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

    /// The handler that owns a level or an output of the plant; `None` for other requests.
    pub(super) fn owner_mut(&mut self) -> Option<&mut Option<String>> {
        match &mut self.request {
            Request::Input(_, Input::Interlock(set) | Input::StartLock(set)) => Some(&mut set.handler_id),
            Request::WriteIo(_, set) => Some(&mut set.handler_id),
            _ => None,
        }
    }

    /// The request itself.
    pub fn into_request(self) -> Request {
        self.request
    }
}

/// The instance that a connection stands for.
pub fn connection_name(connection: &str) -> String {
    let named = connection.replace(['/', '+', '#', '\0'], "_");
    let named = named.chars().take(INSTANCE_MAX - 1);
    CONNECTION_MARK.to_string() + &named.collect::<String>()
}

/// A topic that comes in.
#[derive(Debug)]
pub struct Topic {
    /// Path below the machine's root: a pattern with names in braces.
    pub pattern: &'static str,
    /// What a message does, in one sentence.
    pub summary: &'static str,
    /// True where the retain flag is right: a state of its sender. A retained command would be carried out again.
    pub retained: bool,
    /// Form of its payload, without the fields of its envelope.
    pub form: Form,
    /// Fields of [`CommandMeta`] in its payload: where there are any, the request is answered on `reply/{client_id}`.
    pub envelope: &'static [&'static str],
}

impl Topic {
    /// A topic whose payload is of this form.
    pub(super) const fn new<T: HasForm>(pattern: &'static str, summary: &'static str) -> Self {
        Self {
            pattern,
            summary,
            retained: false,
            form: Form::of::<T>(),
            envelope: &[],
        }
    }

    /// With these fields of [`CommandMeta`].
    pub(super) const fn envelope(mut self, envelope: &'static [&'static str]) -> Self {
        self.envelope = envelope;
        self
    }

    /// With the retain flag.
    pub(super) const fn retained(mut self) -> Self {
        self.retained = true;
        self
    }

    /// Its path with names in braces.
    pub fn path(&self) -> String {
        pattern::shown(self.pattern)
    }

    /// Its filter, with `+` for each level that varies.
    pub fn filter(&self) -> String {
        pattern::filter(self.pattern)
    }

    /// True for a path of the topic.
    pub fn fits(&self, path: &str) -> bool {
        pattern::take_apart(self.pattern, path).is_some()
    }
}

/// The sender of a request over REST: what the head of the request says, and what counts where it says nothing.
pub trait Sender {
    /// A header by its name in lower case; empty where it is not ASCII.
    fn header(&self, name: &str) -> Option<&str>;

    /// Id of the sender.
    fn client_id(&self) -> String;

    /// A command id that nobody used in this boot.
    fn new_command_id(&self) -> String;
}

/// How a request came in.
#[expect(clippy::large_enum_variant, reason = "it lives while one request is parsed")]
pub enum Source<'a> {
    /// On a route of REST.
    Http(&'a dyn Sender),
    /// On a topic of MQTT without an envelope.
    Message,
    /// On a topic of MQTT with fields of this in its payload, which are named.
    Command(CommandMeta, &'static [&'static str]),
}

/// What came in on a route or topic.
pub struct IncomingRequest<'a> {
    /// Values of the names in its path.
    pub params: &'a [(&'a str, &'a str)],
    /// Its body; for JSON an object.
    pub body: Cow<'a, [u8]>,
    /// Its query.
    pub query: QueryValues,
    /// How it came in.
    pub source: Source<'a>,
    /// True where `not_after` of the body is read by itself. [`Row::parse`] sets it.
    pub not_after_is_apart: bool,
}

/// A number of a path, which is written as such: of `1`, `01` and `+1` only the first names something.
pub fn number<T: FromStr + ToString>(text: &str) -> Option<T> {
    text.parse().ok().filter(|number: &T| number.to_string() == text)
}

/// True when each value can be what its name stands for.
pub fn check_path(params: &[(&str, &str)]) -> bool {
    params.iter().all(|(name, value)| match *name {
        "cs" => number::<CoordinateSystemNumber>(value).is_some(),
        "m" | "number" => number::<u16>(value).is_some(),
        "seq" => number::<u64>(value).is_some(),
        _ => true,
    })
}

impl IncomingRequest<'_> {
    /// The value of a name of the path; empty where the path does not name it.
    pub(super) fn text(&self, name: &str) -> &str {
        self.find(name).unwrap_or_default()
    }

    fn find(&self, name: &str) -> Option<&str> {
        let mut params = self.params.iter();
        params.find(|(known, _)| *known == name).map(|(_, value)| *value)
    }

    /// The same as a number.
    pub(super) fn number<T: FromStr + ToString>(&self, name: &str) -> Result<T, Fault> {
        let text = self.text(name);
        number(text).ok_or_else(|| Fault::Level(text.to_owned()))
    }

    /// A number that not every path of the request names.
    pub(super) fn optional_number<T: FromStr + ToString>(&self, name: &str) -> Result<Option<T>, Fault> {
        self.find(name).map(|_| self.number(name)).transpose()
    }

    pub(super) fn cs(&self) -> Result<CoordinateSystemNumber, Fault> {
        self.number("cs")
    }

    /// An input or output of the plant.
    pub(super) fn io_point(&self) -> Result<IoPoint, Fault> {
        let (side, name) = (self.text("side"), self.text("name").to_owned());
        let side = IoSide::of_wire_name(side)
            .ok_or_else(|| Fault::NotFound(format!("there is no io/{side:.64}; write in or out")))?;
        Ok(IoPoint { side, name })
    }

    /// The JSON body. What is said of an output is of the same form where the path names the output.
    pub(super) fn json<T: DeserializeOwned>(&self) -> Result<T, Fault> {
        let seq = self.optional_number("seq")?;
        let left_out = match &self.source {
            Source::Command(_, envelope) => envelope,
            Source::Http(_) | Source::Message if self.not_after_is_apart => &[NOT_AFTER][..],
            Source::Http(_) | Source::Message => &[][..],
        };
        edited_json_object(&self.body, seq.map(|seq| ("seq", seq)), left_out).map_err(Fault::Json)
    }

    /// True over REST.
    pub(super) fn is_rest(&self) -> bool {
        matches!(self.source, Source::Http(_))
    }

    fn header(&self, name: &str) -> Option<&str> {
        match self.source {
            Source::Http(sender) => sender.header(name),
            Source::Message | Source::Command(..) => None,
        }
    }

    /// Identity and condition of the sender in a payload.
    pub(super) fn payload_meta(&self) -> Option<CommandMeta> {
        match &self.source {
            Source::Command(meta, _) => Some(meta.clone()),
            Source::Http(_) | Source::Message => None,
        }
    }

    /// Identity and condition of a command: from the payload, or from `Idempotency-Key`, `If-Match` and `Lease-Fence`.
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

    /// Number of the control lease under which it is sent.
    pub(super) fn fence(&self) -> Result<Option<u64>, Fault> {
        let fence = self.header(LEASE_FENCE).map(|text| text.trim().parse());
        fence.transpose().map_err(|_| {
            Fault::Invalid(
                "Lease-Fence is the number of the control lease, as it was given when it was taken"
                    .to_owned(),
            )
        })
    }

    /// What must hold of a program that is to be changed.
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

    /// The signature of a program.
    pub(super) fn signature(&self) -> Option<String> {
        self.header(PROGRAM_SIGNATURE).map(|text| text.trim().to_owned())
    }

    /// Whether to answer when it is done.
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

/// A request in parts, of which each route and topic takes what it names.
#[derive(Debug, Default)]
pub struct RequestParts {
    /// Values for the names in a path.
    pub(super) params: Vec<Param>,
    /// Query of a route.
    pub(super) query: Vec<(&'static str, String)>,
    pub(super) headers: Vec<(&'static str, String)>,
    pub(super) body: Body,
    /// Payload of its topic where that is not its body.
    pub(super) payload: Option<Value>,
}

/// Body of a request.
#[derive(Debug, Default)]
pub(super) enum Body {
    #[default]
    Nothing,
    Json(Value),
    Text(String),
}

impl RequestParts {
    /// Of a coordinate system.
    pub(super) fn of(cs: CoordinateSystemNumber) -> Self {
        Self::default().with("cs", cs)
    }

    /// Of an input or output of the plant.
    pub(super) fn of_io(point: &IoPoint) -> Self {
        Self::default()
            .with("side", point.side.wire_name())
            .with("name", &point.name)
    }

    /// With a value of a name of the path.
    #[allow(
        clippy::needless_pass_by_value,
        reason = "numbers and literals read better so"
    )]
    pub(super) fn with(mut self, name: &'static str, value: impl ToString) -> Self {
        self.params.push((name, value.to_string()));
        self
    }

    /// Of an output.
    pub(super) fn of_output(
        cs: CoordinateSystemNumber,
        m: Option<u16>,
        seq: u64,
        said: &impl Serialize,
    ) -> Self {
        let parts = Self::of(cs).with("seq", seq).json(said);
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

    /// With the payload of its topic.
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

    /// With a value of the query that may be left out.
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

    /// Whether to answer when it is done.
    pub(super) fn waiting(self, wait: bool) -> Self {
        if wait { self.query("wait", 1) } else { self }
    }

    /// With what must hold of a program.
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

    /// With the id of a command and its condition.
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
