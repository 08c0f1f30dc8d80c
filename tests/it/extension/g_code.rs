//! A G code costs one static, a dialect one more: checker and interpreter take both from outside.

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_interp::codes::feed_words::FEED_WORDS;
use tandem_interp::codes::g00_rapid::G00;
use tandem_interp::codes::g01_linear::G01;
use tandem_interp::codes::g90_g91_distance::{G90, G91};
use tandem_interp::codes::m_auxiliary::AUXILIARY;
use tandem_interp::codes::m02_m30_end::M30;
use tandem_interp::codes::{AXIS_WORDS, Code, CodeTable, WordSpec};
use tandem_interp::dialect::ModalWords;
use tandem_interp::execution::Execution;
use tandem_interp::{CheckContext, Dialect, Inputs, Interpreter, check_dialect};
use tandem_model::axis::{AXES_MAX, Axis, AxisSet, AxisVector};
use tandem_model::flow::{Action, AxisWords, Distance, Frame, Item};
use tandem_model::settings::{Tool, WorkOffsets};
use tandem_model::variables::Variables;
use tandem_runtime::Config;
use tandem_syntax::{Address, Grammar, parse};

/// G07 K: up by K mm, whatever G90 or G91 says.
static G07: Code = Code {
    code: "G07",
    tenths: 70,
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
    words.values[Axis::Z] = execution.words().get(Address::K).unwrap_or_default();
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
    restrictions: &[],
};

fn codes_of(text: &str) -> Vec<&'static str> {
    let (tree, mut diagnostics) = parse(text, (SHOP.grammar)());
    diagnostics.extend(check_dialect(&tree, &SHOP, &CheckContext::default()).diagnostics);
    diagnostics.iter().map(|one| one.code).collect()
}

#[test]
fn a_g_code_of_a_dialect_of_ones_own_is_checked_by_its_table() {
    assert_eq!(codes_of("G07 K5\nM30\n"), Vec::<&str>::new());
    assert_eq!(codes_of("G07 K51\nM30\n"), ["E0109"], "out of its range");
    assert_eq!(codes_of("G07\nM30\n"), ["E0111"], "K is needed");
    assert_eq!(codes_of("G61\nM30\n"), ["E0101"], "not in this dialect");
}

#[test]
fn a_g_code_of_a_dialect_of_ones_own_acts() {
    let machine = Config::demo().resolve().unwrap();
    let mut interpreter = Interpreter::with_dialect(&machine.coordinate_systems[0].settings, &SHOP);
    let (tree, diagnostics) = parse("X1\nG07 K5\nM30\n", (SHOP.grammar)());
    assert!(diagnostics.is_empty(), "{diagnostics:?}");
    interpreter.start(Arc::new(tree), 1);
    let (programs, work_offsets) = (BTreeMap::new(), WorkOffsets::default());
    let inputs = Inputs {
        programs: &programs,
        optional_skip: 0,
        work_offsets: &work_offsets,
        variables: &Variables::default(),
        tool: Some(Tool::default()),
        captured: Some([0.0; AXES_MAX]),
        position: Some(AxisVector::ZERO),
    };
    let mut actions = Vec::new();
    loop {
        match interpreter.next(&inputs).unwrap() {
            Item::Block(block) => actions.push(block.action),
            Item::End(_) => break,
            other => panic!("{other:?}"),
        }
    }
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
