//! A G code costs one static, a dialect another one: checker and interpreter accept both from outside.

use std::path::PathBuf;
use tandem_interp::Dialect;

use tandem_interp::codes::feed_words::FEED_WORDS;
use tandem_interp::codes::g00_rapid::G00;
use tandem_interp::codes::g01_linear::G01;
use tandem_interp::codes::g90_g91_distance::{G90, G91};
use tandem_interp::codes::m_auxiliary::AUXILIARY;
use tandem_interp::codes::m02_m30_end::M30;
use tandem_interp::codes::{AXIS_WORDS, Code, CodeTable, WordSpec};
use tandem_interp::dialect::{ModalWords, Policy};
use tandem_interp::dialects::texts::NO_TEXTS;
use tandem_interp::execution::Execution;
use tandem_model::axis::{Axis, AxisSet, AxisVector};
use tandem_model::flow::{Action, AxisWords, Distance, Frame};
use tandem_model::settings::PathRules;
use tandem_syntax::{Address, Grammar};

use super::runs::{blocks, findings};
use super::{costs, files_where};

/// G07 K: up by K mm, with G90 and G91.
static G07: Code = Code {
    code: "G07",
    name: "Lift",
    words: &[WordSpec::new(Address::K, "way up", "mm", 0.0, 50.0).needed()],
    docs: "Lifts Z by K at rapid speed.",
    select: lift,
    ..Code::BASE
};

fn lift(execution: &mut Execution<'_>) {
    let mut words = AxisWords {
        values: AxisVector::ZERO,
        named: AxisSet::EMPTY,
        distance: Distance::Incremental,
        frame: Frame::Work,
    };
    words.values[Axis::Z] = execution.words.get(Address::K).unwrap_or_default();
    words.named.insert(Axis::Z);
    execution.act(Action::Rapid(words));
}

static SHOP: Dialect = Dialect {
    name: "shop",
    grammar: Grammar::nj,
    g_codes: CodeTable::new(&[&G00, &G01, &G07, &G90, &G91]),
    m_codes: CodeTable::new(&[&M30]),
    auxiliary: &AUXILIARY,
    modal_words: ModalWords::new(&AXIS_WORDS, &FEED_WORDS),
    start_up: &[&G00, &G90],
    cycle_cancel: None,
    home: "",
    block_end: "M999.002",
    policy: Policy::NJ,
    path: PathRules::NJ,
    restrictions: &[],
    texts: &NO_TEXTS,
};

#[test]
fn a_g_code_of_a_dialect_of_ones_own_is_checked_by_its_table() {
    assert_eq!(findings("G07 K5\nM30\n", &SHOP), Vec::<&str>::new());
    assert_eq!(findings("G07 K51\nM30\n", &SHOP), ["E0109"], "out of its range");
    assert_eq!(findings("G07\nM30\n", &SHOP), ["E0111"], "K is needed");
    assert_eq!(findings("G61\nM30\n", &SHOP), ["E0101"], "not in this dialect");
}

#[test]
fn a_g_code_of_a_dialect_of_ones_own_acts() {
    let actions = blocks("X1\nG07 K5\nM30\n", &SHOP).into_iter();
    let actions: Vec<Action> = actions.map(|block| block.action).collect();
    let [Action::Rapid(first), Action::Rapid(second)] = &actions[..] else {
        panic!("{actions:?}");
    };
    assert_eq!(
        (first.distance, first.values[Axis::X].to_bits()),
        (Distance::Absolute, 1.0_f64.to_bits())
    );
    assert_eq!(
        (second.distance, second.values[Axis::Z].to_bits()),
        (Distance::Incremental, 5.0_f64.to_bits())
    );
}

/// Product files that name a file of codes.
pub fn naming(file: &str) -> Vec<PathBuf> {
    files_where("runtime", ".rs", |code| code.contains(file))
}

#[test]
fn a_g_code_is_named_by_its_module_and_by_its_row_in_a_dialect_alone() {
    let codes = "runtime/interp/src/codes";
    let rows = |dialects: &[&str]| {
        let of_dialects = dialects
            .iter()
            .map(|name| format!("runtime/interp/src/dialects/{name}.rs"));
        let module = "runtime/interp/src/codes/mod.rs".to_owned();
        std::iter::once(module)
            .chain(of_dialects)
            .map(PathBuf::from)
            .collect::<Vec<_>>()
    };
    assert_eq!(naming("g31_skip"), rows(&["nj"]));
    assert_eq!(naming("g39_corner"), rows(&["dgshape"]));
    for shared in ["g17_g18_g19_plane", "g40_g41_g42_cutter_compensation"] {
        assert_eq!(naming(shared), rows(&["dgshape", "nj"]), "{shared}");
    }
    assert_eq!(
        costs("a G code that needs no new kind of motion"),
        [codes, "codes/mod.rs", "dialects/nj.rs"]
    );
}
