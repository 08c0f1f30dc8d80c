//! Faults of a configuration, in words for the person who wrote it.

use std::path::{Path, PathBuf};

/// Why a configuration is refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {error}", path = path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// Why.
        error: std::io::Error,
    },
    /// The text is not a configuration.
    #[error("{place}: {message}")]
    Text {
        /// File, line and column, as far as known.
        place: String,
        /// What is wrong and what to write instead.
        message: String,
    },
    /// Values that do not fit together.
    #[error("the configuration does not fit together:\n  {}", .0.join("\n  "))]
    Values(Vec<String>),
}

impl ConfigError {
    pub(super) fn text(text: &str, error: &toml::de::Error) -> Self {
        let before = error.span().and_then(|span| text.get(..span.start));
        let place = before.map_or_else(String::new, |before| {
            let line = before.matches('\n').count() + 1;
            let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
            format!("line {line}, column {column}")
        });
        Self::Text {
            place,
            message: explain(before.unwrap_or_default(), error.message()),
        }
    }

    pub(super) fn in_file(self, path: &Path) -> Self {
        match self {
            Self::Text { place, message } => Self::Text {
                place: format!("{}, {place}", path.display()),
                message,
            },
            other => other,
        }
    }
}

// serde names an unknown key and all known ones; people want the nearest. Of a wrong word they want to know which key it is of.
fn explain(before: &str, message: &str) -> String {
    let mut quoted = message.split('`').skip(1).step_by(2);
    let found = quoted.next().unwrap_or_default();
    if message.starts_with("unknown variant `") {
        let words: Vec<String> = quoted.map(|word| format!("\"{word}\"")).collect();
        let words = match words.as_slice() {
            [many @ .., last] if !many.is_empty() => format!("{} or {last}", many.join(", ")),
            all => all.concat(),
        };
        let key = before.rsplit(['\n', '{', ',']).next().unwrap_or_default();
        let key = key.split('=').next().unwrap_or_default().trim();
        return format!("{key} = \"{found}\": write {words}");
    }
    if !message.starts_with("unknown field `") {
        return message.to_owned();
    }
    match nearest(found, quoted.filter(|known| !known.trim().is_empty())) {
        Some(known) => format!("unknown key `{found}`; did you mean `{known}`?"),
        None => format!("unknown key `{found}`"),
    }
}

/// The known word that is nearest to `word`.
pub(super) fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    known.min_by_key(|candidate| strsim::damerau_levenshtein(word, candidate))
}

#[cfg(test)]
mod tests {
    use crate::Config;

    fn refusal(text: &str) -> String {
        match Config::from_toml(text, "") {
            Ok(config) => config
                .resolve()
                .map_or_else(|error| error.to_string(), |_| String::new()),
            Err(error) => error.to_string(),
        }
    }

    #[test]
    fn a_key_that_nothing_reads_is_named_with_its_place_and_the_nearest_known_one() {
        let text = refusal("[machine]\nname = \"m\"\nservo_periode_us = 1000\n");
        assert_eq!(
            text,
            "line 3, column 1: unknown key `servo_periode_us`; did you mean `servo_period_us`?"
        );
    }

    #[test]
    fn an_unknown_table_is_named_with_the_nearest_known_one() {
        assert!(refusal("[htttp]\nlisten = \"x\"\n").contains("`htttp`; did you mean `http`?"));
    }

    #[test]
    fn a_value_of_the_wrong_type_is_named_with_its_place() {
        let text = refusal("[machine]\nservo_period_us = \"fast\"\n");
        assert!(text.starts_with("line 2, column 19: invalid type"), "{text}");
    }
}
