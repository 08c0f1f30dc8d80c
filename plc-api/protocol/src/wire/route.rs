//! A route of REST: its address, its content, and its description in the documents.

use super::parameter::{Query, Values};
use super::path_parameter::PathParameter;
use super::pattern;
use super::subject::Subject;
use crate::types::form::{Form, HasForm};
use crate::types::ids::COMMAND_ID_MAX;

/// Content of a request or an answer.
#[derive(Debug, Clone, Copy)]
pub enum Content {
    /// No content; the body of a request is ignored.
    Nothing,
    /// JSON with the form of this type.
    Json(Form),
    /// Text: an NC program, or metrics.
    Text,
    /// Any JSON object, for a document of the interface.
    Document,
    /// Bytes in a binary format.
    Bytes,
}

/// Headers that a route reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Headers {
    /// No header that belongs to this interface.
    Nothing,
    /// `Idempotency-Key`.
    Key,
    /// `Idempotency-Key`, and `Lease-Fence`, which is required.
    KeyAndFence,
    /// `Idempotency-Key`, and the conditions of a command: `Lease-Fence`, `If-Match`.
    Command,
    /// `If-None-Match`: the version that the client already has.
    Cached,
    /// `If-Match`, `If-None-Match`: condition for changing a program.
    Condition,
    /// `If-Match`, `If-None-Match` and `Program-Signature`.
    Upload,
    /// `Sec-WebSocket-Protocol`: the token of a client that cannot set `Authorization`.
    WebSocket,
}

/// A header that a route reads.
#[derive(Debug, Clone, Copy)]
pub struct HeaderParameter {
    /// Name of the header, in the spelling of the documents.
    pub name: &'static str,
    /// Allowed values.
    pub values: Values,
    /// True if a request without this header is refused.
    pub is_required: bool,
    /// Meaning of the header.
    pub description: &'static str,
}

impl HeaderParameter {
    const fn new(name: &'static str, values: Values, description: &'static str) -> Self {
        Self {
            name,
            values,
            is_required: false,
            description,
        }
    }
}

const KEY: HeaderParameter = HeaderParameter::new(
    "Idempotency-Key",
    Values::Text(1, COMMAND_ID_MAX),
    "Id of the command. A repeated id gets the stored answer; the command is not executed again.",
);

const FENCE: HeaderParameter = HeaderParameter::new(
    "Lease-Fence",
    Values::Integer(0, None),
    "Number of the control lease under which the command is sent.",
);

/// Creates the regular expression of one to three conditions of a command.
macro_rules! expected_form {
    ($one:literal) => {
        concat!("^", $one, "(, *", $one, "){0,2}$")
    };
}

/// Creates the regular expression of a list of program hashes, or of `*` for any program.
macro_rules! hashes_form {
    ($one:literal) => {
        concat!("^(\\*|", $one, "(, *", $one, ")*)$")
    };
}

const EXPECTED: HeaderParameter = HeaderParameter::new(
    "If-Match",
    Values::Form(expected_form!(
        r#""?([0-9]+|[0-9A-Fa-f]{64}|boot:[0-9A-Za-z]{1,64})"?"#
    )),
    "Condition: revision of the state that the sender has received, hash of the expected program, boot: followed by the \
     expected boot_id, or several of them, separated by commas; all must match.",
);

const PROGRAM_IS: HeaderParameter = HeaderParameter::new(
    "If-Match",
    Values::Form(hashes_form!(r#"(W/)?"?[0-9A-Fa-f]{64}"?"#)),
    "Condition: the stored program has one of these hashes, or exists (*); else 412.",
);

const PROGRAM_IS_NOT: HeaderParameter = HeaderParameter {
    name: "If-None-Match",
    description: "Condition: the stored program has none of these hashes, or does not exist (*); else 412.",
    ..PROGRAM_IS
};

const SIGNATURE: HeaderParameter = HeaderParameter::new(
    "Program-Signature",
    Values::Form("^[A-Za-z0-9+/]{86}==$"),
    "Ed25519 signature of the text's bytes, 64 bytes in Base64.",
);

const HAD: HeaderParameter = HeaderParameter::new(
    "If-None-Match",
    Values::AnyText,
    "Hashes of the programs that the client already has; 304 if the program has one of them.",
);

const PROTOCOLS: HeaderParameter = HeaderParameter::new(
    "Sec-WebSocket-Protocol",
    Values::AnyText,
    "tandem.v1, and bearer. followed by the token, for a client that cannot set Authorization, such as a page in a browser.",
);

impl Headers {
    /// Returns the headers that the route reads.
    pub fn parameters(self) -> &'static [HeaderParameter] {
        const FENCE_REQUIRED: HeaderParameter = HeaderParameter {
            is_required: true,
            ..FENCE
        };
        match self {
            Headers::Nothing => &[],
            Headers::Key => &[KEY],
            Headers::KeyAndFence => &[KEY, FENCE_REQUIRED],
            Headers::Command => &[KEY, FENCE, EXPECTED],
            Headers::Cached => &[HAD],
            Headers::Condition => &[PROGRAM_IS, PROGRAM_IS_NOT],
            Headers::Upload => &[PROGRAM_IS, PROGRAM_IS_NOT, SIGNATURE],
            Headers::WebSocket => &[PROTOCOLS],
        }
    }

    /// Returns true if a header of this name is read.
    pub fn reads(self, name: &str) -> bool {
        let mut parameters = self.parameters().iter();
        parameters.any(|parameter| parameter.name.eq_ignore_ascii_case(name))
    }

    /// Returns true if the headers include `Idempotency-Key`.
    pub fn has_key(self) -> bool {
        matches!(self, Headers::Key | Headers::KeyAndFence | Headers::Command)
    }
}

/// One route.
#[derive(Debug, Clone, Copy)]
pub struct Route {
    /// HTTP method.
    pub method: &'static str,
    /// Subject by which documents group the route.
    pub subject: Subject,
    /// Path below `/api/v1`: a pattern with names in braces.
    pub pattern: &'static str,
    /// Names in the path for which the caller gives a value, in the order of the path.
    pub params: &'static [PathParameter],
    /// Effect of the route, in one sentence.
    pub summary: &'static str,
    /// Query of the route.
    pub query: Query,
    /// Headers that the route reads.
    pub headers: Headers,
    /// Body of the request.
    pub body: Content,
    /// Status and content of a successful answer.
    pub answer: (u16, Content),
    /// Alternative status and content of a successful answer.
    pub other_answer: Option<(u16, Content)>,
    /// Statuses of refusals that do not already result from the other fields.
    pub refusals: &'static [u16],
}

impl Route {
    /// Creates a route without a body, which is answered without content.
    pub const fn new(
        method: &'static str,
        subject: Subject,
        pattern: &'static str,
        params: &'static [PathParameter],
        summary: &'static str,
    ) -> Self {
        Self {
            method,
            subject,
            pattern,
            params,
            summary,
            query: Query::NOTHING,
            headers: Headers::Nothing,
            body: Content::Nothing,
            answer: (204, Content::Nothing),
            other_answer: None,
            refusals: &[],
        }
    }

    /// Creates a route that reads data of the machine.
    pub const fn get(
        subject: Subject,
        pattern: &'static str,
        params: &'static [PathParameter],
        summary: &'static str,
    ) -> Self {
        Self::new("GET", subject, pattern, params, summary)
    }

    /// Creates a route that sets a value.
    pub(super) const fn put<T: HasForm>(
        subject: Subject,
        pattern: &'static str,
        params: &'static [PathParameter],
        summary: &'static str,
    ) -> Self {
        Self::new("PUT", subject, pattern, params, summary).takes(Content::Json(Form::for_type::<T>()))
    }

    /// Creates a route that sends a message or a request.
    pub(super) const fn post<T: HasForm>(
        subject: Subject,
        pattern: &'static str,
        params: &'static [PathParameter],
        summary: &'static str,
    ) -> Self {
        Self::new("POST", subject, pattern, params, summary).takes(Content::Json(Form::for_type::<T>()))
    }

    /// Sets the content of the body.
    #[must_use]
    pub const fn takes(mut self, body: Content) -> Self {
        self.body = body;
        self
    }

    /// Sets an answer with JSON of this form.
    #[must_use]
    pub const fn gives<T: HasForm>(self) -> Self {
        self.answered(200, Content::Json(Form::for_type::<T>()))
    }

    /// Sets an answer with JSON of this form and with the address of a new resource.
    pub(super) const fn gives_new<T: HasForm>(self) -> Self {
        self.answered(201, Content::Json(Form::for_type::<T>()))
    }

    /// Sets the status and content of the answer.
    #[must_use]
    pub const fn answered(mut self, status: u16, content: Content) -> Self {
        self.answer = (status, content);
        self
    }

    /// Adds an alternative answer with this status and JSON of this form.
    pub(super) const fn or<T: HasForm>(mut self, status: u16) -> Self {
        self.other_answer = Some((status, Content::Json(Form::for_type::<T>())));
        self
    }

    /// Sets the query.
    pub(super) const fn query(mut self, query: Query) -> Self {
        self.query = query;
        self
    }

    /// Sets the headers.
    #[must_use]
    pub const fn headers(mut self, headers: Headers) -> Self {
        self.headers = headers;
        self
    }

    /// Adds these statuses to the statuses of refusals.
    #[must_use]
    pub const fn refusals(mut self, refusals: &'static [u16]) -> Self {
        self.refusals = refusals;
        self
    }

    /// Returns the fixed values in the path, by name.
    pub fn fixed(&self) -> impl Iterator<Item = (&'static str, &'static str)> + use<> {
        pattern::fixed(self.pattern)
    }

    /// Returns the names in the path for which the caller gives a value.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + use<> {
        self.params.iter().map(|param| param.name)
    }

    /// Returns the statuses of success, with their contents.
    pub fn answers(&self) -> impl Iterator<Item = (u16, Content)> + use<> {
        [Some(self.answer), self.other_answer].into_iter().flatten()
    }

    /// Returns the path with names in braces.
    pub fn path(&self) -> String {
        pattern::shown(self.pattern)
    }
}
