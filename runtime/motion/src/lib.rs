//! Conversion of path segments to motion profiles: ramps, limits, look-ahead.
//!
//! [`Planner`] is pure: the same segments give the same profiles. A profile is position as a function of time in closed
//! form ([`Law`](tandem_model::profile::Law)), which the servo cycle evaluates while it scales its time.
//!
//! Segments that may blend ([`SegmentEnd::Continuous`](tandem_model::flow::SegmentEnd::Continuous)) form a
//! chain with superposed ramps (M1b, G501). With G500 a chain keeps its path, or with a path tolerance
//! receives a smoother one (`smooth`). It slows down before a motor would exceed its maximum acceleration
//! (M1d, `look_ahead`).
//!
//! Decisions: The rapid limits of a motor apply as configured, even above its maxima. With G501 a block at
//! feedrate respects `max_velocity` but not `max_acceleration`, because the manual does not check
//! `max_acceleration` with G501. With G500 the block respects both.

mod block;
mod chain;
mod chain_check;
mod limit;
mod look_ahead;
mod planner;
mod ramped;
mod rapid;
mod record;
mod replan;
pub mod rules;
mod smooth;
mod smooth_block;
mod tapping;

pub use chain_check::{ChainCheck, ExceededLimit, MissedCorner};
pub use planner::Planner;
pub use ramped::speed_limit;
pub use replan::Replan;
