//! Comments, program numbers and ends in programs of FANUC and similar controls.

use tandem_syntax::{Address, Grammar, NcProgram, Token, TokenKind, Word, tokens};

use super::state::Source;

/// Returns the text with each comment that begins with `;` written in parentheses. Removes a `;` without
/// words after it.
pub(super) fn comments_in_parentheses(source: &str) -> String {
    let mut read = String::with_capacity(source.len());
    for line in source.split_inclusive('\n') {
        let (line, end) = match line.find(['\r', '\n']) {
            Some(at) => line.split_at(at),
            None => (line, ""),
        };
        match semicolon(line) {
            None => read.push_str(line),
            Some(at) => {
                read.push_str(&line[..at]);
                let comment = line[at + 1..].replace(['(', ')'], " ");
                if !comment.trim().is_empty() {
                    read.push('(');
                    read.push_str(&comment);
                    read.push(')');
                }
            }
        }
        read.push_str(end);
    }
    read
}

/// Returns the position of the first `;` outside parentheses.
fn semicolon(line: &str) -> Option<usize> {
    let mut is_comment = false;
    line.bytes().position(|byte| {
        match byte {
            b'(' => is_comment = true,
            b')' => is_comment = false,
            _ => {}
        }
        byte == b';' && !is_comment
    })
}

/// Returns the byte position of the line at which a further program begins: the line of a program number after
/// another program number, or after blocks without one. Only a program number that is alone on its line counts.
pub(super) fn second_program(text: &str, grammar: &'static Grammar, from: Source) -> Option<usize> {
    if from != Source::Fanuc {
        return None;
    }
    let tokens: Vec<Token> = tokens(text, grammar).collect();
    let lines = tokens.split(|token| token.kind == TokenKind::LineEnd);
    let mut has_begun = false;
    let second = lines.filter_map(|line| {
        let mut code = line
            .iter()
            .filter(|token| !matches!(token.kind, TokenKind::Comment | TokenKind::Mark));
        let first = code.next()?;
        let is_number = first.kind == TokenKind::ProgramNumber && code.next().is_none();
        let is_further = std::mem::replace(&mut has_begun, true) && is_number;
        Some(is_further.then_some(first.span.start as usize))
    });
    let second = second.flatten().next()?;
    Some(text[..second].rfind('\n').map_or(0, |end| end + 1))
}

/// M codes that end a main program.
const MAIN_ENDS: [u32; 2] = [2, 30];

/// M code that ends a subprogram.
const RETURN: u32 = 99;

fn has(program: &NcProgram, is_meant: impl Fn(u32) -> bool) -> bool {
    let mut words = program.all_words().iter();
    words.any(|word| word.address == Address::M && word.whole().is_some_and(&is_meant))
}

/// Returns true if the last end in the program is that of a subprogram. An M02 or M30 before it is in a branch.
pub(super) fn is_subprogram(program: &NcProgram) -> bool {
    let is_end = |word: &&Word| {
        let is_known = |m: u32| m == RETURN || MAIN_ENDS.contains(&m);
        word.address == Address::M && word.whole().is_some_and(is_known)
    };
    let last = program.all_words().iter().rfind(is_end);
    last.is_some_and(|word| word.whole() == Some(RETURN))
}

/// Returns true if an M code ends the program. Otherwise, these controls end the program at the end of its
/// text.
pub(super) fn has_end(program: &NcProgram) -> bool {
    has(program, |m| m == RETURN || MAIN_ENDS.contains(&m))
}
