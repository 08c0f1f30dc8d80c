//! Files that import each other in a circle are few, and each circle is listed with its reason.

use std::collections::BTreeSet;

use tandem_tidy::CRATES;
use tandem_tidy::circles::{Graph, circles, circles_of, graph};
use tandem_tidy::product::sources;

/// Source folder of a crate, files, and reason of a circle.
type Circle = (&'static str, &'static [&'static str], &'static str);

/// Intended circles.
const INTENDED: [Circle; 1] = [(
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
    "one registry: a code acts on the execution of a block, whose words and modal state consist of codes, and a dialect \
     is a list of codes with texts about them",
)];

fn graph_of(folder: &str) -> Graph {
    let sources = sources(folder)
        .into_iter()
        .map(|(module, source)| (module, source.text));
    graph(&sources.collect())
}

fn module(path: &str) -> Vec<String> {
    path.split("::").map(str::to_owned).collect()
}

#[test]
fn files_import_each_other_in_listed_circles_only() {
    let found: BTreeSet<Vec<String>> = CRATES
        .into_iter()
        .flat_map(|folder| {
            let circles = circles(&graph_of(folder)).into_iter();
            circles.map(move |circle| circle.iter().map(|file| format!("{folder}/{file}")).collect())
        })
        .collect();
    let listed: BTreeSet<Vec<String>> = INTENDED
        .iter()
        .map(|(folder, circle, _)| circle.iter().map(|file| format!("{folder}/{file}")).collect())
        .collect();
    let unlisted: Vec<_> = found.difference(&listed).collect();
    let stale: Vec<_> = listed.difference(&found).collect();
    assert!(
        unlisted.is_empty() && stale.is_empty(),
        "not in the list: {unlisted:#?}\nin the list, but no circle: {stale:#?}"
    );
}

#[test]
fn a_circle_is_found_by_each_form_of_import() {
    let circle = BTreeSet::from([vec!["a".to_owned(), "b".to_owned()]]);
    for import in [
        "use crate::a::A;",
        "use super::a;",
        "pub(crate) use crate::{c::C, a::{A, B as D}};",
        "fn f() {\n    crate::a::f();\n}",
        "fn f() { println!(\"{}\", crate::a::f()); }",
        "mod inner {\n    use super::super::a::A;\n}",
        "use std::fmt;\n\nuse crate::{\n    c::C,\n    a::A,\n};",
        "#[cfg(test)]\nuse crate::c::C;\nuse crate::a::A;",
        "#[cfg(test)]\nuse crate::c::C;\nfn f() {\n    crate::a::f();\n}",
    ] {
        let texts = [("a", "use crate::b::B;"), ("b", import), ("c", "")];
        assert_eq!(circles_of(&texts), circle, "{import}");
    }
    let by_root = [
        ("", "mod a; mod b; pub use a::A;"),
        ("a", "use crate::b::B;"),
        ("b", "use crate::A;"),
    ];
    assert_eq!(circles_of(&by_root), circle);
    for none in [
        "// use crate::a::A;",
        "use other::a::A;",
        "\n#[cfg(test)]\nmod tests {\n    use crate::a::A;\n}",
        "#[cfg(all(test, unix))]\nuse crate::a::A;",
    ] {
        let texts = [("a", "use crate::b::B;"), ("b", none)];
        assert_eq!(circles_of(&texts), BTreeSet::new(), "{none}");
    }
}

#[test]
fn a_child_may_import_its_parents_but_not_through_another_file() {
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
fn product_modules_are_read_and_test_modules_are_not() {
    let found = graph_of("plc-api/src");
    assert!(found.len() > 30, "{}", found.len());
    assert!(found[&module("scan")].contains(&module("handlers")));
    assert!(!found[&module("handlers")].contains(&module("scan")));
    let found = graph_of("plc-api/protocol/src");
    assert!(
        found.contains_key(&module("handshake::rules")),
        "a product module"
    );
    assert!(
        !found.contains_key(&module("handshake::simulation")),
        "a test module"
    );
    let found = graph_of("runtime/src");
    assert!(found.contains_key(&module("simulation")), "a product module");
    assert!(
        !found.contains_key(&module("simulation::tests")),
        "below a test module"
    );
}
