//! Properties that hold for every text, one for each stage. The robustness tests and the fuzzers of
//! `tests/fuzz` check texts with these functions; each function panics if its property does not hold.

#![allow(dead_code, reason = "a fuzzer examines one stage")]

use std::collections::BTreeMap;
use std::sync::Arc;

use tandem_interp::dialects::{dgshape, nj};
use tandem_interp::{Check, CheckContext, Dialect, Inputs, Interpreter, NO_TOOLS, check_source};
use tandem_model::flow::Item;
use tandem_model::settings::{CoordinateSystemSettings, Tool, WorkOffsets};
use tandem_model::variables::{VariableArray, Variables};
use tandem_model::{Alarm, AxisVector, Diagnostic};
use tandem_syntax::{
    DIAGNOSTICS_MAX, Header, LineIndex, NcProgram, Token, TokenKind, block_bytes, compile, format, parse,
    tokens,
};

/// Maximum number of items for which a program is run.
const ITEMS: usize = 200;

/// Checks all properties.
pub fn all(source: &str) {
    words_are_what_the_text_says(source);
    parsing_gives_a_sound_tree(source);
    the_layout_changes_only_blanks_and_case(source);
    checking_gives_bounded_findings(source);
    what_checks_clean_runs_clean(source);
}

/// Checks the lexer: words are in the order of the text and do not overlap, each number is the double nearest
/// to the written number, and each block has its line number.
pub fn words_are_what_the_text_says(source: &str) {
    in_each_dialect(|dialect| words_of_dialect(source, dialect));
}

fn in_each_dialect(examine: impl Fn(&'static Dialect)) {
    [nj(), dgshape()].into_iter().for_each(examine);
}

fn words_of_dialect(source: &str, dialect: &'static Dialect) {
    let (program, _) = parse(source, (dialect.grammar)());
    let index = LineIndex::new(source);
    let mut end = 0;
    for block in program.blocks() {
        assert_eq!(
            index.locate(program.span(block).start).0,
            block.line,
            "{source:?}"
        );
        if block.has_errors() {
            // it may hold what another block of the line holds, and is never run
            continue;
        }
        for word in program.words(block) {
            let span = word.span();
            assert!(
                span.start >= end && span.start < span.end,
                "{word:?} in {source:?}"
            );
            end = span.end;
            let text = &source[span.start as usize..end as usize];
            let digits = text
                .trim_start_matches(|letter: char| letter.is_ascii_alphabetic())
                .trim();
            if let (Ok(expected), Some(value)) = (digits.parse::<f64>(), word.number()) {
                assert_eq!(value.to_bits(), expected.to_bits(), "{text:?}");
            }
        }
    }
}

/// Checks the parser: findings are within the text, branches lead to blocks, and the tree can be written as
/// intermediate code.
pub fn parsing_gives_a_sound_tree(source: &str) {
    in_each_dialect(|dialect| tree_of_dialect(source, dialect));
}

fn tree_of_dialect(source: &str, dialect: &'static Dialect) {
    let (program, findings) = parse(source, (dialect.grammar)());
    examine_findings(source, &findings);
    assert!(findings.len() <= DIAGNOSTICS_MAX + 1);
    let blocks = program.blocks().len();
    for block in program.blocks() {
        let code = program.program_code(block);
        let target = code.and_then(|code| code.to).unwrap_or_default() as usize;
        assert!(
            target <= blocks,
            "a branch leads to {target} of {blocks} in {source:?}"
        );
        let _ = block_bytes(&program, block, Some("G84"), dialect);
    }
    for header in [Header::Program(1), Header::Subprogram(1000)] {
        assert!(compile(&program, header, dialect).ends_with("close\n"));
    }
}

/// Checks formatting: only blanks and letter case change, so that the intermediate code and the findings stay
/// the same. Formatting a formatted text changes nothing. Tokens omit only blanks.
pub fn the_layout_changes_only_blanks_and_case(source: &str) {
    in_each_dialect(|dialect| layout_of_dialect(source, dialect));
}

fn layout_of_dialect(source: &str, dialect: &'static Dialect) {
    let grammar = (dialect.grammar)();
    let mut end = if source.starts_with('\u{feff}') { 3 } else { 0 };
    for token in tokens(source, grammar) {
        let (start, next) = (token.span.start as usize, token.span.end as usize);
        let between = &source[end..start];
        assert!(
            between.chars().all(|c| " \t\r".contains(c)),
            "{between:?} in {source:?}"
        );
        assert!(start < next, "{token:?} in {source:?}");
        end = next;
    }
    let Ok(laid_out) = format(source, grammar) else {
        return;
    };
    assert_eq!(
        format(&laid_out, grammar).as_deref(),
        Ok(laid_out.as_str()),
        "of {source:?}"
    );
    let squeezed = |text: &str| text.to_ascii_lowercase().replace([' ', '\t', '\r'], "");
    assert_eq!(squeezed(&laid_out).trim_end(), squeezed(source).trim_end());
    assert_eq!(
        comments(&laid_out, dialect),
        comments(source, dialect),
        "of {source:?}"
    );
    let said = |text: &str| {
        let (program, findings) = parse(text, grammar);
        let codes: Vec<_> = findings.iter().map(|found| found.code).collect();
        (compile(&program, Header::Program(1), dialect), codes)
    };
    assert_eq!(said(&laid_out), said(source), "{laid_out:?} of {source:?}");
}

/// Returns the comments of a text without the blanks at their line ends.
fn comments(source: &str, dialect: &'static Dialect) -> Vec<String> {
    let of = |token: &Token| source[token.span.start as usize..token.span.end as usize].replace("\r\n", "\n");
    let all = tokens(source, (dialect.grammar)());
    let comments = all.filter(|token| token.kind == TokenKind::Comment);
    comments
        .map(|token| of(&token).trim_end_matches([' ', '\t', '\r']).to_owned())
        .collect()
}

/// Checks the checker: findings are within the text, their number is bounded, and they are the same each
/// time.
pub fn checking_gives_bounded_findings(source: &str) {
    in_each_dialect(|dialect| {
        let (_, check) = checked(source, dialect);
        let (_, again) = checked(source, dialect);
        assert_eq!(check, again, "{source:?}");
        // errors and warnings of parser and checker, and the note that further findings are not listed
        assert!(check.diagnostics.len() <= 4 * (DIAGNOSTICS_MAX + 1));
        examine_findings(source, &check.diagnostics);
    });
}

/// Checks the interpreter: every text runs for a number of items; a text without findings causes no alarm
/// that it shows.
pub fn what_checks_clean_runs_clean(source: &str) {
    in_each_dialect(|dialect| clean_of_dialect(source, dialect));
}

fn clean_of_dialect(source: &str, dialect: &'static Dialect) {
    let (program, check) = checked(source, dialect);
    let program = Arc::new(program);
    for optional_skip in [0, 1, u32::MAX] {
        let alarm = run(&program, optional_skip, dialect);
        // a program without findings may only calculate a wrong value, miss a program that it calls, run
        // without end or past its last block by a branch, or break a rule that the text alone does not show
        let allowed = matches!(alarm, None | Some(10 | 11 | 20..=23 | 40..=43));
        assert!(
            check.has_errors() || allowed,
            "alarm {alarm:?} without an error in {source:?}"
        );
    }
}

fn checked(source: &str, dialect: &'static Dialect) -> (NcProgram, Check) {
    check_source(source, dialect, &CheckContext::default())
}

fn examine_findings(source: &str, findings: &[Diagnostic]) {
    let index = LineIndex::new(source);
    for finding in findings {
        let (start, end) = (finding.span.start as usize, finding.span.end as usize);
        assert!(
            start <= end && end <= source.len().max(1),
            "{finding:?} in {source:?}"
        );
        assert!(
            start >= source.len() || source.is_char_boundary(start),
            "{finding:?} in {source:?}"
        );
        let (line, column) = index.locate(finding.span.start);
        assert!(line >= 1 && column >= 1 && !finding.message.is_empty() && !finding.help.is_empty());
    }
}

/// Runs a program, which may call itself as program 1000. Returns the number of the alarm that ended it.
fn run(program: &Arc<NcProgram>, optional_skip: u32, dialect: &'static Dialect) -> Option<u16> {
    let programs = BTreeMap::from([(1000, Arc::clone(program))]);
    let ran = run_with(
        program,
        &programs,
        &few_variables(),
        optional_skip,
        dialect,
        ITEMS,
    );
    ran.err().map(|alarm| alarm.entry.number)
}

/// Returns P0 to P63 and Q0 to Q63.
pub fn few_variables() -> Variables {
    Variables {
        global: VariableArray::new(64),
        coordinate_system: VariableArray::new(64),
    }
}

/// Runs a program until its end, an alarm, or the maximum number of items.
pub fn run_with(
    main: &Arc<NcProgram>,
    programs: &BTreeMap<u16, Arc<NcProgram>>,
    variables: &Variables,
    optional_skip: u32,
    dialect: &'static Dialect,
    items: usize,
) -> Result<(), Alarm> {
    let mut interpreter = Interpreter::new(&CoordinateSystemSettings::default(), dialect);
    interpreter.start(Arc::clone(main), 1);
    for _ in 0..items {
        let item = interpreter.next(&Inputs {
            tools: &NO_TOOLS,
            programs,
            optional_skip,
            work_offsets: &WorkOffsets::default(),
            variables,
            tool: Some(Tool::default()),
            captured: Some([0.0; 8]),
            position: Some(AxisVector::ZERO),
        })?;
        if matches!(item, Item::End(_)) {
            break;
        }
    }
    Ok(())
}
