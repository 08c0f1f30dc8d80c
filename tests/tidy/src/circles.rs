//! Import circles between the files of a crate.
//!
//! A file and the files below it in its folder are one subject: imports of a child from the files above it form no
//! circle. Every other path by `crate`, `self`, `super` or an own child is an import.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};

use crate::product::{ModulePath, parse, without_tests};

/// The imports of each file.
pub type Graph = BTreeMap<ModulePath, BTreeSet<ModulePath>>;

/// Path of the crate's root.
const ROOT: ModulePath = Vec::new();

/// Collects the paths that a file names, each relative to the inline module in which it stands.
#[derive(Default)]
struct NamedPaths {
    inline: ModulePath,
    found: Vec<(ModulePath, ModulePath)>,
}

impl NamedPaths {
    fn add(&mut self, path: ModulePath) {
        self.found.push((self.inline.clone(), path));
    }

    /// Adds a path outside of a `use` declaration if it begins with `crate` or `super`.
    fn add_rooted(&mut self, path: ModulePath) {
        let begins = path.first().map(String::as_str);
        if path.len() > 1 && matches!(begins, Some("crate" | "super")) {
            self.add(path);
        }
    }

    fn add_use(&mut self, before: &[String], tree: &syn::UseTree) {
        let with = |name: &syn::Ident| {
            let mut path = before.to_vec();
            path.push(name.to_string());
            path
        };
        match tree {
            syn::UseTree::Path(path) => self.add_use(&with(&path.ident), &path.tree),
            syn::UseTree::Name(name) if name.ident == "self" => self.add(before.to_vec()),
            syn::UseTree::Name(name) => self.add(with(&name.ident)),
            syn::UseTree::Rename(name) => self.add(with(&name.ident)),
            syn::UseTree::Group(group) => group.items.iter().for_each(|tree| self.add_use(before, tree)),
            syn::UseTree::Glob(_) => self.add(before.to_vec()),
        }
    }

    /// Adds the paths of a macro call.
    fn add_tokens(&mut self, tokens: TokenStream) {
        let mut path = ModulePath::new();
        let mut separators = 0;
        for token in tokens {
            match token {
                TokenTree::Ident(name) if separators == 2 || path.is_empty() => {
                    path.push(name.to_string());
                    separators = 0;
                    continue;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' && !path.is_empty() => {
                    separators += 1;
                    continue;
                }
                TokenTree::Group(group) => self.add_tokens(group.stream()),
                TokenTree::Ident(name) => {
                    self.add_rooted(std::mem::replace(&mut path, vec![name.to_string()]));
                    separators = 0;
                    continue;
                }
                _ => {}
            }
            self.add_rooted(std::mem::take(&mut path));
            separators = 0;
        }
        self.add_rooted(path);
    }
}

impl<'ast> Visit<'ast> for NamedPaths {
    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        self.inline.push(module.ident.to_string());
        visit::visit_item_mod(self, module);
        self.inline.pop();
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        self.add_use(&[], &item.tree);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names = path.segments.iter().map(|segment| segment.ident.to_string());
        self.add_rooted(names.collect());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.add_tokens(call.tokens.clone());
    }

    fn visit_item_macro(&mut self, item: &'ast syn::ItemMacro) {
        self.add_tokens(item.mac.tokens.clone());
    }

    fn visit_attribute(&mut self, _: &'ast syn::Attribute) {}
}

/// Returns the file to which a path leads; `exports` holds the files of the names in the crate's root.
fn target(
    from: &ModulePath,
    path: &[String],
    known: &Graph,
    exports: &BTreeMap<String, ModulePath>,
) -> Option<ModulePath> {
    let mut found = match path.first()?.as_str() {
        "crate" => ROOT,
        "self" | "super" => from.clone(),
        child => {
            let mut child_of = from.clone();
            child_of.push(child.to_owned());
            return known.contains_key(&child_of).then_some(child_of);
        }
    };
    let mut rest = path;
    while let [first, after @ ..] = rest
        && ["crate", "self", "super"].contains(&first.as_str())
    {
        if first == "super" {
            found.pop();
        }
        rest = after;
    }
    if let Some(file) = rest
        .first()
        .filter(|_| found.is_empty())
        .and_then(|name| exports.get(name))
    {
        return Some(file.clone());
    }
    found.extend(rest.iter().cloned());
    while !found.is_empty() && !known.contains_key(&found) {
        found.pop();
    }
    (!found.is_empty()).then_some(found)
}

/// Returns the paths that a text names, each with the module in which it stands.
fn named(module: &ModulePath, text: &str) -> Vec<(ModulePath, ModulePath)> {
    let mut paths = NamedPaths::default();
    paths.visit_file(&parse(Path::new(&module.join("/")), text));
    let absolute = |(inline, path)| {
        let mut from = module.clone();
        from.extend::<ModulePath>(inline);
        (from, path)
    };
    paths.found.into_iter().map(absolute).collect()
}

/// Returns the imports between files that are given by their module and product text.
pub fn graph(texts: &BTreeMap<ModulePath, String>) -> Graph {
    let modules = texts.keys().filter(|module| **module != ROOT);
    let mut graph: Graph = modules.map(|module| (module.clone(), BTreeSet::new())).collect();
    let exported = texts.get(&ROOT).map_or_else(Vec::new, |text| named(&ROOT, text));
    let exports = exported.into_iter().filter_map(|(from, mut path)| {
        let file = target(&from, &path, &graph, &BTreeMap::new())?;
        Some((path.pop()?, file))
    });
    let exports: BTreeMap<_, _> = exports.collect();
    for module in graph.keys().cloned().collect::<Vec<_>>() {
        let targets = named(&module, &texts[&module]);
        let targets = targets
            .iter()
            .filter_map(|(from, path)| target(from, path, &graph, &exports));
        let targets = targets.filter(|target| !module.starts_with(target)).collect();
        graph.insert(module, targets);
    }
    graph
}

/// Returns everything that can be reached from a file.
fn reached<'g>(graph: &'g Graph, from: &ModulePath) -> BTreeSet<&'g ModulePath> {
    let mut found = BTreeSet::new();
    let mut pending: Vec<&ModulePath> = graph[from].iter().collect();
    while let Some(module) = pending.pop() {
        if found.insert(module) {
            pending.extend(&graph[module]);
        }
    }
    found
}

/// Returns each set of two or more files that all reach each other.
pub fn circles(graph: &Graph) -> BTreeSet<Vec<String>> {
    let reached: BTreeMap<_, _> = graph
        .keys()
        .map(|module| (module, reached(graph, module)))
        .collect();
    let circle = |module: &ModulePath| {
        let both = reached[module]
            .iter()
            .filter(|other| reached[**other].contains(module));
        both.map(|other| other.join("/")).collect::<Vec<_>>()
    };
    graph
        .keys()
        .map(circle)
        .filter(|circle| circle.len() > 1)
        .collect()
}

/// Returns the circles of files that are given by their module path and text.
pub fn circles_of(texts: &[(&str, &str)]) -> BTreeSet<Vec<String>> {
    let texts = texts.iter().map(|(path, text)| {
        let module: ModulePath = path
            .split("::")
            .filter(|part| !part.is_empty())
            .map(str::to_owned)
            .collect();
        (module, without_tests(Path::new(path), text))
    });
    circles(&graph(&texts.collect()))
}
