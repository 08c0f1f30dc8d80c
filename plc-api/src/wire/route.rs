//! A route of REST: where a request goes, what it carries, and what the documents say of it.

use super::pattern;
use crate::types::form::{Form, HasForm};

/// What a request or an answer carries.
#[derive(Debug, Clone, Copy)]
pub enum Content {
    /// Nothing: a body is not read.
    Nothing,
    /// JSON of this form.
    Json(Form),
    /// Text: an NC program, or metrics.
    Text,
    /// Any JSON object: a document.
    Document,
    /// Bytes of a form of their own.
    Bytes,
}

/// What the query of a route says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Query {
    /// It is not read.
    Nothing,
    /// `from` and `count`.
    Range,
    /// The same, and the fields of [`JournalFilter`](crate::types::data::JournalFilter).
    Journal,
    /// `wait`: answer when it is done.
    Wait,
    /// `wait`: how many seconds at most.
    Seconds,
    /// `cs`, `from` and `count`: which runs.
    Runs,
    /// `dialect`: of the program that is stored.
    Dialect,
    /// `from`, `count` and `axes`: which samples.
    Trace,
    /// `cs`: the coordinate system that runs a program.
    RunBy,
    /// The same, `tolerance`, `from` and `count`: a part of a planned path.
    Path,
}

/// Headers that a route reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Headers {
    /// None of ours.
    Nothing,
    /// `Idempotency-Key`.
    Key,
    /// `Idempotency-Key`, and `Lease-Fence`, which must be there.
    KeyAndFence,
    /// `Idempotency-Key`, and the conditions of a command: `Lease-Fence`, `If-Match`.
    Command,
    /// What the client has already: `If-None-Match`.
    Cached,
    /// Which program is to be changed: `If-Match`, `If-None-Match`.
    Condition,
    /// The same, and `Program-Signature`.
    Upload,
}

impl Headers {
    /// True for what a command reads.
    pub fn has_key(self) -> bool {
        matches!(self, Headers::Key | Headers::KeyAndFence | Headers::Command)
    }
}

/// One route.
#[derive(Debug, Clone, Copy)]
pub struct Route {
    /// HTTP method.
    pub method: &'static str,
    /// Path below `/api/v1`: a pattern with names in braces.
    pub pattern: &'static str,
    /// What it does, in one sentence.
    pub summary: &'static str,
    /// What its query says.
    pub query: Query,
    /// Headers that it reads.
    pub headers: Headers,
    /// What its body holds.
    pub body: Content,
    /// Status of success, and what it carries.
    pub answer: (u16, Content),
    /// Another status of success.
    pub other_answer: Option<(u16, Content)>,
    /// Statuses of refusals that do not follow from the rest.
    pub refusals: &'static [u16],
    /// Largest `{number}` of its path.
    pub number_max: u32,
}

impl Route {
    /// A route without a body, which is answered without content.
    pub const fn new(method: &'static str, pattern: &'static str, summary: &'static str) -> Self {
        Self {
            method,
            pattern,
            summary,
            query: Query::Nothing,
            headers: Headers::Nothing,
            body: Content::Nothing,
            answer: (204, Content::Nothing),
            other_answer: None,
            refusals: &[],
            number_max: 9999,
        }
    }

    /// Reads something of the machine.
    pub const fn get(pattern: &'static str, summary: &'static str) -> Self {
        Self::new("GET", pattern, summary)
    }

    /// Sets a value.
    pub(super) const fn put<T: HasForm>(pattern: &'static str, summary: &'static str) -> Self {
        Self::new("PUT", pattern, summary).takes(Content::Json(Form::of::<T>()))
    }

    /// Tells or asks something.
    pub(super) const fn post<T: HasForm>(pattern: &'static str, summary: &'static str) -> Self {
        Self::new("POST", pattern, summary).takes(Content::Json(Form::of::<T>()))
    }

    /// With a body.
    #[must_use]
    pub const fn takes(mut self, body: Content) -> Self {
        self.body = body;
        self
    }

    /// Answered with JSON of this form.
    #[must_use]
    pub const fn gives<T: HasForm>(self) -> Self {
        self.answered(200, Content::Json(Form::of::<T>()))
    }

    /// Answered with JSON of this form, and where what is new can be read.
    pub(super) const fn gives_new<T: HasForm>(self) -> Self {
        self.answered(201, Content::Json(Form::of::<T>()))
    }

    /// Answered with this status and content.
    #[must_use]
    pub const fn answered(mut self, status: u16, content: Content) -> Self {
        self.answer = (status, content);
        self
    }

    /// Or answered with this status and JSON of this form.
    pub(super) const fn or<T: HasForm>(mut self, status: u16) -> Self {
        self.other_answer = Some((status, Content::Json(Form::of::<T>())));
        self
    }

    /// With this query.
    pub(super) const fn query(mut self, query: Query) -> Self {
        self.query = query;
        self
    }

    /// With these headers.
    pub(super) const fn headers(mut self, headers: Headers) -> Self {
        self.headers = headers;
        self
    }

    /// With these refusals besides.
    #[must_use]
    pub const fn refusals(mut self, refusals: &'static [u16]) -> Self {
        self.refusals = refusals;
        self
    }

    /// With another largest number in its path.
    pub(super) const fn number_max(mut self, number_max: u32) -> Self {
        self.number_max = number_max;
        self
    }

    /// What its path fixes, by name.
    pub fn fixed(&self) -> impl Iterator<Item = (&'static str, &'static str)> + use<> {
        pattern::fixed(self.pattern)
    }

    /// Names in its path that stand for a value of the caller.
    pub fn names(&self) -> impl Iterator<Item = &'static str> + use<> {
        let pattern = self.pattern;
        let is_fixed = move |name: &str| pattern::fixed(pattern).any(|(fixed, _)| fixed == name);
        pattern::names(pattern).filter(move |name| !is_fixed(name))
    }

    /// Statuses of success, and what they carry.
    pub fn answers(&self) -> impl Iterator<Item = (u16, Content)> + use<> {
        [Some(self.answer), self.other_answer].into_iter().flatten()
    }

    /// Its path with names in braces.
    pub fn path(&self) -> String {
        pattern::shown(self.pattern)
    }
}
