//! The dialects that are part of Tandem. Each is one file, named here in two lines.

mod nj;

use crate::dialect::Dialect;

pub use nj::nj;

/// All dialects. Configuration and command line find them by name.
static DIALECTS: &[&Dialect] = &[&nj::NJ];

/// Dialects that are part of the design and not built yet.
const NOT_BUILT: &[&str] = &["dgshape"];

/// The names of all dialects.
pub fn names() -> impl Iterator<Item = &'static str> {
    DIALECTS.iter().map(|dialect| dialect.name)
}

/// The dialect of a name.
///
/// # Errors
/// What to write instead.
pub fn find(name: &str) -> Result<&'static Dialect, String> {
    let found = DIALECTS.iter().copied().find(|dialect| dialect.name == name);
    found.ok_or_else(|| {
        let names: Vec<&str> = names().collect();
        let what = if NOT_BUILT.contains(&name) {
            format!("dialect {name} is not supported yet")
        } else {
            format!("there is no dialect {name}")
        };
        format!("{what}; write {}", names.join(" or "))
    })
}
