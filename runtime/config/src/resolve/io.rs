//! Checks and converts `[io.in]` and `[io.out]`.

use plc_protocol::types::ids::is_client_id;
use plc_protocol::types::io::{
    IO_MAX, IoDeclaration, IoDeclarations, IoKind, IoLoss, IoPoint, IoSide, IoStart, IoValue,
};

use super::super::text::Problems;
use super::super::{IoConfig, IoPointConfig};
use super::TableCheck;

/// Maximum number of characters of a text. Reason: the text is one line of a card.
const TEXT_MAX: usize = 100;

/// Maximum number of characters of a unit.
const UNIT_MAX: usize = 16;

impl IoConfig {
    pub(super) fn declarations(&self, problems: &mut Problems<'_>) -> IoDeclarations {
        let mut declared = IoDeclarations::default();
        for side in IoSide::ALL {
            let (word, points) = match side {
                IoSide::In => ("io.in", &self.inputs),
                IoSide::Out => ("io.out", &self.outputs),
            };
            if points.len() > IO_MAX {
                let text = format!(
                    "[{word}]: {} points are declared; the maximum is {IO_MAX}",
                    points.len()
                );
                problems.add(word, text);
            }
            for (name, config) in points {
                let path = format!("{word}.{name}");
                let mut checked = problems.check_table(path.as_str(), format!("[{path}] "));
                if !is_client_id(name) {
                    checked.problem("", "write a name of 1 to 64 characters without / + #");
                }
                let name = name.clone();
                config.check_loss(side, &mut checked);
                declared.insert(IoPoint { side, name }, config.declaration(&mut checked));
            }
        }
        declared
    }
}

impl IoPointConfig {
    /// Checks that `keep` is used only for outputs, and `at_start` only together with `keep`.
    fn check_loss(&self, side: IoSide, checked: &mut TableCheck<'_, '_>) {
        let is_kept = self.on_loss == Some(IoLoss::KEEP);
        match (is_kept, self.at_start) {
            (true, _) if side == IoSide::In => checked.problem(
                "on_loss",
                "on_loss = \"keep\" is for outputs only: without its owner an input is unknown; write a \
                 safe value",
            ),
            (true, None) => checked.problem(
                "on_loss",
                "on_loss = \"keep\" needs at_start = \"last\", or at_start with the value at a start",
            ),
            (false, Some(_)) => checked.problem(
                "at_start",
                "at_start is for on_loss = \"keep\"; otherwise an output begins with on_loss",
            ),
            _ => {}
        }
    }

    fn declaration(&self, checked: &mut TableCheck<'_, '_>) -> IoDeclaration {
        let numbers = [
            ("unit", self.unit.is_some()),
            ("min", self.min.is_some()),
            ("max", self.max.is_some()),
        ];
        if self.kind == IoKind::Bool {
            for (key, _) in numbers.into_iter().filter(|(_, is_there)| *is_there) {
                checked.problem(key, format!("{key} is for kind = \"number\""));
            }
        }
        for (key, bound) in [("min", self.min), ("max", self.max)] {
            if let Some(bound) = bound.filter(|bound| !bound.is_finite()) {
                checked.problem(key, format!("{key} = {bound}: write a finite number"));
            }
        }
        if let (Some(low), Some(high)) = (self.min, self.max)
            && low > high
        {
            checked.problem(
                "max",
                format!("max = {high}: write at least {low}, the value of min"),
            );
        }
        let unit = self.unit.as_deref().unwrap_or_default();
        for (key, text, most) in [("text", self.text.as_str(), TEXT_MAX), ("unit", unit, UNIT_MAX)] {
            if text.chars().count() > most {
                checked.problem(key, format!("{key}: write up to {most} characters"));
            }
        }
        let default = match self.kind {
            IoKind::Bool => IoValue::Bool(false),
            IoKind::Number => IoValue::Number(0.0),
        };
        let declaration = IoDeclaration {
            kind: self.kind,
            on_loss: self.on_loss.unwrap_or(default.into()),
            at_start: self.at_start,
            text: self.text.clone(),
            unit: self.unit.clone(),
            min: self.min,
            max: self.max,
        };
        let at_start = match self.at_start {
            Some(IoStart::Value(value)) => Some(value),
            _ => None,
        };
        for (key, value) in [("on_loss", declaration.on_loss.value()), ("at_start", at_start)] {
            if let Some(Err(why)) = value.map(|value| declaration.check(value)) {
                checked.problem(key, format!("{key} = {why}"));
            }
        }
        declaration
    }
}

#[cfg(test)]
mod tests {
    use plc_protocol::types::io::IoPoint;

    use super::*;
    use crate::Config;

    const MACHINE: &str = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                           [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n";

    fn declared(text: &str) -> Result<IoDeclarations, String> {
        let config = Config::from_toml(&format!("{MACHINE}{text}"), "");
        let machine = config.and_then(|config| config.resolve());
        machine
            .map(|machine| machine.io)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn io_points_are_declared_by_name_with_a_safe_value_of_their_kind() {
        let io = declared(
            "[io.in.door_closed]\ntext = \"Door\"\n[io.out.lamp]\non_loss = true\n\
             [io.out.pressure]\nkind = \"number\"\nunit = \"bar\"\nmin = 1\nmax = 6.5\non_loss = 1\n\
             [io.out.valve]\non_loss = \"keep\"\nat_start = \"last\"\n",
        );
        let all: Vec<_> = io
            .unwrap()
            .points()
            .map(|(point, declared)| (point, declared.clone()))
            .collect();
        let door = IoDeclaration {
            text: "Door".to_owned(),
            ..IoDeclaration::new(false)
        };
        let pressure = IoDeclaration {
            unit: Some("bar".to_owned()),
            min: Some(1.0),
            max: Some(6.5),
            ..IoDeclaration::new(1.0)
        };
        let expected = [
            (IoPoint::input("door_closed"), door),
            (IoPoint::output("lamp"), IoDeclaration::new(true)),
            (IoPoint::output("pressure"), pressure),
            (
                IoPoint::output("valve"),
                IoDeclaration::new(false).kept(IoStart::LAST),
            ),
        ];
        assert_eq!(all, expected);
    }

    #[test]
    fn a_mistake_names_its_key_and_what_to_write() {
        for (text, key, says) in [
            ("[io.in.a]\non_loss = 1", "[io.in.a] on_loss = 1", "true or false"),
            ("[io.in.\"a/b\"]", "[io.in.a/b]", "without / + #"),
            ("[io.in.a]\nunit = \"bar\"", "unit", "kind = \"number\""),
            ("[io.in.a]\nmax = 1", "max", "kind = \"number\""),
            ("[io.out.a]\non_loss = \"keep\"", "on_loss", "at_start"),
            ("[io.out.a]\nat_start = true", "at_start", "on_loss"),
            ("[io.out.a]\non_loss = \"stay\"", "line", "\"keep\""),
            (
                "[io.out.a]\non_loss = \"keep\"\nat_start = \"first\"",
                "line",
                "\"last\"",
            ),
            (
                "[io.out.a]\non_loss = \"keep\"\nat_start = 1",
                "at_start = 1",
                "true or false",
            ),
            (
                "[io.in.a]\non_loss = \"keep\"\nat_start = true",
                "[io.in.a] on_loss",
                "for outputs",
            ),
            (
                "[io.out.p]\nkind = \"number\"\non_loss = false",
                "[io.out.p] on_loss",
                "a number",
            ),
            (
                "[io.out.p]\nkind = \"number\"\nmin = 1",
                "[io.out.p] on_loss = 0",
                "1 or more",
            ),
            (
                "[io.out.p]\nkind = \"number\"\nmin = 3\nmax = 2\non_loss = 3",
                "max = 2",
                "at least 3",
            ),
            ("[io.out.p]\nkind = \"number\"\nmax = inf", "max = inf", "finite"),
            ("[io.out.p]\nkind = \"text\"", "kind", "number"),
            ("[io.out.p]\non_los = false", "on_los", "on_loss"),
        ] {
            let refusal = declared(text).unwrap_err();
            assert!(
                refusal.contains(key) && refusal.contains(says),
                "{text}: {refusal}"
            );
        }
        let long = format!("[io.in.a]\ntext = \"{}\"", "x".repeat(TEXT_MAX + 1));
        assert!(declared(&long).unwrap_err().contains("text: write up to 100"));
    }

    #[test]
    fn a_plant_has_up_to_256_inputs() {
        let tables = |count| {
            let tables: Vec<_> = (0..count).map(|n| format!("[io.in.a{n}]")).collect();
            tables.join("\n")
        };
        assert!(declared(&tables(IO_MAX)).is_ok());
        assert!(
            declared(&tables(IO_MAX + 1))
                .unwrap_err()
                .contains("the maximum is 256")
        );
    }
}
