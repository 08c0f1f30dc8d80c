//! What programs of FANUC controls, and of those like them, have around their blocks.

use tandem_syntax::{Address, NcProgram};

/// The text with the comments in parentheses that begin with `;`; of one without words only the `;` goes.
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

/// The first `;` that is in no parentheses.
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

/// True where an M code says that the program ends; these controls end it with its text, too.
pub(super) fn has_end(program: &NcProgram) -> bool {
    let ends =
        |word: &tandem_syntax::Word| word.address == Address::M && matches!(word.whole(), Some(2 | 30 | 99));
    program.all_words().iter().any(ends)
}
