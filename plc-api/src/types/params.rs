//! Parameters of an auxiliary function output.

use serde::{Deserialize, Serialize};

/// VA to VH of an output, in JSON `A` to `H`: numbers as the program gives them, without a unit (G20 and G21 do not
/// change them); `None`: not programmed.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "UPPERCASE", default, deny_unknown_fields)]
pub struct Params {
    /// VA.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub a: Option<f64>,
    /// VB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub b: Option<f64>,
    /// VC.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub c: Option<f64>,
    /// VD.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub d: Option<f64>,
    /// VE.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub e: Option<f64>,
    /// VF.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub f: Option<f64>,
    /// VG.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub g: Option<f64>,
    /// VH.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub h: Option<f64>,
}

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

impl Params {
    /// VA.
    pub fn a(&self) -> Option<f64> {
        self.a
    }
    /// VB.
    pub fn b(&self) -> Option<f64> {
        self.b
    }
    /// VC.
    pub fn c(&self) -> Option<f64> {
        self.c
    }
    /// VD.
    pub fn d(&self) -> Option<f64> {
        self.d
    }
    /// VE.
    pub fn e(&self) -> Option<f64> {
        self.e
    }
    /// VF.
    pub fn f(&self) -> Option<f64> {
        self.f
    }
    /// VG.
    pub fn g(&self) -> Option<f64> {
        self.g
    }
    /// VH.
    pub fn h(&self) -> Option<f64> {
        self.h
    }
}
