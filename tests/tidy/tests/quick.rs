//! The table of `tests/quick` names tests that exist: a name without a test would select none, and pass.

use std::path::Path;

use regex::Regex;
use tandem_tidy::{files, read, root};

#[test]
fn each_row_of_the_quick_check_names_a_folder_and_tests() {
    let row = Regex::new(r#"(?m)^    \("([^"]+)", \[[^\]]*\], \[([^\]]*)\]\),$"#).unwrap();
    let text = read(Path::new("tests/quick"));
    let modules: Vec<String> = files(&[".rs"])
        .iter()
        .filter_map(|path| path.strip_prefix("tests/it").ok())
        .map(|path| path.with_extension("").to_string_lossy().replace('/', "::"))
        .collect();
    let mut rows = 0;
    for found in row.captures_iter(&text) {
        rows += 1;
        assert!(root().join(&found[1]).exists(), "{}", &found[1]);
        for name in found[2].split(", ").filter(|name| !name.is_empty()) {
            let name = name.trim_matches('"').trim_end_matches("::");
            assert!(modules.iter().any(|module| module.starts_with(name)), "{name}");
        }
    }
    assert_eq!(
        rows,
        text.matches("/\", [").count() + text.matches(".md\", [").count()
    );
    assert!(rows > 10, "only {rows} rows");
}
