//! Planted faults: no product line is invisible to the rules.

use std::path::Path;

use tandem_tidy::CRATES;
use tandem_tidy::product::{literals, sources, without_tests};

fn product(text: &str) -> String {
    without_tests(Path::new("planted.rs"), text)
}

#[test]
fn a_product_item_after_a_test_import_is_seen() {
    let text = "use std::fmt;\n#[cfg(test)]\nuse crate::a::A;\nfn planted() {}\n";
    assert_eq!(product(text), "use std::fmt;\n\n\nfn planted() {}\n");
}

#[test]
fn test_items_are_removed_wherever_they_stand() {
    for (text, expected) in [
        (
            "#[cfg(test)]\nmod tests {\n    fn a() {}\n}\nfn b() {}\n",
            "\n\n\n\nfn b() {}\n",
        ),
        ("#[test]\nfn a() {}\n", "\n\n"),
        ("#[tokio::test]\nasync fn a() {}\n", "\n\n"),
        (
            "struct A {\n    b: u8,\n    #[cfg(test)]\n    c: u8,\n}\n",
            "struct A {\n    b: u8,\n\n\n}\n",
        ),
        (
            "impl A {\n    /// Test hook.\n    #[cfg(test)]\n    fn b() {}\n    fn c() {}\n}\n",
            "impl A {\n\n\n\n    fn c() {}\n}\n",
        ),
        (
            "fn a() {\n    #[cfg(test)]\n    b();\n    c();\n}\n",
            "fn a() {\n\n\n    c();\n}\n",
        ),
        ("#[cfg(all(test, unix))]\nfn a() {}\n", "\n\n"),
        ("#![cfg(test)]\nfn a() {}\n", "\n\n"),
    ] {
        assert_eq!(product(text), expected, "{text}");
    }
}

#[test]
fn items_that_may_be_compiled_without_tests_stay() {
    for text in [
        "#[cfg(not(test))]\nfn a() {}\n",
        "#[cfg(any(test, feature = \"b\"))]\nfn a() {}\n",
        "#[cfg(unix)]\nfn a() {}\n",
    ] {
        assert_eq!(product(text), text);
    }
}

#[test]
fn every_file_of_a_crate_is_read_or_belongs_to_tests() {
    for folder in CRATES {
        let sources = sources(folder);
        let read: Vec<&Path> = sources.values().map(|source| source.path.as_path()).collect();
        for path in tandem_tidy::files(&[".rs"]) {
            if path.starts_with(folder) && !read.contains(&path.as_path()) {
                assert!(is_declared_for_tests(&path), "{}: in no module", path.display());
            }
        }
    }
}

/// Returns true if the module of this file is declared with `#[cfg(test)]` in the file above it.
fn is_declared_for_tests(path: &Path) -> bool {
    path.ancestors().any(|ancestor| {
        let (Some(name), Some(folder)) = (ancestor.file_stem(), ancestor.parent()) else {
            return false;
        };
        let name = name.to_string_lossy();
        let declarations =
            ["", "pub ", "pub(crate) "].map(|scope| format!("#[cfg(test)]\n{scope}mod {name};"));
        let parents = [
            folder.with_extension("rs"),
            folder.join("mod.rs"),
            folder.join("lib.rs"),
        ];
        parents.iter().any(|parent| {
            let text = std::fs::read_to_string(tandem_tidy::root().join(parent)).unwrap_or_default();
            declarations.iter().any(|declaration| text.contains(declaration))
        })
    })
}

#[test]
fn literals_are_found_in_calls_and_macros_with_their_lines() {
    let text = "fn a() {\n    b(\"one\");\n    println!(\"two {x}\");\n}\n#[doc = \"no\"]\nconst C: &str = r#\"three\"#;\n";
    let found = literals(Path::new("planted.rs"), text);
    let expected = [(2, "one"), (3, "two {x}"), (6, "three")];
    assert_eq!(found, expected.map(|(line, text)| (line, text.to_owned())));
}
