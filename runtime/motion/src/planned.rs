//! The result of planning one block by itself.

use tandem_model::profile::{Law, TimeBase};

/// The longest profile, s: about 31 years. A longer one is an alarm, so that counting servo periods stays exact.
pub(crate) const DURATION_MAX_S: f64 = 1e9;

/// A law with the time that it takes and what scales it.
pub(crate) struct Planned {
    pub(crate) law: Law,
    pub(crate) duration_s: f64,
    pub(crate) time_base: TimeBase,
}
