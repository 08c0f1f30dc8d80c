//! Pages about the form of a program: block numbers, block skip, comments, and the frame that some dialects
//! require.

use tandem_syntax::Grammar;

use super::super::{indented, page};

/// Form element of a program that has a page.
enum Form {
    BlockNumber,
    BlockSkip,
    Mark,
    ProgramNumber,
    Comment,
    BlockEnd,
}

/// Returns the names of all form elements of a dialect.
pub(super) fn names(grammar: &Grammar) -> Vec<String> {
    let form = grammar.program_form;
    let letters = [form.mark, form.number_letter].into_iter().flatten();
    let comments = grammar.line_comment.into_iter();
    let comments = comments.chain(grammar.block_comment.map(|(open, _)| open));
    let own = ["N", "/", "EOB"].into_iter().chain(comments).map(str::to_owned);
    own.chain(letters.map(|letter| char::from(letter).to_string()))
        .collect()
}

/// Returns the page of a form element; `what` is the element as a program contains it.
pub(super) fn page_of(what: &str, grammar: &Grammar) -> Option<String> {
    let (form, name) = find(what, grammar)?;
    let (title, lines, text) = match form {
        Form::BlockNumber => (
            "block number",
            "N10 G01 X5".to_owned(),
            "Stands before the other words of its block, after block skip. It names the block for people; \
             it has no effect."
                .to_owned(),
        ),
        Form::BlockSkip => ("block skip", "/ N10 G01 X5".to_owned(), block_skip(grammar)),
        Form::Mark => (
            "begin and end of the program",
            format!("{name}\nO1\nG90\nM30\n{name}"),
            "Must be alone on the first line: a program without it is not executed. The second one ends the \
             program, and \
             may be omitted."
                .to_owned(),
        ),
        Form::ProgramNumber => (
            "program number",
            format!("{name}1234"),
            format!(
                "Must be alone on the line after the first mark, once, with 1 to {} digits. It is shown, \
                 but is not the number \
                 under which the program is stored.",
                grammar.program_form.number_digits_max
            ),
        ),
        Form::Comment => ("comment", comments(grammar), comment(grammar).to_owned()),
        Form::BlockEnd => (
            "end of block",
            "X5\nY10".to_owned(),
            "A block ends with its line: a line feed, with or without a carriage return before it. No other \
             sign ends a block."
                .to_owned(),
        ),
    };
    Some(page(&name, title, &[indented(&lines), text]))
}

fn find(what: &str, grammar: &Grammar) -> Option<(Form, String)> {
    let is = |letter: Option<u8>| {
        let letter = letter.map(|letter| char::from(letter).to_string());
        letter.is_some_and(|letter| letter.eq_ignore_ascii_case(what))
    };
    let name = what.to_uppercase();
    let number = |digits: &str| {
        digits.is_empty()
            || digits
                .parse()
                .is_ok_and(|number: u8| (1..=grammar.block_skip_max).contains(&number))
    };
    let comments = grammar.line_comment.into_iter();
    let (open, close) = grammar.block_comment.unzip();
    let mut comments = comments.chain(open).chain(close);
    let is_pair = open.zip(close).is_some_and(|(open, close)| {
        let inside = what.strip_prefix(open).and_then(|rest| rest.strip_suffix(close));
        inside.is_some_and(|inside| inside.trim().is_empty())
    });
    let form = match what.strip_prefix('/') {
        _ if is_pair || comments.any(|mark| mark == what) => Form::Comment,
        _ if ["EOB", "<EOB>"].contains(&name.as_str()) => Form::BlockEnd,
        Some(digits) if number(digits) => Form::BlockSkip,
        _ if what.eq_ignore_ascii_case("n") => Form::BlockNumber,
        _ if is(grammar.program_form.mark) => Form::Mark,
        _ if is(grammar.program_form.number_letter) => Form::ProgramNumber,
        _ => return None,
    };
    Some((form, name))
}

fn block_skip(grammar: &Grammar) -> String {
    let numbers = match grammar.block_skip_max {
        1 => String::new(),
        max => format!(
            " / alone is /1, the others are /2 to /{max}. A block may have several of them \
                        (D13)."
        ),
    };
    let place = if grammar.program_codes {
        " It cannot precede program codes."
    } else {
        ""
    };
    format!(
        "The block is skipped if the input of block skip is on when the block is read, which is ahead of \
         the motion. \
         It precedes all other words on its line.{numbers}{place}"
    )
}

fn comments(grammar: &Grammar) -> String {
    let of_line = grammar.line_comment.map(|open| format!("X5 {open} to the wall"));
    let of_block = grammar
        .block_comment
        .map(|(open, close)| format!("X5 {open} to the wall {close}"));
    let lines: Vec<String> = of_line.into_iter().chain(of_block).collect();
    lines.join("\n")
}

fn comment(grammar: &Grammar) -> &'static str {
    match (grammar.line_comment, grammar.comment_spans_lines) {
        (None, _) => {
            "Ends on its line. A comment has no effect; the first comment of a program is its \
                      title."
        }
        (Some(_), _) => {
            "The first form ends with its line, the second form at the closing sign, on any line. A comment \
             has no effect; \
             the first comment of a program is its title."
        }
    }
}
