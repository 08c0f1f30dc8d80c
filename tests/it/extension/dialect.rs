//! A dialect with other numbers for the same meanings: planes, compensation, fixed cycles, restrictions and intermediate
//! code follow the meaning, and texts name the dialect's own codes.

use std::path::PathBuf;

use tandem_interp::codes::feed_words::FEED_WORDS;
use tandem_interp::codes::g00_rapid::G00;
use tandem_interp::codes::g01_linear::G01;
use tandem_interp::codes::g02_g03_arc::{G02, G03};
use tandem_interp::codes::g17_g18_g19_plane::{G17, G18};
use tandem_interp::codes::g20_g21_unit::{G20, G21};
use tandem_interp::codes::g28_g30_reference::G28;
use tandem_interp::codes::g40_g41_g42_cutter_compensation::{G40, G41, G42};
use tandem_interp::codes::g74_g84_tapping::{G80, G84};
use tandem_interp::codes::g90_g91_distance::{G90, G91};
use tandem_interp::codes::g98_g99_return_level::{G98, G99};
use tandem_interp::codes::m_auxiliary::AUXILIARY;
use tandem_interp::codes::m02_m30_end::M30;
use tandem_interp::codes::m99_return::M99;
use tandem_interp::codes::{AXIS_WORDS, Code, CodeTable};
use tandem_interp::dialect::{ModalWords, Policy};
use tandem_interp::dialects::texts::NO_TEXTS;
use tandem_interp::restrictions::USUAL;
use tandem_interp::{CheckContext, Dialect, check_source};
use tandem_model::flow::{Action, Compensation, Item};
use tandem_model::plane::Plane;
use tandem_model::settings::PathRules;
use tandem_syntax::{Grammar, Header, compile};

use super::runs::{blocks, findings, items, texts};
use super::{costs, files_where};

/// A code under another number.
const fn renamed(code: &'static str, of: &'static Code) -> Code {
    Code { code, ..*of }
}

static XY: Code = renamed("G117", &G17);
static ZX: Code = renamed("G118", &G18);
static OFF: Code = renamed("G140", &G40);
static LEFT: Code = renamed("G141", &G41);
static RIGHT: Code = renamed("G142", &G42);
static CANCEL: Code = renamed("G180", &G80);
static TAP: Code = renamed("G184", &G84);
static BACK: Code = renamed("M17", &M99);

static G_CODES: [&Code; 18] = [
    &G00, &G01, &G02, &G03, &XY, &ZX, &G20, &G21, &G28, &OFF, &LEFT, &RIGHT, &CANCEL, &TAP, &G90, &G91, &G98,
    &G99,
];
static M_CODES: [&Code; 2] = [&M30, &BACK];
static START_UP: [&Code; 7] = [&G01, &XY, &G21, &OFF, &CANCEL, &G90, &G98];

static RENAMED: Dialect = with_policy(Policy::NJ, Grammar::nj);

/// The dialect of other numbers that reads so.
pub const fn with_policy(policy: Policy, grammar: fn() -> &'static Grammar) -> Dialect {
    Dialect {
        name: "renamed",
        grammar,
        policy,
        g_codes: CodeTable::new(&G_CODES),
        m_codes: CodeTable::new(&M_CODES),
        auxiliary: &AUXILIARY,
        modal_words: ModalWords::new(&AXIS_WORDS, &FEED_WORDS),
        start_up: &START_UP,
        cycle_cancel: Some(&CANCEL),
        home: "G91 G28",
        block_end: "M999.002",
        path: PathRules::NJ,
        restrictions: &USUAL,
        texts: &NO_TEXTS,
    }
}

#[test]
fn planes_follow_their_meaning() {
    let blocks = blocks("G118 G02 X10 I5\nG117 X20 I5\nM30\n", &RENAMED);
    let planes = blocks.iter().map(|block| match &block.action {
        Action::Arc(arc) => arc.plane,
        other => panic!("{other:?}"),
    });
    assert_eq!(planes.collect::<Vec<_>>(), [Plane::Zx, Plane::Xy]);
    // K is a centre of the ZX plane only
    assert_eq!(findings("G118 G02 X10 K5\nM30\n", &RENAMED), Vec::<&str>::new());
    assert_eq!(findings("G117 G02 X10 K5\nM30\n", &RENAMED), ["E0122"]);
}

#[test]
fn compensation_follows_its_meaning() {
    let blocks = blocks("G142 X10\nG140 X20\nM30\n", &RENAMED);
    let [right, off] = &blocks[..] else {
        panic!("{blocks:?}")
    };
    let expected = Compensation::Right {
        radius: 5.0,
        plane: Plane::Xy,
    };
    assert_eq!(
        (right.compensation, off.compensation),
        (expected, Compensation::Off)
    );
}

#[test]
fn cycles_follow_their_meaning() {
    let text = "G184 X1 Z-5 R2 S100 F100\nG180\nM30\n";
    let items = items(text, &RENAMED).unwrap();
    let taps = items.iter().filter(|item| match item {
        Item::Block(block) => matches!(block.action, Action::Tap(_)),
        _ => false,
    });
    assert_eq!(taps.count(), 2, "in and out: {items:?}");
    let (_, check) = check_source(text, &RENAMED, &CheckContext::default());
    assert_eq!(check.m_codes, [3, 4, 5, 19]);
    let alarm = super::runs::items("G184 X1\nM30\n", &RENAMED).unwrap_err();
    assert_eq!(alarm.text, "the first block of a fixed cycle has no Z");
}

#[test]
fn restrictions_follow_their_meaning_and_name_the_codes_of_the_dialect() {
    let one = |text: &str, message: &str, help: &str| {
        assert_eq!(
            texts(text, &RENAMED),
            [(message.to_owned(), help.to_owned())],
            "{text}"
        );
    };
    one(
        "G141 X9\nG118\nG140 X0\nM30\n",
        "the plane changes during cutter compensation",
        "Write G140 and a lead-out first.",
    );
    one(
        "G141 X9\nM100 VA1\nG140 X0\nM30\n",
        "the program waits during cutter compensation",
        "Write it before G141 or G142, or after the lead-out.",
    );
    one(
        "G141 X9\nG28\nG140 X0\nM30\n",
        "G28 is not allowed during cutter compensation",
        "Write G140 and a lead-out before it.",
    );
    one(
        "G184 X1 Z-5 R2\nG90\nG180\nM30\n",
        "G90 is not allowed in a fixed cycle",
        "Write G180 before it.",
    );
    assert_eq!(findings("G41\nM30\n", &RENAMED), ["E0101"], "not in this dialect");
}

#[test]
fn intermediate_code_follows_the_meaning() {
    let text = "G184 X1 Z-5 R2\nX2\nG180\nX3\nM17\n";
    let (tree, check) = check_source(text, &RENAMED, &CheckContext::default());
    assert!(!check.has_errors(), "{check:?}");
    assert_eq!(
        compile(&tree, Header::Subprogram(1000), &RENAMED),
        "open subprog 1000\n\
         N1 G180.001 G184 X1 Z-5 R2 M999.002\n\
         N2 G184 X2 M999.002\n\
         N3 G180 M999.002\n\
         N4 X3 M999.002\n\
         N5 M17 M999.002 return\n\
         close\n"
    );
}

#[test]
fn a_dialect_is_named_by_the_list_of_dialects_alone() {
    let found = files_where("runtime/interp/src", ".rs", |code| code.contains("nj::NJ"));
    assert_eq!(found, [PathBuf::from("runtime/interp/src/dialects/mod.rs")]);
    assert_eq!(
        costs("a dialect"),
        ["runtime/interp/src/dialects", "dialects/mod.rs", "DIALECTS"]
    );
}
