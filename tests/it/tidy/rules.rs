//! Each rule that a comment, a page or a test names is a row that one can open.

use std::collections::BTreeSet;
use std::path::Path;

use tandem_tidy::{files, read};

/// The numbers of all rules.
fn numbers() -> BTreeSet<&'static str> {
    let tables = [
        tandem_interp::dialects::decisions::DECISIONS,
        tandem_motion::rules::RULES,
        plc_protocol::handshake::rules::RULES,
    ];
    let rows = tables.into_iter().flatten();
    rows.map(|(number, _)| *number).collect()
}

/// True for what looks like the number of a rule: `D31`, `M1d`, `M1d.2`, `H4`.
fn is_number(word: &str) -> bool {
    let is_digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let (head, tail) = word.split_once('.').unwrap_or((word, "0"));
    match head.split_at_checked(1) {
        Some(("D", digits)) => is_digits(digits) && digits.len() == 2 && !word.contains('.'),
        Some(("H", digits)) => is_digits(digits) && digits.len() < 3 && !word.contains('.'),
        Some(("M", group)) => {
            let [b'1', letter] = group.as_bytes() else {
                return false;
            };
            letter.is_ascii_lowercase() && is_digits(tail)
        }
        _ => false,
    }
}

/// The rules that a line of a source or of a page names.
fn cited(path: &Path, line: &str) -> Vec<String> {
    let is_rust = path.extension().is_some_and(|ending| ending == "rs");
    if is_rust && let Some((_, name)) = line.split_once("fn ") {
        let first = name.split('_').next().unwrap_or_default();
        let number = first.get(..1).map(|letter| letter.to_uppercase() + &first[1..]);
        return number.into_iter().filter(|number| is_number(number)).collect();
    }
    let is_comment = !is_rust || line.contains("//");
    line.split(|letter: char| !letter.is_alphanumeric() && !['_', '.'].contains(&letter))
        .map(|word| word.trim_end_matches('.'))
        .filter(|word| is_number(word) && (is_comment || !word.starts_with('H')))
        .map(str::to_owned)
        .collect()
}

#[test]
fn every_rule_that_is_named_is_a_row_of_a_page() {
    let numbers = numbers();
    let (mut seen, mut missing) = (BTreeSet::new(), Vec::new());
    for path in files(&[".rs", ".md"]) {
        if path.ends_with("tidy/rules.rs") {
            continue;
        }
        for (at, line) in read(&path).lines().enumerate() {
            for number in cited(&path, line) {
                if !numbers.contains(number.as_str()) {
                    missing.push(format!(
                        "{}:{}: there is no rule {number}",
                        path.display(),
                        at + 1
                    ));
                }
                seen.insert(number);
            }
        }
    }
    assert!(seen.len() > 60, "only {seen:?} are named");
    assert!(missing.is_empty(), "{missing:#?}");
}

#[test]
fn rules_are_found_in_comments_pages_and_names_of_tests() {
    let rust = |line| cited("a.rs".as_ref(), line);
    assert_eq!(rust("//! As in M1d, M1b.4 and D31."), ["M1d", "M1b.4", "D31"]);
    assert_eq!(rust("fn h4_the_first_claim_owns() {"), ["H4"]);
    assert_eq!(rust("    fn m1i_a_hold() {"), ["M1i"]);
    assert!(rust("    let text = \"G43 H12 M30 D5\";").is_empty());
    assert_eq!(cited("a.md".as_ref(), "see (H2)"), ["H2"]);
}

#[test]
fn rules_ascend_and_each_has_a_number_of_its_own() {
    let in_order = |rows: &[(&str, &str)]| {
        let key = |number: &str| {
            let (head, tail) = number.split_once('.').unwrap_or((number, "0"));
            (head.len(), head.to_owned(), tail.parse::<u32>().unwrap())
        };
        rows.windows(2).all(|pair| key(pair[0].0) < key(pair[1].0))
    };
    assert!(in_order(tandem_interp::dialects::decisions::DECISIONS));
    assert!(in_order(tandem_motion::rules::RULES));
    assert!(in_order(plc_protocol::handshake::rules::RULES));
}
