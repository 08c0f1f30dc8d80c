//! The roadmap lists only what does not exist yet.

use std::path::Path;

use tandem_tidy::read;

/// Sign that an item is not done: a text that a page has or lacks.
struct OpenSign<'a> {
    page: &'a str,
    text: &'a str,
    has: bool,
}

impl OpenSign<'_> {
    /// Reads `<!-- PAGE has "TEXT" -->` or `<!-- PAGE lacks "TEXT" -->`.
    fn parse(line: &str) -> Option<OpenSign<'_>> {
        let inner = line.trim().strip_prefix("<!-- ")?.strip_suffix("\" -->")?;
        let (page, text, has) = match inner.split_once(" has \"") {
            Some((page, text)) => (page, text, true),
            None => inner
                .split_once(" lacks \"")
                .map(|(page, text)| (page, text, false))?,
        };
        Some(OpenSign { page, text, has })
    }

    fn holds(&self) -> bool {
        read(Path::new(self.page)).contains(self.text) == self.has
    }
}

/// Returns the items of "Next": their first lines, each with its signs.
fn next_items(roadmap: &str) -> Vec<(&str, Vec<OpenSign<'_>>)> {
    let section = roadmap
        .split("\n## ")
        .find(|section| section.starts_with("Next\n"));
    let mut items: Vec<(&str, Vec<OpenSign<'_>>)> = Vec::new();
    for line in section.unwrap_or_default().lines() {
        if line.starts_with("- ") {
            items.push((line, Vec::new()));
        } else if let (Some((_, signs)), Some(sign)) = (items.last_mut(), OpenSign::parse(line)) {
            signs.push(sign);
        }
    }
    items
}

#[test]
fn each_next_item_of_the_roadmap_has_a_sign_that_it_is_open() {
    let roadmap = read(Path::new("ROADMAP.md"));
    let items = next_items(&roadmap);
    assert!(items.len() > 2);
    for (item, signs) in items {
        assert!(
            !signs.is_empty(),
            "{item}: add a sign such as `<!-- PAGE lacks \"TEXT\" -->`"
        );
        for sign in signs {
            assert!(
                sign.holds(),
                "{item}: {} shows that it is done: {}",
                sign.page,
                sign.text
            );
        }
    }
}

#[test]
fn a_done_item_without_a_valid_sign_is_found() {
    let done =
        "# R\n\n## Next\n\n- **a**\n  <!-- ROADMAP.md lacks \"Not planned\" -->\n- **b**\n\n## Later\n";
    let signs: Vec<_> = next_items(done).into_iter().map(|(_, signs)| signs).collect();
    assert!(!signs[0][0].holds() && signs[1].is_empty());
}
