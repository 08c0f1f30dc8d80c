//! Parameters of an auxiliary function output.

use serde::{Deserialize, Serialize};

/// Parameters VA to VH of an output, in JSON `A` to `H`: numbers as the program gives them, without a unit
/// (G20 and G21 do not change them); `None` if not programmed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "UPPERCASE", default, deny_unknown_fields)]
pub struct Params {
    /// Parameter VA.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub a: Option<f64>,
    /// Parameter VB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub b: Option<f64>,
    /// Parameter VC.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub c: Option<f64>,
    /// Parameter VD.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d: Option<f64>,
    /// Parameter VE.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub e: Option<f64>,
    /// Parameter VF.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f: Option<f64>,
    /// Parameter VG.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub g: Option<f64>,
    /// Parameter VH.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub h: Option<f64>,
}

/// Defines a function for each field that returns its value.
macro_rules! readers {
    ($($name:ident)*) => {
        impl Params {
            $(
                /// Returns the value, or `None` if the parameter is not programmed.
                pub fn $name(&self) -> Option<f64> {
                    self.$name
                }
            )*
        }
    };
}

readers!(a b c d e f g h);

impl From<[Option<f64>; 8]> for Params {
    fn from([a, b, c, d, e, f, g, h]: [Option<f64>; 8]) -> Self {
        Self {
            a,
            b,
            c,
            d,
            e,
            f,
            g,
            h,
        }
    }
}
