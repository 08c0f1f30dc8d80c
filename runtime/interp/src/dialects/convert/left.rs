//! Finds the modal state that a line to be converted by hand sets for later lines.

use tandem_syntax::{Address, Token, TokenKind};

/// Returns true for G codes that are modal and have the same meaning in nj.
fn stays(code: u32) -> bool {
    matches!(code, 0..=3 | 17..=21 | 54..=59 | 80 | 90 | 91 | 98 | 99)
}

/// G codes in whose blocks the words have another meaning: data setting and macros.
const OTHER_WORDS: [u32; 4] = [10, 65, 66, 67];

/// G codes in whose blocks F is not a distance per minute: a time, a distance per revolution, the pitch of a
/// thread.
const OTHER_FEEDRATE: [u32; 5] = [4, 32, 33, 93, 95];

/// G codes in whose blocks S is not the spindle speed, but its limit or the cutting speed.
const OTHER_SPEED: [u32; 2] = [92, 96];

/// Returns the words of a line, each as its address and the text of its number.
fn words<'a>(
    line: &'a [Token],
    of: impl Fn(&Token) -> &'a str + Copy,
) -> impl Iterator<Item = (Address, &'a str)> {
    line.windows(2).filter_map(move |pair| match pair {
        [letters, number] if number.kind == TokenKind::Number => match letters.kind {
            TokenKind::Address(address) => Some((address, of(number))),
            _ => None,
        },
        _ => None,
    })
}

/// Returns the G codes of a line.
pub(super) fn codes<'a>(
    line: &'a [Token],
    of: impl Fn(&Token) -> &'a str + Copy,
) -> impl Iterator<Item = u32> {
    let codes = words(line, of).filter(|(address, _)| *address == Address::G);
    codes.filter_map(|(_, number)| number.parse().ok())
}

/// Returns the words of a line that remain modal and that are certain to be executed; `None` if the line has
/// no such word.
pub(super) fn in_force<'a>(line: &'a [Token], of: impl Fn(&Token) -> &'a str + Copy) -> Option<String> {
    let is_statement = |token: &Token| {
        let text = of(token);
        let letters = text.bytes().take_while(u8::is_ascii_alphabetic).count();
        token.kind == TokenKind::Skip
            || text.contains('=')
            || (token.kind == TokenKind::Unknown && letters > 1)
    };
    let is_comment = |token: &&Token| token.kind == TokenKind::Comment;
    if line.iter().filter(|token| !is_comment(token)).any(is_statement) {
        return None;
    }
    let has = |all: &[u32]| codes(line, of).any(|code| all.contains(&code));
    if has(&OTHER_WORDS) {
        return None;
    }
    let kept = words(line, of).filter(|(address, number)| match address {
        Address::G => number.parse().is_ok_and(stays),
        Address::F => !has(&OTHER_FEEDRATE),
        Address::S => !has(&OTHER_SPEED),
        _ => false,
    });
    let kept: Vec<String> = kept
        .map(|(address, number)| format!("{}{number}", address.text()))
        .collect();
    (!kept.is_empty()).then(|| kept.join(" "))
}
