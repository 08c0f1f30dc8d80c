//! Plans of coordinate systems, for observers of a simulation.

use std::sync::Arc;

use parking_lot::Mutex;
use plc_protocol::types::CoordinateSystemNumber;
use tandem_model::flow::Segment;
use tandem_model::profile::Profile;

/// Part of the plan of a coordinate system, in the order of execution.
#[derive(Debug, Clone, Copy)]
pub enum PlannedMotion<'a> {
    /// A piece of the toolpath. Its profiles follow.
    Segment {
        /// Number of the segment.
        number: u64,
        /// Geometry of the segment, with F as programmed.
        segment: &'a Segment,
        /// F within the limits of the coordinate system and its motors, in path units per second; `None` if the motion
        /// is not at feedrate.
        speed_limit: Option<f64>,
    },
    /// A profile: position as a function of time.
    Profile(&'a Profile),
}

type Callback = dyn FnMut(CoordinateSystemNumber, PlannedMotion<'_>) + Send;

/// Callback that receives the plans of each coordinate system.
#[derive(Clone)]
pub struct OnPlan(Arc<Mutex<Callback>>);

impl OnPlan {
    /// Creates a callback from a function.
    pub fn new(callback: impl FnMut(CoordinateSystemNumber, PlannedMotion<'_>) + Send + 'static) -> Self {
        Self(Arc::new(Mutex::new(callback)))
    }

    pub(crate) fn call(&self, cs: CoordinateSystemNumber, planned: PlannedMotion<'_>) {
        (self.0.lock())(cs, planned);
    }
}

impl std::fmt::Debug for OnPlan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OnPlan").finish_non_exhaustive()
    }
}
