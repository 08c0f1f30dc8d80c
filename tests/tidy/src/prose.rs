//! The English of comments, help texts, messages, Markdown and HMI texts, and the words that it avoids.

use std::path::Path;
use std::sync::LazyLock;

use regex::Regex;

use crate::product::{literals, without_tests};

/// Words and phrases that a reader has to translate, and what to write instead.
///
/// Each pattern matches within one line, regardless of case; those that begin with `^` match at the beginning of a
/// sentence, with their capital letter.
pub const IDIOMS: [(&str, &str); 31] = [
    (
        r"\b(is|are|was|were|be|been|being) told\b",
        "receives, is notified",
    ),
    (
        r"\btells? (of|what|whether|how|which|that|its|the machine)\b",
        "reports, publishes",
    ),
    (
        r"\b(says? (what|whether|how|which|so)|(is|are|was) said)\b",
        "states, reports",
    ),
    (
        r"\b(nobody|somebody|of whom)\b",
        "name the client, handler, operator or caller",
    ),
    (
        r"\bwho(ever)? (asks?|comes?|has|is|was|waits?|reads?|writes?|goes|wants?|needs?|serves?|sends?|takes?|hears?|looks?)\b",
        "name the client, handler, operator or caller",
    ),
    (r"\b(go(es|ne)?|went) on\b", "continues, resumes"),
    (r"\bas (it was|they were)\b", "unchanged"),
    (
        r"\bwhat (is|was|has|had|comes|came|goes|stands|lies|holds|counts|follows)\b",
        "use a noun",
    ),
    (r"^(What|Whose)\b", "begin with the subject"),
    (
        r"^Of (which|what|the|a|two|those|these|each)\b",
        "begin with the subject",
    ),
    (
        r"^(True|None|False|`None`|`true`|`false`):",
        "Returns `None` if ...",
    ),
    (
        r"\bstands? (in|there|beside|at|for itself|aside|open)\b",
        "is in, occurs in",
    ),
    (r"\bbeside\b", "next to, in addition to"),
    (r"\banew\b", "again"),
    (
        r"\bbehind (it|them|the (last|end|program|block|line|motion))\b",
        "after",
    ),
    (r"\bgives? way\b", "is evicted"),
    (r"\bputs? out\b", "issues, publishes"),
    (r"\bcarr(y|ies|ied) out\b", "executes, applies"),
    (r"\b(take(s|n)? up|took up)\b", "claims, starts"),
    (r"\bcounts? (for|as|no more|until)\b", "applies, is valid"),
    (r"\bno more\b", "no longer, at most"),
    (r"\b(is|are|was) there\b", "exists, is online"),
    (
        r"\bso (many|much|far|long) (as|that)\b",
        "give the number or the condition",
    ),
    (r"\bin (its|their) place\b", "instead"),
    (r"\bthe same (for|of|as|by|with)\b", "equal to, like"),
    (r"\bfor ever\b", "forever, without a limit"),
    (
        r"\b(complain|without a word|at its head|by itself|let in)\b",
        "name actor and effect",
    ),
    (r"\b(heard|hears?)\b", "receives"),
    (r"\bturn(s|ed)? away\b", "rejects"),
    (r"\bjudge[sd]?\b", "authorizes, validates, inspects"),
    (
        r"\b(comes? to (nothing|be)|has gone|is gone|are gone)\b",
        "name the state",
    ),
];

/// An idiom in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// Line, from 1.
    pub line: usize,
    /// Words that were found.
    pub words: String,
    /// Suggestion.
    pub instead: &'static str,
}

/// Compiled [`IDIOMS`].
struct Patterns {
    /// Each pattern.
    each: Vec<Regex>,
    /// All patterns as one, which decides quickly that a line has none.
    any: Regex,
}

static PATTERNS: LazyLock<Patterns> = LazyLock::new(|| {
    let pattern = |(pattern, _): (&str, &str)| {
        let pattern = pattern.replace(r"\b", r"(?-u:\b)");
        match pattern.strip_prefix('^') {
            Some(rest) => format!("(?:^|[.;:] ){rest}"),
            None => format!("(?i:{pattern})"),
        }
    };
    let texts = IDIOMS.map(pattern);
    let compile = |text: &str| Regex::new(text).unwrap_or_else(|error| panic!("{error}"));
    Patterns {
        each: texts.iter().map(|text| compile(text)).collect(),
        any: compile(&texts.join("|")),
    }
});

/// Returns the idioms of one line, with what to write instead.
pub fn idioms(text: &str) -> Vec<(String, &'static str)> {
    if !PATTERNS.any.is_match(text) {
        return Vec::new();
    }
    let rows = PATTERNS.each.iter().zip(IDIOMS);
    let found = rows.flat_map(|(pattern, (_, instead))| {
        let words = pattern.find_iter(text).map(|found| found.as_str().to_owned());
        words.map(move |words| (words, instead))
    });
    found.collect()
}

/// Returns the text after the comment mark of a line.
fn comment<'t>(line: &'t str, mark: &str) -> Option<&'t str> {
    let found = line.match_indices(mark).find(|(at, _)| {
        let before = line[..*at].chars().next_back();
        before.is_none_or(char::is_whitespace)
    });
    found.map(|(at, _)| line[at + mark.len()..].trim_start_matches(['/', '!', '#', ' ']))
}

/// Returns the prose of a file with its line numbers: comments, messages of product code, or Markdown without code.
pub fn prose(path: &Path, text: &str) -> Vec<(usize, String)> {
    let extension = path
        .extension()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let lines = || (1..).zip(text.lines());
    let comments = |mark: &'static str| {
        let found = lines().filter_map(move |(number, line)| Some((number, comment(line, mark)?.to_owned())));
        found.collect::<Vec<_>>()
    };
    match extension.as_str() {
        "rs" => {
            let mut found = comments("//");
            let is_test = ["tests", "benches", "fuzz", "examples", "tests.rs"];
            if !path.iter().any(|part| is_test.iter().any(|name| part == *name)) {
                let messages = literals(path, &without_tests(path, text)).into_iter();
                found.extend(messages.filter(|(_, text)| text.split_whitespace().count() > 3));
            }
            found
        }
        "js" if path.ends_with("web/language/en.js") => {
            lines().map(|(number, line)| (number, line.to_owned())).collect()
        }
        "js" | "mjs" | "ts" => {
            let mut found = comments("//");
            let block = lines().filter_map(|(number, line)| {
                let line = line.trim_start();
                let inner = line.strip_prefix("/*").or_else(|| line.strip_prefix('*'))?;
                Some((number, inner.to_owned()))
            });
            found.extend(block);
            found
        }
        "md" => {
            let mut is_code = false;
            let found = lines().filter(|(_, line)| {
                let is_fence = line.trim_start().starts_with("```");
                is_code ^= is_fence;
                !is_code && !is_fence
            });
            found.map(|(number, line)| (number, line.to_owned())).collect()
        }
        _ => comments("#"),
    }
}

/// Returns the idioms of a file.
pub fn findings(path: &Path, text: &str) -> Vec<Finding> {
    let found = prose(path, text).into_iter().flat_map(|(line, text)| {
        let idioms = idioms(&text).into_iter();
        idioms
            .map(move |(words, instead)| Finding { line, words, instead })
            .collect::<Vec<_>>()
    });
    found.collect()
}
