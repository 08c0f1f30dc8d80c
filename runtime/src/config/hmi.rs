//! `[hmi]`: what a machine builder adds to the HMI.

use std::path::PathBuf;

use plc_api::wire::hmi::{HmiButton, HmiCard};
use schemars::JsonSchema;
use serde::Deserialize;

/// `[hmi]`
#[derive(Debug, Clone, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HmiConfig {
    /// Folder with pages and modules of one's own, served below `/hmi/` to everyone who reaches the HMI: endings html, js, mjs, css,
    /// json, txt, svg, png, jpg, jpeg, webp, gif, ico, woff2, mp3, wav, mp4, pdf and webmanifest.
    pub dir: Option<PathBuf>,
    /// Addresses of further machines that the page of several machines shows, such as `http://mill-2:8080`; at most 31.
    pub machines: Vec<String>,
    /// `[[hmi.button]]`
    pub button: Vec<HmiButton>,
    /// `[[hmi.card]]`
    pub card: Vec<HmiCard>,
}
