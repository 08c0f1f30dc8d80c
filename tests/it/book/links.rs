//! Links within the checkout: files and headings.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use super::page::{pages, read};
use crate::support::binary::root;

/// Addresses of the repository's files for readers outside of the checkout.
const REPOSITORY: [&str; 2] = [
    "https://github.com/tandem-nc/tandem/blob/main/",
    "https://github.com/tandem-nc/tandem/tree/main/",
];

/// Pages outside of the book.
const OTHERS: [&str; 6] = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "ROADMAP.md",
    "runtime/ARCHITECTURE.md",
];

/// Returns the lines outside of fenced blocks, with their numbers, without text in backticks.
fn prose(page: &str) -> Vec<(usize, String)> {
    let mut is_code = false;
    let mut lines = Vec::new();
    for (number, line) in page.lines().enumerate() {
        if line.trim_start().starts_with("```") {
            is_code = !is_code;
        } else if !is_code {
            lines.push((
                number + 1,
                line.split('`').step_by(2).collect::<Vec<_>>().join("`"),
            ));
        }
    }
    lines
}

/// Targets of the links of a page, with their lines.
pub fn targets(page: &str) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for (number, line) in prose(page) {
        for part in line.split("](").skip(1) {
            let target = part.split(')').next().unwrap_or_default();
            found.push((number, target.to_owned()));
        }
    }
    found
}

/// Returns the anchor of a heading: the slug of mdBook and of the hosting sites.
fn slug(heading: &str) -> String {
    heading
        .trim()
        .to_lowercase()
        .chars()
        .filter_map(|letter| match letter {
            ' ' => Some('-'),
            '-' | '_' => Some(letter),
            letter => letter.is_alphanumeric().then_some(letter),
        })
        .collect()
}

/// Returns the anchors of all headings of a page; a repeated heading has a number.
fn anchors(page: &str) -> Vec<String> {
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    let mut is_code = false;
    let mut names = Vec::new();
    for line in page.lines() {
        is_code ^= line.trim_start().starts_with("```");
        let heading = line.trim_start_matches('#');
        if is_code || heading.len() == line.len() || !heading.starts_with(' ') {
            continue;
        }
        let name = slug(heading);
        let times = seen.entry(name.clone()).or_default();
        names.push(if *times == 0 {
            name
        } else {
            format!("{name}-{times}")
        });
        *times += 1;
    }
    names
}

/// A path without `.` and `..`.
fn normal(path: &Path) -> PathBuf {
    let mut normal = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => assert!(normal.pop(), "{} leaves the checkout", path.display()),
            Component::CurDir => {}
            other => normal.push(other),
        }
    }
    normal
}

/// Returns the mistake of a link of a page, if any.
fn wrong(page: &str, text: &str, target: &str) -> Option<String> {
    let (target, anchor) = target.split_once('#').unwrap_or((target, ""));
    let ours = REPOSITORY.iter().find_map(|prefix| target.strip_prefix(prefix));
    let path = match ours {
        Some(path) => PathBuf::from(path),
        None if target.contains("://") || target.starts_with("mailto:") => return None,
        None if target.is_empty() => PathBuf::from(page),
        None => normal(&Path::new(page).parent()?.join(target)),
    };
    if !root().join(&path).exists() {
        return Some(format!("{} is not there", path.display()));
    }
    let is_book = page.starts_with("docs/src");
    if is_book && ours.is_none() && !path.starts_with("docs/src") {
        return Some(format!(
            "{} is no page of the book: name its address",
            path.display()
        ));
    }
    if anchor.is_empty() {
        return None;
    }
    let there = if target.is_empty() {
        anchors(text)
    } else {
        anchors(&read(path.to_str()?))
    };
    (!there.contains(&anchor.to_owned())).then(|| format!("{} has no heading {anchor}", path.display()))
}

#[test]
fn every_link_within_the_checkout_leads_to_a_file_and_to_a_heading_of_it() {
    let mut seen = 0;
    let mut broken = Vec::new();
    let others = OTHERS.iter().map(|page| (*page).to_owned());
    for page in pages().into_iter().chain(others) {
        let text = read(&page);
        for (line, target) in targets(&text) {
            seen += 1;
            broken.extend(wrong(&page, &text, &target).map(|what| format!("{page}:{line}: {what}")));
        }
    }
    assert!(seen > 100, "only {seen} links found");
    assert!(broken.is_empty(), "{broken:#?}");
}

#[test]
fn links_and_headings_are_found_and_judged() {
    let page =
        "# A page\n[a](#two-words) `[b](c.md)`\n```text\n# no\n[d](e)\n```\n## Two words\n## Two words\n";
    assert_eq!(targets(page), [(2, "#two-words".to_owned())]);
    assert_eq!(anchors(page), ["a-page", "two-words", "two-words-1"]);
    assert_eq!(
        slug("What `max_jerk` bounds: G00, G501"),
        "what-max_jerk-bounds-g00-g501"
    );
    assert_eq!(wrong("docs/src/demo.md", page, "#two-words"), None);
    assert!(wrong("docs/src/demo.md", page, "#three-words").is_some());
    assert!(wrong("docs/src/demo.md", page, "missing.md").is_some());
    assert!(wrong("docs/src/demo.md", page, "../../README.md").is_some());
    assert!(wrong("docs/src/demo.md", page, &format!("{}README.md", REPOSITORY[0])).is_none());
}
