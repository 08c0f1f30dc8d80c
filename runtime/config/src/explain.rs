//! Explanations of every name that a user sees. Each name has a page, written from the tables that the product itself
//! uses.

mod language;

use self::language::elsewhere;
use plc_protocol::alarm::USER_ALARM_BASE;
use plc_protocol::types::alarm_text::{AlarmText, AlarmWords};
use plc_protocol::types::explained::ExplainedWord;
use plc_protocol::types::words::words;
use tandem_interp::Dialect;
use tandem_model::alarm::{ALARMS, After, AlarmEntry};
use tandem_structured_text::{FINDINGS, FindingEntry};
use tandem_syntax::{DIAGNOSTICS, DiagnosticEntry};

use crate::declared::SourcedDeclaration;
use crate::{Config, ConfigKey};

/// Tables of rules; each row has the number and the text of a rule.
const RULES: [&[(&str, &str)]; 3] = [
    tandem_interp::dialects::decisions::DECISIONS,
    tandem_motion::rules::RULES,
    plc_protocol::handshake::rules::RULES,
];

/// Number of characters of a name that are compared. Reason: the time to find the nearest name grows with the product
/// of both lengths.
const NAME_MAX: usize = 100;

/// Highest alarm code that a sequence program can use.
const USER_ALARM_CODE_MAX: u16 = 9999;

/// Returns the explanation of a name, or `None` if the name is unknown. Names are: a diagnostic (`E0105`), an alarm
/// (`alarm 412` or `412`), a code (`G02`), an address, a function, a keyword or a variable of the dialect, a word of a
/// state, a refusal or an answer (`HANDLER_LOST`, `not_allowed`), a rule (`D31`), or a key of the configuration. For a
/// word of other controls (`G81` in `nj`), names the replacement.
/// The text contains the pages of everything with this name, as plain text; indented lines are preformatted.
///
/// ```
/// let page = tandem_config::explain::explain("g2", tandem_interp::dialects::nj()).unwrap();
/// assert!(page.starts_with("G02: Circular Interpolation"));
/// ```
pub fn explain(what: &str, dialect: &Dialect) -> Option<String> {
    let what = what.split_whitespace().collect::<Vec<_>>().join(" ");
    let mut pages = pages(&what, dialect);
    // `%` and parentheses have a different meaning in other controls, too
    if pages.is_empty() || matches!(what.as_str(), "%" | "(" | ")") {
        pages.extend(elsewhere::page_of(&what, dialect));
    }
    if pages.is_empty() {
        pages = elsewhere::meant(&what).map_or_else(Vec::new, |meant| self::pages(&meant, dialect));
    }
    (!pages.is_empty()).then(|| pages.join("\n\n"))
}

/// Returns the pages of everything with this name.
fn pages(what: &str, dialect: &Dialect) -> Vec<String> {
    let keys = Config::keys();
    (DiagnosticEntry::find(what).into_iter())
        .map(|entry| of_diagnostic(entry, dialect))
        .chain(FindingEntry::find(what).map(of_finding))
        .chain(alarm(what).map(of_alarm))
        .chain(of_sequence_program(what))
        .chain(language::pages(what, dialect))
        .chain(
            words()
                .filter(|word| word.word.eq_ignore_ascii_case(what))
                .map(of_word),
        )
        .chain(rules(what))
        .chain(keys.iter().filter(|key| is_named(key, what)).map(of_key))
        .collect()
}

/// Explains a name as [`explain`] does, also with the data of a machine. For an M code, given by number or declared
/// name, these are its declarations. For an alarm of the machine's sequence programs, these are its text and remedy.
pub fn explain_here(
    what: &str,
    dialect: &Dialect,
    declared: &[SourcedDeclaration],
    alarm_text: impl Fn(u16) -> Option<AlarmText>,
) -> Option<String> {
    let said = own_code(what).and_then(alarm_text);
    if let Some(said) = said {
        return Some(of_own_alarm(&said));
    }
    let is_meant = |one: &&SourcedDeclaration| {
        let name = one.declaration.name.as_deref();
        language::m_number(what) == Some(one.declaration.m)
            || name.is_some_and(|name| name.eq_ignore_ascii_case(what.trim()))
    };
    let here: Vec<&SourcedDeclaration> = declared.iter().filter(is_meant).collect();
    let Some(first) = here.first() else {
        return explain(what, dialect);
    };
    let mut pages: Vec<String> = here.iter().map(|one| of_declared(one)).collect();
    pages.extend(explain(&format!("M{:02}", first.declaration.m), dialect));
    Some(pages.join("\n\n"))
}

/// Returns the page of an M code with a declaration of this machine.
fn of_declared(declared: &SourcedDeclaration) -> String {
    let SourcedDeclaration { by, declaration } = declared;
    let title = declaration.name.as_deref().unwrap_or("an M code of this machine");
    let params = match &declaration.params {
        None => "It takes every parameter.".to_owned(),
        Some(params) if params.is_empty() => "It takes no parameters.".to_owned(),
        Some(params) => {
            let rows = params
                .iter()
                .map(|(letter, param)| format!("{letter}  {}", param.text()));
            indented(&rows.collect::<Vec<_>>().join("\n"))
        }
    };
    let name = format!("M{:02}", declaration.m);
    page(&name, title, &[format!("Declared by {by}."), params])
}

/// Returns the file name of the picture with the example of a code; `None` if `what` is not a code or has no picture.
pub fn picture(what: &str, dialect: &Dialect) -> Option<String> {
    let (name, _) = dialect.picture(language::code(what.trim(), dialect)?)?;
    Some(name)
}

/// Returns all names that have a page.
pub fn names(dialect: &Dialect) -> Vec<String> {
    let diagnostics = DIAGNOSTICS.iter().map(|entry| entry.code.to_owned());
    let findings = FINDINGS.iter().map(|entry| entry.code.to_owned());
    let alarms = ALARMS.iter().map(|entry| format!("alarm {}", entry.number));
    let rules = RULES
        .into_iter()
        .flatten()
        .map(|(number, _)| (*number).to_owned());
    let keys = Config::keys().into_iter().flat_map(|key| {
        let own = key.path.rsplit('.').next().unwrap_or_default().to_owned();
        [key.path, own]
    });
    diagnostics
        .chain(findings)
        .chain(alarms)
        .chain(language::names(dialect))
        .chain(words().map(|word| word.word.to_owned()))
        .chain(rules)
        .chain(keys)
        .collect()
}

/// Returns the name with a page that is nearest to `what`.
pub fn nearest(what: &str, dialect: &Dialect) -> String {
    let what: String = what.chars().take(NAME_MAX).collect::<String>().to_lowercase();
    let distance = |known: &String| strsim::damerau_levenshtein(&what, &known.to_lowercase());
    names(dialect)
        .into_iter()
        .min_by_key(distance)
        .unwrap_or_default()
}

/// Returns a page with a title and its text.
fn page(name: &str, title: &str, parts: &[String]) -> String {
    let parts = parts.iter().filter(|part| !part.is_empty());
    let mut page = format!("{name}: {title}");
    for part in parts {
        page.push_str("\n\n");
        page.push_str(part);
    }
    page
}

/// Indents lines, which marks them as preformatted.
fn indented(text: &str) -> String {
    let lines: Vec<String> = text.lines().map(|line| format!("    {line}")).collect();
    lines.join("\n")
}

fn of_diagnostic(entry: &DiagnosticEntry, dialect: &Dialect) -> String {
    let (rule, example) = dialect.explained(entry);
    let example = format!("Example:\n\n{}", indented(example));
    page(entry.code, entry.title, &[rule.to_owned(), example])
}

fn of_finding(entry: &FindingEntry) -> String {
    let parts = [entry.explanation.to_owned(), indented(entry.example)];
    page(entry.code, &format!("{} (Structured Text)", entry.title), &parts)
}

/// Returns the number if `what` has the form `412` or `alarm 412`.
fn alarm_number(what: &str) -> Option<u16> {
    let (word, number) = what.rsplit_once(' ').unwrap_or(("alarm", what));
    let number = number.parse().ok()?;
    word.eq_ignore_ascii_case("alarm").then_some(number)
}

fn alarm(what: &str) -> Option<&'static AlarmEntry> {
    let number = alarm_number(what)?;
    ALARMS.iter().copied().find(|entry| entry.number == number)
}

/// Returns the code that a sequence program uses for the alarm with this number; `None` for other alarms.
fn own_code(what: &str) -> Option<u16> {
    let code = alarm_number(what)?.checked_sub(USER_ALARM_BASE)?;
    (code <= USER_ALARM_CODE_MAX).then_some(code)
}

/// Returns the page of an alarm of a sequence program, without texts of the machine.
fn of_sequence_program(what: &str) -> Option<String> {
    let why = "Remedy: Look at what the text says, and at the documentation of the machine.";
    let parts = [why.to_owned()];
    Some(own_page(
        own_code(what)?,
        "an alarm of the sequence program",
        &parts,
    ))
}

/// Returns the page of an alarm of a sequence program, with the texts of the machine.
fn of_own_alarm(said: &AlarmText) -> String {
    let in_language = |(tag, words): (&String, &AlarmWords)| {
        let remedy = words
            .remedy
            .as_ref()
            .map_or(String::new(), |remedy| format!(" {remedy}"));
        format!("{tag}: {}{remedy}", words.text)
    };
    let languages: Vec<String> = said.languages.iter().map(in_language).collect();
    let remedy = said.remedy.as_ref();
    let parts = [
        remedy.map_or(String::new(), |remedy| format!("Remedy: {remedy}")),
        indented(&languages.join("\n")),
    ];
    own_page(said.code, &said.text, &parts)
}

fn own_page(code: u16, title: &str, more: &[String]) -> String {
    let raised = format!(
        "A handler or another part of the sequence program has raised it, as its number {code}; its text says why."
    );
    let after = format!("How to continue: {}", After::Reset.text());
    let mut parts = vec![raised];
    parts.extend_from_slice(more);
    parts.push(after);
    let number = u32::from(USER_ALARM_BASE) + u32::from(code);
    page(&format!("alarm {number}"), title, &parts)
}

fn of_alarm(entry: &AlarmEntry) -> String {
    let parts = [
        entry.cause.to_owned(),
        format!("Remedy: {}", entry.remedy),
        format!("How to continue: {}", entry.after.text()),
    ];
    page(&format!("alarm {}", entry.number), entry.title, &parts)
}

fn of_word(word: &ExplainedWord) -> String {
    let parts = [
        word.meaning.trim_start().to_owned(),
        format!("How to continue: {}", word.way_on),
    ];
    page(word.word, word.of, &parts)
}

/// Returns the rule with this number, or the rules of the group with this number.
fn rules(number: &str) -> impl Iterator<Item = String> {
    let is_named = move |row: &str| {
        let group = row.split('.').next().unwrap_or(row);
        [row, group].iter().any(|name| name.eq_ignore_ascii_case(number))
    };
    let rows = RULES.into_iter().flatten().filter(move |(row, _)| is_named(row));
    rows.map(|(row, text)| format!("{row}: {text}"))
}

/// Returns true if `name` is the name of a key, with or without its table, or the name of a table that contains the
/// key.
fn is_named(key: &ConfigKey, name: &str) -> bool {
    key.path == name || key.path.split('.').any(|part| part == name)
}

fn of_key(key: &ConfigKey) -> String {
    let value = match key.default.as_str() {
        _ if key.is_needed => "needed".to_owned(),
        "" => "may be left out".to_owned(),
        default => format!("default {default}"),
    };
    let mut facts = vec![key.kind.clone(), key.unit.clone(), key.range_text(), value];
    facts.retain(|fact| !fact.is_empty());
    let mut lines = vec![page(
        &key.path,
        &facts.join(", "),
        std::slice::from_ref(&key.text),
    )];
    let words = key.words.iter();
    lines.extend(words.map(|word| format!("    \"{}\"  {}", word.word, word.text)));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use tandem_interp::dialects;

    use super::*;

    fn of_nj(what: &str) -> String {
        explain(what, dialects::nj()).unwrap_or_else(|| panic!("{what} has no page"))
    }

    #[test]
    fn every_name_of_both_dialects_has_a_page_that_begins_with_it() {
        for dialect in [dialects::nj(), dialects::dgshape()] {
            for name in names(dialect) {
                let page = explain(&name, dialect).unwrap_or_else(|| panic!("{name} has no page"));
                assert!(page.lines().count() > 2 || page.contains(": "), "{name}: {page}");
            }
        }
    }

    #[test]
    fn a_code_is_found_however_it_is_written() {
        let page = of_nj("G02");
        assert!(
            page.starts_with("G02: Circular Interpolation in CW direction\n\n    G02 [X_]"),
            "{page}"
        );
        assert!(page.contains("Modal group 01 (motion)"), "{page}");
        for written in ["G2", "g02", "g 02", " G2.0 "] {
            assert_eq!(of_nj(written), page, "{written}");
        }
        assert!(of_nj("G50.1").starts_with("G50.1: "));
        assert!(of_nj("M100").starts_with("M100: Auxiliary Function Output"));
        for none in ["G", "G999", "M192", "G-2", "Gx", "M1.5", "G0x2", "", "ß1"] {
            let page = explain(none, dialects::nj()).unwrap_or_default();
            assert!(
                !page.contains("Modal group") && !page.contains("Output"),
                "{none}: {page}"
            );
        }
    }

    #[test]
    fn a_name_of_any_length_is_compared_with_all_others_at_once() {
        let long = "é".repeat(1_000_000);
        assert_eq!(explain(&long, dialects::nj()), None);
        let begun = std::time::Instant::now();
        nearest(&long, dialects::nj());
        assert!(begun.elapsed().as_secs() < 2, "{:?}", begun.elapsed());
    }

    #[test]
    fn sequence_program_alarm_explained_with_declared_text_and_remedy() {
        let of_machine = |code| {
            (code == 12).then(|| AlarmText {
                code,
                text: "The clamp does not close".to_owned(),
                remedy: Some("Look for chips.".to_owned()),
                languages: [(
                    "de".to_owned(),
                    AlarmWords {
                        text: "Der Spanner klemmt nicht".to_owned(),
                        remedy: None,
                    },
                )]
                .into(),
            })
        };
        let explained = |what: &str| explain_here(what, dialects::nj(), &[], of_machine).unwrap();
        let page = explained("alarm 10012");
        assert_eq!(explained("10012"), page);
        assert!(
            page.starts_with("alarm 10012: The clamp does not close\n"),
            "{page}"
        );
        for part in [
            "as its number 12",
            "Remedy: Look for chips.",
            "    de: Der Spanner klemmt nicht",
            After::Reset.text(),
        ] {
            assert!(page.contains(part), "{part}: {page}");
        }
        assert!(explained("10013").starts_with("alarm 10013: an alarm of the sequence program"));
    }

    #[test]
    fn a_dialect_explains_its_own_codes_only() {
        let dgshape = dialects::dgshape();
        assert!(explain("G83", dgshape).is_some());
        assert!(of_nj("G83").starts_with("G83: of other controls, not of dialect nj"));
        assert_ne!(explain("G04", dgshape), explain("G04", dialects::nj()));
        assert_eq!(explain("sind", dgshape), None);
        assert!(explain("while", dgshape).unwrap().contains("no branches"));
        assert!(
            explain("M100", dgshape)
                .unwrap()
                .contains("unless the configuration has a table m_code")
        );
    }

    #[test]
    fn a_dialect_explains_what_it_shares_as_it_means_it() {
        let dgshape = dialects::dgshape();
        let of = |what: &str| explain(what, dgshape).unwrap();
        let rapid = of("G00");
        assert!(
            rapid.starts_with("G00: Positioning\n\n    G00 [X_] [Y_] [Z_] [A_]\n"),
            "{rapid}"
        );
        assert!(rapid.contains("along a straight line"), "{rapid}");
        assert!(of_nj("G00").contains("not a straight line"));
        assert!(
            rapid.contains("X    target position or distance: -9999.999 to 9999.999 mm with a decimal point"),
            "{rapid}"
        );
        assert!(of("F").contains("-9999.999 to 9999.999 mm/min"));
        assert!(of("E0008").contains("Block skip has no number"));
        assert!(of_nj("E0008").contains("1 to 31"));
        for (what, of_dgshape, nj) in [
            ("%", "begin and end of the program", "remainder of a division"),
            ("O", "program number", "of other controls"),
            ("N", "block number", "block number"),
            ("/", "block skip", "block skip"),
            ("(", "comment", "parentheses"),
            ("()", "comment", "of other controls"),
            ("( )", "comment", "of other controls"),
            ("EOB", "end of block", "end of block"),
            ("<EOB>", "end of block", "end of block"),
        ] {
            assert!(of(what).contains(of_dgshape), "{what}");
            assert!(of_nj(what).contains(nj), "{what}");
        }
        assert!(of_nj("/31").contains("/2 to /31") && explain("/32", dialects::nj()).is_none());
        assert!(of_nj("//").contains("X5 /* to the wall */"));
    }

    #[test]
    fn what_other_controls_write_has_a_page_that_says_what_to_write() {
        for (what, help) in [
            ("T", "Write M06 VA_"),
            ("t12", "Write M06 VA12"),
            ("H", "G43 and G44 take the length"),
            ("#100", "Write Q100"),
            ("G065", "M98 P1000"),
            ("G81", "Write the motions"),
            ("%", "Remove the line"),
            ("(", "Write a comment after //"),
            (";", "Remove it"),
        ] {
            let page = of_nj(what);
            assert!(
                page.contains("of other controls") && page.contains(help),
                "{page}"
            );
        }
        for (what, code) in [
            ("G999", "E0101"),
            ("M192", "E0104"),
            ("Q4096", "E0013"),
            ("e101", "E0101"),
        ] {
            assert!(of_nj(what).starts_with(code), "{what}");
        }
        assert_eq!(of_nj("X10.5"), of_nj("X"));
        assert_eq!(explain("E9999", dialects::nj()), None);
        assert_eq!(of_nj("_CNC_CapturedPosition(2)"), of_nj("_CNC_CapturedPosition2"));
        for symbol in ["&&", "!", "==", "[", "}"] {
            assert!(of_nj(symbol).contains("    "), "{symbol}");
        }
    }

    #[test]
    fn m_codes_of_the_spindle_have_the_names_of_the_manual() {
        for (what, name) in [
            ("M3", "M3: Spindle CW"),
            ("M04", "M04: Spindle CCW"),
            ("M05", "M05: Spindle OFF"),
            ("M19", "M19: Spindle Orientation"),
        ] {
            let page = of_nj(what);
            assert!(
                page.starts_with(name) && page.contains("(D35)") && page.contains("VA"),
                "{page}"
            );
        }
    }

    #[test]
    fn every_alarm_has_a_cause_what_to_do_and_how_it_goes_on() {
        for entry in ALARMS {
            let page = of_nj(&format!("alarm {}", entry.number));
            for part in [entry.title, entry.cause, entry.remedy, entry.after.text()] {
                assert!(part.len() > 10 && page.contains(part), "{}: {page}", entry.number);
            }
        }
    }

    #[test]
    fn each_state_refusal_and_answer_word_explains_meaning_and_next_step() {
        for word in words() {
            let page = of_nj(&word.word.to_lowercase());
            for part in [word.of, word.meaning.trim_start(), word.way_on] {
                assert!(page.contains(part), "{}: {page}", word.word);
            }
        }
    }

    #[test]
    fn every_code_says_what_it_does_and_what_restricts_it() {
        for dialect in [dialects::nj(), dialects::dgshape()] {
            for code in dialect.g_codes.codes.iter().chain(dialect.m_codes.codes) {
                let page = explain(code.code, dialect).unwrap();
                let docs = dialect.docs_of(code);
                assert!(!docs.is_empty() && page.contains(docs), "{}", code.code);
            }
        }
        let page = of_nj("G41");
        assert!(page.contains("Restrictions:"), "{page}");
        assert!(page.contains("the side of the compensation changes"), "{page}");
    }

    #[test]
    fn alarms_functions_keywords_and_variables_have_pages() {
        let alarm = of_nj("412");
        assert!(
            alarm.starts_with("alarm 412: A value that the program needs is damaged"),
            "{alarm}"
        );
        assert_eq!(of_nj("Alarm  412"), alarm);
        assert_eq!(explain("alarm 9", dialects::nj()), None);
        assert!(of_nj("alarm 10007").contains("as its number 7"));
        assert!(of_nj("SIND").starts_with("sind: the sine of degrees\n\n    Q0 = sind(x)"));
        assert!(of_nj("while").contains("    while (condition) command"));
        assert!(of_nj("L255").starts_with("L: variables L0 to L255"));
        assert!(of_nj("L256").starts_with("E0013: "));
        assert!(of_nj("_CNC_CapturedPosition").contains("read only"));
        assert!(of_nj("F").contains("G04"));
    }
}
