//! Checks and converts `[[variables.published]]`.

use std::collections::BTreeMap;

use plc_protocol::types::data::{VARIABLES_AT_ONCE_MAX, VariableArea};
use tandem_model::variables::{COORDINATE_SYSTEM_VARIABLES, GLOBAL_VARIABLES};

use super::super::text::Problems;
use super::super::{CoordinateSystemConfig, PublishedConfig, VariablesConfig};
use super::TableCheck;

/// Ranges of published variables by area, each as first number and length.
pub type PublishedRanges = BTreeMap<VariableArea, Vec<(u32, u32)>>;

impl VariablesConfig {
    pub(super) fn published(
        &self,
        systems: &[CoordinateSystemConfig],
        problems: &mut Problems<'_>,
    ) -> PublishedRanges {
        let mut published = PublishedRanges::new();
        for (index, config) in self.published.iter().enumerate() {
            let name = format!("[[variables.published]] from = \"{:.16}\": ", config.from);
            let mut checked = problems.check_table(format!("variables.published.{index}"), name);
            checked.check_ranges(config, &[]);
            let Some(first) = config.first(&mut checked) else {
                continue;
            };
            for area in config.areas(systems, &mut checked) {
                let ranges = published.entry(area).or_default();
                ranges.push((first, config.count));
                let all: usize = ranges.iter().map(|(_, count)| *count as usize).sum();
                if all > VARIABLES_AT_ONCE_MAX {
                    let text = format!(
                        "with this range {all} variables are published: write at most \
                         {VARIABLES_AT_ONCE_MAX} of P, and of Q"
                    );
                    checked.problem("count", text);
                }
            }
        }
        published
    }
}

impl PublishedConfig {
    fn is_global(&self) -> bool {
        self.from.starts_with('P')
    }

    /// Returns the number of the first variable of the range; `None` if it is invalid.
    fn first(&self, checked: &mut TableCheck<'_, '_>) -> Option<u32> {
        let (letter, len) = if self.is_global() {
            ('P', GLOBAL_VARIABLES)
        } else {
            ('Q', COORDINATE_SYSTEM_VARIABLES)
        };
        let digits = self.from.strip_prefix(letter);
        let digits = digits.filter(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()));
        let Some(first) = digits.and_then(|digits| digits.parse::<u32>().ok()) else {
            let text = format!(
                "write a variable, P0 to P{} or Q0 to Q{}",
                GLOBAL_VARIABLES - 1,
                COORDINATE_SYSTEM_VARIABLES - 1
            );
            checked.problem("from", text);
            return None;
        };
        if (first as usize).saturating_add(self.count as usize) > len {
            let text = format!(
                "count = {}: the variables are {letter}0 to {letter}{}",
                self.count,
                len - 1
            );
            checked.problem("count", text);
        }
        Some(first)
    }

    fn areas(
        &self,
        systems: &[CoordinateSystemConfig],
        checked: &mut TableCheck<'_, '_>,
    ) -> Vec<VariableArea> {
        let numbers = systems.iter().map(|system| system.number);
        match self.coordinate_system {
            None if self.is_global() => vec![VariableArea::Global],
            None => numbers.map(VariableArea::CoordinateSystem).collect(),
            Some(_) if self.is_global() => {
                let text = "coordinate_system: all coordinate systems share the P variables; remove the key, or \
                     write a Q variable";
                checked.problem("coordinate_system", text);
                Vec::new()
            }
            Some(cs) if numbers.clone().any(|number| number == cs) => {
                vec![VariableArea::CoordinateSystem(cs)]
            }
            Some(cs) => {
                let there: Vec<String> = numbers.map(|number| number.to_string()).collect();
                let text = format!(
                    "coordinate_system = {cs}: write an existing one: {}",
                    there.join(", ")
                );
                checked.problem("coordinate_system", text);
                Vec::new()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use plc_protocol::types::data::VariableArea::{CoordinateSystem, Global};

    use crate::Config;

    const TWO: &str = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                       [[motor]]\nnumber = 2\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                       [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n\
                       [[coordinate_system]]\nnumber = 2\naxes = { X = 2 }\n";

    fn resolved(tables: &str) -> Result<crate::Machine, String> {
        let config = Config::from_toml(&format!("{TWO}{tables}"), "");
        let machine = config.and_then(|config| config.resolve());
        machine.map_err(|error| error.to_string())
    }

    #[test]
    fn p_is_published_for_the_machine_q_for_each_coordinate_system_or_one() {
        let tables = "[[variables.published]]\nfrom = \"P200\"\ncount = 16\n[[variables.published]]\nfrom = \"Q0\"\n\
                    [[variables.published]]\nfrom = \"Q4095\"\ncoordinate_system = 2\n";
        let published: Vec<_> = resolved(tables).unwrap().published.into_iter().collect();
        let q = |more: &[(u32, u32)]| [&[(0, 1)], more].concat();
        let expected = [
            (Global, vec![(200, 16)]),
            (CoordinateSystem(1), q(&[])),
            (CoordinateSystem(2), q(&[(4095, 1)])),
        ];
        assert_eq!(published, expected);
    }

    #[test]
    fn what_cannot_be_published_is_refused_with_what_to_write() {
        for (table, says) in [
            ("from = \"X1\"", "write a variable, P0 to P32767 or Q0 to Q4095"),
            ("from = \"P-1\"", "write a variable"),
            ("from = \"\"", "write a variable"),
            ("from = \"P32768\"", "the variables are P0 to P32767"),
            (
                "from = \"Q4090\"\ncount = 7",
                "count = 7: the variables are Q0 to Q4095",
            ),
            ("from = \"P0\"\ncount = 0", "count = 0: write 1 to 1024"),
            ("from = \"P0\"\ncount = 1025", "count = 1025: write 1 to 1024"),
            ("from = \"P0\"\ncoordinate_system = 1", "share the P variables"),
            (
                "from = \"Q0\"\ncoordinate_system = 3",
                "write an existing one: 1, 2",
            ),
        ] {
            let refused = resolved(&format!("[[variables.published]]\n{table}\n")).err();
            assert!(
                refused.as_ref().is_some_and(|text| text.contains(says)),
                "{table}: {refused:?}"
            );
        }
        let two = "[[variables.published]]\nfrom = \"P0\"\ncount = 1000\n[[variables.published]]\nfrom = \"P5000\"\ncount = 25\n";
        assert!(
            resolved(two)
                .unwrap_err()
                .contains("with this range 1025 variables are published")
        );
    }
}
