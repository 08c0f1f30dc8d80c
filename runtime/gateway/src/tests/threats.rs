//! The security page names a test for each attack; each of these tests exists.

use std::path::Path;

fn sources(folder: &Path, text: &mut String) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, text);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            text.push_str(&std::fs::read_to_string(&path).unwrap());
        }
    }
}

#[test]
fn every_line_of_the_threats_has_its_test() {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(own.join("../../docs/src/explanation/security.md")).unwrap();
    let mut text = String::new();
    for folder in [
        "src",
        "../src",
        "../config/src",
        "../store/src",
        "../testing",
        "../../plc-api/src",
        "../../plc-api/protocol/src",
        "../../plc-api/tests",
        "../../plc-api/protocol/tests",
        "../../tests/it",
        "../tests",
    ] {
        sources(&own.join(folder), &mut text);
    }
    let tried = page.split("## Attempts and reactions").nth(1).unwrap();
    let table = tried.split("\n## ").next().unwrap();
    let items: Vec<_> = table.lines().filter(|line| line.starts_with("- ")).collect();
    assert!(items.len() > 20, "{} items", items.len());
    for item in items {
        let (_, tests) = item.rsplit_once(" (").unwrap();
        let names: Vec<_> = tests.split('`').skip(1).step_by(2).collect();
        assert!(!names.is_empty(), "{item} names no test");
        for name in names {
            assert!(text.contains(&format!("fn {name}(")), "{name} is no test");
        }
    }
}
