//! Names that can be searched: CONTRIBUTING, "How we write".

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use tandem_tidy::product::parse;
use tandem_tidy::{CRATES, files, read};

/// Longest name of a test.
const TEST_NAME_MAX: usize = 70;

/// Participles that are no noun.
const PARTICIPLES: [&str; 25] = [
    "Begun", "Bound", "Built", "Chosen", "Drawn", "Found", "Given", "Gone", "Heard", "Held", "Kept", "Known",
    "Left", "Lost", "Made", "Meant", "Put", "Ran", "Said", "Seen", "Sent", "Shown", "Spoken", "Taken",
    "Told",
];

/// Verbs that say nothing without their object.
const BARE_VERBS: [&str; 12] = [
    "begin",
    "carry_out",
    "end",
    "go_on",
    "hear",
    "judge",
    "note",
    "of",
    "say",
    "take",
    "tell",
    "turn_away",
];

/// Types with two declarations of which one is compiled.
const ALTERNATIVES: [&str; 1] = ["HasForm"];

/// Getters in pairs, and methods that keep the name of a method of the standard library: file, name, reason.
const KEPT: [(&str, &str, &str); 2] = [
    ("runtime/model/src/arc.rs", "end", "a getter next to `start`"),
    ("runtime/model/src/flow.rs", "end", "a getter next to `start`"),
];

/// The declared names of one source.
#[derive(Default)]
struct Names {
    types: Vec<String>,
    functions: Vec<String>,
    tests: Vec<String>,
}

impl<'ast> Visit<'ast> for Names {
    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.types.push(item.ident.to_string());
        visit::visit_item_struct(self, item);
    }

    fn visit_item_enum(&mut self, item: &'ast syn::ItemEnum) {
        self.types.push(item.ident.to_string());
        visit::visit_item_enum(self, item);
    }

    fn visit_item_union(&mut self, item: &'ast syn::ItemUnion) {
        self.types.push(item.ident.to_string());
        visit::visit_item_union(self, item);
    }

    fn visit_item_trait(&mut self, item: &'ast syn::ItemTrait) {
        self.types.push(item.ident.to_string());
        visit::visit_item_trait(self, item);
    }

    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        let is_test = |attribute: &syn::Attribute| {
            let last = attribute.path().segments.last();
            last.is_some_and(|segment| segment.ident == "test")
        };
        if item.attrs.iter().any(is_test) {
            self.tests.push(item.sig.ident.to_string());
        } else {
            self.functions.push(item.sig.ident.to_string());
        }
        visit::visit_item_fn(self, item);
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        // a trait names its methods where it is declared
        if item.trait_.is_none() {
            let functions = item.items.iter().filter_map(|item| match item {
                syn::ImplItem::Fn(function) => Some(function.sig.ident.to_string()),
                _ => None,
            });
            self.functions.extend(functions);
        }
        visit::visit_item_impl(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        self.functions.push(item.sig.ident.to_string());
        visit::visit_trait_item_fn(self, item);
    }
}

fn names(path: &Path, text: &str) -> Names {
    let mut names = Names::default();
    names.visit_file(&parse(path, text));
    names
}

fn is_participle(name: &str) -> bool {
    let mut letters = name.chars();
    let is_one_word = letters.next().is_some_and(char::is_uppercase) && letters.all(char::is_lowercase);
    (is_one_word && name.len() > 4 && name.ends_with("ed")) || PARTICIPLES.contains(&name)
}

/// Returns the sources of the crates, without folders of tests.
fn sources() -> impl Iterator<Item = (&'static str, PathBuf, Names)> {
    let is_test = |path: &Path| {
        let names = ["tests", "benches", "fuzz", "examples"];
        path.iter().any(|part| names.iter().any(|name| part == *name))
            || path.to_string_lossy().ends_with("tests.rs")
    };
    let sources = files(&[".rs"]).into_iter().filter(move |path| !is_test(path));
    sources.filter_map(|path| {
        let folder = CRATES
            .into_iter()
            .filter(|folder| path.starts_with(folder))
            .max_by_key(|folder| folder.len())?;
        let names = names(&path, &read(&path));
        Some((folder, path, names))
    })
}

#[test]
fn a_type_name_is_declared_once_in_its_crate_and_is_no_participle() {
    let mut declared: BTreeMap<(&str, String), Vec<PathBuf>> = BTreeMap::new();
    let mut wrong = Vec::new();
    for (folder, path, names) in sources() {
        for name in names.types {
            if is_participle(&name) {
                wrong.push(format!("{}: {name} is a participle", path.display()));
            }
            declared.entry((folder, name)).or_default().push(path.clone());
        }
    }
    assert!(declared.len() > 1_000, "only {} types found", declared.len());
    for ((folder, name), paths) in declared {
        if paths.len() > 1 && !ALTERNATIVES.contains(&name.as_str()) {
            wrong.push(format!(
                "{name} is declared {} times in {folder}: {paths:?}",
                paths.len()
            ));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_function_is_a_verb_with_its_object() {
    let (mut seen, mut wrong) = (0, Vec::new());
    for (_, path, names) in sources() {
        for name in names.functions {
            seen += 1;
            let is_kept = KEPT
                .iter()
                .any(|(file, kept, _)| path.ends_with(file) && *kept == name);
            if BARE_VERBS.contains(&name.as_str()) && !is_kept {
                wrong.push(format!("{}: {name}", path.display()));
            }
        }
    }
    assert!(seen > 5_000, "only {seen} functions found");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn a_test_name_has_at_most_70_characters() {
    let (mut seen, mut wrong) = (0, Vec::new());
    for path in files(&[".rs"]) {
        for name in names(&path, &read(&path)).tests {
            seen += 1;
            if name.len() > TEST_NAME_MAX {
                wrong.push(format!("{}: {name}", path.display()));
            }
        }
    }
    assert!(seen > 2_000, "only {seen} tests found");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn planted_names_are_found() {
    let text = "struct Kept;\n#[cfg(test)]\nuse a::b;\nenum Opened {}\nimpl Kept {\n    fn of() {}\n}\nimpl Iterator for Kept {\n    fn take() {}\n}\ntrait T {\n    fn judge();\n}\n#[test]\nfn a_test() {}\n";
    let names = names(Path::new("planted.rs"), text);
    assert_eq!(names.types, ["Kept", "Opened", "T"]);
    assert_eq!(names.functions, ["of", "judge"]);
    assert_eq!(names.tests, ["a_test"]);
    assert!(["Kept", "Opened", "Asked", "Told"].into_iter().all(is_participle));
    assert!(
        !["Bed", "SpeedLimit", "AcceptedFile"]
            .into_iter()
            .any(is_participle)
    );
}
