//! Checks and converts `[hmi]`, `[[hmi.button]]` and `[[hmi.card]]`.

use std::path::Path;

use plc_protocol::types::CoordinateSystemNumber;
use plc_protocol::types::program::{DiagnosticSeverity, ProgramDiagnostic};
use plc_protocol::wire::hmi::{HmiButton, HmiCard};
use tandem_interp::meaning::Role;
use tandem_model::limits::{M_CODE_MAX, OPTIONAL_SKIP_MAX};
use tandem_model::variables::{COORDINATE_SYSTEM_VARIABLES, GLOBAL_VARIABLES};
use tandem_store::program_store::StoredProgram;

use super::super::machine::ConfiguredSystem;
use super::super::text::Problems;
use super::super::{Config, HmiConfig};
use super::TableCheck;

/// Maximum number of buttons, and of cards. Reason: one panel shows all of them.
const ADDED_MAX: usize = 32;
/// Maximum number of characters of a button's text or a card's title.
const TEXT_MAX: usize = 40;
/// Maximum number of characters of a question, and of a line of NC text.
const LINE_MAX: usize = 200;
/// Maximum number of characters of a unit.
const UNIT_MAX: usize = 12;

/// Inputs that a button can switch. A card can show these inputs and the locks.
const SWITCHES: [&str; 3] = ["optional_stop", "single_block", "dry_run"];
const LOCKS: [&str; 2] = ["interlock", "start_lock"];

impl Config {
    pub(super) fn check_hmi(&self, systems: &[ConfiguredSystem], problems: &mut Problems<'_>) {
        let hmi = &self.hmi;
        let dir = hmi.dir.as_ref().map(|dir| self.base_dir.join(dir));
        let schema = schemars::schema_for!(HmiConfig);
        let mut checked = problems.check_table("hmi", "[hmi] ");
        checked.check_range(&schema, "jog_step_max", hmi.jog_step_max);
        for (what, count) in [("button", hmi.button.len()), ("card", hmi.card.len())] {
            if count > ADDED_MAX {
                problems.add(
                    &format!("hmi.{what}"),
                    format!("[[hmi.{what}]]: write at most {ADDED_MAX}"),
                );
            }
        }
        for (index, button) in hmi.button.iter().enumerate() {
            let mut added = HmiElementCheck {
                checked: problems.check_table(
                    format!("hmi.button.{index}"),
                    format!("[[hmi.button]] \"{:.40}\": ", button.text),
                ),
                systems,
                dir: dir.as_deref(),
            };
            added.button(button);
        }
        for (index, card) in hmi.card.iter().enumerate() {
            let mut added = HmiElementCheck {
                checked: problems.check_table(
                    format!("hmi.card.{index}"),
                    format!("[[hmi.card]] \"{:.40}\": ", card.text),
                ),
                systems,
                dir: dir.as_deref(),
            };
            added.card(card);
        }
    }
}

/// A button or a card that is being checked.
struct HmiElementCheck<'a, 'b, 'c> {
    checked: TableCheck<'a, 'b>,
    systems: &'c [ConfiguredSystem],
    dir: Option<&'c Path>,
}

impl HmiElementCheck<'_, '_, '_> {
    fn button(&mut self, button: &HmiButton) {
        self.common(&button.text, button.icon.as_deref(), button.cs, button.m_code);
        let does = [
            ("m_code", button.m_code.is_some()),
            ("mdi", button.mdi.is_some()),
            ("variable", button.variable.is_some()),
            ("input", button.input.is_some()),
        ];
        self.exactly_one(does);
        if let Some(line) = &button.mdi {
            self.line(line, button.cs);
        }
        if let Some(name) = &button.variable {
            self.variable(name);
        }
        let is_number = button.value.is_some_and(f64::is_finite);
        if button.variable.is_some() && !is_number {
            self.checked
                .problem("value", "variable needs value, the number to be set");
        }
        if button.variable.is_none() && button.value.is_some() {
            self.checked.problem("value", "value is for variable");
        }
        if let Some(input) = &button.input {
            self.input(input, &[]);
        }
        if let Some(question) = &button.confirm {
            self.text("confirm", question, LINE_MAX);
        }
    }

    fn card(&mut self, card: &HmiCard) {
        self.common(&card.text, card.icon.as_deref(), card.cs, card.m_code);
        let shows = [
            ("m_code", card.m_code.is_some()),
            ("variable", card.variable.is_some()),
            ("input", card.input.is_some()),
            ("module", card.module.is_some()),
        ];
        self.exactly_one(shows);
        if let Some(name) = &card.variable {
            self.variable(name);
        }
        match &card.unit {
            Some(unit) if card.variable.is_some() => self.text("unit", unit, UNIT_MAX),
            Some(_) => self.checked.problem("unit", "unit is for variable"),
            None => {}
        }
        if let Some(input) = &card.input {
            self.input(input, &LOCKS);
        }
        if let Some(module) = &card.module {
            self.file("module", module, &["js", "mjs"]);
        }
    }

    fn common(
        &mut self,
        text: &str,
        icon: Option<&str>,
        cs: Option<CoordinateSystemNumber>,
        m_code: Option<u16>,
    ) {
        self.text("text", text, TEXT_MAX);
        if let Some(icon) = icon {
            self.file("icon", icon, &["svg", "png", "webp", "jpg", "jpeg", "gif"]);
        }
        if let Some(cs) = cs
            && !self.systems.iter().any(|system| system.settings.number == cs)
        {
            self.checked
                .problem("cs", format!("cs: there is no coordinate system {cs}"));
        }
        if m_code.is_some_and(|m| m > M_CODE_MAX) {
            self.checked
                .problem("m_code", format!("m_code: write an M code, 0 to {M_CODE_MAX}"));
        }
    }

    fn exactly_one(&mut self, given: [(&str, bool); 4]) {
        let count = given.iter().filter(|(_, is_given)| *is_given).count();
        if count != 1 {
            let names = given.map(|(name, _)| name);
            self.checked.problem(
                "",
                format!("write one of {}; there are {count}", names.join(", ")),
            );
        }
    }

    fn text(&mut self, key: &str, text: &str, most: usize) {
        if !(1..=most).contains(&text.chars().count()) || text.contains(char::is_control) {
            self.checked
                .problem(key, format!("{key}: write 1 to {most} characters"));
        }
    }

    /// Checks a line of NC text for a coordinate system, or for all coordinate systems if `cs` is `None`.
    fn line(&mut self, line: &str, cs: Option<CoordinateSystemNumber>) {
        self.text("mdi", line, LINE_MAX);
        let systems = self.systems;
        for system in systems
            .iter()
            .filter(|system| cs.is_none_or(|cs| system.settings.number == cs))
        {
            let end = system.dialect.m_code(Role::End).map_or("", |code| code.code);
            let program = StoredProgram::manual(&format!("{line}\n{end}\n"), system.text_rules(), false);
            let errors = |found: &&ProgramDiagnostic| found.severity == DiagnosticSeverity::Error;
            if let Some(error) = program.check.diagnostics.iter().find(errors) {
                let text = format!("mdi: {}: {}", error.code, error.message);
                return self.checked.problem("mdi", text);
            }
        }
    }

    fn variable(&mut self, name: &str) {
        let known = [('P', GLOBAL_VARIABLES), ('Q', COORDINATE_SYSTEM_VARIABLES)];
        let is_known = known.iter().any(|(kind, count)| {
            let number = name
                .strip_prefix(*kind)
                .and_then(|number| number.parse::<usize>().ok());
            number.is_some_and(|number| number < *count)
        });
        if !is_known {
            let [(_, p), (_, q)] = known;
            let text = format!(
                "variable = \"{name:.40}\": write P0 to P{} or Q0 to Q{}",
                p - 1,
                q - 1
            );
            self.checked.problem("variable", text);
        }
    }

    fn input(&mut self, name: &str, more: &[&str]) {
        let skip = name
            .strip_prefix("optional_skip/")
            .and_then(|number| number.parse::<u8>().ok());
        let is_skip = skip.is_some_and(|number| (1..=OPTIONAL_SKIP_MAX).contains(&number));
        if !is_skip && !SWITCHES.contains(&name) && !more.contains(&name) {
            let words = [&SWITCHES[..], more].concat().join(", ");
            let text = format!(
                "input = \"{name:.40}\": write {words}, or optional_skip/1 to optional_skip/{OPTIONAL_SKIP_MAX}"
            );
            self.checked.problem("input", text);
        }
    }

    /// Checks that a file exists in the folder of the HMI, and that its name has one of the endings.
    fn file(&mut self, key: &str, name: &str, endings: &[&str]) {
        let is_kind = name
            .rsplit_once('.')
            .is_some_and(|(_, ending)| endings.contains(&ending));
        let is_plain = name
            .split('/')
            .all(|part| !part.is_empty() && !part.starts_with('.') && !part.contains('\\'));
        let Some(dir) = self.dir else {
            return self.checked.problem(
                key,
                format!("{key}: this is a file in the folder dir of [hmi], but [hmi] has no dir"),
            );
        };
        if !is_kind || !is_plain {
            let text = format!(
                "{key} = \"{name:.80}\": write the name of a file of dir that ends in {}",
                endings.join(", ")
            );
            self.checked.problem(key, text);
        } else if !dir.join(name).is_file() {
            self.checked.problem(
                key,
                format!(
                    "{key} = \"{name:.80}\": there is no such file in {}",
                    dir.display()
                ),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SMALL: &str = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                         [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n";

    /// Returns the error of a configuration with these tables; empty if the configuration is valid.
    fn refusal(tables: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("hmi")).unwrap();
        std::fs::write(folder.path().join("hmi/lamp.svg"), "").unwrap();
        std::fs::write(folder.path().join("hmi/oil.js"), "").unwrap();
        let read = Config::from_toml(&format!("{SMALL}{tables}"), folder.path());
        let resolved = read.and_then(|config| config.resolve());
        resolved.map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn an_added_button_does_one_thing_that_the_machine_can_do() {
        let button = |keys: &str| refusal(&format!("[hmi]\ndir = \"hmi\"\n[[hmi.button]]\n{keys}\n"));
        for right in [
            "text = \"Oil\"\nm_code = 60",
            "text = \"Oil\"\nmdi = \"M60 VA2\"\nconfirm = \"Now?\"\nicon = \"lamp.svg\"",
            "text = \"Oil\"\nvariable = \"P32767\"\nvalue = 1.5\nstates = [\"READY\", \"STOPPED\"]",
            "text = \"Oil\"\ninput = \"optional_skip/31\"\ncs = 1",
            "text = \"Oil\"\ninput = \"dry_run\"",
        ] {
            assert_eq!(button(right), "", "{right}");
        }
        for (wrong, why) in [
            ("text = \"\"\nm_code = 60", "text: write 1 to 40"),
            (
                "text = \"Oil\"",
                "write one of m_code, mdi, variable, input; there are 0",
            ),
            ("text = \"Oil\"\nm_code = 60\nmdi = \"M60\"", "there are 2"),
            ("text = \"Oil\"\nm_code = 1000", "m_code: write"),
            ("text = \"Oil\"\nmdi = \"G01 Y5 F\"", "mdi: E"),
            ("text = \"Oil\"\nmdi = \"M60\\nM61\"", "mdi: write 1 to 200"),
            ("text = \"Oil\"\nvariable = \"P32768\"\nvalue = 1", "P0 to P32767"),
            ("text = \"Oil\"\nvariable = \"L5\"\nvalue = 1", "P0 to P32767"),
            ("text = \"Oil\"\nvariable = \"P1\"", "variable needs value"),
            ("text = \"Oil\"\nm_code = 60\nvalue = 1", "value is for variable"),
            ("text = \"Oil\"\ninput = \"optional_skip/32\"", "optional_skip/31"),
            ("text = \"Oil\"\ninput = \"interlock\"", "optional_stop"),
            ("text = \"Oil\"\nm_code = 60\ncs = 2", "no coordinate system 2"),
            ("text = \"Oil\"\nm_code = 60\nicon = \"none.svg\"", "no such file"),
            (
                "text = \"Oil\"\nm_code = 60\nicon = \"../lamp.svg\"",
                "the name of a file of dir",
            ),
            ("text = \"Oil\"\nm_code = 60\nstates = [\"RUNNING\"]", "RUNNING"),
            ("text = \"Oil\"\nm_code = 60\ncolour = \"red\"", "colour"),
        ] {
            let told = button(wrong);
            assert!(told.contains(why), "{wrong}: {told}");
            assert!(told.contains("line "), "it has a place: {told}");
        }
        let without_dir = refusal("[[hmi.button]]\ntext = \"Oil\"\nm_code = 60\nicon = \"lamp.svg\"\n");
        assert!(without_dir.contains("[hmi] has no dir"), "{without_dir}");
    }

    #[test]
    fn an_added_card_shows_one_thing_and_their_number_is_limited() {
        let card = |keys: &str| refusal(&format!("[hmi]\ndir = \"hmi\"\n[[hmi.card]]\n{keys}\n"));
        for right in [
            "text = \"Oil\"\nvariable = \"Q4095\"\nunit = \"mm\"",
            "text = \"Oil\"\ninput = \"interlock\"",
            "text = \"Oil\"\nm_code = 60",
            "text = \"Oil\"\nmodule = \"oil.js\"",
        ] {
            assert_eq!(card(right), "", "{right}");
        }
        for (wrong, why) in [
            ("text = \"Oil\"\nmodule = \"lamp.svg\"", "ends in js, mjs"),
            ("text = \"Oil\"\nmodule = \"gone.js\"", "no such file"),
            (
                "text = \"Oil\"\nm_code = 60\nunit = \"mm\"",
                "unit is for variable",
            ),
            ("text = \"Oil\"", "there are 0"),
        ] {
            let told = card(wrong);
            assert!(told.contains(why), "{wrong}: {told}");
        }
        let many = |count| refusal(&"[[hmi.card]]\ntext = \"Oil\"\nm_code = 60\n".repeat(count));
        assert_eq!(many(ADDED_MAX), "");
        assert!(many(ADDED_MAX + 1).contains("at most 32"));
    }
}
