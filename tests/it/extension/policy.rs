//! Choices of a dialect: two codes of a group, the time at which M codes act, numbers without a point, comments, and
//! the text around a program.

use tandem_interp::Dialect;
use tandem_interp::dialect::{GroupConflict, MCodeTime, Numbers, Policy};
use tandem_model::flow::Item;
use tandem_syntax::{Grammar, ProgramForm, parse};

use super::dialect::with_policy;
use super::runs::{blocks, findings, items, shown};

static LAST_HOLDS: Dialect = with_policy(
    Policy {
        rivals: GroupConflict::LastHolds,
        ..Policy::NJ
    },
    Grammar::nj,
);

static M_FIRST: Dialect = with_policy(
    Policy {
        m_code: MCodeTime::BeforeMotion,
        ..Policy::NJ
    },
    Grammar::nj,
);

static MICROMETRES: Dialect = with_policy(
    Policy {
        numbers: Numbers::Counted,
        ..Policy::NJ
    },
    Grammar::nj,
);

static AS_WRITTEN: Dialect = with_policy(Policy::NJ, Grammar::nj);

static ISO: Dialect = with_policy(Policy::NJ, iso);

fn iso() -> &'static Grammar {
    static GRAMMAR: std::sync::LazyLock<Grammar> = std::sync::LazyLock::new(|| Grammar {
        name: "iso",
        addresses: Grammar::nj().addresses,
        line_comment: Some(";"),
        block_comment: Some(("(", ")")),
        comment_spans_lines: true,
        block_skip_max: 31,
        program_codes: false,
        program_form: ProgramForm {
            mark: Some(b'%'),
            number_letter: Some(b'O'),
            number_digits_max: 8,
        },
        sections: &[],
        foreign: &[],
    });
    &GRAMMAR
}

fn moves(text: &str, dialect: &'static Dialect) -> Vec<String> {
    let blocks = blocks(text, dialect);
    blocks.iter().map(|block| shown(&block.action)).collect()
}

#[test]
fn the_last_code_of_a_group_holds_or_two_are_an_error() {
    let text = "G00 G91 G01 G90 X5\nM30\n";
    assert_eq!(findings(text, &AS_WRITTEN), ["E0106", "E0106"]);
    assert_eq!(findings(text, &LAST_HOLDS), Vec::<&str>::new());
    assert_eq!(moves(text, &LAST_HOLDS), ["linear X5"]);
    // codes without a group do not exclude each other
    assert_eq!(findings("G28 G28\nM30\n", &LAST_HOLDS), ["E0106"]);
}

#[test]
fn an_m_code_acts_behind_the_motion_of_its_block_or_before_it() {
    let order = |dialect| {
        let items = items("X5 M08\nX6 M09\nM30\n", dialect).unwrap().into_iter();
        let names = items.map(|item| match item {
            Item::Block(block) => shown(&block.action),
            Item::Output(output) => format!("M{:02}", output.m),
            other => panic!("{other:?}"),
        });
        names.collect::<Vec<_>>()
    };
    assert_eq!(order(&AS_WRITTEN), ["linear X5", "M08", "linear X6", "M09"]);
    assert_eq!(order(&M_FIRST), ["M08", "linear X5", "M09", "linear X6"]);
    // the end of the program remains after the motion
    assert_eq!(moves("X5 M30\n", &M_FIRST), ["linear X5"]);
}

#[test]
fn a_length_without_a_point_is_as_written_or_in_increments() {
    let text = "X2500 Y2.5\nG20 X10000\nM30\n";
    assert_eq!(moves(text, &AS_WRITTEN), ["linear X2500 Y2.5", "linear X254000"]);
    // 2500 of 0.001 mm; 10000 of 0.0001 inch are one inch of 25.4 mm
    assert_eq!(moves(text, &MICROMETRES), ["linear X2.5 Y2.5", "linear X25.4"]);
    // an arc of radius 5000 increments; F and the M code are no lengths
    let arc = "G02 X10. R5000 F100 M08\nM30\n";
    assert_eq!(findings(arc, &MICROMETRES), Vec::<&str>::new());
    assert_eq!(
        findings("G02 X10. R4000\nM30\n", &MICROMETRES),
        Vec::<&str>::new(),
        "where it begins is unknown"
    );
    assert_eq!(
        findings("G00 X0\nY0\nG02 X10. R4000\nM30\n", &MICROMETRES),
        ["E0122"]
    );
    // numbers without a point have at most eight digits, and the range of the word applies to their meaning
    assert_eq!(findings("X99999999\nM30\n", &MICROMETRES), Vec::<&str>::new());
    assert_eq!(findings("X999999999\nM30\n", &MICROMETRES), ["E0109"]);
    assert_eq!(findings("X99999999\nM30\n", &AS_WRITTEN), ["E0109"]);
}

#[test]
fn comments_and_the_form_of_a_program_are_the_grammars() {
    let text = "%\nO0012 (plate\n2 sides)\nG01 X10 ; to 10\n(back) X0\nM30\n%\nnot read ???\n";
    assert_eq!(findings(text, &ISO), Vec::<&str>::new());
    assert_eq!(moves(text, &ISO), ["linear X10", "linear X0"]);
    let (program, _) = parse(text, iso());
    assert_eq!((program.number(), program.is_complete()), (Some(12), true));
    let (program, found) = parse("O99999999999\nM30\n", iso());
    assert_eq!((program.number(), found.len()), (None, 1));
    // neither is part of a dialect whose grammar does not name it
    let (program, found) = parse("%\nO12\nM30\n", Grammar::nj());
    assert_eq!((program.number(), found.is_empty()), (None, false));
    assert!(!parse("X1 ; a\n", Grammar::nj()).1.is_empty());
    assert!(!parse("X1 // a\n", iso()).1.is_empty());
}
