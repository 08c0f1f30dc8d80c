//! The machinery decides by what codes mean, not by their names: these are written in `codes` and `dialects` alone.

use tandem_tidy::product::{literals, without_tests};
use tandem_tidy::{CRATES, files, read};

/// Folders in which codes are named.
const NAMED: [&str; 2] = ["/codes/", "/dialects/"];

/// Programs and handlers of simulated worlds, which are tests.
const WORLDS: &str = "runtime/testing/tests/worlds/";

/// True for a text that begins with a G or M code: `G01`, `G54 to G59`. `M1a` is a rule of motion.
fn begins_with_a_code(literal: &str) -> bool {
    let number = literal.strip_prefix(['G', 'M']).unwrap_or_default();
    let behind = number.trim_start_matches(|digit: char| digit.is_ascii_digit());
    behind.len() < number.len() && !behind.starts_with(|letter: char| letter.is_ascii_lowercase())
}

/// True for a line that names a file of one code.
fn names_a_file(line: &str) -> bool {
    line.match_indices("codes::").any(|(at, path)| {
        let mut file = line[at + path.len()..].chars();
        matches!(file.next(), Some('g' | 'm')) && file.next().is_some_and(|digit| digit.is_ascii_digit())
    })
}

#[test]
fn no_machinery_names_a_code() {
    let mut found = Vec::new();
    for path in files(&[".rs"]) {
        let name = path.to_string_lossy();
        let is_named = NAMED.iter().any(|folder| name.contains(folder));
        let is_test = name.contains("/tests") || name.starts_with(WORLDS);
        if is_named || is_test || !CRATES.iter().any(|folder| name.starts_with(folder)) {
            continue;
        }
        let text = read(&path);
        let code = without_tests(&path, &text);
        let lines = code.lines().enumerate();
        let mut named: Vec<_> = lines
            .filter(|(_, line)| !line.trim_start().starts_with("//") && names_a_file(line))
            .map(|(number, line)| (number + 1, line.trim().to_owned()))
            .collect();
        let literals = literals(&path, &code).into_iter();
        named.extend(literals.filter(|(_, literal)| begins_with_a_code(literal)));
        found.extend(
            named
                .iter()
                .map(|(number, text)| format!("{name}:{number}: {text}")),
        );
    }
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn names_of_codes_are_found() {
    let named = |source: &str| {
        let source = format!("fn planted() {{ {source}\n}}");
        let literals = literals("planted.rs".as_ref(), &source).into_iter();
        literals
            .filter(|(_, literal)| begins_with_a_code(literal))
            .map(|(line, _)| line)
            .collect::<Vec<_>>()
    };
    assert_eq!(named(r#"matches!(code, "M02" | "G50.1")"#), [1, 1]);
    assert_eq!(
        named("\n\nlet text = \"G43, G44 and \\\n G49 move nothing\";\nf(\"M30\")"),
        [3, 5]
    );
    assert_eq!(named(r#"if letter == '"' { f("G1") }"#), [1]);
    assert_eq!(named(r#"if letter == '\'' { f("G1") }"#), [1]);
    for none in [
        r#"'G'; "Go"; "the cycle of G84"; "M1a""#,
        r#"// "G01""#,
        r#"text("<path d=\"M14 {line}\"/>")"#,
        "fn f<'a>(code: &'a str) {}",
    ] {
        assert_eq!(named(none), [0; 0], "{none}");
    }
    assert!(names_a_file("use crate::codes::g20_g21_unit::G20;"));
    assert!(!names_a_file("use crate::codes::feed_words;"));
}
