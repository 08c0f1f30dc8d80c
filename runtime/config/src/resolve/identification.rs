//! Checks and converts `[identification]`.

use plc_protocol::types::machine::Identification;

use super::super::Config;
use super::super::text::Problems;

/// Maximum number of characters of a text. Reason: nameplates show the texts.
const TEXT_MAX: usize = 200;

impl Config {
    pub(super) fn identification(&self, problems: &mut Problems<'_>) -> Identification {
        let config = &self.identification;
        let mut checked = problems.check_table("identification", "[identification] ");
        checked.check_ranges(config, &[]);
        for (key, text) in [
            ("manufacturer", &config.manufacturer),
            ("model", &config.model),
            ("serial_number", &config.serial_number),
            ("product_instance_uri", &config.product_instance_uri),
            ("location", &config.location),
        ] {
            let is_short = |text: &str| (1..=TEXT_MAX).contains(&text.chars().count());
            if let Some(text) = text
                && (!is_short(text) || text.contains(char::is_control))
            {
                checked.problem(
                    key,
                    format!("{key}: write a line of 1 to {TEXT_MAX} characters, or remove the key"),
                );
            }
        }
        if let Some(uri) = &config.product_instance_uri
            && (!uri.contains(':') || uri.contains(char::is_whitespace))
        {
            let text = format!(
                "product_instance_uri = \"{uri:.40}\": write a URI, such as urn:example.com:mill:4711"
            );
            checked.problem("product_instance_uri", text);
        }
        Identification {
            manufacturer: config.manufacturer.clone(),
            model: config.model.clone(),
            serial_number: config.serial_number.clone(),
            product_instance_uri: config.product_instance_uri.clone(),
            location: config.location.clone(),
            year_of_construction: config.year_of_construction,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: &str = "[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                           [[coordinate_system]]\nnumber = 1\naxes = { X = 1 }\n[identification]\n";

    fn identification(text: &str) -> Result<Identification, String> {
        let config = Config::from_toml(&format!("{MACHINE}{text}"), "");
        let machine = config.and_then(|config| config.resolve());
        machine
            .map(|machine| machine.identification)
            .map_err(|error| error.to_string())
    }

    #[test]
    fn what_the_nameplate_says_is_taken_as_it_is_and_nothing_is_made_up() {
        let plate = identification("manufacturer = \"Example Works\"\nyear_of_construction = 2024\n");
        let expected = Identification {
            manufacturer: Some("Example Works".to_owned()),
            year_of_construction: Some(2024),
            ..Identification::default()
        };
        assert_eq!(plate, Ok(expected));
        assert_eq!(identification(""), Ok(Identification::default()));
    }

    #[test]
    fn what_stands_on_no_nameplate_is_refused_at_its_key() {
        for (text, why) in [
            (
                "manufacturer = \"\"",
                "manufacturer: write a line of 1 to 200 characters",
            ),
            ("location = \"a\\nb\"", "location: write a line"),
            (
                "product_instance_uri = \"4711\"",
                "write a URI, such as urn:example.com:mill:4711",
            ),
            (
                "year_of_construction = 24",
                "year_of_construction = 24: write 1900 to 2999",
            ),
            ("serial = \"1\"", "serial"),
        ] {
            let refused = identification(text).unwrap_err();
            assert!(refused.contains(why), "{text}: {refused}");
        }
        assert!(identification(&format!("model = \"{}\"", "a".repeat(200))).is_ok());
        assert!(identification(&format!("model = \"{}\"", "a".repeat(201))).is_err());
    }
}
