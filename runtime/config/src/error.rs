//! Errors of a configuration, described for the author of the configuration.

use std::path::{Path, PathBuf};

/// Reason why a configuration is rejected.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read the configuration {path}: {error}", path = path.display())]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        error: std::io::Error,
    },
    /// The text contains exactly one error.
    #[error("{place}: {message}")]
    Text {
        /// File, line and column, as far as known.
        place: String,
        /// Description of the error and the correct form.
        message: String,
    },
    /// Values that do not fit together, or several errors of any kind; each with its line and column if these
    /// are known.
    #[error("the configuration does not fit together:\n  {}", .0.join("\n  "))]
    Values(Vec<String>),
}

impl ConfigError {
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

// serde lists the unknown key and all known keys; users need only the nearest known key. For a wrong word,
// users need to know its key.
pub(super) fn explain(before: &str, message: &str) -> String {
    let found = quoted(message).next().unwrap_or_default();
    if message.starts_with("unknown variant `") {
        let words: Vec<String> = known(message).map(|word| format!("\"{word}\"")).collect();
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
    match nearest(found, known(message)) {
        Some(known) => format!("unknown key `{found}`; did you mean `{known}`?"),
        None => format!("unknown key `{found}`"),
    }
}

/// Returns the quoted parts of an error message of serde; the first is the value that serde found.
pub(super) fn quoted(message: &str) -> impl Iterator<Item = &str> {
    message.split('`').skip(1).step_by(2)
}

/// Returns the keys or words that serde expected, from its error message.
pub(super) fn known(message: &str) -> impl Iterator<Item = &str> {
    let expected = message.rsplit_once("expected");
    quoted(expected.map_or("", |(_, known)| known))
}

/// Returns the known word that is most similar to `word`.
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
    fn unknown_key_is_reported_with_position_and_nearest_known_key() {
        let text = "[machine]\nname = \"m\"\nservo_periode_us = 1000\n[[motor]]\nnumber = 1\nkind = \"linear\"\n\
                    max_velocity = 5\nmax_acceleration = 5\n[[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n";
        let text = refusal(text);
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
    fn wrong_words_keys_and_conflicts_are_reported_together_in_text_order() {
        let text = "[machine]\nnames = 5\n[[motor]]\nnumber = 1\nkind = \"line\"\nmax_velocity = 0\nmax_acceleration = 5\n\
                    [[coordinate_system]]\nnumber = 1\naxes = { X = 1, Y = 7 }\nunits = \"cm\"\nspindle = 9\n";
        let refusal = refusal(text);
        let lines: Vec<&str> = refusal.lines().map(str::trim).collect();
        let expected = [
            "the configuration does not fit together:",
            "line 2, column 1: unknown key `names`; did you mean `name`?",
            "line 5, column 8: kind = \"line\": write \"linear\", \"rotary\" or \"spindle\"",
            "line 6, column 1: [[motor]] number = 1: max_velocity = 0: write 0.000000001 to 1000000000000",
            "line 10, column 17: [[coordinate_system]] number = 1: axes: Y = 7: there is no [[motor]] 7",
            "line 11, column 9: units = \"cm\": write \"mm\" or \"inch\"",
            "line 12, column 1: [[coordinate_system]] number = 1: spindle = 9: there is no [[motor]] 9 of kind spindle",
        ];
        assert_eq!(lines, expected);
    }

    #[test]
    fn errors_caused_by_missing_or_unreadable_values_are_not_reported() {
        let text = "[[motor]]\nnumber = \"one\"\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                    [[motor]]\nnumber = 2\nkind = \"linear\"\n[[coordinate_system]]\nnumber = 1\naxes = { X = 1, Y = 2 }\n\
                    hold_slew_ms = [\"a\"]\n";
        let refusal = refusal(text);
        let lines: Vec<&str> = refusal.lines().map(str::trim).collect();
        let begins = [
            "the configuration does not fit together:",
            "line 2, column 10: invalid type: string \"one\"",
            "line 6, column 1: missing field `max_velocity`",
            "line 12, column 16: invalid type",
        ];
        let all_told = lines
            .iter()
            .zip(begins)
            .all(|(line, begin)| line.starts_with(begin));
        assert!(all_told && lines.len() == begins.len(), "{refusal}");
    }

    #[test]
    fn a_word_with_quotes_of_its_own_is_one_problem() {
        let text = "[mqtt]\non_bus_loss = \"a`b`c\"\n";
        assert_eq!(
            refusal(text)
                .matches("write \"continue\" or \"hold_at_wait\"")
                .count(),
            1
        );
        assert_eq!(refusal(text).matches("on_bus_loss").count(), 1);
    }

    #[test]
    fn problems_of_a_text_are_looked_for_up_to_a_limit() {
        let keys: Vec<String> = (0..150).map(|number| format!("key_{number} = 1\n")).collect();
        assert_eq!(refusal(&keys.concat()).matches("unknown key").count(), 100);
    }

    #[test]
    fn a_value_of_the_wrong_type_is_named_with_its_place() {
        let text = refusal("[machine]\nservo_period_us = \"fast\"\n");
        assert!(text.starts_with("line 2, column 19: invalid type"), "{text}");
    }
}
