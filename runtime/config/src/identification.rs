//! `[identification]`: the nameplate of the machine.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[identification]`: the nameplate of the machine, for clients over OPC UA, MTConnect, MQTT and REST.
#[derive(Debug, Clone, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct IdentificationConfig {
    /// Manufacturer of the machine.
    pub manufacturer: Option<String>,
    /// Model name of the manufacturer.
    pub model: Option<String>,
    /// Serial number of the manufacturer.
    pub serial_number: Option<String>,
    /// A URI that identifies the machine worldwide, such as `urn:example.com:mill:4711`.
    pub product_instance_uri: Option<String>,
    /// Location of the machine, such as `hall 2, cell 4`.
    pub location: Option<String>,
    /// Year of construction.
    #[schemars(range(min = 1900, max = 2999))]
    pub year_of_construction: Option<u16>,
}
