//! Completion at a position in a program.

use lsp_types::{CompletionItem, CompletionItemKind, Documentation, Position};
use tandem_interp::Dialect;
use tandem_interp::codes::{Code, WordSpec};
use tandem_interp::meaning::Role;
use tandem_syntax::{Address, Function, Keyword, Token, TokenKind, VariableKind};

use super::document::Document;
use super::features::codes;

/// Words without a code that are allowed in every block except a dwell.
const OF_EVERY_BLOCK: [Address; 5] = [Address::F, Address::S, Address::Ta, Address::Td, Address::Ts];

/// Kind of the place at which the user completes text.
enum CompletionPlace {
    /// Between the words of a block, or in an empty block.
    Block,
    /// Within an expression or a condition.
    Expression,
    /// Within the bracket of an indirect variable.
    Brackets,
}

/// Returns the completion items at a position: words of the preceding codes, codes, and program codes.
pub(super) fn completion(document: &Document, at: Position) -> Vec<CompletionItem> {
    let byte = document.offset(at);
    let mut line = document.line_at(byte);
    line.retain(|token| token.span.end as usize <= byte);
    if in_comment(document, byte) {
        return Vec::new();
    }
    let dialect = document.target.dialect;
    if !(dialect.grammar)().program_codes {
        return block(document, &line);
    }
    match completion_place(document, &line) {
        CompletionPlace::Brackets => variables().collect(),
        CompletionPlace::Expression => variables().chain(functions()).collect(),
        CompletionPlace::Block => {
            let mut items = block(document, &line);
            items.extend(Keyword::ALL.iter().map(|keyword| keyword_item(*keyword)));
            items.extend(functions());
            items
        }
    }
}

fn completion_place(document: &Document, line: &[Token]) -> CompletionPlace {
    let is = |token: &Token, text: &str| document.text_at(token.span) == text;
    let opened = |open: &str, close: &str| {
        let opens = line.iter().filter(|token| is(token, open)).count();
        opens > line.iter().filter(|token| is(token, close)).count()
    };
    let assigns = matches!(
        line,
        [first, ..] if matches!(first.kind, TokenKind::Variable(_))
    );
    if opened("[", "]") {
        CompletionPlace::Brackets
    } else if opened("(", ")") || (assigns && line.iter().any(|token| is(token, "="))) {
        CompletionPlace::Expression
    } else {
        CompletionPlace::Block
    }
}

/// Returns the words and codes that a block allows.
fn block(document: &Document, line: &[Token]) -> Vec<CompletionItem> {
    let dialect = document.target.dialect;
    let mut items = words(&codes(document, line), dialect);
    let all = dialect.g_codes.codes.iter().chain(dialect.m_codes.codes);
    items.extend(all.map(|code| {
        item(
            code.code,
            CompletionItemKind::KEYWORD,
            dialect.name_of(code),
            dialect.docs_of(code),
        )
    }));
    items.extend(outputs(document));
    items
}

fn keyword_item(keyword: Keyword) -> CompletionItem {
    let (form, meaning) = keyword.meaning();
    item(
        keyword.text(),
        CompletionItemKind::KEYWORD,
        form.lines().next().unwrap_or_default(),
        meaning,
    )
}

fn functions() -> impl Iterator<Item = CompletionItem> {
    Function::ALL.iter().map(|function| {
        item(
            function.text(),
            CompletionItemKind::FUNCTION,
            function.meaning(),
            function.domain(),
        )
    })
}

fn variables() -> impl Iterator<Item = CompletionItem> {
    VariableKind::ALL.into_iter().map(|kind| {
        let name = kind.prefix();
        let detail = format!("{name}0 to {name}{}", kind.index_max());
        CompletionItem {
            // Sorts the variables before the functions.
            sort_text: Some(format!("!{name}")),
            ..item(name, CompletionItemKind::VARIABLE, &detail, kind.meaning())
        }
    })
}

fn in_comment(document: &Document, byte: usize) -> bool {
    let inside = |token: &Token| (token.span.start as usize) < byte && byte <= token.span.end as usize;
    let mut comments = document.tokens().filter(|token| token.kind == TokenKind::Comment);
    comments.any(|token| inside(&token) && !document.text_at(token.span).ends_with(['/', ')']))
}

fn item(label: &str, kind: CompletionItemKind, detail: &str, docs: &str) -> CompletionItem {
    CompletionItem {
        label: label.to_owned(),
        kind: Some(kind),
        detail: Some(detail.to_owned()),
        documentation: Some(Documentation::String(docs.to_owned())),
        ..CompletionItem::default()
    }
}

/// Returns the words of the codes; if no code has words, returns the words that need no code.
fn words(codes: &[&Code], dialect: &Dialect) -> Vec<CompletionItem> {
    let of_word = |word: &WordSpec| {
        let needed = if word.required { ", needed" } else { "" };
        let detail = format!("{}: {}{needed}", word.meaning, dialect.range_text(word));
        CompletionItem {
            // Sorts the words before the codes.
            sort_text: Some(format!("!{}", word.address.text())),
            ..item(word.address.text(), CompletionItemKind::PROPERTY, &detail, "")
        }
    };
    let own: Vec<_> = codes.iter().flat_map(|code| dialect.words_of(code)).collect();
    if !own.is_empty() {
        let rests = codes.iter().any(|code| code.role == Role::Dwell);
        let others = OF_EVERY_BLOCK
            .iter()
            .filter(|address| !rests && own.iter().all(|word| word.address != **address))
            .filter_map(|address| dialect.modal_words.get(*address));
        return own.iter().copied().chain(others).map(of_word).collect();
    }
    let known = Address::ALL.iter().filter(|address| {
        let addresses = (dialect.grammar)().addresses;
        addresses.contains(**address)
    });
    let modal = known.filter_map(|address| dialect.modal_words.get(*address));
    modal.map(of_word).collect()
}

/// Returns the M codes of the manual and those of the configuration.
fn outputs(document: &Document) -> Vec<CompletionItem> {
    let target = &document.target;
    let known = target.machine.as_ref().map(|machine| &machine.m_codes);
    let usual = target.dialect.usual_outputs().iter();
    let usual = usual.filter(|usual| known.is_none_or(|known| !known.contains_key(&usual.m)));
    let mut items: Vec<_> = usual
        .map(|usual| {
            let label = format!("M{:02}", usual.m);
            item(&label, CompletionItemKind::EVENT, usual.name, usual.docs)
        })
        .collect();
    let Some(machine) = &target.machine else {
        return items;
    };
    let of_output = |(number, settings): (&u16, &tandem_runtime::MCodeSettings)| {
        let mut facts: Vec<String> = settings.wait_state.iter().cloned().collect();
        if let Some(limit) = settings.timeout_ms {
            facts.push(format!("reset within {limit} ms"));
        }
        let usual = target.dialect.usual_output(*number);
        let name = usual.map_or(String::new(), |usual| format!("{}, ", usual.name));
        let detail = format!("{name}output of {}", machine.name);
        item(
            &format!("M{number:02}"),
            CompletionItemKind::EVENT,
            &detail,
            &facts.join(", "),
        )
    };
    items.extend(machine.m_codes.iter().map(of_output));
    items
}
