//! Words that people see in messages, each with its meaning and the next step. The row of a word is next to
//! the definition of the word.

use serde::{Deserialize, Serialize};

/// Meaning of a name.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Explanation {
    /// The requested name.
    pub what: String,
    /// Plain text; indented lines must be shown unchanged.
    pub text: String,
    /// File name, below `/pictures/`, of a picture of the example in the text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<String>,
}

/// A word that people see.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ExplainedWord {
    /// Kind of the word, such as `status of a command`.
    pub of: &'static str,
    /// The word as it appears in messages.
    pub word: &'static str,
    /// Meaning of the word.
    pub meaning: &'static str,
    /// The next step for the reader.
    pub way_on: &'static str,
}

/// Defines an enum of words: each variant has its word in JSON, its meaning (also its documentation), and the
/// next step for the reader.
macro_rules! explained {
    (
        $of:literal
        $(#[$doc:meta])*
        pub enum $name:ident {
            $($(@$at:ident)? $(#[doc = $meaning:literal])+ $variant:ident = $word:literal, $way_on:literal;)*
        }
    ) => {
        $(#[$doc])*
        pub enum $name {
            $($(#[$at])? $(#[doc = $meaning])+ #[serde(rename = $word)] $variant,)*
        }

        impl $name {
            /// All words with their meanings.
            pub const EXPLAINED: &[$crate::types::explained::ExplainedWord] = &[
                $($crate::types::explained::ExplainedWord {
                    of: $of,
                    word: $word,
                    meaning: concat!($($meaning),+),
                    way_on: $way_on,
                },)*
            ];
        }
    };
}
pub(crate) use explained;
