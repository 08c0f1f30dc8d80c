//! A dialect is described in its own row: no other code names one.

use tandem_tidy::product::{literals, without_tests};
use tandem_tidy::{CRATES, files, read};

/// Names of the dialects.
const NAMES: [&str; 2] = ["nj", "dgshape"];

/// Files of the settings of a dialect: the keys of its table, and their reference.
const SETTINGS: [&str; 4] = [
    "runtime/config/src/dgshape.rs",
    "runtime/config/src/resolve/dgshape.rs",
    "runtime/config/src/lib.rs",
    "runtime/config/src/reference.rs",
];

/// True for a line of code that calls a dialect by its name, such as `dialects::nj()`.
fn calls_a_dialect(line: &str) -> bool {
    let code = line.split("//").next().unwrap_or_default();
    let words = |path: &str| {
        path.split(|letter: char| !letter.is_alphanumeric())
            .next()
            .map(str::to_owned)
    };
    let called = code
        .match_indices("dialects::")
        .filter_map(|(at, path)| words(&code[at + path.len()..]));
    called.into_iter().any(|word| NAMES.contains(&word.as_str()))
}

/// Returns the lines of a source that name a dialect.
fn lines_with_names(path: &std::path::Path, code: &str) -> Vec<usize> {
    let calls = code.lines().enumerate().filter(|(_, line)| calls_a_dialect(line));
    let mut found: Vec<usize> = calls.map(|(number, _)| number + 1).collect();
    let named = literals(path, code).into_iter();
    let is_name = |literal: &str| NAMES.contains(&literal.split(['.', ':']).next_back().unwrap_or_default());
    found.extend(
        named
            .filter(|(_, literal)| is_name(literal))
            .map(|(line, _)| line),
    );
    found
}

#[test]
fn no_code_outside_of_its_own_folder_names_a_dialect() {
    let mut found = Vec::new();
    for path in files(&[".rs"]) {
        let name = path.to_string_lossy();
        let is_exempt = name.contains("/dialects/")
            || name.contains("/tests")
            || name.contains("/benches/")
            || SETTINGS.contains(&name.as_ref());
        if is_exempt || !CRATES.iter().any(|folder| name.starts_with(folder)) {
            continue;
        }
        let text = read(&path);
        let code = without_tests(&path, &text);
        found.extend(
            lines_with_names(&path, &code)
                .into_iter()
                .map(|line| format!("{name}:{line}")),
        );
    }
    assert!(found.is_empty(), "{found:#?}");
}

#[test]
fn planted_names_of_dialects_are_found() {
    let planted =
        |code: &str| lines_with_names("planted.rs".as_ref(), &format!("fn planted() {{ {code}\n}}"));
    assert_eq!(planted(r#"dialect.name == "dgshape""#), [1]);
    assert_eq!(planted("\nlet dialect = dialects::nj();"), [2]);
    assert!(planted(r#"// the dialect "nj""#).is_empty());
    assert!(planted(r#"text("a comment of dialect dgshape ends on its line")"#).is_empty());
}
