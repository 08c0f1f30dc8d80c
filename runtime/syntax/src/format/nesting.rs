//! Nesting depth of the commands of a line within branches, loops and cases.

use crate::program_code::Keyword;
use crate::tokens::TokenKind;

/// A branch, loop or `switch` that is open around a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Frame {
    /// The keyword has a single command, unless braces follow.
    Single(Keyword),
    /// The keyword has commands in braces.
    Braces(Keyword),
}

/// Nesting of the program codes in a program without errors, updated token by token.
#[derive(Debug, Default)]
pub(super) struct IndentTracker {
    open: Vec<Frame>,
    /// Keywords of the constructs that the last command has ended, innermost first. An `else` may continue
    /// one of them.
    ended: Vec<Keyword>,
    /// The keyword whose parentheses are being read, and the number of open parentheses.
    head: Option<(Keyword, usize)>,
    /// True if the next `while` is the end of a `do`.
    do_ends: bool,
    /// True if the line has had words of a command.
    words: bool,
}

impl IndentTracker {
    /// Returns the indentation level of a line whose first token has this kind.
    pub fn begin_line(&mut self, first: Option<TokenKind>) -> usize {
        if first == Some(TokenKind::Keyword(Keyword::Else)) {
            self.reopen();
        }
        // commands of a case are a level below its label
        let level = |frame: &Frame| match frame {
            Frame::Braces(Keyword::Switch) => 2,
            _ => 1,
        };
        let before = match first {
            Some(TokenKind::Punctuation(b'}')) => self.open.last().map_or(0, level),
            Some(TokenKind::Punctuation(b'{') | TokenKind::Keyword(Keyword::Case | Keyword::Default)) => 1,
            _ => 0,
        };
        let levels: usize = self.open.iter().map(level).sum();
        levels.saturating_sub(before)
    }

    /// Updates the nesting after a token that is not a comment.
    pub fn pass(&mut self, kind: TokenKind) {
        match kind {
            TokenKind::Keyword(keyword) => {
                self.end_line();
                self.keyword(keyword);
            }
            TokenKind::Punctuation(b'(') => {
                if let Some((_, depth)) = &mut self.head {
                    *depth += 1;
                }
            }
            TokenKind::Punctuation(b')') => self.close_parenthesis(),
            TokenKind::Punctuation(b'{') => {
                if let Some(Frame::Single(keyword)) = self.open.pop() {
                    self.open.push(Frame::Braces(keyword));
                }
            }
            TokenKind::Punctuation(b'}') => {
                self.end_line();
                if let Some(Frame::Braces(keyword) | Frame::Single(keyword)) = self.open.pop() {
                    self.end_construct(keyword);
                }
            }
            TokenKind::Address(_) | TokenKind::Variable(_) if self.head.is_none() => self.words = true,
            _ => {}
        }
    }

    /// Ends the command if the line has words.
    pub fn end_line(&mut self) {
        if std::mem::take(&mut self.words) {
            self.end_command();
        }
    }

    fn keyword(&mut self, keyword: Keyword) {
        match keyword {
            Keyword::Else => {
                self.reopen();
                self.open.push(Frame::Single(keyword));
            }
            Keyword::Do => self.open.push(Frame::Single(keyword)),
            Keyword::If | Keyword::While | Keyword::Switch => {
                if keyword == Keyword::If && self.open.last() == Some(&Frame::Single(Keyword::Else)) {
                    // `else if` is indented by one level, not by two
                    self.open.pop();
                }
                self.head = Some((keyword, 0));
            }
            Keyword::Break => self.end_command(),
            Keyword::Case | Keyword::Default => {}
        }
    }

    fn close_parenthesis(&mut self) {
        let Some((keyword, depth)) = &mut self.head else {
            return;
        };
        *depth = depth.saturating_sub(1);
        if *depth > 0 {
            return;
        }
        let keyword = *keyword;
        self.head = None;
        if keyword == Keyword::While && std::mem::take(&mut self.do_ends) {
            self.end_command();
        } else {
            self.open.push(Frame::Single(keyword));
        }
    }

    /// Ends a command, and all constructs of which it is the only command.
    fn end_command(&mut self) {
        self.ended.clear();
        if let Some(Frame::Single(keyword)) = self.open.last().copied() {
            self.open.pop();
            self.end_construct(keyword);
        }
    }

    /// Ends the construct of a keyword, and all constructs of which it is the only command.
    fn end_construct(&mut self, mut keyword: Keyword) {
        self.ended.clear();
        loop {
            self.ended.push(keyword);
            if keyword == Keyword::Do {
                self.do_ends = true;
                return;
            }
            let Some(Frame::Single(outer)) = self.open.last().copied() else {
                return;
            };
            self.open.pop();
            keyword = outer;
        }
    }

    /// Reopens the constructs around the `if` to which an `else` belongs.
    fn reopen(&mut self) {
        if let Some(at) = self.ended.iter().position(|keyword| *keyword == Keyword::If) {
            let outer: Vec<_> = self.ended.drain(..).skip(at + 1).collect();
            self.open.extend(outer.into_iter().rev().map(Frame::Single));
        }
    }
}
