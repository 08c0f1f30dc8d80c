//! Pages as text: their code blocks.

use std::path::Path;

use crate::support::binary::root;

/// A fenced block.
pub struct Block {
    /// Text after the fence: a language, and words for these tests, separated by commas.
    pub info: String,
    pub text: String,
    /// Line of the page on which it begins.
    pub line: usize,
}

impl Block {
    pub fn is(&self, language: &str, word: &str) -> bool {
        let mut words = self.info.split(',');
        words.next() == Some(language) && words.any(|it| it == word)
    }

    /// The file that the reader writes it to.
    pub fn file(&self) -> Option<&str> {
        self.info.split(',').find_map(|word| word.strip_prefix("file="))
    }
}

/// The fenced blocks of a page.
pub fn blocks(page: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<Block> = None;
    let mut indent = 0;
    for (number, line) in page.lines().enumerate() {
        let fence = line.trim_start().strip_prefix("```");
        match (&mut open, fence) {
            (None, Some(info)) => {
                indent = line.len() - line.trim_start().len();
                open = Some(Block {
                    info: info.to_owned(),
                    text: String::new(),
                    line: number + 1,
                });
            }
            (Some(_), Some("")) => blocks.extend(open.take()),
            (Some(block), _) => {
                // a block in a list is indented as its fence is
                block.text.push_str(line.get(indent..).unwrap_or_default());
                block.text.push('\n');
            }
            (None, None) => {}
        }
    }
    assert!(open.is_none(), "a fence is not closed");
    blocks
}

/// Included list of packages, which `docs/third-party-packages` writes. Only a built book needs it.
const BUILD_PRODUCT: &str = "../../third-party-packages.md";

/// A file of the checkout, with what it includes.
pub fn read(path: &str) -> String {
    let read = |path: &Path| {
        std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
    };
    let path = root().join(path);
    let folder = path.parent().unwrap();
    let mut page = String::new();
    for line in read(&path).lines() {
        let included = line
            .strip_prefix("{{#include ")
            .and_then(|rest| rest.strip_suffix("}}"));
        match included {
            Some(BUILD_PRODUCT) => {}
            Some(file) => page.push_str(&read(&folder.join(file))),
            None => page.push_str(line),
        }
        page.push('\n');
    }
    page
}

/// The pages of the book, by their paths in the checkout.
pub fn pages() -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec!["docs/src".to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(root().join(&folder)).unwrap() {
            let entry = entry.unwrap();
            let path = format!("{folder}/{}", entry.file_name().to_string_lossy());
            if entry.path().is_dir() {
                folders.push(path);
            } else if Path::new(&path).extension().is_some_and(|ending| ending == "md") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}
