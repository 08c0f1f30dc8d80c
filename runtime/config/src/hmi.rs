//! `[hmi]`: additions of a machine builder to the HMI.

use std::path::PathBuf;

use plc_protocol::wire::hmi::{HmiButton, HmiCard, JOG_STEP_MAX_DEFAULT};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// `[hmi]`
#[derive(Debug, Clone, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct HmiConfig {
    /// Folder with your own pages and modules, served below `/hmi/` to every client that reaches the HMI. File types:
    /// html, js, mjs, css, json, txt, svg, png, jpg, jpeg, webp, gif, ico, woff2, mp3, wav, mp4, pdf and webmanifest.
    pub dir: Option<PathBuf>,
    /// Addresses of further machines for the page that shows several machines, such as `http://mill-2:8080`; at most
    /// 31.
    pub machines: Vec<String>,
    /// Longest jog that needs no refresh, on every transport. Such a jog moves its whole distance unless it
    /// is stopped.
    #[schemars(range(min = 0, max = 1000), extend("x-unit" = "mm or deg"))]
    pub jog_step_max: f64,
    /// Every client that reaches the HMI may hold, stop and abort without a login. After 20 at once, one verb is
    /// limited to 5 per second for each host and coordinate system; further ones are delayed.
    /// For panels at the machine.
    pub stop_without_login: bool,
    /// `[[hmi.button]]`
    pub button: Vec<HmiButton>,
    /// `[[hmi.card]]`
    pub card: Vec<HmiCard>,
}

impl Default for HmiConfig {
    fn default() -> Self {
        Self {
            dir: None,
            machines: Vec::new(),
            jog_step_max: JOG_STEP_MAX_DEFAULT,
            stop_without_login: false,
            button: Vec::new(),
            card: Vec::new(),
        }
    }
}
