//! The form of a JSON text, given by the type that is encoded as the text or decoded from it.

use serde::Serialize;

use super::{BootId, Timestamp};

/// Version of the interface, `v` in every message.
pub const INTERFACE_VERSION: u32 = 1;

/// The form of a JSON text, given by a type. With the feature `schema` it provides the JSON Schema of the
/// type.
#[derive(Debug, Clone, Copy)]
pub struct Form {
    /// Name of the type in the documents of the interface.
    #[cfg(feature = "schema")]
    pub name: fn() -> std::borrow::Cow<'static, str>,
    /// Schema of the type.
    #[cfg(feature = "schema")]
    pub schema: fn(&mut schemars::SchemaGenerator) -> schemars::Schema,
}

/// A type that can be the form of a JSON text.
#[cfg(feature = "schema")]
pub trait HasForm: schemars::JsonSchema {}
#[cfg(feature = "schema")]
impl<T: schemars::JsonSchema> HasForm for T {}

/// A type that can be the form of a JSON text.
#[cfg(not(feature = "schema"))]
pub trait HasForm {}
#[cfg(not(feature = "schema"))]
impl<T> HasForm for T {}

impl Form {
    /// Returns the form of this type.
    pub const fn for_type<T: HasForm>() -> Self {
        Self {
            #[cfg(feature = "schema")]
            name: T::schema_name,
            #[cfg(feature = "schema")]
            schema: T::json_schema,
        }
    }
}

// A message: its payload in the envelope of every message. In generated documents it has the description of
// its payload.
#[allow(
    missing_docs,
    reason = "a description of its own would go before that of the payload"
)]
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(rename = "{T}Message"))]
pub struct MessageEnvelope<'a, T> {
    /// Version of the interface.
    #[cfg_attr(feature = "schema", schemars(extend("const" = INTERFACE_VERSION)))]
    pub v: u32,
    /// The boot that publishes the message.
    pub boot_id: &'a BootId,
    /// Time of publication.
    #[cfg_attr(feature = "schema", schemars(with = "String", extend("format" = "date-time")))]
    pub ts: &'a Timestamp,
    /// For a state: revision, which increases with each change of this topic.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rev: Option<u64>,
    /// Content of the message.
    #[serde(flatten)]
    pub payload: &'a T,
}
