//! Words that people see, each with its meaning and what to do about it. Each row is beside the definition of its word.

use serde::{Deserialize, Serialize};

/// What a name means.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Explanation {
    /// The name that was asked for.
    pub what: String,
    /// Plain text; lines that are indented stand as they are.
    pub text: String,
    /// Name of a picture of its example, below `/pictures/`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub picture: Option<String>,
}

/// A word that people see.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Explained {
    /// What it is a word of.
    pub of: &'static str,
    /// The word, as messages have it.
    pub word: &'static str,
    /// What it means.
    pub meaning: &'static str,
    /// How to go on.
    pub way_on: &'static str,
}

/// An enum of words: each has its word in JSON, its meaning as documentation, and how to go on.
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
            /// All words, with what they mean.
            pub const EXPLAINED: &[$crate::types::explained::Explained] = &[
                $($crate::types::explained::Explained {
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
