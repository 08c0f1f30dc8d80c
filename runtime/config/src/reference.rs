//! The reference of the configuration, generated from the declarations of its types.

use plc_protocol::types::m_code::ParamDeclaration;
use plc_protocol::wire::hmi::{HmiButton, HmiCard};
use schemars::generate::SchemaSettings;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::error::known;
use super::{
    AlarmConfig, Config, CoordinateSystemConfig, DgshapeConfig, HandlersConfig, HmiConfig, HttpConfig,
    IdentificationConfig, IoPointConfig, LockConfig, LockSourceConfig, MCodeConfig, MachineConfig,
    MotorConfig, MqttConfig, MtconnectConfig, ProgramsConfig, PublishedConfig, SimulatedRoundConfig,
    SimulatedSkipConfig, TlsConfig, ToolConfig,
};

/// A key of the configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfigKey {
    /// Table as written in a configuration, such as `[[motor]]`.
    pub table: String,
    /// Table and key, such as `motor.lag_ms`.
    pub path: String,
    /// Description in Markdown.
    pub text: String,
    /// Type of the value, described in words.
    pub kind: String,
    /// Unit of the value; empty if the value has no unit.
    pub unit: String,
    /// Lowest and highest value of a number or of each number of a list; infinite without a limit.
    pub range: (f64, f64),
    /// All words that the key accepts as its value.
    pub words: Vec<ConfigWord>,
    /// Default value as written in a configuration; empty if the key has no default.
    pub default: String,
    /// True if the key is mandatory.
    pub is_needed: bool,
}

/// A word that is a value of a key.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ConfigWord {
    /// The word.
    pub word: String,
    /// Meaning of the word; empty if the key describes it.
    pub text: String,
}

impl ConfigKey {
    /// Returns the range in words; empty if the value has no limits.
    pub fn range_text(&self) -> String {
        let number = |value: f64| match value.abs() {
            size if size == 0.0 || (1e-3..1e6).contains(&size) => value.to_string(),
            _ => format!("{value:e}"),
        };
        match self.range {
            (f64::NEG_INFINITY, f64::INFINITY) => String::new(),
            (low, f64::INFINITY) => format!("from {}", number(low)),
            (low, high) => format!("{} to {}", number(low), number(high)),
        }
    }

    fn new(table: &str, name: &str, key: &str, schema: &Value, is_needed: bool) -> Self {
        let default = match &schema["default"] {
            Value::Null => String::new(),
            value => value.to_string(),
        };
        let mut words = Vec::new();
        collect_words(schema, &mut words);
        collect_words(&schema["items"], &mut words);
        Self {
            table: table.trim_matches('`').to_owned(),
            path: format!("{name}.{key}"),
            text: text(schema).replace('\n', " "),
            kind: kind(schema),
            unit: schema["x-unit"].as_str().unwrap_or_default().to_owned(),
            range: range(schema),
            words,
            default,
            is_needed,
        }
    }
}

impl Config {
    /// Returns all keys, table by table in the order of their types. The mandatory keys of each table come
    /// first.
    pub fn keys() -> Vec<ConfigKey> {
        let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
        let config = settings.into_generator().into_root_schema_for::<Self>();
        let tables = [
            ("machine", order_of::<MachineConfig>()),
            ("identification", order_of::<IdentificationConfig>()),
            ("motor", order_of::<MotorConfig>()),
            ("coordinate_system", order_of::<CoordinateSystemConfig>()),
            ("coordinate_system.dgshape", order_of::<DgshapeConfig>()),
            ("tool", order_of::<ToolConfig>()),
            ("m_code", order_of::<MCodeConfig>()),
            ("m_code.params", order_of::<ParamDeclaration>()),
            ("alarm", order_of::<AlarmConfig>()),
            ("input.interlock", order_of::<LockConfig>()),
            ("input.start_lock", order_of::<LockConfig>()),
            ("input.interlock.source", order_of::<LockSourceConfig>()),
            ("io.in", order_of::<IoPointConfig>()),
            ("io.out", order_of::<IoPointConfig>()),
            ("handlers", order_of::<HandlersConfig>()),
            ("variables.published", order_of::<PublishedConfig>()),
            ("simulated_skip", order_of::<SimulatedSkipConfig>()),
            ("simulated_round", order_of::<SimulatedRoundConfig>()),
            ("mqtt", order_of::<MqttConfig>()),
            ("http", order_of::<HttpConfig>()),
            ("hmi", order_of::<HmiConfig>()),
            ("hmi.button", order_of::<HmiButton>()),
            ("hmi.card", order_of::<HmiCard>()),
            ("tls", order_of::<TlsConfig>()),
            ("mtconnect", order_of::<MtconnectConfig>()),
            ("programs", order_of::<ProgramsConfig>()),
        ];
        let mut keys = Vec::new();
        for (name, order) in tables {
            let (mut schema, mut table) = (config.as_value(), config.as_value());
            for step in name.split('.') {
                schema = &table["properties"][step];
                // The schema of an optional table has two forms: the table, and null.
                let mut forms = schema["anyOf"].as_array().into_iter().flatten();
                schema = forms
                    .find(|form| form["properties"].is_object())
                    .unwrap_or(schema);
                let of_many = [&schema["items"], &schema["additionalProperties"]];
                let many = of_many.into_iter().find(|table| table.is_object());
                table = many.unwrap_or(schema);
            }
            // The schema of a table within another table has no title.
            let title = match text(schema) {
                named if named.starts_with('`') => named.to_owned(),
                _ => format!(
                    "[{}]",
                    name.replace("m_code", "m_code.N").replace("alarm", "alarm.N")
                ),
            };
            let needed = table["required"].as_array().map_or(&[][..], Vec::as_slice);
            let of_table = keys.len();
            keys.extend(order.iter().map(|key| {
                let is_needed = needed.iter().any(|needed| needed == key);
                ConfigKey::new(&title, name, key, &table["properties"][key], is_needed)
            }));
            keys[of_table..].sort_by_key(|key| !key.is_needed);
        }
        keys
    }
}

/// Returns the keys of a table in the order of its type, from the error message of serde for an unknown key.
fn order_of<T: DeserializeOwned>() -> Vec<String> {
    let refused = toml::from_str::<T>("'' = 0").err();
    let message = refused.as_ref().map_or("", toml::de::Error::message);
    known(message).map(str::to_owned).collect()
}

/// Returns the lowest and highest value of a number, or of each number of a list of fixed length. A missing
/// limit is infinite.
pub(super) fn range(schema: &Value) -> (f64, f64) {
    let items = Some(&schema["items"]).filter(|_| schema["minItems"].is_number());
    let bound = |name: &str| schema[name].as_f64().or_else(|| items?[name].as_f64());
    (
        bound("minimum").unwrap_or(f64::NEG_INFINITY),
        bound("maximum").unwrap_or(f64::INFINITY),
    )
}

fn text(schema: &Value) -> &str {
    schema["description"].as_str().unwrap_or_default()
}

/// Collects the words that a value accepts in all its forms, each with its meaning.
fn collect_words(schema: &Value, words: &mut Vec<ConfigWord>) {
    let of_value = |value: &Value, text: &str| {
        let (word, text) = (value.as_str()?.to_owned(), text.to_owned());
        Some(ConfigWord { word, text })
    };
    words.extend(of_value(&schema["const"], text(schema)));
    let list = |name: &str| schema[name].as_array().into_iter().flatten();
    words.extend(list("enum").filter_map(|value| of_value(value, "")));
    for form in list("oneOf").chain(list("anyOf")) {
        collect_words(form, words);
    }
}

fn kind(schema: &Value) -> String {
    let mut words = Vec::new();
    collect_words(schema, &mut words);
    let word = match schema["type"].as_str().or(schema["type"][0].as_str()) {
        _ if !words.is_empty() => "word",
        Some("integer") => "whole number",
        Some("string") => "text",
        Some("object") => "table",
        Some("array") => match &schema["minItems"] {
            Value::Null => return format!("list of {}s", kind(&schema["items"])),
            count => return format!("{count} numbers"),
        },
        Some(other) => other,
        None => {
            let forms = schema["anyOf"].as_array().into_iter().flatten();
            return forms.map(kind).collect::<Vec<_>>().join(" or ");
        }
    };
    word.to_owned()
}

#[cfg(test)]
mod tests {
    use toml::{Table, Value};

    use super::*;

    const SMALL: &str = "[machine]\n[handlers]\n[[motor]]\nnumber = 1\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                         [[motor]]\nnumber = 2\nkind = \"linear\"\nmax_velocity = 5\nmax_acceleration = 5\n\
                         [[coordinate_system]]\nnumber = 1\naxes = { X = 1, Y = 2 }\ndialect = \"dgshape\"\ndgshape = {}\n[programs]\n[identification]\n[[tool]]\nid = 1\n[[variables.published]]\nfrom = \"P1\"\n[m_code.5]\n\
                         [[simulated_skip]]\nmotor = 1\nbelow = 0\n\
                         [[simulated_round]]\ncoordinate_system = 1\nkind = \"boss\"\nx = 0\ny = 0\ndiameter = 9\nball = 2\n[[hmi.button]]\ntext = \"a\"\nm_code = 1\n\
                         [[hmi.card]]\ntext = \"a\"\nm_code = 1\n";

    /// Returns the error of a configuration in which this key has this value.
    #[allow(
        clippy::cast_possible_truncation,
        reason = "ranges of whole numbers have few digits"
    )]
    fn refusal(key: &ConfigKey, value: f64) -> String {
        let mut config: Table = SMALL.parse().unwrap();
        let (path, name) = key.path.rsplit_once('.').unwrap();
        let mut table = &mut config;
        for step in path.split('.') {
            table = match &mut table[step] {
                Value::Array(tables) => tables[0].as_table_mut().unwrap(),
                one => one.as_table_mut().unwrap(),
            };
            if table.contains_key("5") {
                table = table["5"].as_table_mut().unwrap();
            }
        }
        let value = match key.kind.as_str() {
            "whole number" => Value::Integer(value as i64),
            "number" => Value::Float(value),
            "2 numbers" => Value::from(vec![value, value.midpoint(1e9)]),
            _ => Value::from(vec![value; 4]),
        };
        table.insert(name.to_owned(), value);
        let config = Config::from_toml(&config.to_string(), "").and_then(|config| config.resolve());
        config.map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn a_configuration_is_held_to_the_range_of_each_key() {
        let mut seen = 0;
        for key in Config::keys() {
            let (low, high) = key.range;
            let name = key.path.rsplit('.').next().unwrap();
            if !low.is_finite() || !high.is_finite() {
                continue;
            }
            seen += 1;
            let is_whole = key.kind == "whole number";
            let step = |value: f64| {
                if is_whole {
                    1.0
                } else {
                    (value.abs() / 2.0).max(1e-10)
                }
            };
            for beyond in [low - step(low), high + step(high)] {
                let why = refusal(&key, beyond);
                assert!(
                    why.contains(name) || why.contains("invalid value"),
                    "{}: {beyond}: {why}",
                    key.path
                );
            }
            for within in [low, high] {
                let why = refusal(&key, within);
                let is_refused = why.contains(&format!("{name} = {within}: write "));
                assert!(!is_refused, "{}: {why}", key.path);
            }
        }
        assert!(seen > 35, "only {seen} ranges");
    }

    #[test]
    fn keys_come_in_the_order_of_their_types_and_none_is_left_out() {
        let keys: Vec<String> = Config::keys().into_iter().map(|key| key.path).collect();
        let at = |path: &str| keys.iter().position(|key| key == path).unwrap();
        assert_eq!(at("machine.name"), 0);
        assert!(at("motor.kind") < at("motor.max_jerk") && at("motor.max_jerk") < at("motor.rapid_velocity"));
        assert!(at("coordinate_system.dgshape.calculator") < at("coordinate_system.dgshape.external_offset"));
        assert!(
            at("motor.lag_ms") < at("coordinate_system.number") && at("m_code.timing") < at("http.listen")
        );
        let config = schemars::schema_for!(Config);
        for table in config.as_value()["properties"].as_object().unwrap().keys() {
            assert!(
                keys.iter().any(|key| key.starts_with(&format!("{table}."))),
                "{table}"
            );
        }
    }

    #[test]
    fn a_key_tells_type_unit_default_and_words() {
        let keys = Config::keys();
        let key = |path: &str| keys.iter().find(|key| key.path == path).unwrap();
        let window = key("motor.in_position");
        assert_eq!((window.kind.as_str(), window.unit.as_str()), ("number", "units"));
        assert_eq!(
            (window.default.as_str(), window.range_text().as_str()),
            ("0.01", "1e-9 to 1e9")
        );
        assert!(!window.is_needed && key("motor.kind").is_needed);
        let words = key("m_code.unhandled")
            .words
            .iter()
            .map(|word| word.word.as_str());
        assert!(words.eq(["alarm", "wait", "auto_reset"]));
        assert!(
            keys.iter()
                .all(|key| !key.text.is_empty() && !key.kind.is_empty())
        );
    }
}
