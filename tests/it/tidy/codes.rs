//! The machinery decides by what codes mean, not by their names: these stand in `codes` and `dialects` alone.

use super::{CRATES, files, read, without_unit_tests};

/// Where codes are named.
const NAMED: [&str; 2] = ["runtime/interp/src/codes/", "runtime/interp/src/dialects/"];

/// True for `G01`, `G50.1`: a text that is one G code and nothing else. A sentence that quotes codes is no name.
fn is_code(literal: &str) -> bool {
    let number = literal.strip_prefix('G').unwrap_or_default();
    number.starts_with(|digit: char| digit.is_ascii_digit())
        && number.chars().all(|part| part.is_ascii_digit() || part == '.')
}

/// True for a line that names one G code in a literal, or a file of one.
fn names_a_code(line: &str) -> bool {
    let of_file = line.match_indices("codes::").any(|(at, path)| {
        let mut file = line[at + path.len()..].chars();
        matches!(file.next(), Some('g' | 'm')) && file.next().is_some_and(|digit| digit.is_ascii_digit())
    });
    of_file || line.split('"').skip(1).step_by(2).any(is_code)
}

#[test]
fn no_machinery_names_a_g_code() {
    let mut found = Vec::new();
    for path in files(&[".rs"]) {
        let name = path.to_string_lossy();
        let is_test = name.contains("/tests") || NAMED.iter().any(|folder| name.starts_with(folder));
        if is_test || !CRATES.iter().any(|folder| name.starts_with(folder)) {
            continue;
        }
        let text = read(&path);
        let lines = without_unit_tests(&text).lines().enumerate();
        let code = lines.filter(|(_, line)| !line.trim_start().starts_with("//"));
        let named = code.filter(|(_, line)| names_a_code(line));
        found.extend(named.map(|(number, line)| format!("{name}:{}: {}", number + 1, line.trim())));
    }
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn names_of_codes_are_found() {
    for line in [
        r#"matches!(code, "M02" | "G50.1")"#,
        r#"if code == "G41" {"#,
        "use crate::codes::g20_g21_unit::G20;",
    ] {
        assert!(names_a_code(line), "{line}");
    }
    for line in [
        r#"text("G43, G44 and G49 move nothing")"#,
        r#"'G'; "Go""#,
        "codes::feed_words",
    ] {
        assert!(!names_a_code(line), "{line}");
    }
}
