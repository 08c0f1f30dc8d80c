//! A card of the HMI costs one file and, in the list of views, its import and its place: no other file names
//! it.

use std::path::Path;

use super::{costs, files_where};
use tandem_tidy::read;

const LIST: &str = "web/views/index.js";

/// Places for a card, which `main.js` builds.
fn places(main: &str) -> Vec<&str> {
    let build = main.split_once("const places = {").unwrap().1;
    let build = build.split_once("};").unwrap().0;
    let rows = build.lines().filter_map(|line| line.trim().split_once(": h("));
    rows.map(|(place, _)| place).collect()
}

/// The name that a card of this file exports: `feed_hold.js` is `feedHold`.
fn name_of(stem: &str) -> String {
    let mut words = stem.split('_');
    let first = words.next().unwrap_or_default().to_owned();
    words.fold(first, |name, word| {
        let (begin, rest) = word.split_at(1);
        name + &begin.to_uppercase() + rest
    })
}

/// Returns the missing and the superfluous parts of a card.
fn mistakes(stem: &str, card: &str, list: &str, places: &[&str]) -> Vec<String> {
    let name = name_of(stem);
    let begin = format!("export const {name} = {{\n  place: \"");
    let place = card.split_once(&begin).and_then(|(_, rest)| rest.split_once('"'));
    let is_placed = place.is_some_and(|(place, _)| places.contains(&place));
    let count = |wanted: &str| list.lines().filter(|line| *line == wanted).count();
    let rules = [
        (
            is_placed,
            "exports no view of its name with a place of the screen",
        ),
        (card.contains("\n  create"), "makes no element"),
        (
            count(&format!("import {{ {name} }} from \"./{stem}.js\";")) == 1,
            "is not imported once",
        ),
        (
            count(&format!("  {name},")) == 1,
            "does not stand once in the list",
        ),
    ];
    let broken = rules.into_iter().filter(|(holds, _)| !holds);
    broken.map(|(_, what)| format!("{name} {what}")).collect()
}

#[test]
fn a_card_is_a_file_and_its_import_and_place_in_the_list() {
    let (list, main) = (read(LIST.as_ref()), read("web/main.js".as_ref()));
    let places = places(&main);
    assert_eq!(places.len(), 8, "{places:?}");
    let cards = files_where("web/views", ".js", |_| true);
    let cards: Vec<_> = cards.iter().filter(|path| !path.ends_with("index.js")).collect();
    for path in &cards {
        let stem = path.file_stem().unwrap().to_str().unwrap();
        assert_eq!(mistakes(stem, &read(path), &list, &places), Vec::<String>::new());
    }
    let imports = list.lines().filter(|line| line.starts_with("import ")).count();
    assert_eq!(imports, cards.len(), "the list imports cards only");
    assert_eq!(costs("an HMI card"), ["web/views", LIST]);
}

#[test]
fn what_a_card_lacks_is_found() {
    let card = "export const clock = {\n  place: \"left\",\n  create(app) {\n  },\n};\n";
    let list = "import { clock } from \"./clock.js\";\nexport const views = [\n  clock,\n];\n";
    let places = ["left"];
    assert_eq!(mistakes("clock", card, list, &places), Vec::<String>::new());
    assert_eq!(name_of("wall_clock"), "wallClock");
    for (card, list) in [
        (card.replace("clock =", "other ="), list.to_owned()),
        (card.replace("left", "attic"), list.to_owned()),
        (card.replace("create", "make"), list.to_owned()),
        (card.to_owned(), list.replace("import", "// import")),
        (card.to_owned(), list.replace("  clock,\n", "")),
    ] {
        assert_eq!(mistakes("clock", &card, &list, &places).len(), 1, "{card}{list}");
    }
}

#[test]
fn no_file_but_the_list_and_cards_that_share_a_part_names_a_card() {
    let naming = |folder: &str, ending: &str| files_where(folder, ending, |code| code.contains("views/"));
    assert_eq!(naming("web", ".js"), [Path::new("web/main.js")]);
    for (folder, ending) in [
        ("web", ".html"),
        ("web", ".css"),
        ("runtime", ".rs"),
        ("plc-api", ".rs"),
    ] {
        assert_eq!(naming(folder, ending), Vec::<std::path::PathBuf>::new());
    }
    let main = read("web/main.js".as_ref());
    let imports: Vec<_> = main
        .lines()
        .filter(|line| line.contains("from \"./views/"))
        .collect();
    assert_eq!(imports, ["import { views } from \"./views/index.js\";"]);
}
