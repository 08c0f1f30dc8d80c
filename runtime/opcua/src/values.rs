//! Values of variables, by the path of each, and their units.

use std::collections::BTreeMap;

use opcua::types::{EUInformation, ExtensionObject, LocalizedText, Range, StatusCode, UAString, Variant};

/// Values of variables by path, or the reason why a value is missing.
#[derive(Debug, Default)]
pub struct Values(BTreeMap<String, Result<Variant, StatusCode>>);

impl Values {
    /// Stores a value; `None` means that the machine has not sent it yet.
    pub fn put(&mut self, path: &str, name: &str, value: Option<impl Into<Variant>>) {
        let value = value.map(Into::into).ok_or(StatusCode::BadWaitingForInitialData);
        self.0.insert(format!("{path}/{name}"), value);
    }

    pub fn into_iter(self) -> impl Iterator<Item = (String, Result<Variant, StatusCode>)> {
        self.0.into_iter()
    }
}

/// A unit with its code in UNECE recommendation 20 and its usual symbol.
#[derive(Debug, Clone, Copy)]
pub struct Unit {
    code: &'static str,
    sign: &'static str,
    name: &'static str,
}

pub const MILLIMETRE: Unit = Unit {
    code: "MMT",
    sign: "mm",
    name: "millimetre",
};
pub const DEGREE: Unit = Unit {
    code: "DD",
    sign: "°",
    name: "degree",
};
pub const MILLIMETRE_PER_MINUTE: Unit = Unit {
    code: "H81",
    sign: "mm/min",
    name: "millimetre per minute",
};
pub const REVOLUTIONS_PER_MINUTE: Unit = Unit {
    code: "RPM",
    sign: "r/min",
    name: "revolutions per minute",
};
pub const PERCENT: Unit = Unit {
    code: "P1",
    sign: "%",
    name: "percent",
};

impl From<Unit> for Variant {
    /// Converts a unit; its identifier is calculated from the letters of the code (OPC 10000-8, 5.6.3).
    fn from(unit: Unit) -> Self {
        let unit_id = unit
            .code
            .bytes()
            .fold(0, |id, letter| (id << 8) | i32::from(letter));
        ExtensionObject::from_message(EUInformation {
            namespace_uri: UAString::from("http://www.opcfoundation.org/UA/units/un/cefact"),
            unit_id,
            display_name: LocalizedText::from(unit.sign),
            description: LocalizedText::from(unit.name),
        })
        .into()
    }
}

/// Returns the lowest and highest value.
pub fn range(low: f64, high: f64) -> Variant {
    ExtensionObject::from_message(Range { low, high }).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_identifier_of_a_unit_is_its_code() {
        let Variant::ExtensionObject(millimetre) = Variant::from(MILLIMETRE) else {
            unreachable!("a unit is a structure");
        };
        // UNECE_to_OPCUA.csv of the OPC Foundation: MMT is 5066068
        let unit = millimetre.inner_as::<EUInformation>().map(|unit| unit.unit_id);
        assert_eq!(unit, Some(5_066_068));
    }
}
