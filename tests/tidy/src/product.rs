//! Product code: the sources of a crate without everything that is compiled only for its unit tests.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use proc_macro2::{Span, TokenTree};
use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Attribute, Item, Meta};

use crate::{read, root};

/// Path of a module within its crate; the root is empty.
pub type ModulePath = Vec<String>;

/// Product source of one file.
#[derive(Debug, Clone)]
pub struct Source {
    /// File, relative to the root of the checkout.
    pub path: PathBuf,
    /// Text with empty lines instead of test items.
    pub text: String,
}

/// Results by key. Each is computed once in a process, because many rules read every file.
struct Memo<T>(Mutex<BTreeMap<String, Arc<OnceLock<T>>>>);

impl<T: Clone> Memo<T> {
    const fn new() -> Self {
        Self(Mutex::new(BTreeMap::new()))
    }

    fn get(&self, key: &str, compute: impl FnOnce() -> T) -> T {
        let mut results = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let result = Arc::clone(results.entry(key.to_owned()).or_default());
        drop(results);
        result.get_or_init(compute).clone()
    }
}

/// Returns true if an item with these attributes is compiled for unit tests only.
pub fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| match &attribute.meta {
        Meta::List(list) if list.path.is_ident("cfg") => {
            syn::parse2::<Meta>(list.tokens.clone()).is_ok_and(|predicate| requires_test(&predicate))
        }
        meta => meta
            .path()
            .segments
            .last()
            .is_some_and(|last| last.ident == "test"),
    })
}

/// Returns true if a `cfg` predicate holds in unit tests only.
fn requires_test(predicate: &Meta) -> bool {
    let Meta::List(list) = predicate else {
        return predicate.path().is_ident("test");
    };
    let parser = syn::punctuated::Punctuated::<Meta, syn::Token![,]>::parse_terminated;
    let Ok(operands) = list.parse_args_with(parser) else {
        return false;
    };
    if list.path.is_ident("all") {
        return operands.iter().any(requires_test);
    }
    list.path.is_ident("any") && operands.iter().all(requires_test)
}

/// Collects the line ranges of test items.
#[derive(Default)]
struct TestLines(Vec<(usize, usize)>);

impl TestLines {
    /// Notes the lines of a test item, and returns true if it is one.
    fn add_test(&mut self, attributes: &[Attribute], span: Span) -> bool {
        let is_test = is_test(attributes);
        if is_test {
            self.0.push((span.start().line, span.end().line));
        }
        is_test
    }
}

/// Returns the attributes of an item.
fn item_attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::ExternCrate(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Union(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

/// Returns the attributes of an expression that may stand as a statement.
fn expression_attributes(expression: &syn::Expr) -> &[Attribute] {
    match expression {
        syn::Expr::Assign(it) => &it.attrs,
        syn::Expr::Block(it) => &it.attrs,
        syn::Expr::Call(it) => &it.attrs,
        syn::Expr::If(it) => &it.attrs,
        syn::Expr::Macro(it) => &it.attrs,
        syn::Expr::MethodCall(it) => &it.attrs,
        syn::Expr::Return(it) => &it.attrs,
        syn::Expr::Unsafe(it) => &it.attrs,
        _ => &[],
    }
}

impl<'ast> Visit<'ast> for TestLines {
    fn visit_item(&mut self, item: &'ast Item) {
        if !self.add_test(item_attributes(item), item.span()) {
            visit::visit_item(self, item);
        }
    }

    fn visit_impl_item(&mut self, item: &'ast syn::ImplItem) {
        let attributes: &[Attribute] = match item {
            syn::ImplItem::Const(item) => &item.attrs,
            syn::ImplItem::Fn(item) => &item.attrs,
            syn::ImplItem::Type(item) => &item.attrs,
            _ => &[],
        };
        if !self.add_test(attributes, item.span()) {
            visit::visit_impl_item(self, item);
        }
    }

    fn visit_trait_item(&mut self, item: &'ast syn::TraitItem) {
        let attributes: &[Attribute] = match item {
            syn::TraitItem::Const(item) => &item.attrs,
            syn::TraitItem::Fn(item) => &item.attrs,
            syn::TraitItem::Type(item) => &item.attrs,
            _ => &[],
        };
        if !self.add_test(attributes, item.span()) {
            visit::visit_trait_item(self, item);
        }
    }

    fn visit_field(&mut self, field: &'ast syn::Field) {
        if !self.add_test(&field.attrs, field.span()) {
            visit::visit_field(self, field);
        }
    }

    fn visit_field_value(&mut self, field: &'ast syn::FieldValue) {
        if !self.add_test(&field.attrs, field.span()) {
            visit::visit_field_value(self, field);
        }
    }

    fn visit_variant(&mut self, variant: &'ast syn::Variant) {
        if !self.add_test(&variant.attrs, variant.span()) {
            visit::visit_variant(self, variant);
        }
    }

    fn visit_arm(&mut self, arm: &'ast syn::Arm) {
        if !self.add_test(&arm.attrs, arm.span()) {
            visit::visit_arm(self, arm);
        }
    }

    fn visit_stmt(&mut self, statement: &'ast syn::Stmt) {
        let attributes: &[Attribute] = match statement {
            syn::Stmt::Local(local) => &local.attrs,
            syn::Stmt::Expr(expression, _) => expression_attributes(expression),
            syn::Stmt::Macro(call) => &call.attrs,
            syn::Stmt::Item(_) => &[],
        };
        if !self.add_test(attributes, statement.span()) {
            visit::visit_stmt(self, statement);
        }
    }
}

/// Parses a Rust source.
///
/// # Panics
/// Panics if the text is not Rust, and names the file.
pub fn parse(path: &Path, text: &str) -> syn::File {
    syn::parse_file(text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Returns a Rust source with empty lines instead of its test items, so that line numbers stay valid.
///
/// # Panics
/// Panics if the text is not Rust, and names the file.
pub fn without_tests(path: &Path, text: &str) -> String {
    static PRODUCTS: Memo<String> = Memo::new();
    PRODUCTS.get(text, || remove_tests(path, text))
}

fn remove_tests(path: &Path, text: &str) -> String {
    let file = parse(path, text);
    if is_test(&file.attrs) {
        return "\n".repeat(text.lines().count());
    }
    let mut tests = TestLines::default();
    tests.visit_file(&file);
    let mut product = String::with_capacity(text.len());
    for (number, line) in (1..).zip(text.lines()) {
        if !tests
            .0
            .iter()
            .any(|(first, last)| (*first..=*last).contains(&number))
        {
            product.push_str(line);
        }
        product.push('\n');
    }
    product
}

/// Returns the product sources of a crate by module: the files that its roots declare, without test modules.
///
/// # Panics
/// Panics if a declared file does not exist or is not Rust.
pub fn sources(folder: &str) -> BTreeMap<ModulePath, Source> {
    static CRATES: Memo<BTreeMap<ModulePath, Source>> = Memo::new();
    CRATES.get(folder, || read_sources(folder))
}

fn read_sources(folder: &str) -> BTreeMap<ModulePath, Source> {
    let mut found = BTreeMap::new();
    for name in ["lib.rs", "main.rs"] {
        let path = Path::new(folder).join(name);
        if root().join(&path).exists() {
            // The modules of a binary and those of its library share one name space here: no name occurs in both.
            let module = if name == "lib.rs" {
                Vec::new()
            } else {
                vec!["main".to_owned()]
            };
            add_modules(&path, Path::new(folder), &[], module, &mut found);
        }
    }
    assert!(!found.is_empty(), "{folder} has neither lib.rs nor main.rs");
    found
}

/// Adds a file as a module, and the files of the modules that it declares.
fn add_modules(
    path: &Path,
    children: &Path,
    module: &[String],
    name: ModulePath,
    found: &mut BTreeMap<ModulePath, Source>,
) {
    let text = without_tests(path, &read(path));
    let declared = parse(path, &text)
        .items
        .into_iter()
        .filter_map(|item| match item {
            Item::Mod(item) if item.content.is_none() => Some(item),
            _ => None,
        });
    for declaration in declared {
        let child = declaration.ident.to_string();
        let by_attribute = declaration.attrs.iter().find_map(path_attribute);
        let candidates = match by_attribute {
            Some(file) => vec![path.with_file_name(file)],
            None => vec![
                children.join(format!("{child}.rs")),
                children.join(&child).join("mod.rs"),
            ],
        };
        let file = candidates.iter().find(|file| root().join(file).exists());
        let Some(file) = file else {
            panic!("{}: no file for `mod {child}`", path.display());
        };
        let mut inner = module.to_vec();
        inner.push(child.clone());
        add_modules(file, &children.join(&child), &inner.clone(), inner, found);
    }
    let path = path.to_owned();
    found.insert(name, Source { path, text });
}

/// Returns the file of `#[path = "file"]`.
fn path_attribute(attribute: &Attribute) -> Option<String> {
    let Meta::NameValue(pair) = &attribute.meta else {
        return None;
    };
    let syn::Expr::Lit(literal) = &pair.value else {
        return None;
    };
    let syn::Lit::Str(file) = &literal.lit else {
        return None;
    };
    pair.path.is_ident("path").then(|| file.value())
}

/// Returns the string literals of a source with their first lines, also those in macro calls, but not those of
/// attributes.
///
/// # Panics
/// Panics if the text is not Rust, and names the file.
pub fn literals(path: &Path, text: &str) -> Vec<(usize, String)> {
    #[derive(Default)]
    struct Literals(Vec<(usize, String)>);

    impl Literals {
        fn add_tokens(&mut self, tokens: proc_macro2::TokenStream) {
            for token in tokens {
                match token {
                    TokenTree::Group(group) => self.add_tokens(group.stream()),
                    TokenTree::Literal(literal) => {
                        let line = literal.span().start().line;
                        if let syn::Lit::Str(text) = syn::Lit::new(literal) {
                            self.0.push((line, text.value()));
                        }
                    }
                    _ => {}
                }
            }
        }
    }

    impl<'ast> Visit<'ast> for Literals {
        fn visit_attribute(&mut self, _: &'ast Attribute) {}

        fn visit_lit_str(&mut self, literal: &'ast syn::LitStr) {
            self.0.push((literal.span().start().line, literal.value()));
        }

        fn visit_macro(&mut self, call: &'ast syn::Macro) {
            self.add_tokens(call.tokens.clone());
        }
    }

    let mut found = Literals::default();
    found.visit_file(&parse(path, text));
    found.0
}
