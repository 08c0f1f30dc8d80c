//! English that any engineer reads without translating: CONTRIBUTING, "How we write".

use std::path::Path;

use tandem_tidy::prose::{findings, idioms, prose};
use tandem_tidy::{files, read};

/// Files whose words are not written here, or that list the words.
const NOT_READ: [(&str, &str); 5] = [
    ("tests/tidy", "lists the words"),
    ("CHANGELOG.md", "names former texts"),
    ("web/types.d.ts", "generated from the interface"),
    ("runtime/opcua/nodesets", "companion specifications"),
    ("runtime/mtconnect/schemas", "schemas of the standard"),
];

/// Lines that name listed phrases because they say what to write instead: file, words in the line.
const EXCEPTIONS: [(&str, &str); 11] = [
    ("CONTRIBUTING.md", "Avoid *who*, *nobody*"),
    ("CONTRIBUTING.md", "| tell, say, put out (a message); hear |"),
    ("CONTRIBUTING.md", "| turn away, judge |"),
    ("CONTRIBUTING.md", "inspect (damage) | judge |"),
    ("CONTRIBUTING.md", "| carry out, put out |"),
    ("CONTRIBUTING.md", "| take up |"),
    ("CONTRIBUTING.md", "| counts no more; days for which it counts |"),
    ("CONTRIBUTING.md", "| nobody knows; old; open |"),
    ("CONTRIBUTING.md", "| give way |"),
    ("CONTRIBUTING.md", "| behind (time), beside |"),
    ("CONTRIBUTING.md", "| anew, go on |"),
];

fn is_exception(path: &Path, line: &str) -> bool {
    EXCEPTIONS
        .iter()
        .any(|(file, words)| path.ends_with(file) && line.contains(words))
}

#[test]
fn no_text_has_a_phrase_of_the_list() {
    let (mut seen, mut wrong) = (0, Vec::new());
    for path in files(&[".rs", ".js", ".mjs", ".ts", ".py", ".toml", ".sh", ".md"]) {
        if NOT_READ.iter().any(|(folder, _)| path.starts_with(folder)) {
            continue;
        }
        let text = read(&path);
        seen += prose(&path, &text).len();
        let lines: Vec<&str> = text.lines().collect();
        for finding in findings(&path, &text) {
            if !is_exception(&path, lines[finding.line - 1]) {
                let (line, words, instead) = (finding.line, finding.words, finding.instead);
                wrong.push(format!("{}:{line}: \"{words}\"; {instead}", path.display()));
            }
        }
    }
    assert!(seen > 20_000, "only {seen} lines of prose found");
    assert!(wrong.is_empty(), "{} phrases:\n{}", wrong.len(), wrong.join("\n"));
}

#[test]
fn each_exception_is_in_its_file() {
    for (file, words) in EXCEPTIONS {
        assert!(read(file.as_ref()).contains(words), "{file}: {words}");
    }
}

#[test]
fn phrases_are_found_in_each_kind_of_prose() {
    for (path, text) in [
        ("a.rs", "/// It is told so.\nfn f() {}\n"),
        ("a.rs", "fn f() { g(\"the client is told of it\"); }\n"),
        (
            "a.rs",
            "#[cfg(test)]\nuse a::b;\nfn f() { g(\"the client is told of it\"); }\n",
        ),
        ("a.js", "let x = 1; // it is told so\n"),
        ("web/language/en.js", "  a: \"it is told so\",\n"),
        ("a.py", "x = 1  # it is told so\n"),
        ("a.md", "It is told so.\n"),
    ] {
        assert_eq!(findings(path.as_ref(), text).len(), 1, "{path}: {text}");
    }
    for (path, text) in [
        ("a.rs", "fn is_told() { told(\"told\") }\n"),
        ("tests/a.rs", "fn f() { g(\"the client is told of it\"); }\n"),
        ("a.md", "```\nit is told so\n```\n"),
    ] {
        assert_eq!(findings(path.as_ref(), text), [], "{path}: {text}");
    }
    assert_eq!(idioms("Returns it. Of the two, this.").len(), 1);
    assert_eq!(idioms("one of the two").len(), 0);
}
