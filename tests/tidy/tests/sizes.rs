//! Sizes of files and functions.

use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use tandem_tidy::product::{parse, without_tests};
use tandem_tidy::{files, read};

const LINES_MAX: usize = 600;
/// Tables of HMI texts grow with the screen, one line a text.
const TEXTS_MAX: usize = 2000;
const FUNCTION_LINES_MAX: usize = 70;

#[test]
fn a_file_has_at_most_600_product_lines() {
    let mut too_long = Vec::new();
    for path in files(&[".rs", ".js", ".mjs", ".css", ".ts"]) {
        // one line for each type of the interface, generated: tests/browser/generated.test.mjs
        if path.ends_with("web/types.d.ts") {
            continue;
        }
        let text = read(&path);
        let is_rust = path.extension().is_some_and(|extension| extension == "rs");
        let lines = if is_rust {
            // a removed test item leaves empty lines, which no product file has one after another
            let product = without_tests(&path, &text);
            let lines: Vec<&str> = product.lines().collect();
            let is_left = |at: &usize| !lines[*at].is_empty() || *at == 0 || !lines[at - 1].is_empty();
            (0..lines.len()).filter(is_left).count()
        } else {
            text.lines().count()
        };
        let is_table = path
            .parent()
            .is_some_and(|folder| folder.ends_with("web/language"));
        if lines > if is_table { TEXTS_MAX } else { LINES_MAX } {
            too_long.push(format!("{}: {lines} lines", path.display()));
        }
    }
    assert!(too_long.is_empty(), "{too_long:#?}");
}

/// Collects the first line and the length of each function.
#[derive(Default)]
struct Functions(Vec<(usize, usize)>);

impl Functions {
    fn add(&mut self, signature: &syn::Signature, block: &syn::Block) {
        let (first, last) = (signature.span().start().line, block.span().end().line);
        self.0.push((first, last - first + 1));
    }
}

impl<'ast> Visit<'ast> for Functions {
    fn visit_item_fn(&mut self, function: &'ast syn::ItemFn) {
        self.add(&function.sig, &function.block);
        visit::visit_item_fn(self, function);
    }

    fn visit_impl_item_fn(&mut self, function: &'ast syn::ImplItemFn) {
        self.add(&function.sig, &function.block);
        visit::visit_impl_item_fn(self, function);
    }

    fn visit_trait_item_fn(&mut self, function: &'ast syn::TraitItemFn) {
        if let Some(block) = &function.default {
            self.add(&function.sig, block);
        }
        visit::visit_trait_item_fn(self, function);
    }
}

fn indent(line: &str) -> usize {
    line.len() - line.trim_start().len()
}

/// Returns the first line and the length of each function of a JavaScript source, by the brace that closes it at the
/// same indent.
fn javascript_functions(text: &str) -> Vec<(usize, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let mut words = line.trim_start().split([' ', '(', '*']);
        let begins = words.find(|word| !["export", "default", "async"].contains(word)) == Some("function");
        if !begins || line.ends_with('}') {
            continue;
        }
        let closes = |other: &&str| indent(other) == indent(line) && other.trim_start().starts_with('}');
        if let Some(length) = lines[at + 1..].iter().position(closes) {
            found.push((at + 1, length + 2));
        }
    }
    found
}

#[test]
fn a_function_has_at_most_70_lines() {
    let (mut seen, mut too_long) = (0, Vec::new());
    for path in files(&[".rs", ".js", ".mjs"]) {
        let text = read(&path);
        let functions = if path.extension().is_some_and(|extension| extension == "rs") {
            let mut functions = Functions::default();
            functions.visit_file(&parse(&path, &text));
            functions.0
        } else {
            javascript_functions(&text)
        };
        seen += functions.len();
        let long = functions.iter().filter(|(_, lines)| *lines > FUNCTION_LINES_MAX);
        too_long.extend(long.map(|(line, lines)| format!("{}:{line}: {lines} lines", path.display())));
    }
    assert!(seen > 5_000, "only {seen} functions found");
    assert!(too_long.is_empty(), "{too_long:#?}");
}

#[test]
fn functions_are_measured_from_their_signature_to_their_last_brace() {
    let text = "/// Doc.\npub(crate) async fn a(\n    x: u8,\n) -> u8 {\n    x\n}\n\nfn b() {}\n\ntrait T {\n    fn c(&self);\n    fn d() {\n        1;\n    }\n}\n";
    let mut functions = Functions::default();
    functions.visit_file(&parse("planted.rs".as_ref(), text));
    assert_eq!(functions.0, [(2, 5), (8, 1), (12, 3)]);
    let script = "export async function a(x) {\n  x();\n}\nfunction b() {}\n";
    assert_eq!(javascript_functions(script), [(1, 3)]);
}
