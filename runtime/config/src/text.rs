//! Converts the text of a configuration into its tables, and finds all problems in it. After each problem,
//! the value is corrected or removed, and the tables are read again.

use std::collections::BTreeMap;
use std::ops::Range;

use serde::Deserialize;
use tandem_syntax::LineIndex;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue, Error, ValueDeserializer};

use super::error::{explain, known, quoted};
use super::{Config, ConfigError};

/// Maximum number of problems that are searched for in one configuration. Reason: each problem requires
/// another pass over the tables.
const PROBLEMS_MAX: usize = 100;

/// Line and column (from 1) of each key and table, by paths such as `motor.0.kind`.
pub(super) type KeyPositions = BTreeMap<String, (u32, u32)>;

/// Problems of a configuration, each with its position if the position is known.
pub(super) struct Problems<'a> {
    places: &'a KeyPositions,
    found: Vec<(Option<(u32, u32)>, String)>,
}

impl<'a> Problems<'a> {
    pub fn new(places: &'a KeyPositions) -> Self {
        let found = Vec::new();
        Self { places, found }
    }

    /// Adds a problem of the key or table at a path. A key that is not in the text gets the position of its
    /// table.
    pub fn add(&mut self, path: &str, text: String) {
        let mut paths = std::iter::successors(Some(path), |path| Some(path.rsplit_once('.')?.0));
        let place = paths.find_map(|path| self.places.get(path).copied());
        self.found.push((place, text));
    }

    pub fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// Returns the error that lists the problems in the order of the text.
    pub fn into_error(mut self) -> ConfigError {
        self.found.sort_by_key(|(place, _)| (place.is_none(), *place));
        let lines = self.found.into_iter().map(|(place, text)| match place {
            Some(place) => format!("{}: {text}", words(place)),
            None => text,
        });
        ConfigError::Values(lines.collect())
    }
}

fn words((line, column): (u32, u32)) -> String {
    format!("line {line}, column {column}")
}

/// Reads a configuration text.
///
/// # Errors
/// Returns all problems, except those that may only follow from a missing or unreadable value.
pub(super) fn read(text: &str) -> Result<Config, ConfigError> {
    let index = LineIndex::new(text);
    let locate = |offset: usize| index.locate(u32::try_from(offset).unwrap_or(u32::MAX));
    let note = |error: &Error| {
        let before = error.span().and_then(|span| text.get(..span.start));
        let place = before.map(|before| locate(before.len()));
        (place, explain(before.unwrap_or_default(), error.message()))
    };
    let alone = |(place, message): (Option<(u32, u32)>, String)| ConfigError::Text {
        place: place.map(words).unwrap_or_default(),
        message,
    };
    let parsed = DeTable::parse(text).map_err(|error| alone(note(&error)))?;
    let mut tables = Spanned::new(parsed.span(), DeValue::Table(parsed.into_inner()));
    let mut places = KeyPositions::new();
    collect_positions("", tables.get_ref(), &locate, &mut places);
    let mut problems = Problems::new(&places);
    let (mut is_whole, mut taken_out) = (true, Vec::new());
    let config = loop {
        let error = match Config::deserialize(ValueDeserializer::from(tables.clone())) {
            Ok(config) => break Some(config),
            Err(error) => error,
        };
        let (message, span) = (error.message(), error.span().unwrap_or_default());
        let key = (
            span.clone(),
            quoted(message).next().unwrap_or_default().to_owned(),
        );
        if !(message.starts_with("missing field") && taken_out.contains(&key)) {
            problems.found.push(note(&error));
        }
        let word = known(message)
            .next()
            .filter(|_| message.starts_with("unknown variant"));
        is_whole &= word.is_some() || message.starts_with("unknown field");
        match mend(&mut tables, &span, word) {
            Some(key) if problems.found.len() < PROBLEMS_MAX => taken_out.push(key),
            _ => break None,
        }
    };
    if let Some(config) = config.filter(|_| is_whole) {
        if problems.is_empty() {
            return Ok(Config { places, ..config });
        }
        config.resolve_into(&mut problems);
    }
    Err(match &mut problems.found[..] {
        [only] => alone(std::mem::take(only)),
        _ => problems.into_error(),
    })
}

fn collect_positions(
    path: &str,
    value: &DeValue<'_>,
    locate: &impl Fn(usize) -> (u32, u32),
    places: &mut KeyPositions,
) {
    let mut collect = |key: &str, start: usize, value: &Spanned<DeValue<'_>>| {
        let path = if path.is_empty() {
            key.to_owned()
        } else {
            format!("{path}.{key}")
        };
        collect_positions(&path, value.get_ref(), locate, places);
        places.insert(path, locate(start));
    };
    match value {
        DeValue::Table(table) => {
            for (key, value) in table {
                collect(key.get_ref(), key.span().start, value);
            }
        }
        DeValue::Array(array) => {
            for (index, value) in array.iter().enumerate() {
                collect(&index.to_string(), value.span().start, value);
            }
        }
        _ => {}
    }
}

/// Replaces the value at a span of the text by a word. If `word` is `None`, removes the key, the value with
/// its key, or the table at that span. Returns the span of the enclosing table, and the key in it.
fn mend(
    within: &mut Spanned<DeValue<'_>>,
    span: &Range<usize>,
    word: Option<&str>,
) -> Option<(Range<usize>, String)> {
    let of = within.span();
    match within.get_mut() {
        DeValue::Table(table) => {
            let is_it = |(key, value): &(&Spanned<_>, &Spanned<DeValue<'_>>)| {
                let has = value.span();
                match value.get_ref() {
                    _ if key.span() == *span => true,
                    DeValue::Table(_) => has == *span,
                    DeValue::Array(array) if array.iter().any(|item| item.get_ref().is_table()) => false,
                    _ => has.start <= span.start && span.end <= has.end,
                }
            };
            let found = table.iter().find(is_it).map(|(key, _)| key.clone());
            let Some(key) = found else {
                return table.iter_mut().find_map(|(_, value)| mend(value, span, word));
            };
            match (table.get_mut(&key), word) {
                (Some(value), Some(word)) => *value.get_mut() = DeValue::String(word.to_owned().into()),
                _ => drop(table.remove(&key)),
            }
            Some((of, key.into_inner().into_owned()))
        }
        DeValue::Array(array) if array.iter().any(|item| item.span() == *span) => {
            let items = std::mem::replace(array, DeArray::new()).into_iter();
            *array = items.filter(|item| item.span() != *span).collect();
            Some((of, String::new()))
        }
        DeValue::Array(array) => array.iter_mut().find_map(|item| mend(item, span, word)),
        _ => None,
    }
}
