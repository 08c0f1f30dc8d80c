//! Files that import each other in a circle are few, and each circle is listed.
//!
//! A file and the files below it in its folder are one subject: imports of a child from the files above it form no
//! circle. Everything else that a file names by `crate`, `self`, `super` or its own child is an arrow.

use std::collections::{BTreeMap, BTreeSet};

use super::{CRATES, files, read, without_unit_tests};

/// A circle: the sources of its crate, its files, and its reason.
type Circle = (&'static str, &'static [&'static str], &'static str);

/// Circles that are meant.
const MEANT: [Circle; 1] = [(
    "runtime/interp/src",
    &[
        "block_words",
        "codes",
        "dialect",
        "dialects/texts",
        "execution",
        "modal",
        "numbers",
        "restrictions",
        "text_position",
    ],
    "one registry: a code acts on the execution of a block, whose words and modal state are made of codes, and a dialect \
         is a list of them, with texts of its own about them",
)];

/// A file as a module: its path within the crate.
type Module = Vec<String>;

/// The crate's root.
const ROOT: Module = Vec::new();

/// The imports of each file.
type Graph = BTreeMap<Module, BTreeSet<Module>>;

fn parts(path: &str) -> Module {
    path.split("::").map(|part| part.trim().to_owned()).collect()
}

/// The code without comments.
fn code(text: &str) -> String {
    let lines = without_unit_tests(text).lines();
    let lines = lines.map(|line| line.split("//").next().unwrap_or_default());
    lines.collect::<Vec<_>>().join("\n")
}

/// The single paths of `a::{b, c::d}`.
fn single(tree: &str) -> Vec<String> {
    let Some((before, inner)) = tree.split_once('{') else {
        let path = tree.split(" as ").next().unwrap_or_default();
        return vec![path.trim().to_owned()];
    };
    let inner = inner.rsplit_once('}').map_or(inner, |(inner, _)| inner);
    let (mut depth, mut branches) = (0, vec![String::new()]);
    for letter in inner.chars() {
        depth += i32::from(letter == '{') - i32::from(letter == '}');
        match letter {
            ',' if depth == 0 => branches.push(String::new()),
            _ => branches.last_mut().expect("one branch at least").push(letter),
        }
    }
    let branches = branches.iter().filter(|branch| !branch.trim().is_empty());
    branches
        .flat_map(|branch| single(branch))
        .map(|path| format!("{}{path}", before.trim()))
        .collect()
}

/// Returns the paths that a file names: its `use` lines, and paths in its code that begin with `crate` or `super`.
fn named(code: &str) -> Vec<String> {
    let mut found = Vec::new();
    let mut rest = String::new();
    for statement in code.split_inclusive(';') {
        let begin = statement.rfind("use ").filter(|at| {
            let line = statement[..*at].rsplit('\n').next().unwrap_or_default();
            let before = line.trim();
            statement.ends_with(';') && (before.is_empty() || before.starts_with("pub"))
        });
        match begin {
            Some(at) => found.extend(single(statement[at + 4..].trim_end_matches(';'))),
            None => rest.push_str(statement),
        }
    }
    for root in ["crate::", "super::"] {
        for (at, _) in rest.match_indices(root) {
            let is_inner = rest[..at].ends_with("::") || rest[..at].ends_with('$');
            let end =
                rest[at..].find(|letter: char| !letter.is_alphanumeric() && letter != '_' && letter != ':');
            if !is_inner {
                found.push(rest[at..end.map_or(rest.len(), |end| at + end)].to_owned());
            }
        }
    }
    found
}

/// The file that a path leads to from a file; `exports` tells where the names of the crate's root come from.
fn target(from: &Module, path: &str, known: &Graph, exports: &BTreeMap<String, Module>) -> Option<Module> {
    let mut path = parts(path);
    let mut found = match path[0].as_str() {
        "crate" => Vec::new(),
        "self" | "super" => from.clone(),
        child => {
            let mut child_of = from.clone();
            child_of.push(child.to_owned());
            return known.contains_key(&child_of).then_some(child_of);
        }
    };
    while path
        .first()
        .is_some_and(|part| ["crate", "self", "super"].contains(&part.as_str()))
    {
        if path.remove(0) == "super" {
            found.pop();
        }
    }
    if let Some(file) = path
        .first()
        .filter(|_| found.is_empty())
        .and_then(|name| exports.get(name))
    {
        return Some(file.clone());
    }
    found.extend(path);
    while !found.is_empty() && !known.contains_key(&found) {
        found.pop();
    }
    (!found.is_empty()).then_some(found)
}

/// The arrows between files, given by their module and text.
fn graph(texts: &BTreeMap<Module, String>) -> Graph {
    let modules = texts.keys().filter(|module| **module != ROOT);
    let mut graph: Graph = modules.map(|module| (module.clone(), BTreeSet::new())).collect();
    let exported = named(&code(texts.get(&ROOT).map_or("", String::as_str)));
    let exports = exported.iter().filter_map(|path| {
        let file = target(&ROOT, path, &graph, &BTreeMap::new())?;
        Some((parts(path).pop()?, file))
    });
    let exports: BTreeMap<_, _> = exports.collect();
    for module in graph.keys().cloned().collect::<Vec<_>>() {
        let targets = named(&code(&texts[&module]));
        let targets = targets
            .iter()
            .filter_map(|path| target(&module, path, &graph, &exports));
        let targets = targets.filter(|target| !module.starts_with(target)).collect();
        graph.insert(module, targets);
    }
    graph
}

/// All that can be reached from a file.
fn reached<'g>(graph: &'g Graph, from: &Module) -> BTreeSet<&'g Module> {
    let mut found = BTreeSet::new();
    let mut open: Vec<&Module> = graph[from].iter().collect();
    while let Some(module) = open.pop() {
        if found.insert(module) {
            open.extend(&graph[module]);
        }
    }
    found
}

/// Files that all reach each other, two and more.
fn circles(graph: &Graph) -> BTreeSet<Vec<String>> {
    let reached: BTreeMap<_, _> = graph
        .keys()
        .map(|module| (module, reached(graph, module)))
        .collect();
    let circle = |module: &Module| {
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

/// True for a file, or one below it, that its parent builds for tests only.
fn is_of_tests(module: &Module, texts: &BTreeMap<Module, String>) -> bool {
    (0..module.len()).any(|depth| {
        let declared = format!("#[cfg(test)]\nmod {};", module[depth]);
        let parent = texts.get(&module[..depth]);
        parent.is_some_and(|text| text.contains(&declared))
    })
}

/// The files of a crate by module; tests and the root of a binary are none.
fn sources(folder: &str) -> BTreeMap<Module, String> {
    let mut found = BTreeMap::new();
    for path in files(&[".rs"]) {
        let Ok(inner) = path.strip_prefix(folder) else {
            continue;
        };
        let inner = inner.with_extension("");
        let mut module = parts(&inner.to_str().expect("a name").replace('/', "::"));
        if module == ["lib"] || module.last().is_some_and(|last| last == "mod") {
            module.pop();
        }
        if module != ["main"] {
            found.insert(module, read(&path));
        }
    }
    let of_tests: Vec<Module> = found
        .keys()
        .filter(|module| is_of_tests(module, &found))
        .cloned()
        .collect();
    found.retain(|module, _| !of_tests.contains(module));
    found
}

#[test]
fn no_files_import_each_other_in_a_circle_but_those_of_the_list() {
    let found: BTreeSet<Vec<String>> = CRATES
        .into_iter()
        .flat_map(|folder| {
            let circles = circles(&graph(&sources(folder)));
            circles
                .into_iter()
                .map(move |circle| circle.iter().map(|file| format!("{folder}/{file}")).collect())
        })
        .collect();
    let listed: BTreeSet<Vec<String>> = MEANT
        .iter()
        .map(|(folder, circle, _)| circle.iter().map(|file| format!("{folder}/{file}")).collect())
        .collect();
    let new: Vec<_> = found.difference(&listed).collect();
    let gone: Vec<_> = listed.difference(&found).collect();
    assert!(
        new.is_empty() && gone.is_empty(),
        "not in the list: {new:#?}\nin the list and not there: {gone:#?}"
    );
}

fn circles_of(texts: &[(&str, &str)]) -> BTreeSet<Vec<String>> {
    let texts = texts.iter().map(|(path, text)| {
        let module = if path.is_empty() { ROOT } else { parts(path) };
        (module, (*text).to_owned())
    });
    circles(&graph(&texts.collect()))
}

#[test]
fn a_circle_is_found_in_every_way_to_name_a_file() {
    let one = BTreeSet::from([vec!["a".to_owned(), "b".to_owned()]]);
    for back in [
        "use crate::a::A;",
        "use super::a;",
        "pub(crate) use crate::{c::C, a::{A, B as D}};",
        "fn f() {\n    crate::a::f();\n}",
        "use std::fmt;\n\nuse crate::{\n    c::C,\n    a::A,\n};",
    ] {
        let texts = [("a", "use crate::b::B;"), ("b", back), ("c", "")];
        assert_eq!(circles_of(&texts), one, "{back}");
    }
    let by_root = [
        ("", "pub use a::A;"),
        ("a", "use crate::b::B;"),
        ("b", "use crate::A;"),
    ];
    assert_eq!(circles_of(&by_root), one);
    for none in [
        "// use crate::a::A;",
        "use other::a::A;",
        "\n#[cfg(test)]\nmod tests {\n    use crate::a::A;\n}",
    ] {
        assert_eq!(
            circles_of(&[("a", "use crate::b::B;"), ("b", none)]),
            BTreeSet::new(),
            "{none}"
        );
    }
}

#[test]
fn a_child_may_use_what_is_above_it_but_not_by_way_of_others() {
    let family = [
        ("a", "mod b;\nuse b::B;"),
        ("a::b", "use super::A;\nuse crate::a::C;"),
    ];
    assert_eq!(circles_of(&family), BTreeSet::new());
    let others = [
        ("a", "mod b;\nuse b::B;"),
        ("a::b", "use crate::c::C;"),
        ("c", "use crate::a::A;"),
    ];
    let circle = ["a", "a/b", "c"].map(str::to_owned).to_vec();
    assert_eq!(circles_of(&others), BTreeSet::from([circle]));
}

#[test]
fn the_sources_are_read() {
    let found = graph(&sources("plc-api/src"));
    assert!(found.len() > 40, "{}", found.len());
    assert!(found[&parts("scan")].contains(&parts("handlers")));
    assert!(!found[&parts("handlers")].contains(&parts("scan")));
    assert!(
        !found.contains_key(&parts("handshake::simulation")),
        "it is a test"
    );
    let found = graph(&sources("runtime/src"));
    assert!(found.contains_key(&parts("simulation")), "it is none");
    assert!(!found.contains_key(&parts("world::broker")), "it is below one");
}
