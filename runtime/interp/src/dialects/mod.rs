//! The dialects that are part of Tandem. Each dialect is one file, with its module and its entry in the list
//! here.

pub mod convert;
pub mod decisions;
mod dgshape;
pub mod examples;
mod nj;
pub mod texts;

use crate::dialect::Dialect;

pub use dgshape::dgshape;
pub use nj::nj;

/// Name of the dialect of texts for which neither a machine nor an option names one.
pub const DEFAULT_NAME: &str = nj::NAME;

/// Returns the dialect of texts for which neither a machine nor an option names one.
pub fn default_dialect() -> &'static Dialect {
    nj()
}

/// All dialects. Configuration and command line find them by name.
static DIALECTS: &[&Dialect] = &[&nj::NJ, &dgshape::DGSHAPE];

/// Returns the names of all dialects.
pub fn names() -> impl Iterator<Item = &'static str> {
    DIALECTS.iter().map(|dialect| dialect.name)
}

/// Returns the dialect with this name.
///
/// # Errors
/// Returns an error text with the existing names if no dialect has this name.
pub fn find(name: &str) -> Result<&'static Dialect, String> {
    let found = DIALECTS.iter().copied().find(|dialect| dialect.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = names().collect();
        format!("there is no dialect {name}; write {}", names.join(" or "))
    })
}
