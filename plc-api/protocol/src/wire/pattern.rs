//! Patterns of paths, such as `cs/{cs}/tool/set` or `/cs/{cs}/{verb=load}`: writers fill them, readers split
//! paths by them.
//!
//! `{name}` stands for one level; `{name=value}` is the fixed level `value`, which is also the value of
//! `name`.

use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};

/// The name in a pattern, and its value.
pub type Param = (&'static str, String);

enum PatternLevel<'a> {
    Plain(&'a str),
    Named(&'a str),
    Fixed(&'a str, &'a str),
}

fn level(text: &str) -> PatternLevel<'_> {
    match text.strip_prefix('{').and_then(|text| text.strip_suffix('}')) {
        None => PatternLevel::Plain(text),
        Some(name) => match name.split_once('=') {
            None => PatternLevel::Named(name),
            Some((name, value)) => PatternLevel::Fixed(name, value),
        },
    }
}

/// Returns the pattern as documents show it: each fixed level as its value only.
pub(super) fn shown(pattern: &str) -> String {
    let levels = pattern.split('/').map(|text| match level(text) {
        PatternLevel::Plain(_) | PatternLevel::Named(_) => text,
        PatternLevel::Fixed(_, value) => value,
    });
    levels.collect::<Vec<_>>().join("/")
}

/// Returns the pattern as an MQTT filter, with `+` for each level that is not fixed.
pub(super) fn filter(pattern: &str) -> String {
    let shown = shown(pattern);
    let levels = shown.split('/').map(|text| match level(text) {
        PatternLevel::Plain(text) => text,
        _ => "+",
    });
    levels.collect::<Vec<_>>().join("/")
}

/// Returns the names of the pattern, including those of fixed levels.
pub(super) fn names(pattern: &str) -> impl Iterator<Item = &str> {
    pattern.split('/').filter_map(|text| match level(text) {
        PatternLevel::Plain(_) => None,
        PatternLevel::Named(name) | PatternLevel::Fixed(name, _) => Some(name),
    })
}

/// Returns the fixed values of the pattern, by name.
pub(super) fn fixed(pattern: &str) -> impl Iterator<Item = (&str, &str)> {
    pattern.split('/').filter_map(|text| match level(text) {
        PatternLevel::Fixed(name, value) => Some((name, value)),
        _ => None,
    })
}

/// Returns the path with these values, each encoded by `encode`. Returns `None` if a name of the pattern has
/// no value, or if the pattern fixes a different value.
pub(super) fn fill(pattern: &str, params: &[Param], encode: impl Fn(&str) -> String) -> Option<String> {
    let value = |name: &str| Some(params.iter().find(|(known, _)| *known == name)?.1.as_str());
    let mut levels = Vec::new();
    for text in pattern.split('/') {
        levels.push(match level(text) {
            PatternLevel::Plain(text) => text.to_owned(),
            PatternLevel::Named(name) => encode(value(name)?),
            PatternLevel::Fixed(name, fixed) => value(name).filter(|value| *value == fixed)?.to_owned(),
        });
    }
    Some(levels.join("/"))
}

/// Returns the values in a path for the names of the pattern, or `None` if the path does not match the
/// pattern.
pub(super) fn take_apart<'a>(pattern: &'static str, path: &'a str) -> Option<Vec<(&'a str, &'a str)>> {
    let mut params = Vec::new();
    let mut levels = path.split('/');
    for text in pattern.split('/') {
        let found = levels.next()?;
        match level(text) {
            PatternLevel::Plain(text) if text == found => {}
            PatternLevel::Named(name) => params.push((name, found)),
            PatternLevel::Fixed(name, value) if value == found => params.push((name, value)),
            PatternLevel::Plain(_) | PatternLevel::Fixed(..) => return None,
        }
    }
    levels.next().is_none().then_some(params)
}

/// Characters that are encoded as `%XX`: all but the unreserved characters of a URL.
const RESERVED: &AsciiSet = &NON_ALPHANUMERIC
    .remove(b'-')
    .remove(b'.')
    .remove(b'_')
    .remove(b'~');

/// Encodes a text as one level of a path: all characters but the unreserved ones become `%XX`.
pub fn percent_encoded(text: &str) -> String {
    utf8_percent_encode(text, RESERVED).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn params(params: &[(&'static str, &str)]) -> Vec<Param> {
        params
            .iter()
            .map(|(name, value)| (*name, (*value).to_owned()))
            .collect()
    }

    #[test]
    fn a_path_that_is_filled_comes_apart_again() {
        let pattern = "cs/{cs}/{verb=load}";
        let values = params(&[("cs", "2"), ("verb", "load")]);
        let path = fill(pattern, &values, str::to_owned);
        assert_eq!(path.as_deref(), Some("cs/2/load"));
        assert_eq!(
            take_apart(pattern, "cs/2/load"),
            Some(vec![("cs", "2"), ("verb", "load")])
        );
        for other in ["cs/2/hold", "cs/2", "cs/2/load/x", "x/2/load"] {
            assert_eq!(take_apart(pattern, other), None, "{other}");
        }
        assert_eq!(
            fill(pattern, &params(&[("cs", "2"), ("verb", "hold")]), str::to_owned),
            None
        );
        assert_eq!(fill(pattern, &params(&[("cs", "2")]), str::to_owned), None);
        assert_eq!(shown(pattern), "cs/{cs}/load");
        assert_eq!(filter(pattern), "cs/+/load");
    }

    #[test]
    fn a_value_of_any_characters_makes_one_level() {
        assert_eq!(percent_encoded("a-1._~"), "a-1._~");
        assert_eq!(percent_encoded("a/b c?"), "a%2Fb%20c%3F");
    }
}
