//! `[programs]`: the store of NC programs.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use tandem_store::program_store::PROGRAMS_BYTES_MAX;

/// `[programs]`
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ProgramsConfig {
    /// Maximum size of the texts of all programs together, MiB. In memory, a program takes about four times
    /// the size of its text, at most twelve times.
    #[schemars(range(min = 1, max = 16384))]
    pub total_max_mib: usize,
    /// Public keys of Ed25519, each in Base64 or as the name of a PEM file. Only programs with a signature by one of
    /// these keys are loaded and called. Without keys, no signature is needed.
    pub signed_by: Vec<String>,
    /// Accepts manual data input, which is never signed; default `true`, and `false` with `signed_by`.
    pub mdi: Option<bool>,
}

impl Default for ProgramsConfig {
    fn default() -> Self {
        Self {
            total_max_mib: PROGRAMS_BYTES_MAX >> 20,
            signed_by: Vec::new(),
            mdi: None,
        }
    }
}
