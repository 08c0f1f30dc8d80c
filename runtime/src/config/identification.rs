//! `[identification]`: what the nameplate of the machine says.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[identification]`: what the nameplate of the machine says, for those who read the machine by OPC UA, MTConnect, MQTT or REST.
#[derive(Debug, Clone, Default, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct IdentificationConfig {
    /// Who built the machine.
    pub manufacturer: Option<String>,
    /// What its builder calls machines of its kind.
    pub model: Option<String>,
    /// What its builder tells it from others by.
    pub serial_number: Option<String>,
    /// A URI that names it among all machines in the world, such as `urn:example.com:mill:4711`.
    pub product_instance_uri: Option<String>,
    /// Where it stands, such as `hall 2, cell 4`.
    pub location: Option<String>,
    /// When it was built.
    #[schemars(range(min = 1900, max = 2999))]
    pub year_of_construction: Option<u16>,
}
