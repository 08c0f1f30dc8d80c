//! Pages about the language: codes, addresses, functions, keywords and variables of a dialect, and the form
//! of its programs.

pub(super) mod elsewhere;
mod form;
mod symbols;

use tandem_interp::Dialect;
use tandem_interp::codes::{Code, ModalGroup, WordSpec};
use tandem_interp::dialect::OtherMCodes;
use tandem_interp::meaning::Role;
use tandem_model::limits::M_CODE_MAX;
use tandem_syntax::{Address, Function, Keyword, VariableKind};

use super::{indented, page};

/// Returns the pages of all language elements with this name.
pub(super) fn pages(what: &str, dialect: &Dialect) -> Vec<String> {
    let of_code = code(what, dialect).map(|code| of_code(code, what, dialect));
    let of_address = (Address::ALL.iter())
        .find(|address| address.text().eq_ignore_ascii_case(what))
        .and_then(|address| of_address(*address, dialect));
    let of_form = form::page_of(what, (dialect.grammar)());
    let mut pages: Vec<String> = of_code.into_iter().chain(of_address).chain(of_form).collect();
    if (dialect.grammar)().program_codes {
        let is_named = |name: &str| name.eq_ignore_ascii_case(what);
        let functions = Function::ALL.iter().filter(|function| is_named(function.text()));
        pages.extend(functions.map(|function| of_function(*function)));
        let keywords = Keyword::ALL.iter().filter(|keyword| is_named(keyword.text()));
        pages.extend(keywords.map(|keyword| of_keyword(*keyword)));
        let kinds = VariableKind::ALL.into_iter();
        let kinds = kinds.filter(|kind| is_variable(what, kind.prefix(), kind.index_max()));
        pages.extend(kinds.map(of_variable));
        pages.extend(symbols::page_of(what));
    }
    pages
}

/// Returns the names of all language elements that have a page.
pub(super) fn names(dialect: &Dialect) -> Vec<String> {
    let codes = dialect.g_codes.codes.iter().chain(dialect.m_codes.codes);
    let mut names: Vec<String> = codes.map(|code| code.code.to_owned()).collect();
    let addresses = Address::ALL.iter().copied();
    let addresses = addresses.filter(|address| of_address(*address, dialect).is_some());
    names.extend(addresses.map(|address| address.text().to_owned()));
    names.extend(form::names((dialect.grammar)()));
    if (dialect.grammar)().program_codes {
        names.extend(symbols::names());
        names.extend(Function::ALL.iter().map(|function| function.text().to_owned()));
        names.extend(Keyword::ALL.iter().map(|keyword| keyword.text().to_owned()));
        names.extend(VariableKind::ALL.iter().map(|kind| format!("{}0", kind.prefix())));
    }
    names
}

/// Returns the code that a user names, for example as `G2`, `g 02` or `M100`.
pub(super) fn code(what: &str, dialect: &Dialect) -> Option<&'static Code> {
    let (letter, number) = what.split_at_checked(1)?;
    let number = number.trim();
    if !number.starts_with(|digit: char| digit.is_ascii_digit()) {
        return None;
    }
    let value: f64 = number.parse().ok()?;
    let table = match letter {
        "G" | "g" => &dialect.g_codes,
        "M" | "m" => &dialect.m_codes,
        _ => return None,
    };
    let same = |code: &&Code| {
        let own: Result<f64, _> = code.code[1..].parse();
        own.is_ok_and(|own| (own - value).abs() < 1e-9)
    };
    let is_output = || {
        let in_range = value.fract().abs() < 1e-9 && value <= f64::from(M_CODE_MAX);
        letter.eq_ignore_ascii_case("m") && in_range
    };
    let listed = table.codes.iter().copied().find(|code| same(code));
    listed.or_else(|| is_output().then_some(dialect.auxiliary))
}

/// Returns the M number that a user names as `M12` or `m 12`.
pub(super) fn m_number(what: &str) -> Option<u16> {
    let (letter, number) = what.trim().split_at_checked(1)?;
    letter.eq_ignore_ascii_case("m").then_some(())?;
    number.trim().parse().ok().filter(|m| *m <= M_CODE_MAX)
}

fn of_code(code: &Code, what: &str, dialect: &Dialect) -> String {
    let is_output = std::ptr::eq(code, dialect.auxiliary);
    let name = if is_output {
        what.to_uppercase().replace(' ', "")
    } else {
        code.code.to_owned()
    };
    let undeclared = match dialect.policy.other_m_codes {
        OtherMCodes::Declared if is_output => {
            "The manual of the dialect does not list it: it is an error unless the configuration has a table m_code for it."
        }
        _ => "",
    };
    let words = dialect.words_of(code).map(|word| {
        let form = format!("{}_", word.address.text());
        if word.required { form } else { format!("[{form}]") }
    });
    let form: Vec<String> = std::iter::once(name.clone()).chain(words).collect();
    let usual = m_number(what).and_then(|m| dialect.usual_output(m).filter(|_| is_output));
    page(
        &name,
        usual.map_or(dialect.name_of(code), |usual| usual.name),
        &[
            indented(&form.join(" ")),
            in_force(code),
            usual.map_or("", |usual| usual.docs).to_owned(),
            dialect.docs_of(code).to_owned(),
            undeclared.to_owned(),
            restrictions(code, dialect),
            table(
                dialect.words_of(code).map(|word| (word.address.text(), word)),
                dialect,
            ),
            example(code, dialect),
        ],
    )
}

/// Returns an example program for a code, and the command that shows the effect of the program.
fn example(code: &Code, dialect: &Dialect) -> String {
    let Some(program) = dialect.example(code) else {
        return String::new();
    };
    format!(
        "Example:\n\n{}\n\nIn a file, such as example.nc, it is drawn by\n\n    tandem plot example.nc --dialect {} -o example.svg",
        indented(&program),
        dialect.name
    )
}

fn restrictions(code: &Code, dialect: &Dialect) -> String {
    let rows = tandem_interp::restrictions_of(code, dialect);
    if rows.is_empty() {
        return String::new();
    }
    let rows: Vec<String> = rows.iter().map(|row| format!("- {row}")).collect();
    format!("Restrictions:\n\n{}", rows.join("\n"))
}

fn in_force(code: &Code) -> String {
    match (code.group, code.role) {
        (ModalGroup::NonModal, Role::Auxiliary | Role::Call | Role::Return | Role::End | Role::Stop) => {
            String::new()
        }
        (ModalGroup::NonModal, _) => "It is in force for its block only.".to_owned(),
        (group, _) => format!(
            "Modal group {} ({}): it stays in force until another code of the group.",
            group.number(),
            group.text()
        ),
    }
}

/// Returns a table of words with meaning and range, one word per line.
fn table<'a>(rows: impl Iterator<Item = (&'a str, &'a WordSpec)>, dialect: &Dialect) -> String {
    let rows = rows.map(|(name, word)| {
        let whole = if word.integer { ", whole" } else { "" };
        let needed = if word.required { ", needed" } else { "" };
        format!(
            "    {name:<4} {}: {}{whole}{needed}",
            word.meaning,
            dialect.range_text(word)
        )
    });
    rows.collect::<Vec<_>>().join("\n")
}

fn of_address(address: Address, dialect: &Dialect) -> Option<String> {
    let codes = dialect.g_codes.codes.iter().chain(dialect.m_codes.codes);
    let codes = codes.copied().chain([dialect.auxiliary]);
    let of_codes = codes.filter_map(|code| Some((code.code, code.word(address)?)));
    let modal = dialect.modal_words.get(address).map(|word| ("", word));
    let rows: Vec<_> = modal.into_iter().chain(of_codes).collect();
    let is_known = (dialect.grammar)().addresses.contains(address);
    let title = "a word with these codes or, if no code precedes it, without a code in its block";
    (is_known && !rows.is_empty()).then(|| page(address.text(), title, &[table(rows.into_iter(), dialect)]))
}

fn of_function(function: Function) -> String {
    let arguments = if function.arguments() == 2 { "x, y" } else { "x" };
    let form = format!("    Q0 = {}({arguments})", function.text());
    let text = match function.domain() {
        "any" => "For any number.".to_owned(),
        domain => format!(
            "For {domain}. For other values the result is not a number (NaN), and a word with this value \
             raises alarm 10 (D07)."
        ),
    };
    page(function.text(), function.meaning(), &[form, text])
}

fn of_keyword(keyword: Keyword) -> String {
    let (form, meaning) = keyword.meaning();
    page(
        keyword.text(),
        "part of a program code",
        &[indented(form), meaning.to_owned()],
    )
}

/// Returns true if `what` is a variable with this name, either without an index or with a valid index.
fn is_variable(what: &str, prefix: &str, index_max: u16) -> bool {
    let Some((head, index)) = what.split_at_checked(prefix.len()) else {
        return false;
    };
    let exists = || index.parse().is_ok_and(|index: u16| index <= index_max);
    let is_long = prefix.len() > 1;
    head.eq_ignore_ascii_case(prefix) && ((is_long && index.is_empty()) || exists())
}

fn of_variable(kind: VariableKind) -> String {
    let name = kind.prefix();
    let title = format!("variables {name}0 to {name}{}", kind.index_max());
    page(name, &title, &[kind.meaning().to_owned()])
}
