//! Path segments to motion profiles: ramps, limits, look-ahead.
//!
//! [`Planner`] is pure: the same segments give the same profiles. A profile is position as a function of time in
//! closed form ([`Law`](tandem_model::profile::Law)); the servo cycle evaluates it and scales its time.
//!
//! In this version each segment ends at rest: blending and look-ahead (motion-semantics 1b, 1d) are not built, so a
//! segment that may blend ([`SegmentEnd::Continuous`](tandem_model::flow::SegmentEnd::Continuous)) comes to rest
//! too, with the same in-position check as an exact stop.
//!
//! Decisions of ours: the rapid limits of a motor are taken as they are, also where they are above its maxima; G01
//! is held to `max_velocity` but not to `max_acceleration` (manual: not checked in G501).

mod planner;
mod ramped;
mod rapid;

pub use planner::Planner;
