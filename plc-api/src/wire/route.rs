//! A route of REST: where a request goes, what it carries, and what the documents say of it.

use super::pattern;
use super::right::Right;

/// What a request or an answer carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Content {
    /// Nothing: a body is not read.
    Nothing,
    /// JSON, by name of its schema.
    Json(&'static str),
    /// Text: an NC program, or metrics.
    Text,
    /// Any JSON object: a document.
    Document,
}

/// What the query of a route says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Query {
    /// It is not read.
    Nothing,
    /// `from` and `count`.
    Range,
    /// `wait`: answer when it is done.
    Wait,
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
}

/// One route.
#[derive(Debug)]
pub struct Route {
    /// HTTP method.
    pub method: &'static str,
    /// Path below `/api/v1`: a pattern with names in braces.
    pub pattern: &'static str,
    /// What it asks of its caller; `None`: nothing, since it says nothing of the machine.
    pub right: Option<Right>,
    /// What it does, for the documents.
    pub summary: &'static str,
    /// What its query says.
    pub query: Query,
    /// Headers that it reads.
    pub headers: Headers,
    /// What its body holds.
    pub body: Content,
    /// Status of success, and what it carries.
    pub answers: &'static [(u16, Content)],
    /// Statuses of refusals that do not follow from the rest.
    pub refusals: &'static [u16],
    /// Largest `{number}` of its path.
    pub number_max: u32,
}

/// Answered without content.
pub const NO_CONTENT: &[(u16, Content)] = &[(204, Content::Nothing)];

impl Route {
    /// A route with this method, on which nothing is sent.
    pub const fn new(
        method: &'static str,
        pattern: &'static str,
        right: Option<Right>,
        summary: &'static str,
        answers: &'static [(u16, Content)],
    ) -> Self {
        Self {
            method,
            pattern,
            right,
            summary,
            query: Query::Nothing,
            headers: Headers::Nothing,
            body: Content::Nothing,
            answers,
            refusals: &[],
            number_max: 9999,
        }
    }

    /// Reads something of the machine.
    pub const fn get(
        pattern: &'static str,
        summary: &'static str,
        answers: &'static [(u16, Content)],
    ) -> Self {
        Self::new("GET", pattern, Some(Right::Read), summary, answers)
    }

    /// Sets a value.
    pub(super) const fn put(
        pattern: &'static str,
        right: Right,
        summary: &'static str,
        body: &'static str,
    ) -> Self {
        Self::new("PUT", pattern, Some(right), summary, NO_CONTENT).json(body)
    }

    /// Says something.
    pub(super) const fn post(
        pattern: &'static str,
        right: Right,
        summary: &'static str,
        body: &'static str,
        answers: &'static [(u16, Content)],
    ) -> Self {
        Self::new("POST", pattern, Some(right), summary, answers).json(body)
    }

    /// With a JSON body of this schema.
    pub(super) const fn json(mut self, schema: &'static str) -> Self {
        self.body = Content::Json(schema);
        self
    }

    /// With a text as its body.
    pub(super) const fn text(mut self) -> Self {
        self.body = Content::Text;
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
    pub fn fixed(&self) -> impl Iterator<Item = (&str, &str)> {
        pattern::fixed(self.pattern)
    }

    /// Names in its path that stand for a value of the caller.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        let names = pattern::names(self.pattern);
        names.filter(|name| self.fixed().all(|(fixed, _)| fixed != *name))
    }

    /// Its path with names in braces.
    pub fn path(&self) -> String {
        pattern::shown(self.pattern)
    }
}
