//! No product code is replaced or added under test: what a test runs is what is shipped.

use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Item};
use tandem_tidy::product::{is_test, parse, sources};
use tandem_tidy::{CRATES, read};

/// Conditions on `test` that stay: file, text of the line after the condition, reason.
const KEPT: [(&str, &str, &str); 2] = [
    (
        "runtime/structured-text/src/code.rs",
        "pub names: std::collections::HashMap<String, (usize, Elementary)>,",
        "the names of variables, which a scan does not need, and by which only tests read them",
    ),
    (
        "runtime/structured-text/src/check/links.rs",
        "for variable in &self.frames[program].variables {",
        "fills the names of variables",
    ),
];

/// Lines of conditions on `test`, except for those of test modules and of the imports for them.
#[derive(Default)]
struct TestConditions(Vec<usize>);

fn names_test(tokens: TokenStream) -> bool {
    tokens.into_iter().any(|token| match token {
        TokenTree::Group(group) => names_test(group.stream()),
        TokenTree::Ident(name) => name == "test",
        _ => false,
    })
}

impl<'ast> Visit<'ast> for TestConditions {
    fn visit_item(&mut self, item: &'ast Item) {
        let is_of_tests = match item {
            Item::Mod(module) => is_test(&module.attrs),
            Item::Use(import) => is_test(&import.attrs),
            _ => false,
        };
        if !is_of_tests {
            visit::visit_item(self, item);
        }
    }

    fn visit_attribute(&mut self, attribute: &'ast Attribute) {
        let is_condition = attribute.path().is_ident("cfg") || attribute.path().is_ident("cfg_attr");
        if let (true, syn::Meta::List(list)) = (is_condition, &attribute.meta)
            && names_test(list.tokens.clone())
        {
            self.0.push(attribute.span().start().line);
        }
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        if call.path.is_ident("cfg") && names_test(call.tokens.clone()) {
            self.0.push(call.span().start().line);
        }
    }
}

fn conditions(path: &Path, text: &str) -> Vec<usize> {
    let mut found = TestConditions::default();
    found.visit_file(&parse(path, text));
    found.0
}

#[test]
fn no_product_code_is_replaced_under_test() {
    let mut found = Vec::new();
    let mut kept: Vec<_> = KEPT.iter().map(|(file, line, _)| (*file, *line)).collect();
    for folder in CRATES {
        for source in sources(folder).into_values() {
            let text = read(&source.path);
            for line in conditions(&source.path, &text) {
                let after = text.lines().nth(line).unwrap_or_default().trim();
                let file = source.path.display().to_string();
                let before = kept.len();
                kept.retain(|kept| *kept != (file.as_str(), after));
                if kept.len() == before {
                    found.push(format!("{file}:{line}: {after}"));
                }
            }
        }
    }
    assert!(
        found.is_empty(),
        "code that depends on `test`; pass the difference as a parameter:\n{}",
        found.join("\n")
    );
    assert!(kept.is_empty(), "remove from KEPT: {kept:?}");
}

#[test]
fn a_replaced_item_is_found_and_a_test_module_is_not() {
    let text = "#[cfg(test)]\nuse std::fs;\n#[cfg(test)]\nmod tests {\n    #[cfg(test)]\n    fn helper() {}\n}\n\
                #[cfg(not(test))]\nuse std::io;\nstruct Clock {\n    #[cfg(test)]\n    paused: bool,\n}\n\
                fn wait() -> u64 {\n    #[cfg(any(test, feature = \"x\"))]\n    return 1;\n    \
                if cfg!(test) { 2 } else { 10 }\n}\n#[cfg_attr(test, allow(dead_code))]\nfn other() {}\n";
    assert_eq!(conditions(Path::new("a.rs"), text), [8, 11, 15, 17, 19]);
}
